//! The floor of the loop: processes that pass a token around a ring once per tick.
//!
//! ```text
//!   timer -> first process --wake--> second --wake--> ... --wake--> last --wake--> first, which waits for the timer
//!            |<------------------- chain ---------------------------->|
//!            |<------------------- lap --------------------------------------------->|
//! ```
//!
//! The ring does what the loops do, except control: no middleware and no messages, but the same processor and
//! priorities. `chain` is comparable with the series `loop` of a flight. The first process is this one, on a thread of
//! its own. The others run the same executable.

use std::hint::black_box;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::{Child, Command};
use std::sync::atomic::Ordering;
use std::time::Duration;

use analysis::series::histogram;
use errors::Failure;
use hdrhistogram::Histogram;
use ipc::clock::{now_ns, timespec};
use ipc::sys::{EVENTS, WakePage};
use process::rt::{Standing, fifo_refusal, loop_processors, loops_cpu, take_stand};
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::io::{Errno, fcntl_dupfd_cloexec};
use rustix::thread::futex;

use super::timer::{PeriodicTimer, Schedule, on_a_thread, stay_awake};

#[derive(Clone, Debug, Default)]
pub struct RingSettings {
    /// The priority is that of the first process; each later one has one more, as the loops have. A period of 0 lets lap
    /// follow lap without a timer.
    pub schedule: Schedule,
    /// What each process computes before it wakes the next one: as many as there are processes, 2 to 64.
    pub work: Vec<Work>,
    pub rehearsal: Option<RingRehearsal>,
    /// Whether each process waits for an eventfd, which holds the token, and not for a futex.
    pub by_eventfd: bool,
    /// How long a process reads its event in a loop before it waits in the kernel [ns]. Where it does, there are two
    /// processes, each on a processor of its own, and the token goes around twice per tick.
    pub polls_ns: u64,
}

/// A token that goes around before each tick and is not recorded.
#[derive(Clone, Copy, Debug)]
pub struct RingRehearsal {
    /// How far ahead of a tick the timer is set [ns].
    pub lead_ns: u64,
    /// Time that must be left for a warm-up run to begin [ns].
    pub needs_ns: u64,
}

#[derive(Clone, Debug)]
pub struct RingFloor {
    /// From the first process' begin to the instant before the last one wakes it [ns].
    pub chain: Histogram<u64>,
    /// From the first process' begin to its having the token back [ns].
    pub lap: Histogram<u64>,
    /// From the beginning of each tick to the first process' waking [ns]; ticks slept through with their whole
    /// lateness.
    pub lateness: Histogram<u64>,
    pub ticks_run: u64,
    /// Ticks slept through, or over before the token was back.
    pub ticks_skipped: u64,
    /// What the first process was granted; the others have the same.
    pub standing: Standing,
}

/// Laps that are not recorded: until the processes are there and warm.
const WARM_UP: u32 = 100;
/// How long a token may take before the ring counts as broken; the processes' start is in it.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Measures with processes of an `ironbird` executable: usually the present one.
pub fn measure(settings: &RingSettings, executable: &Path) -> Result<RingFloor, Failure> {
    let (settings, executable) = (settings.clone(), executable.to_owned());
    let processes = settings.work.len();
    if !(2..=EVENTS).contains(&processes) {
        let mistake = format!("a ring has 2 to {EVENTS} processes, not {processes}");
        return Err(Failure::usage(mistake));
    }
    // The processes end with the thread that starts them.
    on_a_thread("ring floor", move || {
        let Schedule { cpu, priority, .. } = settings.schedule;
        let cpu = cpu.unwrap_or_else(loops_cpu);
        let highest = priority + processes as i32 - 1;
        let refusal = fifo_refusal(highest).filter(|_| priority > 0);
        let priority = if refusal.is_some() { 0 } else { priority };
        let ends = ends(settings.by_eventfd, processes).map_err(failed("cannot make a ring"))?;
        // Before this thread takes its stand: a process inherits the scheduling of the thread that starts it.
        let others = Others::start(&executable, &ends, cpu, priority, &settings)?;
        let mut standing = take_stand(cpu, priority);
        let refusal = refusal.map(|reason| format!("SCHED_FIFO {highest}: {reason}"));
        standing.refused.extend(refusal);
        let _awake = stay_awake(&mut standing);
        let (by_eventfd, polls_ns) = (settings.by_eventfd, settings.polls_ns);
        let mut link = Link::new(by_eventfd, [&ends[0], &ends[1]], 0, processes, polls_ns)?;
        let measured = go_around(&mut link, &settings, standing);
        drop(others);
        measured
    })
}

