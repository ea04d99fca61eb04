//! Real-time set-up of a process, and what it was granted.

mod setup;
pub(crate) mod sys;
mod usage;

pub use setup::{Engaged, Grant, Grants, Mode, STEPS, Settings, Step, settle};
pub use sys::{CountingAllocator, thread_allocations};
pub use usage::{Usage, UsageMeter};
