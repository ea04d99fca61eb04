//! Campaigns: many flights of one file, their table, and its statistics.
//!
//! ```text
//! file --> campaign (factors, variants, success criteria) --> samples of a flight --> its settings
//! a flight, tick by tick --> metrics --> outcome --> table --> chunk: a file of rows
//! ```
//!
//! Nothing here flies (`experiments` does), starts a process or reads a clock. Start reading in [`campaign::Campaign`].

pub mod aggregate;
mod bins;
pub mod campaign;
pub mod chunk;
pub mod distribution;
pub mod fault;
pub mod file;
pub mod gates;
pub mod generator;
pub mod lines;
pub mod metric_distribution;
pub mod metrics;
pub mod parquet_file;
pub mod results;
pub mod results_document;
pub mod spread;
pub mod table;
