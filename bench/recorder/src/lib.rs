//! The recorder: a process beside the control loop that computes every figure from the messages' time stamps.
//!
//! ```text
//! topics --drain--> analysis::flight_statistics --each second--> latency.hlog, report.json
//!               |-> states.csv                --at the end--> report.txt, report.html, flight.svg
//!               |-> flight.mcap (the crate flight_log)
//!               \-> Lyapunov monitor --> topic `theorem`, recorded like the others
//! ```
//!
//! Start reading in [`recording::run`]. One part has one job: [`message_streams`] reads the topics, [`run_files`] writes
//! the files, [`host_monitor`] samples the kernel's counters, `report_builder` makes the report.

pub mod atomic_file;
mod faulty_inputs;
pub mod hlog;
pub mod host_monitor;
pub mod injected_faults;
pub mod kernel_trace;
pub mod log_metadata;
pub mod message_streams;
pub mod ports;
pub mod recording;
mod report_builder;
pub mod role_statuses;
pub mod run_directory;
pub mod run_files;
