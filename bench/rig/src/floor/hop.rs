//! `ironbird ring-hop`: one process of the ring; the measuring process starts it.

use clap::Args;
use role::launcher::end_with_launcher;
use role::rt::take_stand;
use wire::clock::now_ns;

use failure::{Failure, OK};
use machine::floor::link::{END, Link, WakeMechanism};
use machine::floor::work::Work;

/// Flags of `ring-hop`, which nobody types.
#[derive(Clone, Debug, Args)]
pub struct HopArgs {
    /// What wakes the next process.
    #[arg(long, value_enum)]
    pub wake: WakeMechanism,
    /// Place in the ring.
    #[arg(long)]
    pub position: usize,
    /// Processes of the ring.
    #[arg(long)]
    pub processes: usize,
    /// Processor.
    #[arg(long)]
    pub cpu: usize,
    /// SCHED_FIFO priority; 0 is SCHED_OTHER.
    #[arg(long)]
    pub priority: i32,
    /// Iterations of arithmetic between being woken and waking.
    #[arg(long)]
    pub work: u64,
    /// Process number of the one that measures; its end ends this one.
    #[arg(long)]
    pub launcher: u32,
}

/// Hands the token on until the ring ends.
///
/// # Errors
/// [`Failure`] where the standard streams are no link of a ring, or the scheduling was refused.
pub fn hop(args: &HopArgs) -> Result<u8, Failure> {
    end_with_launcher(Some(args.launcher))?;
    let mut link = Link::inherited(args.wake, args.position, args.processes)?;
    let work = Work { iterations: args.work };
    let standing = take_stand(args.cpu, args.priority);
    if standing.priority != args.priority {
        return Err(Failure::failed(format!("a process of the ring: {}", standing.refused.join(", "))));
    }
    while link.wait(None)? != END {
        work.run();
        link.ring(now_ns())?;
    }
    Ok(OK)
}
