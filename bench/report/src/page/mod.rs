//! The report as one self-contained web page: no network, no script, no font.
//!
//! It shows what report.json holds, and nothing else.

mod autopsy;
pub mod figures;
mod flight;
mod parts;
pub mod picture;
mod setup;
mod summary;
mod theorem;
mod timing;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::plot::STYLE;
use crate::schema::Report;

/// What the page looks like, without its charts.
const PAGE_STYLE: &str = include_str!("page.css");

/// Renders a report.
#[must_use]
pub fn render(report: &Report) -> String {
    let run = &report.run;
    let build = run.build.of_version(&run.version);
    let title = format!("{} with gains {}, {}", run.trajectory, run.preset, run.started);
    let page: Markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content=(format!("ironbird {build}"));
                // An empty picture, so that no browser asks a server for one.
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(PAGE_STYLE)) }
            }
            body {
                (summary::head(report))
                main {
                    (summary::sections(report))
                    (flight::section(report))
                    (timing::section(report))
                    (theorem::section(report))
                    (setup::section(report))
                }
                footer { "ironbird " (build) ", report.json of " (run.started) }
            }
        }
    };
    page.into_string()
}
