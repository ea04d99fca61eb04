//! The dashboard's screen: a pure function of the model.
//!
//! ```text
//! header    instance, phase, time, tick, misses
//! verdicts  does it track, is it in time, does the theorem hold
//! tabs
//! page      one of six
//! keys
//! ```
//!
//! Every colour is visible on black and on white, and text always says the same as the colour.

mod pages;
mod region;

use messages::blackboards::EndReason;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Margin, Rect};
use ratatui::style::{Color, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Wrap};

use crate::watch::dashboard_model::{Judged, Model, Tab};
use analysis::phrase::count;
use analysis::schema::TimingVerdict;
use region::{BAD, FAINT, GOOD, HEADING, PLAIN, Region, SELECTED, fitting, good_or_bad};

/// The smallest terminal that has room for a page.
pub const SMALLEST: (u16, u16) = (40, 12);

pub fn draw(model: &Model, frame: &mut Frame<'_>) {
    let area = frame.area();
    let (width, height) = SMALLEST;
    if area.width < width || area.height < height {
        let text = format!(
            "{} x {} is too small: ironbird watch needs {width} x {height}",
            area.width, area.height
        );
        frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
        return;
    }
    let lines = [Constraint::Length(1); 3];
    let rows = [&lines[..], &[Constraint::Min(1), Constraint::Length(1)]].concat();
    let [header, verdicts, tabs, page, keys] = Layout::vertical(rows).areas(area);
    frame.render_widget(header_line(model, area.width), header);
    frame.render_widget(verdict_line(model, area.width), verdicts);
    frame.render_widget(tab_line(model.tab, area.width), tabs);
    frame.render_widget(key_line(model, area.width), keys);
    let area = page.inner(Margin::new(1, 0));
    let mut region = Region { frame, area };
    match &model.flight {
        None => waiting(model, &mut region),
        Some(flight) => pages::draw(model, flight, &mut region),
    }
    if model.help {
        help_window(model.launched, frame);
    }
    if !model.colours {
        for cell in &mut frame.buffer_mut().content {
            (cell.fg, cell.bg) = (Color::Reset, Color::Reset);
        }
    }
}

fn header_line(model: &Model, width: u16) -> Line<'_> {
    let mut parts = vec![Line::styled(format!(" {}", model.instance), HEADING)];
    let mut add =
        |text: String, style: Style| parts.push(Line::styled(format!("   {text}"), style));
    if let Some(flight) = &model.flight {
        let (run, tick) = (&flight.run, flight.tick());
        match flight.ending {
            None => add("flying".into(), GOOD),
            Some(ending) => {
                let style = good_or_bad(ending == EndReason::Completed);
                add(format!("ended: {}", ending.name()), style);
            }
        }
        let [now_s, last_s] = [tick, run.last_tick].map(|tick| run.flight_time_s(tick));
        add(format!("{now_s:.1} of {last_s:.1} s"), PLAIN);
        if model.is_flying() && !flight.recorder_lives {
            add("no recorder: no news".into(), BAD);
        }
        let (missed, skipped) = (run.deadlines_missed, run.ticks_skipped);
        for (name, count) in [("missed", missed), ("skipped", skipped)] {
            let style = if count == 0 { PLAIN } else { BAD };
            add(format!("{name} {count}"), style);
        }
        add(format!("tick {tick}"), FAINT);
        let flown = &flight.settings.flight;
        let (trajectory, preset) = (&flown.trajectory, &flown.preset);
        add(format!("{trajectory}, gains {preset}"), FAINT);
    } else {
        let words = ["waits for a flight", "starts"][usize::from(model.launched)];
        add(words.into(), PLAIN);
    }
    fitting(parts, width)
}

