//! The dashboard's screen: a pure function of the model.
//!
//! ```text
//! head    instance, phase, time, tick, misses
//! words   does it track, is it in time, does the theorem hold
//! tabs
//! body    a page per file
//! foot    keys
//! ```

mod drawing;
mod flight_page;
mod help_window;
mod latency_page;
mod laws_page;
mod lyapunov_page;
mod plant_page;
mod realtime_page;

use messages::blackboards::EndReason;
use messages::content::NO_TICK;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

use crate::watch::dashboard_model::{Model, Tab, WatchedFlight, verdicts};
use drawing::Paint;
use report::schema::{FlightVerdict, StabilityVerdict, TimingVerdict};

/// The smallest terminal that has room for a page.
pub const SMALLEST: (u16, u16) = (40, 12);

pub fn draw(model: &Model, frame: &mut Frame<'_>) {
    let paint = Paint::new(model.colours);
    let area = frame.area();
    if area.width < SMALLEST.0 || area.height < SMALLEST.1 {
        let text = format!(
            "{} x {} is too small: ironbird watch needs {} x {}",
            area.width, area.height, SMALLEST.0, SMALLEST.1
        );
        frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
        return;
    }
    let [head, words, tabs, body, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Min(1),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(head_line(model, paint, area.width), head);
    frame.render_widget(word_line(model, paint, area.width), words);
    frame.render_widget(tab_line(model, paint, area.width), tabs);
    frame.render_widget(foot_line(model, paint, area.width), foot);
    let body = Rect {
        x: body.x + 1,
        width: body.width - 2,
        ..body
    };
    match (&model.flight, model.tab) {
        (None, _) => waiting(model, frame, body),
        (Some(flight), Tab::Flight) => flight_page::draw(flight, paint, frame, body),
        (Some(flight), Tab::Latency) => {
            latency_page::draw(flight, model.series, paint, frame, body)
        }
        (Some(flight), Tab::Theorem) => lyapunov_page::draw(flight, paint, frame, body),
        (Some(flight), Tab::Plant) => plant_page::draw(flight, &model.desk, paint, frame, body),
        (Some(flight), Tab::RealTime) => realtime_page::draw(flight, paint, frame, body),
        (Some(flight), Tab::Laws) => laws_page::draw(flight, paint, frame, body),
    }
    if model.help {
        help_window::draw(model, paint, frame, area);
    }
}

/// A line with as many of the parts, in order, as fit.
fn fitting<'a>(parts: impl IntoIterator<Item = Line<'a>>, width: u16) -> Line<'a> {
    let mut room = usize::from(width);
    let mut line = Line::default();
    for part in parts {
        let Some(rest) = room.checked_sub(part.width()) else {
            break;
        };
        room = rest;
        line.extend(part);
    }
    line
}

fn head_line<'a>(model: &'a Model, paint: Paint, width: u16) -> Line<'a> {
    let name = Span::styled(format!(" {}", model.instance), paint.heading());
    let Some(flight) = &model.flight else {
        return fitting(
            [Line::from(name), Line::from("   waits for a flight")],
            width,
        );
    };
    let run = &flight.run;
    let phase = match flight.ending {
        None => Span::styled("   flying", paint.good()),
        Some(EndReason::Completed) => Span::styled("   landed: completed", paint.good()),
        Some(ending) => Span::styled(format!("   landed: {}", ending.name()), paint.bad()),
    };
    let mut parts = vec![name, phase];
    let tick = flight.tick();
    if tick != NO_TICK {
        parts.push(Span::raw(format!(
            "   {:.1} of {:.1} s",
            run.flight_time_s(tick),
            run.flight_time_s(run.last_tick)
        )));
    }
    let count = |name: &str, count: u64| {
        let style = if count == 0 {
            ratatui::style::Style::new()
        } else {
            paint.bad()
        };
        Span::styled(format!("   {name} {count}"), style)
    };
    if flight.ending.is_none() && !flight.recorder_lives {
        parts.push(Span::styled("   no recorder: no news", paint.bad()));
    }
    parts.push(count("missed", run.deadlines_missed));
    parts.push(count("skipped", run.ticks_skipped));
    if tick != NO_TICK {
        parts.push(Span::styled(format!("   tick {tick}"), paint.faint()));
    }
    let (trajectory, preset) = (
        flight.setting("flight.trajectory"),
        flight.setting("flight.preset"),
    );
    if !trajectory.is_empty() {
        parts.push(Span::styled(
            format!("   {trajectory}, gains {preset}"),
            paint.faint(),
        ));
    }
    fitting(parts.into_iter().map(Line::from), width)
}

