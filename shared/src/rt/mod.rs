//! Real-time set-up of a process, and what it was granted.

mod setup;
pub(crate) mod sys;
mod thread;
mod usage;

pub use setup::{Engaged, Grant, Grants, Mode, STEPS, Settings, Step, hold_cpu_latency, settle};
pub use sys::{Alarm, BELLS, Bell, BellPage, CountingAllocator, thread_allocations};
pub use thread::{Standing, fifo_refusal, loops_cpu, take_stand};
pub use usage::{Usage, UsageMeter};
