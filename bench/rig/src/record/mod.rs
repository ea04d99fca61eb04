//! The recorder: a process beside the loop that builds everything from the messages' stamps.
//!
//! ```text
//! topics --drain--> tally (series, deadlines, flight) --each second--> latency.hlog, report.json
//!               |-> states.csv                         --at the end--> report.txt, report.html, flight.svg
//!               |-> flight.mcap (flight_log)
//!               \-> pairs --> the theorem's monitor --> topic `theorem`, which goes the same ways
//! ```

pub mod crew;
pub mod facts;
pub mod hlog;
pub mod pairs;
pub mod ports;
pub mod process;
pub mod replaced;
pub mod traced;