fn word_line<'a>(model: &'a Model, paint: Paint, width: u16) -> Line<'a> {
    let Some(flight) = &model.flight else {
        return Line::default();
    };
    let words = verdicts(flight);
    let lost_at = flight.lost_at();
    let style = |is_bad: bool, is_good: bool| match (is_bad, is_good) {
        _ if lost_at.is_some() => paint.faint(),
        (true, _) => paint.bad(),
        (_, true) => paint.good(),
        _ => paint.faint(),
    };
    let (flown, timing, theorem) = (words.flight.word, words.timing.word, words.theorem.word);
    let is_off = matches!(flown, FlightVerdict::OffTrack | FlightVerdict::Lost);
    let parts = [
        (
            flown.words(),
            style(is_off, flown == FlightVerdict::Tracked),
        ),
        (
            timing.words(),
            style(
                timing == TimingVerdict::Late,
                timing == TimingVerdict::InTime,
            ),
        ),
        (
            theorem.words(),
            style(
                theorem == StabilityVerdict::Broken,
                theorem == StabilityVerdict::Holds,
            ),
        ),
    ];
    let subjects = [" ", "   timing ", "   theorem "];
    let part = |(subject, (word, style))| {
        Line::from(vec![
            Span::styled(subject, paint.faint()),
            Span::styled(word, style),
        ])
    };
    let until = lost_at.map(|tick| Line::styled(format!(" up to tick {tick}:"), paint.bad()));
    fitting(
        until
            .into_iter()
            .chain(subjects.into_iter().zip(parts).map(part)),
        width,
    )
}

fn tab_line<'a>(model: &Model, paint: Paint, width: u16) -> Line<'a> {
    let numbers = |number: usize| Span::styled(format!(" {number} "), paint.faint());
    let label = |tab: Tab, name: &'static str| {
        Span::styled(
            format!(" {name} "),
            if tab == model.tab {
                paint.selected()
            } else {
                paint.heading()
            },
        )
    };
    // A narrow terminal shows only the open page's name.
    let roomy = usize::from(width) >= Tab::ALL.iter().map(|tab| tab.name().len() + 5).sum();
    let mut line = Line::default();
    for (i, tab) in Tab::ALL.into_iter().enumerate() {
        line.push_span(numbers(i + 1));
        if roomy || tab == model.tab {
            line.push_span(label(tab, tab.name()));
        }
    }
    line
}

fn foot_line<'a>(model: &Model, paint: Paint, width: u16) -> Line<'a> {
    let key = |key: &'static str, does: &'static str| {
        Line::from(vec![
            Span::styled(format!(" {key}"), paint.heading()),
            Span::styled(format!(" {does} "), paint.faint()),
        ])
    };
    let mut keys = Vec::new();
    if model.desk.typed.is_some() {
        keys.extend([key("Enter", "inject"), key("Esc", "leave it")]);
    } else {
        keys.push(key(
            "q",
            if model.flies() {
                "leave, it flies on"
            } else {
                "leave"
            },
        ));
        keys.push(key("?", "help"));
        match model.tab {
            Tab::Plant => keys.extend([
                key("Up/Down", "select"),
                key("Enter", "edit"),
                key("f", "fault"),
            ]),
            Tab::Latency => keys.extend([key("Up/Down", "select"), key("r", "reset")]),
            _ => keys.extend([key("Tab", "next"), key("r", "reset")]),
        }
    }
    let lost = model.flight.as_ref().map_or(0, WatchedFlight::lost);
    if lost > 0 {
        keys.push(Line::from(Span::styled(
            format!("  lost {lost} messages"),
            paint.bad(),
        )));
    }
    fitting(keys, width)
}

fn waiting(model: &Model, frame: &mut Frame<'_>, area: Rect) {
    let text = vec![
        Line::from(format!("Waits for instance `{}` to fly.", model.instance)),
        Line::default(),
        Line::from("Start a flight in another terminal:"),
        Line::from(if model.instance == "default" {
            "  ironbird fly".to_owned()
        } else {
            format!("  ironbird fly --instance {}", model.instance)
        }),
    ];
    frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: false }), area);
}
