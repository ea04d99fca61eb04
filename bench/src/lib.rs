//! The rig: flights of the four stages, in one process or in four.

pub mod in_process;
