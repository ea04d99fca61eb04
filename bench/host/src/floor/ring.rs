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
use std::os::fd::{AsFd as _, OwnedFd};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Duration;

use analysis::series::histogram;
use clap::ValueEnum;
use errors::Failure;
use hdrhistogram::Histogram;
use ipc::clock::{now_ns, timespec};
use ipc::sys::{BELLS, WakePage};
use process::rt::{Standing, fifo_refusal, loops_cpu, take_stand};
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::io::Errno;
use rustix::thread::futex;

use super::timer::{PeriodicTimer, Schedule, on_a_thread, stay_awake};

#[derive(Clone, Debug)]
pub struct RingSettings {
    pub wake: WakeMechanism,
    /// The priority is that of the first process; each later one has one more, as the loops have. A period of 0 lets lap
    /// follow lap without a timer.
    pub schedule: Schedule,
    /// What each process computes before it wakes the next one: as many as there are processes, 2 to 64.
    pub work: Vec<Work>,
    pub rehearsal: Option<RingRehearsal>,
}

/// A token that goes around before each tick and is not recorded.
#[derive(Clone, Copy, Debug)]
pub struct RingRehearsal {
    /// How far ahead of a tick the timer is set [ns].
    pub lead_ns: u64,
    /// Time that must be left for a rehearsal to begin [ns].
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
    if !(2..=BELLS).contains(&processes) {
        let mistake = format!("a ring has 2 to {BELLS} processes, not {processes}");
        return Err(Failure::usage(mistake));
    }
    // The processes end with the thread that starts them.
    on_a_thread("ring floor", move || {
        let Schedule { cpu, priority, .. } = settings.schedule;
        let cpu = cpu.unwrap_or_else(loops_cpu);
        let highest = priority + processes as i32 - 1;
        let refusal = fifo_refusal(highest).filter(|_| priority > 0);
        let priority = if refusal.is_some() { 0 } else { priority };
        let links = Links::new(settings.wake, processes)?;
        // Before this thread takes its stand: a process inherits the scheduling of the thread that starts it.
        let others = Others::start(&executable, &links, cpu, priority, &settings.work)?;
        let mut standing = take_stand(cpu, priority);
        let refusal = refusal.map(|reason| format!("SCHED_FIFO {highest}: {reason}"));
        standing.refused.extend(refusal);
        let _awake = stay_awake(&mut standing);
        let measured = go_around(&mut links.first()?, &settings, standing);
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
    link.ring(END)?;
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
    link.ring(now_ns())?;
    link.wait(Some(TIMEOUT))
}

struct Others(Vec<Child>);

impl Others {
    fn start(
        executable: &Path,
        links: &Links,
        cpu: usize,
        priority: i32,
        work: &[Work],
    ) -> Result<Self, Failure> {
        let (wake, processes) = match links {
            Links::Eventfd(counters) => ("eventfd", counters.len()),
            Links::Futex { processes, .. } => ("futex", *processes),
        };
        let launcher = std::process::id();
        let mut others = Self(Vec::new());
        for (position, work) in work.iter().enumerate().skip(1) {
            let own_priority = match priority {
                0 => 0,
                priority => priority + position as i32,
            };
            let arguments = format!(
                "ring-hop --wake {wake} --position {position} --processes {processes} --cpu {cpu} \
                 --priority {own_priority} --work {} --launcher {launcher}",
                work.iterations
            );
            let (stdin, stdout) = links.of(position)?;
            let child = Command::new(executable)
                .args(arguments.split(' '))
                .stdin(stdin)
                .stdout(stdout)
                .spawn()
                .map_err(|e| Failure::failed(format!("cannot start a process of the ring: {e}")))?;
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

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WakeMechanism {
    /// A counter of the kernel: one `write` to ring, one `read` to wait.
    Eventfd,
    /// A word in shared memory: one `futex` call to ring, one to wait.
    Futex,
}

/// Ends the ring in the place of a token; the largest number that an eventfd takes.
pub const END: u64 = u64::MAX - 1;

/// The place of a process in the ring: what it waits on and what it wakes.
pub enum Link {
    Eventfd {
        own: OwnedFd,
        next: OwnedFd,
    },
    Futex {
        page: WakePage,
        own: usize,
        next: usize,
        /// How often the own one had been notified when it was last read.
        heard: u32,
    },
}

fn failed<E: std::fmt::Display>(what: &str) -> impl Fn(E) -> Failure {
    move |e| Failure::failed(format!("{what}: {e}"))
}

impl Link {
    /// The link of a process of `Others`: its end of the ring are its standard streams.
    pub fn inherited(
        wake: WakeMechanism,
        position: usize,
        processes: usize,
    ) -> Result<Self, Failure> {
        let (stdin, stdout) = (std::io::stdin(), std::io::stdout());
        let link = match wake {
            WakeMechanism::Eventfd => stdin.as_fd().try_clone_to_owned().and_then(|own| {
                let next = stdout.as_fd().try_clone_to_owned()?;
                Ok(Self::Eventfd { own, next })
            }),
            WakeMechanism::Futex => WakePage::map(stdin.as_fd()).map(|page| Self::Futex {
                page,
                own: position,
                next: (position + 1) % processes,
                heard: 0,
            }),
        };
        link.map_err(|e| {
            failed("standard input and output are no link of a ring")(e)
                .or_code(errors::USAGE)
                .help("`ironbird doctor` starts these processes by itself")
        })
    }

    pub fn ring(&self, token: u64) -> Result<(), Failure> {
        match self {
            Self::Eventfd { next, .. } => rustix::io::write(next, &token.to_ne_bytes())
                .map(drop)
                .map_err(failed("cannot ring an eventfd")),
            Self::Futex { page, next, .. } => {
                let bell = &page[*next];
                bell.token.store(token, Ordering::Relaxed);
                bell.rung.fetch_add(1, Ordering::Release);
                futex::wake(&bell.rung, futex::Flags::empty(), 1)
                    .map(drop)
                    .map_err(failed("cannot wake a futex"))
            }
        }
    }

    pub fn wait(&mut self, timeout: Option<Duration>) -> Result<u64, Failure> {
        let timeout = timeout.map(|timeout| timespec(timeout.as_nanos() as u64));
        let silent = || Failure::failed("a process of the ring hangs or has died");
        match self {
            Self::Eventfd { own, .. } => {
                if timeout.is_some() {
                    let ready = poll(&mut [PollFd::new(own, PollFlags::IN)], timeout.as_ref());
                    if ready.map_err(failed("cannot wait for an eventfd"))? == 0 {
                        return Err(silent());
                    }
                }
                let mut token = [0; 8];
                match rustix::io::read(own, &mut token) {
                    Ok(8) => Ok(u64::from_ne_bytes(token)),
                    Ok(_) => Err(silent()),
                    Err(e) => Err(failed("cannot read an eventfd")(e)),
                }
            }
            Self::Futex {
                page, own, heard, ..
            } => {
                let bell = &page[*own];
                loop {
                    let rung = bell.rung.load(Ordering::Acquire);
                    if rung != *heard {
                        *heard = rung;
                        return Ok(bell.token.load(Ordering::Relaxed));
                    }
                    match futex::wait(&bell.rung, futex::Flags::empty(), rung, timeout.as_ref()) {
                        Ok(()) | Err(Errno::AGAIN | Errno::INTR) => {}
                        Err(Errno::TIMEDOUT) => return Err(silent()),
                        Err(e) => return Err(failed("cannot wait for a futex")(e)),
                    }
                }
            }
        }
    }
}

enum Links {
    Eventfd(Vec<OwnedFd>),
    Futex { file: OwnedFd, processes: usize },
}

impl Links {
    fn new(wake: WakeMechanism, processes: usize) -> Result<Self, Failure> {
        match wake {
            WakeMechanism::Eventfd => (0..processes)
                .map(|_| eventfd(0, EventfdFlags::CLOEXEC))
                .collect::<Result<_, _>>()
                .map(Self::Eventfd)
                .map_err(failed("cannot make an eventfd")),
            WakeMechanism::Futex => page_file()
                .map(|file| Self::Futex { file, processes })
                .map_err(failed("cannot make a memory file")),
        }
    }

    fn first(&self) -> Result<Link, Failure> {
        match self {
            Self::Eventfd(counters) => Ok(Link::Eventfd {
                own: clone(&counters[0])?,
                next: clone(&counters[1])?,
            }),
            Self::Futex { file, .. } => Ok(Link::Futex {
                page: WakePage::map(file.as_fd()).map_err(failed("cannot map a memory file"))?,
                own: 0,
                next: 1,
                heard: 0,
            }),
        }
    }

    fn of(&self, position: usize) -> Result<(Stdio, Stdio), Failure> {
        Ok(match self {
            Self::Eventfd(counters) => {
                let next = &counters[(position + 1) % counters.len()];
                (clone(&counters[position])?.into(), clone(next)?.into())
            }
            Self::Futex { file, .. } => (clone(file)?.into(), Stdio::null()),
        })
    }
}

fn page_file() -> Result<OwnedFd, Errno> {
    let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
    let file = memfd_create("ironbird-ring", flags)?;
    ftruncate(&file, WakePage::BYTES as u64)?;
    fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    Ok(file)
}

fn clone(descriptor: &OwnedFd) -> Result<OwnedFd, Failure> {
    descriptor
        .try_clone()
        .map_err(failed("cannot duplicate a descriptor"))
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
