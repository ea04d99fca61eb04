//! The help window, drawn over the page.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::{Block, Clear, Paragraph};

use crate::watch::dashboard_model::Model;
use crate::watch::screen::drawing::Paint;

pub(super) fn draw(model: &Model, paint: Paint, frame: &mut Frame<'_>, area: Rect) {
    let keys = [
        ("1 .. 6", "pages"),
        ("Tab, S-Tab", "next page, previous page"),
        ("Up, Down", "rows"),
        ("Enter", "edit and inject (Plant)"),
        ("f", "inject a fault (Plant)"),
        ("r", "restart statistics"),
        ("q, Esc", "leave; it flies on"),
        (
            "Ctrl-C",
            if model.launched {
                "end the flight"
            } else {
                "leave"
            },
        ),
    ];
    let mut lines: Vec<Line<'_>> = keys
        .iter()
        .map(|(key, does)| Line::from(format!(" {key:<12}{does}")))
        .collect();
    lines.push(Line::styled(" any key closes", paint.faint()));
    let (width, height) = (40.min(area.width), 11.min(area.height));
    let place = Rect {
        x: (area.width - width) / 2,
        y: (area.height - height) / 2,
        width,
        height,
    };
    frame.render_widget(Clear, place);
    frame.render_widget(
        Paragraph::new(lines).block(Block::bordered().title(" ironbird watch ")),
        place,
    );
}