fn verdict_line(model: &Model, width: u16) -> Line<'_> {
    let Some(flight) = &model.flight else {
        return Line::default();
    };
    let (verdicts, not_fresh) = flight.verdicts();
    let lost_at = flight.lost_at();
    let mut all = Judged::all(&verdicts);
    if verdicts.timing.word == TimingVerdict::Late {
        all[1].word = format!("late, {:.2} % on time", not_fresh.on_time_percent());
    }
    let subjects = [" ", "   timing ", "   theorem "];
    let parts = subjects.into_iter().zip(all).map(|(subject, it)| {
        let is_good = it.is_good.filter(|_| lost_at.is_none());
        let word = Span::styled(it.word, is_good.map_or(FAINT, good_or_bad));
        Line::from_iter([Span::styled(subject, FAINT), word])
    });
    let until = lost_at.map(|tick| Line::styled(format!(" up to tick {tick}:"), BAD));
    fitting(until.into_iter().chain(parts), width)
}

fn tab_line<'a>(open: Tab, width: u16) -> Line<'a> {
    // A narrow terminal shows only the open page's name.
    let all_widths = Tab::ALL.iter().map(|(_, name)| name.len() + 5).sum();
    let is_wide = usize::from(width) >= all_widths;
    let mut line = Line::default();
    for (number, (tab, name)) in (1..).zip(Tab::ALL) {
        line.push_span(Span::styled(format!(" {number} "), FAINT));
        if is_wide || tab == open {
            let style = if tab == open { SELECTED } else { HEADING };
            line.push_span(Span::styled(format!(" {name} "), style));
        }
    }
    line
}

fn key_line<'a>(model: &Model, width: u16) -> Line<'a> {
    let leave = ["leave", "leave, it flies on"][usize::from(model.is_flying())];
    let on_page: &[_] = match model.tab {
        _ if model.parameters.typed.is_some() => &[("Enter", "inject"), ("Esc", "leave it")],
        Tab::Plant => &[("Up/Down", "select"), ("Enter", "edit"), ("f", "fault")],
        Tab::Latency => &[("Up/Down", "select"), ("r", "reset")],
        _ => &[("Tab", "next"), ("Up/Down", "scroll"), ("r", "reset")],
    };
    let on_every_page = match model.parameters.typed {
        Some(_) => vec![],
        None => vec![("q", leave), ("?", "help")],
    };
    let key = |(key, does): &(&str, &str)| {
        let (key, does) = (format!(" {key}"), format!(" {does} "));
        Line::from_iter([Span::styled(key, HEADING), Span::styled(does, FAINT)])
    };
    let lost = model.flight.as_ref().map_or(0, |flight| flight.lost());
    let lost = (lost > 0).then(|| Line::styled(format!("  lost {}", count(lost, "message")), BAD));
    let keys = on_every_page.iter().chain(on_page).map(key);
    fitting(keys.chain(lost), width)
}

fn waiting(model: &Model, region: &mut Region<'_, '_>) {
    let instance = &model.instance;
    let flag = match instance.as_str() {
        "default" => String::new(),
        name => format!(" --instance {name}"),
    };
    let text = match model.launched {
        true => format!("The flight of instance `{instance}` starts: its processes get ready."),
        false => format!(
            "Waits for instance `{instance}` to fly.\n\nStart a flight in another terminal:\n  ironbird fly{flag}"
        ),
    };
    let text = Paragraph::new(text).wrap(Wrap { trim: false });
    region.frame.render_widget(text, region.area);
}

fn help_window(launched: bool, frame: &mut Frame<'_>) {
    let ctrl_c = ["leave", "end the flight"][usize::from(launched)];
    let text = format!(
        " 1 .. 6      pages\n Tab, S-Tab  next page, previous page\n Up, Down    rows, scroll\n Enter       edit and inject (Plant)\n \
         f           inject a fault (Plant)\n r           restart statistics\n q, Esc      leave; it flies on\n \
         Ctrl-C      {ctrl_c}\n any key closes"
    );
    let area = frame.area();
    let (width, height) = (40.min(area.width), 11.min(area.height));
    let place = Rect {
        x: (area.width - width) / 2,
        y: (area.height - height) / 2,
        width,
        height,
    };
    frame.render_widget(Clear, place);
    let window = Paragraph::new(text).block(Block::bordered().title(" ironbird watch "));
    frame.render_widget(window, place);
}
