//! A part of the screen, and its styles.

use std::cell::Cell;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Paragraph, RenderDirection, Sparkline, Wrap};
use textwrap::{Options, WordSplitter};

pub(super) const PLAIN: Style = Style::new();
pub(super) const GOOD: Style = Style::new().fg(Color::Green);
pub(super) const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
pub(super) const ACTUAL: Style = Style::new().fg(Color::Blue).add_modifier(Modifier::BOLD);
pub(super) const HEADING: Style = Style::new().add_modifier(Modifier::BOLD);
pub(super) const FAINT: Style = Style::new().add_modifier(Modifier::DIM);
pub(super) const SELECTED: Style = Style::new().add_modifier(Modifier::REVERSED);

pub(super) const fn good_or_bad(is_good: bool) -> Style {
    if is_good { GOOD } else { BAD }
}

/// A part of the screen that is filled from the top.
pub(super) struct Region<'r, 'f> {
    pub(super) frame: &'r mut Frame<'f>,
    pub(super) area: Rect,
}

impl Region<'_, '_> {
    /// Takes lines off the top.
    pub(super) fn split(&mut self, lines: u16) -> Rect {
        let [top, rest] =
            Layout::vertical([Constraint::Length(lines), Constraint::Min(0)]).areas(self.area);
        self.area = rest;
        top
    }

    pub(super) fn put(&mut self, lines: Vec<Line<'_>>) {
        let height = u16::try_from(lines.len()).unwrap_or(u16::MAX);
        let top = self.split(height.min(self.area.height));
        self.frame.render_widget(Paragraph::new(lines), top);
    }

    /// Fills the rest with lines from the scrolled one on, and limits that so that the rest is filled.
    pub(super) fn put_scrolled(&mut self, mut lines: Vec<Line<'_>>, scrolled: &Cell<usize>) {
        let (all, height) = (lines.len(), usize::from(self.area.height));
        let room = if all > height {
            height.saturating_sub(1)
        } else {
            all
        };
        let first = scrolled.get().min(all - room);
        scrolled.set(first);
        lines.drain(..first);
        lines.truncate(room);
        if room < all {
            let text = format!("rows {} to {} of {all}: Up, Down", first + 1, first + room);
            lines.push(Line::styled(text, FAINT));
        }
        self.put(lines);
    }

    /// Fills the rest with lines that are wrapped.
    pub(super) fn put_wrapped(&mut self, lines: Vec<Line<'_>>) {
        let text = Paragraph::new(lines).wrap(Wrap { trim: true });
        self.frame.render_widget(text, self.area);
    }

    /// Fills the rest with values as bars between `floor` and `ceiling`, the newest at the right edge.
    pub(super) fn put_bars(&mut self, values: &[f64], [floor, ceiling]: [f64; 2]) {
        const STEPS: f64 = 1000.0;
        let span = (ceiling - floor).max(f64::MIN_POSITIVE);
        let steps = |value: &f64| ((value - floor) / span * STEPS).round().clamp(0.0, STEPS) as u64;
        let newest_first: Vec<u64> = values.iter().rev().map(steps).collect();
        let bars = Sparkline::default().data(&newest_first).max(STEPS as u64);
        let bars = bars.direction(RenderDirection::RightToLeft).style(ACTUAL);
        self.frame.render_widget(bars, self.area);
    }

    /// A table with a heading, scrolled so that the selected row is visible.
    pub(super) fn put_table(
        &mut self,
        heading: Line<'_>,
        rows: Vec<Line<'_>>,
        selected: usize,
        room: usize,
    ) {
        let first = selected
            .saturating_sub(room / 2)
            .min(rows.len().saturating_sub(room));
        let rows = rows.into_iter().enumerate().skip(first).take(room);
        let rows = rows.map(|(i, row)| match i == selected {
            true => row.style(SELECTED),
            false => row,
        });
        self.put([heading.style(HEADING)].into_iter().chain(rows).collect());
    }
}

/// A line with as many of the parts, in order, as fit.
pub(super) fn fitting<'a, L: Into<Line<'a>>>(
    parts: impl IntoIterator<Item = L>,
    width: u16,
) -> Line<'a> {
    let mut room = usize::from(width);
    let mut line = Line::default();
    for part in parts.into_iter().map(Into::into) {
        let Some(rest) = room.checked_sub(part.width()) else {
            break;
        };
        room = rest;
        line.extend(part);
    }
    line
}

/// Text in lines of a width, broken at blanks; lines after the first are indented.
pub(super) fn wrapped(text: &str, width: u16, indent: usize) -> Vec<String> {
    let indent = " ".repeat(indent);
    let options = Options::new(width.into())
        .subsequent_indent(&indent)
        .word_splitter(WordSplitter::NoHyphenation)
        .break_words(false);
    let lines = textwrap::wrap(text, options).into_iter();
    lines.map(Into::into).collect()
}
