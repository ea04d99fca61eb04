//! Results for people: each is a [`document::Document`], built once and written as text, web page or Markdown.
//!
//! These files contain all words, columns and HTML. The numbers come from the other modules of the crate.

pub mod brief;
pub mod comparison;
pub mod diff;
pub mod document;
pub mod figures;
pub mod files;
pub mod flight;
pub mod junit;
pub mod latencies;
pub mod margin;
pub mod outages;
pub mod picture;
pub mod plot;
pub mod scale;
pub mod theorem;