fn go_around(
    link: &mut Link,
    settings: &RingSettings,
    standing: Standing,
) -> Result<RingFloor, Failure> {
    for _ in 0..WARM_UP {
        pass_around(link, Work::default())?;
    }
    let laps = if settings.polls_ns > 0 { 2 } else { 1 };
    let pass_around = |link: &mut Link, work| (0..laps).try_fold(0, |_, _| pass_around(link, work));
    let (mut chain, mut lap) = (histogram()?, histogram()?);
    let (work, schedule) = (settings.work[0], &settings.schedule);
    let mut timer = match schedule.period_ns {
        0 => None,
        period_ns => Some(PeriodicTimer::new(period_ns, schedule.duration)?),
    };
    let rehearsal = settings.rehearsal;
    let (lead_ns, needs_ns) = rehearsal.map_or((0, u64::MAX), |it| (it.lead_ns, it.needs_ns));
    let mut start_ns = now_ns();
    let end_ns = start_ns + schedule.duration.as_nanos() as u64;
    loop {
        if let Some(timer) = &mut timer {
            let mut rehearsed = Ok(0);
            let woken = timer.next_wake(lead_ns, |left_ns| {
                if left_ns >= needs_ns {
                    rehearsed = pass_around(link, work);
                }
            });
            rehearsed?;
            if woken.is_none() {
                break;
            }
            // The periodic timer's own records are none of the ring's time.
            start_ns = now_ns();
        } else if start_ns >= end_ns {
            break;
        }
        let sent_ns = pass_around(link, work)?;
        let back_ns = now_ns();
        lap.saturating_record(back_ns - start_ns);
        chain.saturating_record(sent_ns.saturating_sub(start_ns));
        start_ns = back_ns;
    }
    link.notify(END)?;
    let (ticks_run, ticks_skipped, lateness) = match timer {
        Some(timer) => (timer.ticks_run(), timer.skipped, timer.lateness),
        None => (lap.len(), 0, histogram()?),
    };
    Ok(RingFloor {
        chain,
        lap,
        lateness,
        ticks_run,
        ticks_skipped,
        standing,
    })
}

fn pass_around(link: &mut Link, work: Work) -> Result<u64, Failure> {
    work.run();
    link.notify(now_ns())?;
    link.wait(Some(TIMEOUT))
}

struct Others(Vec<Child>);

impl Others {
    fn start(
        executable: &Path,
        ends: &[OwnedFd],
        cpu: usize,
        priority: i32,
        settings: &RingSettings,
    ) -> Result<Self, Failure> {
        let RingSettings { work, polls_ns, .. } = settings;
        let (processes, launcher) = (work.len(), std::process::id());
        let cpus = match polls_ns {
            0 => vec![cpu],
            _ => loop_processors(cpu, processes),
        };
        let end = |position: usize| {
            let end = ends[position % processes].try_clone();
            end.map_err(failed("cannot duplicate a descriptor"))
        };
        let by_eventfd = ["", " --by-eventfd"][usize::from(settings.by_eventfd)];
        let mut others = Self(Vec::new());
        for (position, Work { iterations }) in work.iter().enumerate().skip(1) {
            let priority = priority + position as i32 * priority.signum();
            let cpu = cpus[position % cpus.len()];
            let arguments = format!(
                "ring-hop --position {position} --processes {processes} --cpu {cpu} --priority {priority} \
                 --work {iterations} --polls-ns {polls_ns} --launcher {launcher}{by_eventfd}"
            );
            let child = Command::new(executable)
                .args(arguments.split(' '))
                .stdin(end(position)?)
                .stdout(end(position + 1)?)
                .spawn()
                .map_err(failed("cannot start a process of the ring"))?;
            others.0.push(child);
        }
        Ok(others)
    }
}

