//! The real-time set-up of a process, and what it was granted.

mod memory;
mod setup;
pub(crate) mod sys;
mod thread;
mod usage;

pub use memory::settle;
pub use setup::{Engaged, WITHOUT_ROOT, hold_cpu_latency, remedy};
pub use sys::{CountingAllocator, thread_allocations};
pub(crate) use sys::{exit_when_signalled, no_longer_ignore};
pub use thread::{Standing, fifo_refusal, loops_cpu, take_stand};
pub use usage::UsageMeter;
