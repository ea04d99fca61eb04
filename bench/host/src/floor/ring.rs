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

use std::path::Path;
use std::process::{Child, Command};
use std::time::Duration;

use hdrhistogram::Histogram;
use ipc::clock::now_ns;
use process::rt::{Standing, fifo_refusal, loops_cpu, take_stand};

use crate::floor::link::{END, Link, Links, WakeMechanism};
use crate::floor::periodic_timer::PeriodicTimer;
use crate::floor::timer::{on_a_thread, stay_awake};
use crate::floor::work::Work;
use errors::Failure;
use report::series::histogram;

#[derive(Clone, Debug)]
pub struct RingSettings {
    pub wake: WakeMechanism,
    /// Length of a tick [ns]; 0 lets lap follow lap without a timer.
    pub period_ns: u64,
    pub duration: Duration,
    /// On which processor; `None` is that of the loops.
    pub cpu: Option<usize>,
    /// SCHED_FIFO priority of the first process, each later one has one more, as the loops have; 0 is SCHED_OTHER.
    pub priority: i32,
    /// What each process computes before it wakes the next one: as many as there are processes, 2 to 64.
    pub work: Vec<Work>,
    /// Whether it rehearses, as the loops do.
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
const PATIENCE: Duration = Duration::from_secs(5);

/// Measures with processes of an `ironbird` executable: usually the present one.
///
/// # Errors
/// Usage, where no tick fits into the duration or the number of processes is no ring; where a process cannot be
/// started or dies.
pub fn measure(settings: &RingSettings, executable: &Path) -> Result<RingFloor, Failure> {
    let (settings, executable) = (settings.clone(), executable.to_owned());
    let processes = settings.work.len();
    if !(2..=ipc::sys::BELLS).contains(&processes) {
        return Err(Failure::usage(format!(
            "a ring has 2 to {} processes, not {processes}",
            ipc::sys::BELLS
        )));
    }
    let cpu = settings.cpu.unwrap_or_else(loops_cpu);
    // The processes end with the thread that starts them.
    on_a_thread("ring floor", move || {
        let highest = settings.priority + i32::try_from(processes).unwrap_or(i32::MAX) - 1;
        let refusal = if settings.priority > 0 {
            fifo_refusal(highest)
        } else {
            None
        };
        let priority = if refusal.is_some() {
            0
        } else {
            settings.priority
        };
        let links = Links::new(settings.wake, processes)?;
        // Before this thread takes its stand: a process inherits the scheduling of the thread that starts it.
        let others = Others::start(&executable, &links, cpu, priority, &settings.work)?;
        let mut standing = take_stand(cpu, priority);
        standing
            .refused
            .extend(refusal.map(|reason| format!("SCHED_FIFO {highest}: {reason}")));
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
        link.ring(now_ns())?;
        link.wait(Some(PATIENCE))?;
    }
    let (mut chain, mut lap) = (histogram()?, histogram()?);
    if settings.period_ns == 0 {
        return race(link, settings, standing, chain, lap);
    }
    let mut periodic_timer = PeriodicTimer::new(settings.period_ns, settings.duration)?;
    let RingRehearsal { lead_ns, needs_ns } = settings.rehearsal.unwrap_or(RingRehearsal {
        lead_ns: 0,
        needs_ns: u64::MAX,
    });
    let mut rehearsed = Ok(());
    while periodic_timer
        .next_wake_after(lead_ns, |left_ns| {
            if left_ns >= needs_ns {
                rehearsed = pass_around(link, settings.work[0]).map(drop);
            }
        })
        .is_some()
    {
        std::mem::replace(&mut rehearsed, Ok(()))?;
        // The periodic timer's own records are none of the ring's time.
        let start_ns = now_ns();
        let sent_ns = pass_around(link, settings.work[0])?;
        lap.saturating_record(now_ns() - start_ns);
        chain.saturating_record(sent_ns.saturating_sub(start_ns));
    }
    link.ring(END)?;
    Ok(RingFloor {
        chain,
        lap,
        ticks_run: periodic_timer.ticks_run(),
        ticks_skipped: periodic_timer.skipped,
        lateness: periodic_timer.lateness,
        standing,
    })
}

/// Sends the token around; gives when the last process sent it [ns].
fn pass_around(link: &mut Link, work: Work) -> Result<u64, Failure> {
    work.run();
    link.ring(now_ns())?;
    link.wait(Some(PATIENCE))
}

/// Lap after lap, as fast as the machine can.
fn race(
    link: &mut Link,
    settings: &RingSettings,
    standing: Standing,
    mut chain: Histogram<u64>,
    mut lap: Histogram<u64>,
) -> Result<RingFloor, Failure> {
    let end_ns = now_ns() + u64::try_from(settings.duration.as_nanos()).unwrap_or(u64::MAX / 2);
    let mut start_ns = now_ns();
    while start_ns < end_ns {
        settings.work[0].run();
        link.ring(start_ns)?;
        let sent_ns = link.wait(Some(PATIENCE))?;
        chain.saturating_record(sent_ns.saturating_sub(start_ns));
        let back_ns = now_ns();
        lap.saturating_record(back_ns - start_ns);
        start_ns = back_ns;
    }
    link.ring(END)?;
    Ok(RingFloor {
        ticks_run: lap.len(),
        ticks_skipped: 0,
        chain,
        lap,
        lateness: histogram()?,
        standing,
    })
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
        let wake = match links.wake() {
            WakeMechanism::Eventfd => "eventfd",
            WakeMechanism::Futex => "futex",
        };
        let mut others = Self(Vec::new());
        for (position, work) in (0_i32..).zip(work).skip(1) {
            let own_priority = if priority > 0 { priority + position } else { 0 };
            let (stdin, stdout) = links.of(position.unsigned_abs() as usize)?;
            let child = Command::new(executable)
                .args(["ring-hop", "--wake", wake])
                .args([
                    "--position",
                    &position.to_string(),
                    "--processes",
                    &links.processes().to_string(),
                ])
                .args([
                    "--cpu",
                    &cpu.to_string(),
                    "--priority",
                    &own_priority.to_string(),
                ])
                .args([
                    "--work",
                    &work.iterations.to_string(),
                    "--launcher",
                    &std::process::id().to_string(),
                ])
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
