//! Page 6: the signals that each law publishes.

use messages::telemetry::LAW_ROLES;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use crate::watch::dashboard_model::WatchedFlight;
use crate::watch::screen::drawing::Paint;
use crate::watch::screen::drawing::put;
use report::schema::SignalSection;

/// Width from which the smallest and the largest value fit.
const ROOMY: u16 = 76;

pub(super) fn draw(flight: &WatchedFlight, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    let mut lines = Vec::new();
    let mut names_columns = area.width >= ROOMY;
    for (role, tally) in LAW_ROLES.into_iter().zip(&flight.tally.telemetry) {
        let name = flight.setting(&format!("{role}.law"));
        let signals = tally.section();
        let mut heading = Line::from(Span::styled(format!("{role} {name}"), paint.heading()));
        if signals.is_empty() {
            heading.push_span(Span::styled("   shows nothing of itself", paint.faint()));
        } else if std::mem::take(&mut names_columns) {
            let columns = format!("{:>13}{:>13}{:>13}", "now", "smallest", "largest");
            let gap = (NAME + 2).saturating_sub(heading.width());
            heading.push_span(Span::styled(
                format!("{:gap$}{columns}", ""),
                paint.heading(),
            ));
        }
        lines.push(heading);
        lines.extend(signals.iter().map(|signal| row(signal, area.width)));
    }
    let rows = usize::from(area.height);
    if lines.len() > rows {
        let hidden = lines.len() - rows.saturating_sub(1);
        lines.truncate(rows.saturating_sub(1));
        lines.push(Line::styled(
            format!("and {hidden} more: enlarge the terminal"),
            paint.faint(),
        ));
    }
    put(frame, area, lines);
}

const NAME: usize = 27;

fn row<'a>(signal: &SignalSection, width: u16) -> Line<'a> {
    let number =
        |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.4e}"));
    let SignalSection {
        name,
        unit,
        last,
        min,
        max,
    } = signal;
    let [last, min, max] = [*last, *min, *max].map(number);
    let text = if width >= ROOMY {
        format!("  {name:<NAME$.NAME$}{last:>13}{min:>13}{max:>13} {unit}")
    } else {
        // The number must not be cut: without its exponent it would be another one.
        let room = usize::from(width).saturating_sub(1 + 11);
        format!(" {name:<room$.room$}{last:>11}")
    };
    Line::from(text.trim_end().to_owned())
}
