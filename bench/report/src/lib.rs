//! From records to numbers to pages: accounting, outages, and the report.
//!
//! ```text
//! messages --> tally (series, deadlines, theorem, tracer), autopsy --> words, verdict
//!          --> schema --> text, page, junit, diff
//! ```
//!
//! Nothing here starts a process, reads a clock or knows the middleware.

pub mod autopsy;
pub mod beside;
pub mod comparison;
pub mod deaths;
pub mod diff;
pub mod files;
pub mod finding;
pub mod host;
pub mod injected;
pub mod json;
pub mod junit;
pub mod laws;
pub mod lead;
pub mod losses;
pub mod margin;
pub mod page;
pub mod plot;
pub mod run_facts;
pub mod schema;
pub mod sections;
pub mod speed;
pub mod states;
pub mod statistics;
pub mod status;
pub mod swaps;
pub mod tally;
pub mod text;
pub mod tick;
pub mod traces;
pub mod tracking;
pub mod verdict;
pub mod words;
