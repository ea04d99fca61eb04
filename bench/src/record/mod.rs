//! The recorder: a process beside the loop that builds everything from the messages' stamps.
//!
//! ```text
//! topics --drain--> tally (series, deadlines, flight) --each second--> latency.hlog, report.json
//!               \-> states.csv                         --at the end--> report.txt
//! ```

pub mod deadlines;
pub mod host;
pub mod process;
pub mod report;
mod sections;
pub mod series;
pub mod states;
pub mod tally;
pub mod text;
pub mod theorem;
