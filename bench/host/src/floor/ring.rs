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
use std::process::Child;
use std::sync::atomic::Ordering;
use std::time::Duration;

use analysis::series::Latencies;
use errors::Failure;
use ipc::clock::{now_ns, timespec};
use ipc::sys::{EVENTS, WakePage};
use process::rt::{Standing, fifo_refusal, loops_cpu, take_stand};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::io::Errno;
use rustix::thread::futex;

use super::timer::{PeriodicTimer, Schedule, on_a_thread, stay_awake};

#[derive(Clone, Debug)]
pub struct RingFloor {
    /// From the first process' begin to the instant before the last one wakes it [ns].
    pub chain: Latencies,
    /// From the first process' begin to its having the token back [ns].
    pub lap: Latencies,
    /// Ticks slept through, or over before the token was back.
    pub ticks_skipped: u64,
    /// What the first process was granted; the others have the same.
    pub standing: Standing,
}

/// Laps that are not recorded: until the processes are there and warm.
const WARM_UP: u32 = 100;
/// How long a token may take before the ring counts as broken; the processes' start is in it.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Measures with processes of an `ironbird` executable: usually the present one. The priority is that of the first
/// process; each later one has one more, as the loops have. `work` is what each process computes before it wakes the
/// next one: as many as there are processes, 2 to 64.
pub fn measure(
    schedule: &Schedule,
    work: Vec<Work>,
    executable: &Path,
) -> Result<RingFloor, Failure> {
    let (schedule, executable) = (schedule.clone(), executable.to_owned());
    let processes = work.len();
    if !(2..=EVENTS).contains(&processes) {
        let mistake = format!("a ring has 2 to {EVENTS} processes, not {processes}");
        return Err(Failure::usage(mistake));
    }
    // The processes end with the thread that starts them.
    on_a_thread("ring floor", move || {
        let Schedule { cpu, priority, .. } = schedule;
        let cpu = cpu.unwrap_or_else(loops_cpu);
        let highest = priority + processes as i32 - 1;
        let refusal = fifo_refusal(highest).filter(|_| priority > 0);
        let priority = if refusal.is_some() { 0 } else { priority };
        let page = page().map_err(failed("cannot make a ring"))?;
        // Before this thread takes its stand: a process inherits the scheduling of the thread that starts it.
        let others = Others::start(&executable, &page, cpu, priority, &work)?;
        let mut standing = take_stand(cpu, priority);
        let refusal = refusal.map(|reason| format!("SCHED_FIFO {highest}: {reason}"));
        standing.refused.extend(refusal);
        let _awake = stay_awake(&mut standing);
        let mut link = Link::new(&page, 0, processes)?;
        let measured = go_around(&mut link, &schedule, work[0], standing);
        drop(others);
        measured
    })
}

fn go_around(
    link: &mut Link,
    schedule: &Schedule,
    work: Work,
    standing: Standing,
) -> Result<RingFloor, Failure> {
    for _ in 0..WARM_UP {
        pass_around(link, Work::default())?;
    }
    let (mut chain, mut lap) = (Latencies::new()?, Latencies::new()?);
    let mut timer = PeriodicTimer::new(schedule.period_ns, schedule.duration)?;
    while timer.next_wake().is_some() {
        // The periodic timer's own records are none of the ring's time.
        let start_ns = now_ns();
        let sent_ns = pass_around(link, work)?;
        lap.record(now_ns() - start_ns);
        chain.record(sent_ns.saturating_sub(start_ns));
    }
    link.notify(END)?;
    Ok(RingFloor {
        chain,
        lap,
        ticks_skipped: timer.skipped,
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
        page: &OwnedFd,
        cpu: usize,
        priority: i32,
        work: &[Work],
    ) -> Result<Self, Failure> {
        let processes = work.len();
        let mut others = Self(Vec::new());
        for (position, Work { iterations }) in work.iter().enumerate().skip(1) {
            let priority = priority + position as i32 * priority.signum();
            let arguments = format!(
                "--position {position} --processes {processes} --cpu {cpu} --priority {priority} \
                 --work {iterations}"
            );
            let page = page.try_clone();
            let page = page.map_err(failed("cannot duplicate a descriptor"))?;
            let child = process::signals::child(executable, "ring-hop")
                .args(arguments.split(' '))
                .stdin(page)
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

/// Ends the ring in the place of a token.
pub const END: u64 = u64::MAX;

/// The place of a process in the ring: what it waits for and what it notifies.
pub struct Link {
    page: WakePage,
    own: usize,
    next: usize,
    /// How often the own event had been notified when it was last read.
    seen: u32,
}

fn failed<E: std::fmt::Display>(what: &str) -> impl Fn(E) -> Failure {
    move |e| Failure::failed(format!("{what}: {e}"))
}

impl Link {
    fn new(page: impl AsFd, position: usize, processes: usize) -> Result<Self, Failure> {
        Ok(Self {
            page: WakePage::map(page.as_fd()).map_err(failed("cannot join a ring"))?,
            own: position,
            next: (position + 1) % processes,
            seen: 0,
        })
    }

    /// The link of a process of `Others`: its standard input is the ring's page.
    pub fn inherited(position: usize, processes: usize) -> Result<Self, Failure> {
        Self::new(std::io::stdin(), position, processes).map_err(|e| {
            failed("standard input is no link of a ring")(e)
                .or_code(errors::USAGE)
                .help("`ironbird doctor` starts these processes by itself")
        })
    }

    pub fn notify(&self, token: u64) -> Result<(), Failure> {
        let event = &self.page[self.next];
        event.token.store(token, Ordering::Relaxed);
        event.count.fetch_add(1, Ordering::SeqCst);
        futex::wake(&event.count, futex::Flags::empty(), 1)
            .map(drop)
            .map_err(failed("cannot wake a futex"))
    }

    pub fn wait(&mut self, timeout: Option<Duration>) -> Result<u64, Failure> {
        let timeout = timeout.map(|timeout| timespec(timeout.as_nanos() as u64));
        let event = &self.page[self.own];
        loop {
            let count = event.count.load(Ordering::SeqCst);
            if count != self.seen {
                self.seen = count;
                return Ok(event.token.load(Ordering::Relaxed));
            }
            match futex::wait(&event.count, futex::Flags::empty(), count, timeout.as_ref()) {
                Ok(()) | Err(Errno::AGAIN | Errno::INTR) => {}
                Err(Errno::TIMEDOUT) => {
                    let silent = "a process of the ring hangs or has died";
                    return Err(Failure::failed(silent));
                }
                Err(e) => return Err(failed("cannot wait for a futex")(e)),
            }
        }
    }
}

/// The memory with a futex for each process of a ring.
fn page() -> Result<OwnedFd, Errno> {
    let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
    let page = memfd_create("ironbird-ring", flags)?;
    ftruncate(&page, WakePage::BYTES as u64)?;
    fcntl_add_seals(&page, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    Ok(page)
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
