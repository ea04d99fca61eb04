//! The report as one self-contained web page: no network, no font; its script only reads charts out.
//!
//! It shows what report.json holds, and nothing else.

pub mod figures;
mod flight;
mod histograms;
mod outages;
pub mod parts;
pub mod picture;
mod setup;
mod summary;
mod telemetry;
mod theorem;
mod timing;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::plot::STYLE;
use crate::schema::Report;
use crate::text;

/// What the page looks like, without its charts.
const PAGE_STYLE: &str = include_str!("page.css");

/// Reads a chart out where a pointer is.
const READOUT: &str = include_str!("readout.js");

/// The page may load nothing, wherever the words in it come from.
const POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'";

/// Renders a report.
#[must_use]
pub fn render(report: &Report) -> String {
    let run = &report.run;
    let build = run.build.of_version(&run.version).to_string();
    let body = html! {
        (summary::head(report))
        (summary::contents(report))
        main {
            (timing::section(report))
            (outages::section(report))
            (summary::section(report))
            (flight::section(report))
            (theorem::section(report))
            (setup::section(report))
        }
        footer { "ironbird " (build) ", report.json of " (run.started) }
    };
    document(&text::title(run), &build, body)
}

/// A page of its own that a build has made.
#[must_use]
pub fn document(title: &str, build: &str, body: Markup) -> String {
    let page: Markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="generator" content=(format!("ironbird {build}"));
                // An empty picture, so that no browser asks a server for one.
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(PAGE_STYLE)) }
            }
            body {
                (body)
                script { (PreEscaped(READOUT)) }
            }
        }
    };
    page.into_string()
}
