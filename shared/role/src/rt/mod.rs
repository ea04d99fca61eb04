//! The real-time set-up of a process, and what it was granted.

mod setup;
pub(crate) mod sys;
mod thread;
mod usage;

pub use setup::{Engaged, hold_cpu_latency, remedy, settle};
pub use sys::{CountingAllocator, thread_allocations};
pub use thread::{Standing, fifo_refusal, loops_cpu, take_stand};
pub use usage::UsageMeter;
