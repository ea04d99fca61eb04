//! Outages on the page: their causes, and a timeline of each of the worst.

use crate::outages::{OutageCase, TimelineStage, TimelineTick, WORST_SHOWN};
use crate::phrase::count;
use crate::render::html::{cell, figure, section as part, table};
use crate::render::plot::{BELOW, CHARACTER, HALF_CAPITAL, WIDTH, tenths};
use crate::schema::Report;
use maud::{Markup, html};
use messages::role::STAGES;

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
        @if autopsy.pending > 0 { p.note { (count(autopsy.pending, "missed deadline")) " not classified yet." } }
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
    if number == 1 {
        "What happened".into()
    } else {
        format!("The {number} longest")
    }
}

fn picture(number: usize, case: &OutageCase, tick_us: f64) -> Markup {
    let stage = case
        .stage
        .as_deref()
        .map(|stage| format!(", {stage}"))
        .unwrap_or_default();
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
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

fn gantt(case: &OutageCase, tick_us: f64, title: String) -> Gantt {
    let begin_us = |tick: u64| (tick as f64 - case.tick as f64) * tick_us;
    let shown = windows(case);
    let begins = shown
        .iter()
        .flat_map(|(first, last)| *first..=last + 1)
        .map(|tick| Begin {
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
        windows: shown
            .iter()
            .map(|(first, last)| (begin_us(*first), begin_us(last + 1)))
            .collect(),
        begins: begins.collect(),
        missed: missed.collect(),
        rows: (0..STAGES.len()).map(|i| row(case, i, begin_us)).collect(),
    }
}

fn length(us: f64) -> String {
    if us >= 1e3 {
        format!("{} ms", us / 1e3)
    } else {
        format!("{us} us")
    }
}

/// The ticks of the timeline that follow each other: first, last.
fn windows(case: &OutageCase) -> Vec<(u64, u64)> {
    let mut shown: Vec<(u64, u64)> = Vec::new();
    for TimelineTick { tick, .. } in &case.timeline {
        match shown.last_mut() {
            Some((_, last)) if *last + 1 == *tick => *last = *tick,
            _ => shown.push((*tick, *tick)),
        }
    }
    shown
}

fn row(case: &OutageCase, stage: usize, begin_us: impl Fn(u64) -> f64) -> Row {
    let name = STAGES[stage].name();
    let work = case.timeline.iter().filter_map(|tick| {
        let of = |name: &str| tick.stages.iter().find(|it| it.role == name);
        let TimelineStage {
            wake_us,
            send_us,
            is_fresh,
            ..
        } = of(name)?;
        let due = match stage.checked_sub(1) {
            None => Some(begin_us(tick.tick)),
            Some(before) => of(STAGES[before].name())
                .filter(|_| *is_fresh)
                .map(|it| it.send_us),
        };
        let input = if *is_fresh {
            ""
        } else {
            ", without the input of its tick"
        };
        let word = format!(
            "{name} in tick {}: {wake_us:.0} to {send_us:.0} us{input}",
            tick.tick
        );
        Some(Work {
            due,
            from: *wake_us,
            to: *send_us,
            is_stale: !is_fresh,
            word,
        })
    });
    let stands_out = case.stage.as_deref() == Some(name);
    let late =
        (stands_out && case.delay_us > 0.0).then_some((case.due_us, case.due_us + case.delay_us));
    Row {
        label: name.into(),
        class: name,
        stands_out,
        late,
        work: work.collect(),
    }
}

#[derive(Clone, Debug)]
pub struct Work {
    /// When it could have begun, where that is known.
    pub due: Option<f64>,
    pub from: f64,
    pub to: f64,
    /// Whether it was done without what it should have worked on.
    pub is_stale: bool,
    /// What it was, for who points at it.
    pub word: String,
}

#[derive(Clone, Debug)]
pub struct Row {
    pub label: String,
    pub class: &'static str,
    pub stands_out: bool,
    /// From when on, and until when it was late.
    pub late: Option<(f64, f64)>,
    pub work: Vec<Work>,
}

/// A line over all rows, at the beginning of a stretch of time.
#[derive(Clone, Debug)]
pub struct Begin {
    pub at: f64,
    pub label: String,
}

#[derive(Clone, Debug)]
pub struct Gantt {
    /// What it shows, for who cannot see it.
    pub title: String,
    pub label: String,
    /// What is shown of the time, in order: from, to.
    pub windows: Vec<(f64, f64)>,
    pub begins: Vec<Begin>,
    /// Stretches in which something was missed, with words.
    pub missed: Vec<(f64, f64, String)>,
    /// From the first to the last.
    pub rows: Vec<Row>,
}

/// Height of a row [pixels].
const ROW: f64 = 22.0;
/// Height of a bar [pixels].
const THICK: f64 = 12.0;
/// The least that is seen of a bar [pixels].
const THIN: f64 = 2.0;
/// Height of the row of crosses [pixels].
const CROSSES: f64 = 14.0;
/// Half the size of a cross [pixels].
const HALF: f64 = 3.5;
/// Space above the first row [pixels].
const ABOVE: f64 = 4.0;
/// Space between two windows [pixels].
const GAP: f64 = 36.0;
/// Space to the right of the rows, for half a number [pixels].
const RIGHT: f64 = 14.0;

impl Gantt {
    /// The picture as an `svg` element.
    #[must_use]
    pub fn svg(&self) -> Markup {
        let (left, right) = (self.left(), WIDTH - RIGHT);
        let foot = ABOVE + ROW * self.rows.len() as f64 + CROSSES;
        html! {
            svg viewBox=(format!("0 0 {WIDTH} {}", foot + BELOW)) role="img" aria-label=(self.title) {
                @for (from, to, word) in &self.missed {
                    @let (x, end) = (self.at(*from), self.at(*to));
                    rect.missed-tick.late x=(x) y=(ABOVE) width=(tenths(end - x)) height=(foot - ABOVE) {
                        title { (word) }
                    }
                }
                g.grid {
                    @for begin in &self.begins {
                        @let x = self.at(begin.at);
                        line x1=(x) x2=(x) y1=(ABOVE) y2=(foot) {}
                    }
                    @for (x, label) in self.labels() { text.below x=(x) y=(foot + 15.0) { (label) } }
                    text.of-x x=(right) y=(foot + BELOW - 5.0) { (self.label) }
                }
                @for (i, row) in self.rows.iter().enumerate() { (self.row(row, ABOVE + ROW * (i as f64 + 0.5))) }
                @if !self.missed.is_empty() {
                    text.left x=(left - 5.0) y=(foot - CROSSES / 2.0 + HALF_CAPITAL) { "missed" }
                }
                @for (_, to, _) in &self.missed { path.cross.late d=(cross(self.at(*to), foot - CROSSES / 2.0)) {} }
                path.frame d=(format!("M{left} {ABOVE}V{foot}H{right}")) {}
                @for pair in self.windows.windows(2) {
                    @let middle = (self.at(pair[0].1) + self.at(pair[1].0)) / 2.0;
                    path.frame.gap d=(format!("M{} {}l4 -8m4 0l-4 8", tenths(middle - 4.0), foot + 4.0)) {}
                }
            }
        }
    }

    fn row(&self, row: &Row, y: f64) -> Markup {
        html! {
            text.left.strong[row.stands_out] x=(self.left() - 5.0) y=(y + HALF_CAPITAL) { (row.label) }
            @if let Some((from, to)) = row.late {
                path.late-stage.late d=(format!("M{} {y}H{}", self.at(from), self.at(to))) {}
            }
            g.(row.class) {
                @for work in &row.work {
                    @let (from, to) = (self.at(work.from), self.at(work.to));
                    @if let Some(due) = work.due {
                        path.waited d=(format!("M{} {y}H{from}", self.at(due))) {}
                    }
                    rect.work.stale[work.is_stale] x=(from) y=(y - THICK / 2.0)
                        width=(tenths(to - from).max(THIN)) height=(THICK) { title { (work.word) } }
                }
            }
        }
    }

    /// Places of the names of begins: those that have the room.
    fn labels(&self) -> Vec<(f64, &str)> {
        let mut shown = Vec::new();
        let mut free_from = 0.0;
        for begin in &self.begins {
            let (x, half) = (
                self.at(begin.at),
                CHARACTER * begin.label.chars().count() as f64 / 2.0,
            );
            if x - half >= free_from && x + half <= WIDTH {
                shown.push((x, begin.label.as_str()));
                free_from = x + half;
            }
        }
        shown
    }

    fn left(&self) -> f64 {
        let names = self
            .rows
            .iter()
            .map(|row| row.label.chars().count())
            .chain([6]);
        10.0 + CHARACTER * names.max().unwrap_or(1) as f64
    }

    /// Place of an instant [pixels]: all that lies between two windows stands in the middle between them.
    fn at(&self, instant: f64) -> f64 {
        let gaps = self.windows.len().saturating_sub(1) as f64;
        let shown: f64 = self.windows.iter().map(|(from, to)| to - from).sum();
        let scale = (WIDTH - RIGHT - self.left() - GAP * gaps) / shown;
        let mut x = self.left();
        for (i, (from, to)) in self.windows.iter().enumerate() {
            if instant < *from {
                return tenths(if i == 0 { x } else { x - GAP / 2.0 });
            }
            x += (instant.min(*to) - from) * scale;
            if instant <= *to || i + 1 == self.windows.len() {
                return tenths(x);
            }
            x += GAP;
        }
        tenths(x)
    }
}

fn cross(x: f64, y: f64) -> String {
    let [left, right, top, foot] = [x - HALF, x + HALF, y - HALF, y + HALF].map(tenths);
    format!("M{left} {top}L{right} {foot}M{left} {foot}L{right} {top}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_begins_are_left_out_where_they_have_no_room() {
        let begin = |i: i32| Begin {
            at: f64::from(i),
            label: format!("+{}", 98_000 + i),
        };
        let gantt = Gantt {
            title: String::new(),
            label: String::new(),
            windows: vec![(0.0, 10.0)],
            begins: (0..=10).map(begin).collect(),
            missed: Vec::new(),
            rows: Vec::new(),
        };
        let shown: Vec<&str> = gantt.labels().into_iter().map(|(_, label)| label).collect();
        assert_eq!(shown, ["+98000", "+98002", "+98004", "+98006", "+98008"]);
    }

    #[test]
    fn instants_between_two_windows_stand_between_them() {
        let gantt = Gantt {
            title: String::new(),
            label: String::new(),
            windows: vec![(-1.0, 3.0), (96.0, 100.0)],
            begins: Vec::new(),
            missed: Vec::new(),
            rows: Vec::new(),
        };
        let places =
            [-9.0, -1.0, 0.0, 3.0, 50.0, 96.0, 100.0, 9e9].map(|instant| gantt.at(instant));
        assert!(
            places.windows(2).all(|pair| pair[0] <= pair[1]),
            "{places:?}"
        );
        assert_eq!(
            (places[0], places[7]),
            (places[1], places[6]),
            "what lies beyond stands at the ends"
        );
        assert!(
            (places[5] - places[3] - GAP).abs() < 0.11
                && (places[4] - places[3] - GAP / 2.0).abs() < 0.11
        );
        assert!((places[6] - (WIDTH - RIGHT)).abs() < 0.11, "{places:?}");
    }
}
