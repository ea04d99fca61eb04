//! Outages: their classes, and who worked when in the worst of them.

use maud::{Markup, html};
use model::role::STAGES;

use crate::autopsy::section::{Case, TimelineStage, TimelineTick, WORST_SHOWN};
use crate::page::parts::{cell, count, figure, section as part, table};
use crate::plot::gantt::{Begin, Gantt, Row, Work};
use crate::schema::Report;

/// The classes with their counts and the worst outages; nothing of a flight without one.
pub fn section(report: &Report) -> Markup {
    let autopsy = &report.autopsy;
    if autopsy.classes.is_empty() {
        return html! {};
    }
    let tick_us = report.run.wall_period_us;
    let content = html! {
        @if !report.deaths.is_empty() {
            h3 { "Processes that ended in flight" }
            ul { @for death in &report.deaths { li { (death.line()) } } }
        }
        p { "An outage is a row of ticks in which a deadline was missed, or a stage did not work on its input." }
        (table(&["cause", "stage", "outages", "deadlines missed"], autopsy.classes.iter().map(|class| {
            vec![
                cell(class.class.words()),
                cell(class.stage.as_deref().unwrap_or("-")),
                cell(class.outages),
                cell(class.missed),
            ]
        })))
        @if autopsy.pending > 0 { p.note { (count(autopsy.pending, "missed deadline")) " not classed yet." } }
        h3 { (worst(autopsy.worst.len().min(WORST_SHOWN))) }
        p.marks {
            span.key.block.deadline { "worked: from waking to sending" } " "
            span.key.block.stale.deadline { "without the input of its tick" } " "
            span.key.deadline { "due, and not awake yet" } " "
            span.key.late { "the delay that it is put down to" } " "
            span.key.block.band.late { "its command missed the deadline" }
        }
        div.plots {
            @for (i, case) in autopsy.worst.iter().take(WORST_SHOWN).enumerate() { (picture(i + 1, case, tick_us)) }
        }
        p.note {
            "Lines stand where ticks begin, which is the deadline of the tick before. The kernel's counters are read every "
            "10 ms; docs/measuring.md says what that leaves open."
        }
    };
    part("outages", "Outages", content)
}

fn worst(number: usize) -> String {
    if number == 1 { "What happened".into() } else { format!("The {number} longest") }
}

fn picture(number: usize, case: &Case, tick_us: f64) -> Markup {
    let stage = case.stage.as_deref().map(|stage| format!(", {stage}")).unwrap_or_default();
    let title = format!("{}{stage}", case.class.words());
    let facts = format!(
        "{:.3} s, tick {}: {} out, {} missed. {}.",
        case.time_s,
        case.tick,
        count(case.ticks, "tick"),
        count(case.missed, "deadline"),
        capital(&case.evidence)
    );
    figure(
        &format!("outage-{number}"),
        &title,
        &[],
        html! { p.evidence { (facts) } (gantt(case, tick_us, title.clone()).svg()) },
    )
}

fn capital(sentence: &str) -> String {
    let mut letters = sentence.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn gantt(case: &Case, tick_us: f64, title: String) -> Gantt {
    let begin_us = |tick: u64| (tick as f64 - case.tick as f64) * tick_us;
    let shown = windows(case);
    let begins = shown.iter().flat_map(|(first, last)| *first..=last + 1).map(|tick| Begin {
        at: begin_us(tick),
        label: match tick.cast_signed() - case.tick.cast_signed() {
            0 => "0".into(),
            after => format!("{after:+}"),
        },
    });
    let missed = case.timeline.iter().filter(|tick| tick.missed).map(|tick| {
        let word = format!("tick {}: its command missed the deadline", tick.tick);
        (begin_us(tick.tick), begin_us(tick.tick + 1), word)
    });
    Gantt {
        title: format!("outage: {title}"),
        label: format!("ticks from {} on, each {} long", case.tick, length(tick_us)),
        windows: shown.iter().map(|(first, last)| (begin_us(*first), begin_us(last + 1))).collect(),
        begins: begins.collect(),
        missed: missed.collect(),
        rows: (0..STAGES.len()).map(|i| row(case, i, begin_us)).collect(),
    }
}

fn length(us: f64) -> String {
    if us >= 1e3 { format!("{} ms", us / 1e3) } else { format!("{us} us") }
}

/// The ticks of the timeline that follow each other: first, last.
fn windows(case: &Case) -> Vec<(u64, u64)> {
    let mut shown: Vec<(u64, u64)> = Vec::new();
    for TimelineTick { tick, .. } in &case.timeline {
        match shown.last_mut() {
            Some((_, last)) if *last + 1 == *tick => *last = *tick,
            _ => shown.push((*tick, *tick)),
        }
    }
    shown
}

fn row(case: &Case, stage: usize, begin_us: impl Fn(u64) -> f64) -> Row {
    let name = STAGES[stage].name();
    let work = case.timeline.iter().filter_map(|tick| {
        let of = |name: &str| tick.stages.iter().find(|it| it.role == name);
        let TimelineStage { wake_us, send_us, is_fresh, .. } = of(name)?;
        let due = match stage.checked_sub(1) {
            None => Some(begin_us(tick.tick)),
            Some(before) => of(STAGES[before].name()).filter(|_| *is_fresh).map(|it| it.send_us),
        };
        let input = if *is_fresh { "" } else { ", without the input of its tick" };
        let word = format!("{name} in tick {}: {wake_us:.0} to {send_us:.0} us{input}", tick.tick);
        Some(Work { due, from: *wake_us, to: *send_us, is_stale: !is_fresh, word })
    });
    let stands_out = case.stage.as_deref() == Some(name);
    let late = (stands_out && case.delay_us > 0.0).then_some((case.due_us, case.due_us + case.delay_us));
    Row { label: name.into(), class: name, stands_out, late, work: work.collect() }
}
