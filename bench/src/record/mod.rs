//! The recorder: a process beside the loop that builds everything from the messages' stamps.
//!
//! ```text
//! topics --drain--> tally (series, deadlines, flight) --each second--> latency.hlog, report.json
//!               |-> states.csv                         --at the end--> report.txt, report.html, flight.svg
//!               \-> flight.mcap (crate::log)
//! ```

pub mod autopsy;
pub mod classes;
pub mod crew;
pub mod deadlines;
pub mod distribution;
pub mod evidence;
pub mod files;
pub mod host;
pub mod json;
pub mod ports;
pub mod process;
pub mod report;
pub mod sampler;
pub mod sections;
pub mod series;
pub mod states;
pub mod tally;
pub mod text;
pub mod theorem;
pub mod theorem_text;
pub mod tracer;
pub mod traces;
