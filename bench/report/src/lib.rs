//! From messages to numbers, and from numbers to pages: the report of a flight, comparisons and robustness margins.
//!
//! ```text
//! messages --> flight_statistics (series, deadlines, theorem, tracer), miss_analysis --> verdicts, gates
//!          --> schema --> render (text, page, charts, JUnit)
//! ```
//!
//! Start with [`schema`], the data of a report, and [`flight_statistics`], which fills it. Only [`render`] contains words,
//! columns and HTML. This crate starts no process, reads no clock and does not use the middleware.

pub mod baseline;
pub mod candidate_causes;
pub mod comparison;
pub mod deadlines;
pub mod diff;
pub mod distribution;
pub mod faults;
pub mod finding;
pub mod flight_metrics;
pub mod flight_statistics;
pub mod freshness;
pub mod gates;
pub mod host;
pub mod json;
pub mod laws;
pub mod margin;
pub mod margin_section;
pub mod message_loss;
pub mod miss_analysis;
pub mod miss_causes;
pub mod outages;
pub mod phrase;
pub mod process_failures;
pub mod processor_trace;
pub mod render;
pub mod run_facts;
#[cfg(test)]
mod sample;
pub mod schema;
pub mod sections;
pub mod series;
pub mod speed;
pub mod states;
pub mod statistics;
pub mod status;
pub mod swaps;
pub mod theorem;
pub mod timer_lead;
pub mod tracer;
pub mod traces;
pub mod tracking;
pub mod verdicts;
