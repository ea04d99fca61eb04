//! Analysis of a flight: from messages to numbers and verdicts, and the schema of report.json.
//!
//! This crate owns the statistics of a flight (latencies, deadlines, tracking, theorem), the causes of missed deadlines,
//! gates and verdicts, comparisons of flights, robustness margins and the intervals and tests behind them. It returns
//! numbers and data types; its only sentences are those that report.json stores, as the reason of a verdict. Text, pages
//! and charts are made by the crate `render`. It starts no process, reads no clock and does not use the middleware.
//!
//! ```text
//! messages --> flight_statistics (series, deadlines, theorem, tracer), miss_analysis --> verdicts, gates --> schema
//! ```
//!
//! Start with [`schema`], the data of a report, and [`flight_statistics`], which fills it.

pub mod baseline;
pub mod command_verdicts;
pub mod comparison;
pub mod deadlines;
pub mod diff;
pub mod distribution;
pub mod effort;
pub mod faults;
pub mod finding;
pub mod firmware;
pub mod flight_metrics;
pub mod flight_statistics;
pub mod freshness;
pub mod gates;
pub mod host;
pub mod json;
pub mod laws;
pub mod losses;
pub mod margin;
pub mod miss_analysis;
pub mod miss_causes;
pub mod observations;
pub mod outages;
pub mod phrase;
pub mod process_failures;
pub mod processor_trace;
pub mod recovery;
pub mod report_file;
#[cfg(test)]
mod sample;
pub mod schema;
pub mod sections;
pub mod series;
pub mod states;
pub mod statistics;
pub mod targets;
pub mod theorem;
pub mod timer_lead;
pub mod tracer;
pub mod traces;
pub mod tracking;
pub mod verdicts;
