//! The real-time set-up of a process, and what it was granted.

mod allocations;
mod memory;
mod setup;
pub(crate) mod sys;
mod thread;
mod usage;

pub use allocations::{count_allocation, thread_allocations};
pub use memory::settle;
pub use setup::{Ahead, Engaged, OffLoops, WITHOUT_ROOT, hold_cpu_latency, remedy};
pub use sys::prepare_child;
pub(crate) use sys::{exit_when_signalled, is_ignored, no_longer_ignore};
pub use thread::{
    Raised, Standing, allow_cpus, fifo_refusal, loop_processors, loops_cpu, take_stand,
};
pub use usage::UsageMeter;
