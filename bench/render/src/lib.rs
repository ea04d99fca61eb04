//! Results for people: each is a [`document::Document`], built once and written as terminal text, web page or Markdown.
//!
//! This crate owns all words, columns, HTML and charts of reports, comparisons and robustness margins, the picture of a
//! flight and its JUnit XML. It computes no result: the numbers come from the crate `analysis`, and what is not in
//! report.json is in no report.
//!
//! Start with [`document`], the model that all results share, and [`flight`], the sections of a flight's report. Charts are
//! data too: a [`plot::Chart`] says what to draw, and [`plot`] draws it.

pub mod brief;
pub mod cases;
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
pub mod page;
pub mod picture;
pub mod plot;
pub mod scale;
pub mod sentences;
pub mod theorem;

/// Script that draws a quadrotor in three dimensions: the function `vehicleView`, described in the file.
pub const VEHICLE_JS: &str = include_str!("vehicle.js");
