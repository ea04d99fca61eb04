//! Why deadlines were missed: the classes of the autopsy and its worst cases.

use maud::{Markup, html};

use crate::page::parts::{cell, table, us};
use crate::schema::Report;

/// The classes with their counts and the worst cases; nothing of a flight that missed nothing.
pub fn section(report: &Report) -> Markup {
    let autopsy = &report.autopsy;
    if autopsy.classes.is_empty() {
        return html! {};
    }
    html! {
        h3 { "Why they were missed" }
        (table(&["why", "stage", "missed"], autopsy.classes.iter().map(|class| {
            vec![
                cell(class.class.words()),
                cell(class.stage.as_deref().unwrap_or("")),
                cell(class.count),
            ]
        })))
        details {
            summary { "The worst, with the evidence" }
            ul {
                @for case in &autopsy.worst {
                    li {
                        (format!("{:.3} s, tick {}", case.time_s, case.tick)) ": " (case.class.words())
                        @if let Some(stage) = &case.stage { ", " (stage) }
                        ", " (us(case.late_us)) " us late, " (case.in_a_row) " in a row. " (case.evidence)
                    }
                }
            }
        }
        p.note { "The kernel's counters are read every 10 ms; docs/measuring.md says what that leaves open." }
    }
}
