//! Page 4: the current parameters, and the input line that changes them.

use messages::parameters::{Airframe, SPECS, Spec};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

use crate::params::{bound, number};
use crate::watch::dashboard_model::{ParameterPage, WatchedFlight};
use crate::watch::screen::drawing::Paint;
use crate::watch::screen::drawing::{first_row, put};

pub(super) fn draw(
    flight: &WatchedFlight,
    desk: &ParameterPage,
    paint: Paint,
    frame: &mut Frame<'_>,
    area: Rect,
) {
    // An error message may need two lines.
    let foot = if area.height >= 12 { 2 } else { 1 };
    let room = usize::from(area.height).saturating_sub(foot + 1);
    let first = first_row(desk.selected, SPECS.len(), room);
    let mut lines = vec![Line::styled(heading(area.width), paint.heading())];
    for (row, spec) in SPECS.iter().enumerate().skip(first).take(room) {
        let value = flight.in_force.value[row];
        let style = if row == desk.selected {
            paint.selected()
        } else if value != flight.airframe.get(spec.parameter) {
            paint.bad()
        } else {
            ratatui::style::Style::new()
        };
        lines.push(Line::styled(
            row_text(spec, &flight.airframe, value, area.width),
            style,
        ));
    }
    put(frame, area, lines);
    let used = (SPECS.len().min(room) + 1) as u16;
    let gap = u16::from(area.height > used + foot as u16);
    let foot = Rect {
        y: area.y + used + gap,
        height: area.height - used - gap,
        ..area
    };
    frame.render_widget(
        Paragraph::new(said(flight, desk, paint)).wrap(Wrap { trim: true }),
        foot,
    );
}

/// Whether there is room for nominal value and range.
const fn is_roomy(width: u16) -> bool {
    width >= 74
}

fn heading(width: u16) -> String {
    if is_roomy(width) {
        format!(
            "{:<24}{:>11}  {:<8}{:>9}{:>9}{:>9}",
            "parameter", "in force", "unit", "nominal", "min", "max"
        )
    } else {
        format!("{:<24}{:>11}", "parameter", "in force")
    }
}

fn row_text(spec: &Spec, airframe: &Airframe, value: f64, width: u16) -> String {
    let (nominal, range) = (airframe.get(spec.parameter), airframe.range(spec.parameter));
    let mark = if value == nominal { ' ' } else { '*' };
    let row = format!("{:<24}{:>10}{mark}", spec.name, number(value));
    if is_roomy(width) {
        // A long unit uses the room of the nominal value, which is 0 in that row.
        let rest = 17_usize.saturating_sub(spec.unit.len().max(8));
        let nominal = number(nominal);
        format!(
            "{row}  {:<8}{nominal:>rest$}{:>9}{:>9}",
            spec.unit,
            bound(range.min),
            bound(range.max)
        )
    } else {
        row
    }
}

fn said<'a>(flight: &WatchedFlight, desk: &'a ParameterPage, paint: Paint) -> Vec<Line<'a>> {
    let spec = desk.parameter().spec();
    let range = flight.airframe.range(spec.parameter);
    let mut lines = Vec::new();
    if let Some(typed) = desk.typed.as_ref().filter(|_| desk.fault) {
        lines.push(Line::from(vec![
            Span::raw("fault, as in state.drop=0.1 for 1s: "),
            Span::styled(format!("{typed}_"), paint.heading()),
        ]));
    } else if let Some(typed) = &desk.typed {
        lines.push(Line::from(vec![
            Span::raw(format!(
                "{} [{}], {:?} to {:?}: ",
                spec.name, spec.unit, range.min, range.max
            )),
            Span::styled(format!("{typed}_"), paint.heading()),
        ]));
    } else if desk.waits {
        lines.push(Line::from("waits for the plant's answer"));
    }
    match &desk.said {
        Some(said) => {
            lines.push(Line::styled(
                said.text.as_str(),
                if said.refused {
                    paint.bad()
                } else {
                    paint.good()
                },
            ));
        }
        None if lines.is_empty() => {
            lines.push(Line::styled(spec.meaning, paint.faint()));
            let epoch = flight.in_force.parameter_epoch;
            let last = flight
                .newest_swap
                .as_ref()
                .map(|swap| format!("; the last: {}", swap.words()));
            let swaps = format!(
                "* is not nominal; swaps so far {epoch}{}",
                last.unwrap_or_default()
            );
            lines.push(Line::styled(swaps, paint.faint()));
        }
        None => {}
    }
    lines
}
