//! The best this machine can do: a bare timer, a raw ring of processes, cyclictest.

pub mod comparison;
pub mod cyclictest;
pub mod link;
pub mod periodic_timer;
pub mod ring;
pub mod timer;
pub mod work;
