//! When the loop was out, and why: the classes of the autopsy and its worst outages.

use maud::{Markup, html};

use crate::page::parts::{cell, table};
use crate::schema::Report;

/// The classes with their counts and the worst outages; nothing of a flight without one.
pub fn section(report: &Report) -> Markup {
    let autopsy = &report.autopsy;
    if autopsy.classes.is_empty() {
        return html! {};
    }
    html! {
        h3 { "Outages, and why" }
        (table(&["why", "stage", "outages", "deadlines missed"], autopsy.classes.iter().map(|class| {
            vec![
                cell(class.class.words()),
                cell(class.stage.as_deref().unwrap_or("")),
                cell(class.outages),
                cell(class.missed),
            ]
        })))
        details {
            summary { "The worst, with the evidence" }
            ul {
                @for case in &autopsy.worst { li { (case.line()) } }
            }
        }
        p.note { "The kernel's counters are read every 10 ms; docs/measuring.md says what that leaves open." }
    }
}
