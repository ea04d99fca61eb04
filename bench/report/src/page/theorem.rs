//! The theorem: V_th over time, what explains its rises, and the excitation.

use maud::{Markup, html};

use crate::page::figures::Figures;
use crate::page::parts::{self, cell, chart, table};
use crate::schema::Report;
use crate::text::theorem::explained;

/// The section.
pub fn section(report: &Report) -> Markup {
    let theorem = &report.theorem;
    if let Some(why) = theorem.inapplicable() {
        return parts::section("theorem", "Theorem", html! { p { "Not applicable: " (why) "." } });
    }
    if theorem.ticks_checked == 0 {
        let content = html! { p { "Not watched: no step of the estimates was seen." } };
        return parts::section("theorem", "Theorem", content);
    }
    let content = html! {
        p {
            strong { (theorem.verdict()) } ": " (parts::count(theorem.ticks_checked, "step")) " checked, "
            (theorem.unexplained()) " unexplained. V_th " (exponent(theorem.v_th_start)) " rad^2/s^2 at the start, "
            (exponent(theorem.v_th_end)) " at the end; fell by " (exponent(theorem.descent))
            " where the theorem predicts " (exponent(theorem.descent_predicted)) ". Estimates "
            @if theorem.is_live { "move as predicted" } @else { strong { "do not move as predicted" } }
            ", in " (parts::count(theorem.steps_adapted, "step")) ". Largest excess of a step over what it owes: "
            (exponent(theorem.step_excess_max)) " of what rounding is allowed."
        }
        @if theorem.ticks_unwatched > 0 {
            p.note {
                (parts::count(theorem.ticks_unwatched, "tick")) " not watched: the monitor lacks a message before them."
            }
        }
        p { (theorem.convergence) }
        (plots(report))
        div.columns {
            div { h3 { "Steps against the theorem" } (causes(report)) }
            div {
                h3 { "Estimates" }
                (estimates(report))
                @if !theorem.broken.is_empty() {
                    p.note { "The theorem bounds no estimate under " (theorem.broken.join(", ")) "." }
                }
            }
        }
        p {
            "Rate error " (exponent(theorem.rate_error_max_rad_s)) " rad/s at most, "
            (exponent(theorem.rate_error_final_rad_s)) " at the end; "
            (parts::count(theorem.ticks_saturated, "saturated tick")) ", "
            (theorem.ticks_stale) " with a stale input, " (parts::count(theorem.live_swaps, "live swap"))
            " of an estimated parameter. Excitation of the worst direction: " (exponent(theorem.excitation))
            " e-folds of the error in the last 10 s, " (exponent(theorem.excitation_least)) " in the least of all 10 s."
        }
    };
    parts::section("theorem", "Theorem", content)
}

/// A number that no line is broken in.
fn exponent(value: f64) -> Markup {
    html! { span.exponent { (format!("{value:.3e}")) } }
}

fn plots(report: &Report) -> Markup {
    let Some(traces) = &report.traces else { return html! {} };
    let figures = Figures::of(traces, report);
    let keys = [("v", "V"), ("v_th", "V_th")];
    html! {
        div.plots {
            (chart("v", "V and V_th", &keys, &figures.lyapunov()))
            (chart("v-change", "Their change in a tick", &keys, &figures.lyapunov_change()))
            @for cause in traces.violations.keys() {
                (chart(&format!("violations-{cause}"), &format!("Violations under {}", cause.replace('_', " ")), &[],
                    &figures.violations(cause)))
            }
        }
        p.note { "The axis of the changes is logarithmic to both sides of 0, and linear in its middle." }
    }
}

/// Every cause that struck, with its counts.
fn causes(report: &Report) -> Markup {
    let theorem = &report.theorem;
    let mut names: Vec<&String> = theorem.violations.keys().chain(theorem.v_above_bound.keys()).collect();
    names.sort();
    names.dedup();
    let rows = names.into_iter().map(|cause| {
        let rise = theorem.largest_rise.get(if cause == "unexplained" { "none" } else { cause });
        vec![
            html! { (cause) br; small { (explained(cause)) } },
            cell(theorem.violations.get(cause).copied().unwrap_or(0)),
            rise.map_or_else(|| cell("-"), |rise| exponent(rise.absolute)),
            cell(theorem.v_above_bound.get(cause).copied().unwrap_or(0)),
        ]
    });
    table(&["cause", "violations", "largest rise of V_th", "V above its bound (not judged)"], rows)
}

fn estimates(report: &Report) -> Markup {
    let rows = report.theorem.estimates.iter().map(|estimate| {
        vec![
            cell(&estimate.name),
            exponent(estimate.error),
            exponent(estimate.error_start),
            if report.theorem.broken.is_empty() { exponent(estimate.error_bound) } else { cell("no bound") },
            exponent(estimate.identifiability),
            cell(if estimate.found { "yes" } else { "no" }),
        ]
    });
    table(&["parameter", "error", "first error", "at most, by the theorem", "excitation", "found"], rows)
}