impl Drop for Others {
    fn drop(&mut self) {
        for child in &mut self.0 {
            // After the last token they end by themselves; only one that hangs needs it.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Ends the ring in the place of a token; the largest number that an eventfd takes.
pub const END: u64 = u64::MAX - 1;

/// The place of a process in the ring: what it waits for and what it notifies.
pub enum Link {
    Eventfd([OwnedFd; 2]),
    Futex {
        page: WakePage,
        own: usize,
        next: usize,
        /// How often the own event had been notified when it was last read.
        seen: u32,
        polls_ns: u64,
    },
}

fn failed<E: std::fmt::Display>(what: &str) -> impl Fn(E) -> Failure {
    move |e| Failure::failed(format!("{what}: {e}"))
}

impl Link {
    fn new(
        by_eventfd: bool,
        ends: [impl AsFd; 2],
        position: usize,
        processes: usize,
        polls_ns: u64,
    ) -> Result<Self, Failure> {
        let [own, next] = ends.each_ref().map(AsFd::as_fd);
        let link = if by_eventfd {
            let both = (own.try_clone_to_owned(), next.try_clone_to_owned());
            both.0.and_then(|own| Ok(Self::Eventfd([own, both.1?])))
        } else {
            WakePage::map(own).map(|page| Self::Futex {
                page,
                own: position,
                next: (position + 1) % processes,
                seen: 0,
                polls_ns,
            })
        };
        link.map_err(failed("cannot join a ring"))
    }

    /// The link of a process of `Others`: its standard streams are its ends.
    pub fn inherited(
        by_eventfd: bool,
        position: usize,
        processes: usize,
        polls_ns: u64,
    ) -> Result<Self, Failure> {
        let (own, next) = (std::io::stdin(), std::io::stdout());
        let ends = [own.as_fd(), next.as_fd()];
        Self::new(by_eventfd, ends, position, processes, polls_ns).map_err(|e| {
            failed("standard input is no link of a ring")(e)
                .or_code(errors::USAGE)
                .help("`ironbird doctor` starts these processes by itself")
        })
    }

    pub fn notify(&self, token: u64) -> Result<(), Failure> {
        match self {
            Self::Eventfd([_, next]) => rustix::io::write(next, &token.to_ne_bytes())
                .map(drop)
                .map_err(failed("cannot write to an eventfd")),
            Self::Futex { page, next, .. } => {
                let event = &page[*next];
                event.token.store(token, Ordering::Relaxed);
                event.count.fetch_add(1, Ordering::SeqCst);
                if event.polled.load(Ordering::SeqCst) == 1 {
                    return Ok(());
                }
                futex::wake(&event.count, futex::Flags::empty(), 1)
                    .map(drop)
                    .map_err(failed("cannot wake a futex"))
            }
        }
    }

    pub fn wait(&mut self, timeout: Option<Duration>) -> Result<u64, Failure> {
        let timeout = timeout.map(|timeout| timespec(timeout.as_nanos() as u64));
        let silent = || Failure::failed("a process of the ring hangs or has died");
        let (event, seen, polls_ns) = match self {
            Self::Eventfd([own, _]) => {
                if timeout.is_some() {
                    let ready = poll(&mut [PollFd::new(own, PollFlags::IN)], timeout.as_ref());
                    if ready.map_err(failed("cannot wait for an eventfd"))? == 0 {
                        return Err(silent());
                    }
                }
                let mut token = [0; 8];
                return match rustix::io::read(own, &mut token) {
                    Ok(8) => Ok(u64::from_ne_bytes(token)),
                    Ok(_) => Err(Failure::failed("standard input is no eventfd")),
                    Err(e) => Err(failed("cannot read an eventfd")(e)),
                };
            }
            Self::Futex {
                page,
                own,
                seen,
                polls_ns,
                ..
            } => (&page[*own], seen, *polls_ns),
        };
        if polls_ns > 0 {
            event.polled.store(1, Ordering::SeqCst);
            let until_ns = now_ns() + polls_ns;
            while event.count.load(Ordering::Acquire) == *seen && now_ns() < until_ns {}
            event.polled.store(0, Ordering::SeqCst);
        }
        loop {
            let count = event.count.load(Ordering::SeqCst);
            if count != *seen {
                *seen = count;
                return Ok(event.token.load(Ordering::Relaxed));
            }
            match futex::wait(&event.count, futex::Flags::empty(), count, timeout.as_ref()) {
                Ok(()) | Err(Errno::AGAIN | Errno::INTR) => {}
                Err(Errno::TIMEDOUT) => return Err(silent()),
                Err(e) => return Err(failed("cannot wait for a futex")(e)),
            }
        }
    }
}

/// What the processes of a ring wait for, in their order: an eventfd each, or a page with a futex for each.
fn ends(by_eventfd: bool, processes: usize) -> Result<Vec<OwnedFd>, Errno> {
    if by_eventfd {
        let ends = (0..processes).map(|_| eventfd(0, EventfdFlags::CLOEXEC));
        return ends.collect();
    }
    let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
    let page = memfd_create("ironbird-ring", flags)?;
    ftruncate(&page, WakePage::BYTES as u64)?;
    fcntl_add_seals(&page, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    let ends = (0..processes).map(|_| fcntl_dupfd_cloexec(&page, 0));
    ends.collect()
}

/// The stand-in for a law: iterations of a chain of dependent multiplications.
///
/// A wait by the clock would hide a preemption; a fixed amount of work is prolonged by it, as a law is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    pub iterations: u64,
}

impl Work {
    /// The work that takes this processor about `ns` undisturbed: calibrated by the best of some trials.
    pub fn lasting(ns: u64) -> Self {
        const TRIAL: Work = Work { iterations: 20_000 };
        const TRIALS: u32 = 20;
        let timed = |_| {
            let start_ns = now_ns();
            TRIAL.run();
            now_ns() - start_ns
        };
        let trial_ns = (0..TRIALS).map(timed).min().unwrap_or(1).max(1);
        Self {
            iterations: ns * TRIAL.iterations / trial_ns,
        }
    }

    pub fn run(self) {
        let mut x = black_box(1.0_f64);
        for _ in 0..self.iterations {
            x = x * 0.999_999 + 1e-6;
        }
        black_box(x);
    }
}
