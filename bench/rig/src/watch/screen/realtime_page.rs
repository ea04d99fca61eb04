//! Page 5: the real-time rights that each process requested and got.

use messages::blackboards::{RolePhase, Status};
use messages::realtime::RealtimeStep;
use messages::role::Role;
use process::rt::remedy;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

use crate::watch::dashboard_model::WatchedFlight;
use crate::watch::screen::drawing::Paint;
use crate::watch::screen::drawing::put;
use errors::errno_text;
use report::sections::role_section;

const COLUMN: usize = 12;

pub(super) fn draw(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    let name = if area.width >= 74 { 14 } else { 12 };
    let shown = (usize::from(area.width).saturating_sub(name) / COLUMN).clamp(1, 5);
    // The plant first: its delays matter most.
    let crew: Vec<(&Role, &Status)> = flight.crew.iter().take(shown).collect();
    let row = |title: &str, text: &dyn Fn(&Status) -> String| {
        let cells: String = crew
            .iter()
            .map(|(_, status)| format!("{:<COLUMN$}", text(status)))
            .collect();
        Line::from(format!("{title:<name$}{cells}"))
    };
    let names: String = crew
        .iter()
        .map(|(role, _)| format!("{:<COLUMN$}", role.name()))
        .collect();
    let mut lines = vec![
        Line::styled(format!("{:<name$}{names}", ""), paint.heading()),
        row("process", &|status| status.pid.to_string()),
        row("phase", &|status| phase(status).into()),
        row("scheduling", &|status| role_section(status).scheduling),
    ];
    for step in RealtimeStep::ALL {
        let title = serde_json::to_value(step)
            .ok()
            .and_then(|v| v.as_str().map(str::to_owned))
            .unwrap_or_default();
        let mut line = Line::from(format!("{title:<name$}"));
        for (role, status) in &crew {
            let grant = status.grants.of(step);
            let asked = match (step, role) {
                (RealtimeStep::Affinity, Role::Record) => format!("not {} ", grant.value),
                (RealtimeStep::Affinity, _) => format!("{} ", grant.value),
                _ if grant.value > 0 => format!("{} ", grant.value),
                _ => String::new(),
            };
            line.push_span(match (grant.asked, grant.granted()) {
                (1, true) => {
                    Span::styled(format!("{:<COLUMN$}", format!("{asked}ok")), paint.good())
                }
                (1, false) => Span::styled(
                    format!("{:<COLUMN$}", format!("{asked}REFUSED")),
                    paint.bad(),
                ),
                _ => Span::styled(format!("{:<COLUMN$}", "-"), paint.faint()),
            });
        }
        lines.push(line);
    }
    lines.push(row("ticks", &|status| status.ticks_run.to_string()));
    lines.push(row("skipped", &|status| status.ticks_skipped.to_string()));
    lines.push(row("stale", &|status| status.ticks_stale.to_string()));
    lines.push(row("rejected", &|status| {
        status.rejections.total().to_string()
    }));
    if shown < flight.crew.len() {
        lines.insert(
            0,
            Line::styled(
                format!("room for {shown} of {} roles", flight.crew.len()),
                paint.faint(),
            ),
        );
    }
    let rest = put(frame, area, lines);
    frame.render_widget(
        Paragraph::new(refusals(flight, paint)).wrap(Wrap { trim: true }),
        rest,
    );
}

const fn phase_words(phase: RolePhase) -> &'static str {
    match phase {
        RolePhase::Starting => "starting",
        RolePhase::Ready => "ready",
        RolePhase::Armed => "armed",
        RolePhase::Flying => "flying",
        RolePhase::Landed => "landed",
    }
}

fn phase(status: &Status) -> &'static str {
    phase_words(status.phase())
}

/// Each refusal once, with its remedy.
fn refusals<'a>(flight: &WatchedFlight, paint: Paint) -> Vec<Line<'a>> {
    let mut lines = Vec::new();
    for step in RealtimeStep::ALL {
        let refused = flight
            .crew
            .values()
            .map(|status| status.grants.of(step))
            .find(|grant| grant.asked == 1 && !grant.granted());
        if let Some(grant) = refused {
            lines.push(Line::styled(
                format!("{}: {}", errno_text(grant.errno), remedy(step, grant.errno)),
                paint.faint(),
            ));
        }
    }
    lines
}
