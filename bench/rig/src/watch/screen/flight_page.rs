//! Page 1: position, attitude, horizon, the position error over time.

use messages::content::Mode;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Line as Stroke};

use crate::watch::dashboard_model::POINT_S;
use crate::watch::dashboard_model::WatchedFlight;
use crate::watch::screen::drawing::Paint;
use crate::watch::screen::drawing::{bars, put};

const NUMBERS: u16 = 50;
const HORIZON: (u16, u16) = (26, 12);
/// Pitch at the upper edge of the horizon [rad].
const PITCH_RAD: f64 = 0.8;

pub(super) fn draw(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    let below = put(frame, area, numbers(flight, paint, area.width));
    let is_wide = area.width >= NUMBERS + HORIZON.0 && area.height >= HORIZON.1;
    if is_wide {
        let x = area.x + NUMBERS + (area.width - NUMBERS - HORIZON.0).min(8);
        horizon(
            flight,
            paint,
            frame,
            Rect {
                x,
                y: area.y,
                width: HORIZON.0,
                height: HORIZON.1,
            },
        );
    }
    error(flight, paint, frame, below);
}

fn numbers<'a>(flight: &WatchedFlight, paint: Paint, width: u16) -> Vec<Line<'a>> {
    // One digit less on a narrow terminal.
    let (column, fewer) = if width < 46 { (7, 1) } else { (10, 0) };
    let row = |name: &str, values: &[f64], digits: usize, unit: &str| {
        let digits = digits - fewer;
        let values: String = values
            .iter()
            .map(|value| format!("{value:>column$.digits$}"))
            .collect();
        Line::from(format!("{name:<10}{values} {unit}"))
    };
    let heading = |names: [&str; 3]| {
        let names: String = names
            .iter()
            .map(|name| format!("{name:>column$}"))
            .collect();
        Line::styled(format!("{:<10}{names}", ""), paint.heading())
    };
    let degrees = |rad: [f64; 3]| rad.map(f64::to_degrees);
    let state = flight.state.unwrap_or_default();
    let setpoint = flight.setpoint.unwrap_or_default();
    let speeds = flight.rotor_speeds.unwrap_or_default();
    let (p, r) = (state.truth.position_w_m, setpoint.reference.position_w_m);
    let total = flight.tally.flight();
    vec![
        heading(["x", "y", "z"]),
        row("position", &p, 3, "m"),
        row("reference", &r, 3, "m"),
        row("error", &[p[0] - r[0], p[1] - r[1], p[2] - r[2]], 3, "m"),
        heading(["roll", "pitch", "yaw"]),
        row("attitude", &degrees(state.measured.attitude_rad), 2, "deg"),
        row("set-point", &degrees(setpoint.attitude_rad), 2, "deg"),
        row("rate", &degrees(state.measured.rate_b_rad_s), 2, "deg/s"),
        rotors(&state.measured.rotor_speed_command_rad_s, column, fewer),
        Line::from(format!("{:<10}{:>column$.3} N", "thrust", speeds.thrust_n)),
        mode(flight, paint),
        Line::from(format!(
            "{:<10}{:.4} m   rms {:.4}   max {:.4}",
            "error",
            total.position_error_final_m,
            total.position_error_rms_m,
            total.position_error_max_m
        )),
    ]
}

fn rotors<'a>(speeds: &[f64; 4], column: usize, fewer: usize) -> Line<'a> {
    let (width, digits) = ((3 * column - 2) / 4, 1 - fewer);
    let speeds: String = speeds
        .iter()
        .map(|speed| format!(" {speed:>width$.digits$}"))
        .collect();
    Line::from(format!("{:<10}{speeds} rad/s", "rotors"))
}

fn mode<'a>(flight: &WatchedFlight, paint: Paint) -> Line<'a> {
    let word = |mode: u64| match Mode::from_wire(mode) {
        Some(Mode::Fresh) => "fresh",
        Some(Mode::Held) => "held",
        Some(Mode::Fallback) => "fallback",
        Some(Mode::Idle) => "idle",
        Some(Mode::NotFinite) => "not finite",
        None => "unknown",
    };
    let styled = |word: &'static str| Span::styled(word, paint.verdict(word == "fresh"));
    let mut line = Line::from(format!("{:<10}", "mode"));
    match (&flight.wrench, &flight.rotor_speeds) {
        (Some(wrench), Some(speeds)) => {
            line.extend([
                Span::raw("inner "),
                styled(word(wrench.mode)),
                Span::raw("   mixer "),
                styled(word(speeds.mode)),
            ]);
            if speeds.saturated == 1 {
                line.push_span(Span::styled("   saturated", paint.bad()));
            }
        }
        _ => line.push_span(Span::raw("-")),
    }
    line
}

/// The horizon as seen from the airframe: it rises to the right if the left side is up.
fn horizon(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    let attitude = flight
        .state
        .map_or([0.0; 3], |state| state.measured.attitude_rad);
    let wanted = flight
        .setpoint
        .map_or([0.0; 3], |setpoint| setpoint.attitude_rad);
    // A cell is half as wide as it is high.
    let half_width = f64::from(area.width) / f64::from(area.height) / 2.0;
    let colour = |style: ratatui::style::Style| style.fg.unwrap_or(Color::Reset);
    let stroke = |[roll, pitch, _]: [f64; 3], reach: f64, colour: Color| {
        let (sin, cos) = roll.sin_cos();
        let rise = pitch / PITCH_RAD;
        Stroke {
            x1: -reach * cos,
            y1: rise - reach * sin,
            x2: reach * cos,
            y2: rise + reach * sin,
            color: colour,
        }
    };
    let canvas = Canvas::default()
        .marker(Marker::Braille)
        .x_bounds([-half_width, half_width])
        .y_bounds([-1.0, 1.0])
        .paint(move |context| {
            context.draw(&stroke(wanted, 0.45, colour(paint.reference())));
            context.draw(&stroke(attitude, half_width, colour(paint.actual())));
            context.layer();
            // The airframe.
            context.print(-0.4, 0.0, Line::from("--"));
            context.print(0.0, 0.0, Line::from("+"));
            context.print(0.3, 0.0, Line::from("--"));
        });
    frame.render_widget(canvas, area);
}

fn error(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    if area.height < 4 {
        return;
    }
    let points = flight.position_error.newest(usize::from(area.width));
    let most = points.iter().copied().fold(0.0, f64::max);
    let title = format!(
        "position error, last {:.0} s; full height {most:.4} m",
        f64::from(area.width) * POINT_S
    );
    let area = Rect {
        y: area.y + 1,
        height: area.height - 1,
        ..area
    };
    let below = put(frame, area, vec![Line::styled(title, paint.heading())]);
    bars(frame, below, &points, (0.0, most), paint.actual());
}
