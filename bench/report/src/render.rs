//! The report for people: text, web page, charts and JUnit XML.
//!
//! These files contain all words, columns and HTML. The numbers come from the other modules of the crate.

pub mod baseline_text;
pub mod brief;
pub mod comparison_page;
pub mod comparison_text;
pub mod diff_text;
pub mod facts_text;
pub mod failure_text;
pub mod figures;
pub mod files;
pub mod html;
pub mod junit;
pub mod latency_page;
pub mod margin_page;
pub mod margin_text;
pub mod outage_page;
pub mod outage_text;
pub mod page;
pub mod picture;
pub mod plot;
pub mod scale;
pub mod table;
pub mod text;
pub mod theorem_text;
