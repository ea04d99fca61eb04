//! Page 3: V and V_th, estimates compared with true values, violations by cause.

use controller::laws::adaptive;
use messages::monitor::{Cause, Monitor};
use messages::parameters::ESTIMATED;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

use crate::watch::dashboard_model::POINT_S;
use crate::watch::dashboard_model::WatchedFlight;
use crate::watch::screen::drawing::Paint;
use crate::watch::screen::drawing::{bars, put};
use report::laws::no_theorem;
use report::theorem::Theorem;

/// Short names of the estimated parameters.
const SYMBOLS: [&str; 3] = ["I_R kg m^2", "k_r N m s", "delta rad/s^2"];
/// Minimum height of the chart.
const PICTURE: u16 = 8;
/// Decades below the largest V_th that the chart shows.
const DECADES: f64 = 6.0;

pub(super) fn draw(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    if let Some(why) = flight.laws.without_theorem.map(no_theorem) {
        let text = Paragraph::new(format!("The theorem is not applicable: {why}."));
        frame.render_widget(text.wrap(Wrap { trim: true }), area);
        return;
    }
    let (Some(wrench), Some(monitor)) = (&flight.wrench, &flight.monitor) else {
        put(
            frame,
            area,
            vec![Line::from("nothing has been said of the theorem yet")],
        );
        return;
    };
    let theorem = flight.tally.theorem.section();
    let mut lines = vec![verdict(&theorem, flight.lost_at(), area.width, paint)];
    lines.extend(values(flight, monitor, area.width));
    lines.push(Line::styled(estimate_heading(area.width), paint.heading()));
    for (i, parameter) in ESTIMATED.iter().enumerate() {
        let truth = theorem
            .estimates
            .get(i)
            .map_or(0.0, |estimate| estimate.actual);
        let found = theorem
            .estimates
            .get(i)
            .is_some_and(|estimate| estimate.found);
        let name = if is_roomy(area.width) {
            parameter.name()
        } else {
            SYMBOLS[i]
        };
        let mut row = estimate_row(
            name,
            adaptive::estimate(&wrench.telemetry)[i],
            truth,
            monitor.estimate_error[i],
            area.width,
        );
        row.push_span(Span::styled(
            if found { "  found" } else { "" },
            paint.good(),
        ));
        lines.push(row);
    }
    let rest = put(frame, area, lines);
    let rest = put(
        frame,
        rest,
        causes(monitor, rest.height >= 8, rest.width, paint),
    );
    let rest = put(
        frame,
        rest,
        vec![Line::from(format!(
            "excitation {:.1e} e-folds in 10 s, least {:.1e}; (18) {}",
            theorem.excitation,
            theorem.excitation_least,
            if theorem.converged {
                "held"
            } else {
                "did not hold so far"
            }
        ))],
    );
    // The explanation, if enough room remains for the chart.
    let words = u16::try_from(theorem.convergence.len())
        .unwrap_or(u16::MAX)
        .div_ceil(rest.width.max(1))
        + 1;
    let words = if rest.height >= words + PICTURE {
        words
    } else {
        0
    };
    frame.render_widget(
        Paragraph::new(theorem.convergence).wrap(Wrap { trim: true }),
        Rect {
            height: words,
            ..rest
        },
    );
    picture(
        flight,
        paint,
        frame,
        Rect {
            y: rest.y + words,
            height: rest.height - words,
            ..rest
        },
    );
}

fn verdict<'a>(theorem: &Theorem, lost_at: Option<u64>, width: u16, paint: Paint) -> Line<'a> {
    if let Some(tick) = lost_at {
        let held = if theorem.holds {
            "held"
        } else {
            "DID NOT HOLD"
        };
        let words =
            format!("theorem {held} up to tick {tick}; unchecked since: the recorder has gone");
        return Line::styled(words, paint.bad());
    }
    let words = if theorem.holds {
        "theorem holds"
    } else {
        "theorem DOES NOT HOLD"
    };
    let steps = if is_roomy(width) {
        format!(" {} steps,", theorem.ticks_checked)
    } else {
        String::new()
    };
    Line::from(vec![
        Span::styled(words, paint.verdict(theorem.holds)),
        Span::raw(format!(":{steps} {} unexplained", theorem.unexplained())),
    ])
}

