//! Page 6: what each law shows of itself, as it names it.

use model::telemetry::LAW_ROLES;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use crate::watch::draw::put;
use crate::watch::draw::style::Paint;
use crate::watch::model::WatchedFlight;
use report::laws::SignalSection;

/// Width from which there is room for the smallest and the largest value.
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
            heading.push_span(Span::styled(format!("{:gap$}{columns}", ""), paint.heading()));
        }
        lines.push(heading);
        lines.extend(signals.iter().map(|signal| row(signal, area.width)));
    }
    let rows = usize::from(area.height);
    if lines.len() > rows {
        let hidden = lines.len() - rows.saturating_sub(1);
        lines.truncate(rows.saturating_sub(1));
        lines.push(Line::styled(format!("and {hidden} more: enlarge the terminal"), paint.faint()));
    }
    put(frame, area, lines);
}

/// Width of a name.
const NAME: usize = 27;

fn row<'a>(signal: &SignalSection, width: u16) -> Line<'a> {
    let number = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.4e}"));
    let SignalSection { name, unit, last, min, max } = signal;
    let [last, min, max] = [*last, *min, *max].map(number);
    let text = if width >= ROOMY {
        format!("  {name:<NAME$.NAME$}{last:>13}{min:>13}{max:>13} {unit}")
    } else {
        // The number comes last and must be whole: without its exponent it would be another one.
        let room = usize::from(width).saturating_sub(1 + 11);
        format!(" {name:<room$.room$}{last:>11}")
    };
    Line::from(text.trim_end().to_owned())
}
