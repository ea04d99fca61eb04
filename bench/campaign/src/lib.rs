//! Campaigns: many flights of one file, their table, and what it says.
//!
//! ```text
//! file --> campaign (factors: distribution <- generator, spread; arms; gates) --> draws of a flight, and its settings
//! a flight, tick by tick --> metrics --> outcome --> table --> chunk: a file of rows
//! ```
//!
//! Nothing here flies, starts a process or reads a clock.

pub mod campaign;
pub mod chunk;
pub mod distribution;
pub mod fault;
pub mod file;
pub mod findings;
pub mod gates;
pub mod generator;
pub mod lines;
pub mod metrics;
pub mod outcome;
pub mod rows;
pub mod spread;
pub mod statistics;
pub mod sum;
pub mod table;
