//! `ironbird cpu-load`: a process that keeps the loops' processor busy; the supervisor starts it.

use clap::Args;
use ipc::clock::{busy_wait, now_ns, sleep_until};
use process::rt::take_stand;
use process::signals::end_with_launcher;

use errors::{Failure, OK};

/// The time of which a share is busy [ns].
const CYCLE_NS: u64 = 10_000_000;

/// Flags of the hidden command `cpu-load`.
#[derive(Clone, Debug, Args)]
pub struct CpuLoadArgs {
    /// Processor.
    #[arg(long)]
    pub cpu: usize,
    /// SCHED_FIFO priority; 0 is SCHED_OTHER.
    #[arg(long)]
    pub priority: i32,
    /// Share of the time in which it is busy.
    #[arg(long)]
    pub share: f64,
    /// When it begins, on CLOCK_MONOTONIC [ns].
    #[arg(long)]
    pub from_ns: u64,
    /// When it ends [ns].
    #[arg(long)]
    pub until_ns: u64,
    /// Name of the instance that it disturbs, shown in the list of processes.
    #[arg(long)]
    pub instance: String,
    /// Process number of the supervisor; this process ends with it.
    #[arg(long)]
    pub launcher: u32,
}

/// Keeps the processor busy until the load's end.
pub fn cpu_load(args: &CpuLoadArgs) -> Result<u8, Failure> {
    end_with_launcher(Some(args.launcher))?;
    while now_ns() < args.from_ns {
        sleep_until(args.from_ns);
    }
    let standing = take_stand(args.cpu, args.priority);
    if standing.priority != args.priority || !standing.refused.is_empty() {
        return Err(Failure::failed(format!(
            "the processor is not kept busy: {}",
            standing.refused.join(", ")
        )));
    }
    let busy_ns = (args.share.clamp(0.0, 1.0) * CYCLE_NS as f64) as u64;
    let mut cycle_ns = now_ns();
    while cycle_ns < args.until_ns {
        busy_wait(busy_ns.min(args.until_ns - cycle_ns));
        if busy_ns < CYCLE_NS {
            sleep_until(cycle_ns + CYCLE_NS);
        }
        cycle_ns = now_ns();
    }
    Ok(OK)
}