/// V, V_th and the rate error: current values and, if there is room, their history.
fn values<'a>(flight: &WatchedFlight, monitor: &Monitor, width: u16) -> [Line<'a>; 3] {
    let e = flight
        .tally
        .flight()
        .rate_error_final_rad_s
        .map_or_else(|| "-".into(), |e| format!("{e:.3e}"));
    let (now, change) = (
        [
            format!("V    {:>10.3e}", monitor.v),
            format!("V_th {:>10.3e}", monitor.v_th),
            format!("|e|  {e:>10}"),
        ],
        [
            format!(
                "  change {:>10.2e}  at most {:>10.2e}",
                monitor.v_change, monitor.v_change_bound
            ),
            format!(
                "  first  {:>10.2e}  fell by {:>10.2e}",
                monitor.v_th_start, monitor.descent
            ),
            format!(
                "  rms    {:>10.2e}  largest {:>10.2e}",
                monitor.rate_error_rms_rad_s, monitor.rate_error_max_rad_s
            ),
        ],
    );
    let units = [
        "rad^2/s^2".into(),
        format!("of {:.2e} predicted", monitor.descent_predicted),
        "rad/s".into(),
    ];
    let narrow_units = ["rad^2/s^2", "rad^2/s^2", "rad/s"];
    std::array::from_fn(|i| {
        Line::from(if is_roomy(width) {
            format!("{}{}  {}", now[i], change[i], units[i])
        } else {
            format!("{}  {}", now[i], narrow_units[i])
        })
    })
}

const fn is_roomy(width: u16) -> bool {
    width >= 70
}

fn estimate_heading(width: u16) -> String {
    if is_roomy(width) {
        format!(
            "{:<25}{:>13}{:>13}{:>13}",
            "estimates", "estimated", "true", "error"
        )
    } else {
        format!("{:<14}{:>11}{:>11}", "estimates", "estimated", "true")
    }
}

fn estimate_row<'a>(name: &str, estimated: f64, truth: f64, error: f64, width: u16) -> Line<'a> {
    Line::from(if is_roomy(width) {
        format!("{name:<25}{estimated:>13.4e}{truth:>13.4e}{error:>13.2e}")
    } else {
        format!("{name:<14}{estimated:>11.3e}{truth:>11.3e}")
    })
}

/// Steps by cause, for rises of V_th and of V.
fn causes<'a>(monitor: &Monitor, all: bool, width: u16, paint: Paint) -> Vec<Line<'a>> {
    let (name, count, unjudged) = if is_roomy(width) {
        (25, 13, "V, unjudged")
    } else {
        (20, 9, "V")
    };
    let heading = format!(
        "{:<name$}{:>count$}{unjudged:>count$}",
        "violations by cause", "V_th"
    );
    let mut lines = vec![Line::styled(heading, paint.heading())];
    for cause in Cause::ALL {
        let (steps, unjudged) = (
            monitor.violations[cause as usize],
            monitor.v_above_bound[cause as usize],
        );
        if cause != Cause::Unexplained && (!all || steps + unjudged == 0) {
            continue;
        }
        let style = match (cause, steps) {
            (Cause::Unexplained, 1..) => paint.bad(),
            _ => ratatui::style::Style::new(),
        };
        lines.push(Line::styled(
            format!("{:<name$}{steps:>count$}{unjudged:>count$}", cause.name()),
            style,
        ));
    }
    lines
}

fn picture(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    if area.height < 3 {
        return;
    }
    let points: Vec<f64> = flight
        .v_th
        .newest(usize::from(area.width))
        .iter()
        .map(|v| v.max(f64::MIN_POSITIVE).log10())
        .collect();
    let Some(most) = points.iter().copied().reduce(f64::max) else {
        return;
    };
    let title = format!(
        "V_th, last {:.0} s; full height {:.1e} rad^2/s^2, {DECADES:.0} decades",
        f64::from(area.width) * POINT_S,
        10_f64.powf(most)
    );
    let below = put(frame, area, vec![Line::styled(title, paint.heading())]);
    bars(
        frame,
        below,
        &points,
        (most - DECADES, most),
        paint.actual(),
    );
}
