//! The flight: the paper's figures, drawn for this flight, and what its laws show.

use maud::{Markup, html};

use crate::page::figures::{ESTIMATED, Figures, ROTORS};
use crate::page::parts::{self, Key, cell, chart, number, table};
use crate::page::telemetry;
use crate::schema::Report;
use crate::text;

/// Attitude, position, errors, torque, rotors, path; estimates of a law that has some; each law's telemetry.
pub fn section(report: &Report) -> Markup {
    let flight = &report.flight;
    let estimates = flight.estimates.iter().map(|estimate| {
        let digits = |value: f64| cell(format!("{value:.6e}"));
        vec![cell(&estimate.name), digits(estimate.estimated), digits(estimate.actual)]
    });
    let content = html! {
        p {
            "Position error rms " (number(flight.position_error_rms_m)) " m, largest "
            (number(flight.position_error_max_m)) " m, at the end " (number(flight.position_error_final_m))
            " m, over " (parts::count(flight.states, "state")) (text::without_state(report))
            @if let Some(e) = flight.rate_error_final_rad_s {
                "; rate error of the inner law at the end " span.nobreak { (number(e)) " rad/s" }
            }
            "; rotors saturated in " (parts::count(flight.saturated_ticks, "tick")) "."
        }
        (plots(report))
        @if !flight.estimates.is_empty() {
            h3 { "Estimates at the end" }
            (table(&["parameter", "estimated", "true"], estimates))
        }
        (telemetry::laws(report))
    };
    parts::section("flight", "Flight", content)
}

fn plots(report: &Report) -> Markup {
    let Some(traces) = &report.traces else { return html! {} };
    let figures = Figures::of(traces, report);
    const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
    const AXES: [&str; 3] = ["x", "y", "z"];
    const AXIS_KEYS: [Key<'_>; 3] = [("x", "x"), ("y", "y"), ("z", "z")];
    const ANGLE_KEYS: [Key<'_>; 3] = [("roll", "roll"), ("pitch", "pitch"), ("yaw", "yaw")];
    let rotors: [Key<'_>; 4] = [(ROTORS[0], "1"), (ROTORS[1], "2"), (ROTORS[2], "3"), (ROTORS[3], "4")];
    let symbols = ["I_R", "k_r", "delta"];
    html! {
        p.marks {
            "In every plot over time: " span.key.mark.swap { @if report.faults.is_empty() { "live swap" } @else { "live swap, fault" } } " "
            span.key.mark.missed { "missed deadline" } " Each line is drawn through the smallest and the largest value of "
            (parts::count(traces.flight.every_ticks, "tick")) "."
        }
        div.plots {
            @for i in 0..3 {
                (chart(ANGLES[i], &format!("Attitude: {}", ANGLES[i]),
                    &[(ANGLES[i], "actual"), ("reference", "reference")], &figures.attitude(i)))
            }
            @for i in 0..3 {
                (chart(AXES[i], &format!("Position: {}", AXES[i]),
                    &[(AXES[i], "actual"), ("reference", "reference")], &figures.position(i)))
            }
            (chart("position-error", "Tracking error: position", &AXIS_KEYS, &figures.position_error()))
            @if traces.has_rate_error() {
                (chart("rate-error", "Tracking error: body rates", &ANGLE_KEYS, &figures.rate_error()))
            }
            (chart("distance", "Distance from the reference", &[], &figures.distance()))
            (chart("thrust", "Thrust demanded", &[], &figures.thrust()))
            (chart("torque", "Torque demanded", &ANGLE_KEYS, &figures.torque()))
            (chart("rotors", "Rotor speeds", &rotors, &figures.rotor_speeds()))
        }
        @if traces.has_estimates() {
            div.plots {
                @for i in 0..3 {
                    (chart(ESTIMATED[i], &format!("Estimate of {}", symbols[i]),
                        &[(ESTIMATED[i], "estimated"), ("reference", "true")], &figures.estimate(i)))
                }
                @for i in 0..3 {
                    (chart(&format!("{}-error", ESTIMATED[i]), &format!("Estimation error of {}", symbols[i]),
                        &[(ESTIMATED[i], "estimated less true")], &figures.estimate_error(i)))
                }
            }
        }
        div.plots {
            @for (across, up, title) in [(0, 1, "from above"), (0, 2, "along y"), (1, 2, "along x")] {
                (chart(&format!("path-{}{}", AXES[across], AXES[up]), &format!("Path seen {title}"),
                    &[("flown", "flown"), ("reference", "reference"), ("swap ring", "live swap")],
                    &figures.path(across, up)))
            }
        }
        p.note { "Paths show at most the last minute; both axes have the same scale." }
    }
}
