//! Colours that are readable on light, dark and colourless terminals.
//!
//! Every colour is visible on black and on white. Text always says the same as the colour.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Paragraph, Sparkline};

#[derive(Clone, Copy, Debug)]
pub struct Paint {
    colours: bool,
}

impl Paint {
    #[must_use]
    pub const fn new(colours: bool) -> Self {
        Self { colours }
    }

    fn colour(self, colour: Color) -> Style {
        if self.colours {
            Style::new().fg(colour)
        } else {
            Style::new()
        }
    }

    #[must_use]
    pub fn good(self) -> Style {
        self.colour(Color::Green)
    }

    #[must_use]
    pub fn bad(self) -> Style {
        self.colour(Color::Red).add_modifier(Modifier::BOLD)
    }

    #[must_use]
    pub fn actual(self) -> Style {
        self.colour(Color::Blue).add_modifier(Modifier::BOLD)
    }

    /// Setpoints in charts.
    #[must_use]
    pub fn reference(self) -> Style {
        self.colour(Color::Magenta)
    }

    #[must_use]
    pub fn heading(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    #[must_use]
    pub fn faint(self) -> Style {
        Style::new().add_modifier(Modifier::DIM)
    }

    #[must_use]
    pub fn selected(self) -> Style {
        Style::new().add_modifier(Modifier::REVERSED)
    }

    #[must_use]
    pub fn verdict(self, good: bool) -> Style {
        if good { self.good() } else { self.bad() }
    }
}

/// Draws lines at the top of an area; returns the area below them.
pub(super) fn put(frame: &mut Frame<'_>, area: Rect, lines: Vec<Line<'_>>) -> Rect {
    let height = u16::try_from(lines.len())
        .unwrap_or(u16::MAX)
        .min(area.height);
    frame.render_widget(Paragraph::new(lines), Rect { height, ..area });
    Rect {
        y: area.y + height,
        height: area.height - height,
        ..area
    }
}

/// Draws values as bars between `floor` and `ceiling`, the newest at the right edge.
pub(super) fn bars(
    frame: &mut Frame<'_>,
    area: Rect,
    values: &[f64],
    (floor, ceiling): (f64, f64),
    style: Style,
) {
    const STEPS: f64 = 1000.0;
    let span = (ceiling - floor).max(f64::MIN_POSITIVE);
    let scaled: Vec<u64> = values
        .iter()
        .map(|value| ((value - floor) / span * STEPS).round().clamp(0.0, STEPS) as u64)
        .collect();
    let shift = area
        .width
        .saturating_sub(u16::try_from(scaled.len()).unwrap_or(u16::MAX));
    let right = Rect {
        x: area.x + shift,
        width: area.width - shift,
        ..area
    };
    frame.render_widget(
        Sparkline::default()
            .data(&scaled)
            .max(STEPS as u64)
            .style(style),
        right,
    );
}

/// The first table row to show so that the selected row is visible.
pub(super) fn first_row(selected: usize, rows: usize, room: usize) -> usize {
    selected
        .saturating_sub(room / 2)
        .min(rows.saturating_sub(room))
}
