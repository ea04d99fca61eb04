//! Outages: their causes, and each of the worst ones with its timeline.

use std::collections::BTreeMap;

use crate::document::{self, Block, Figure, known, row, table};
use crate::plot::{Axis, Chart, Layer};
use crate::scale::Scale;
use crate::sentences;
use analysis::outages::{
    CauseCount, OutageCase, OutageSection, TimelineStage, TimelineTick, WORST_SHOWN,
};
use analysis::phrase::{self, count, surrounded};
use analysis::schema::{Report, Speed};
use messages::role::STAGES;

pub fn blocks(report: &Report) -> Vec<Block> {
    let outages = &report.autopsy;
    let margin = sentences::margin(report).map(|margin| Block::Fact("Margin", margin));
    let mut blocks = Vec::from_iter(margin);
    let none = if report.run.speed() == Speed::Lockstep {
        "not looked for: in lockstep there are no deadlines"
    } else {
        "none"
    };
    if outages.classes.is_empty() && outages.pending == 0 {
        blocks.push(Block::Fact("Outages", none.into()));
        return blocks;
    }
    blocks.extend(list(outages));
    if outages.worst.is_empty() {
        return blocks;
    }
    let legend = [
        ("block deadline", "worked: from waking to sending"),
        ("block stale deadline", "without the input of its tick"),
        ("deadline", "due, and not awake yet"),
        ("late", "the longest delay"),
        ("block band late", "its command missed the deadline"),
    ];
    let legend = legend.map(|(class, word)| (class, word.into()));
    blocks.push(Block::Legend(legend.into()));
    let tick_us = report.run.wall_period_us;
    let figure = |(i, case): (usize, &OutageCase)| {
        let title = with_stage(case.class.words(), case.stage.as_deref());
        let chart = chart(case, tick_us, &title);
        Figure {
            note: line(case),
            ..Figure::new(format!("outage-{}", i + 1), title, Vec::new(), chart)
        }
    };
    let worst = outages.worst.iter().take(WORST_SHOWN);
    blocks.push(Block::Figures(worst.enumerate().map(figure).collect()));
    blocks.push(Block::Note(
        "Lines stand where ticks begin, which is the deadline of the tick before. The kernel's counters are read every \
         10 ms; `ironbird docs measuring` says what that leaves open."
            .into(),
    ));
    blocks
}

fn list(outages: &OutageSection) -> Vec<Block> {
    let rows = outages.classes.iter().map(|it| {
        let stage = known(it.stage.as_deref());
        row([&it.class.words(), &stage, &it.outages, &it.missed])
    });
    let pending =
        (outages.pending > 0).then(|| row([&"not classified yet", &"-", &"-", &outages.pending]));
    let columns = ["Outages", "stage", "outages", "missed"];
    let mut blocks = vec![table(columns, rows.chain(pending))];
    blocks.push(Block::Note(
        "An outage is a row of ticks in which a deadline was missed, or a stage did not work on its input.".into(),
    ));
    blocks.extend(culprits(outages));
    let worst = outages.worst.iter().take(WORST_SHOWN);
    let mut text: String = worst.map(case_text).collect();
    if !text.is_empty() {
        text += "    woke .. sent [us], from the beginning of the outage's first tick; * without the input of its tick\n";
    }
    blocks.push(Block::Terminal(text));
    blocks
}

/// The programs and interrupts that ran instead of the delayed stages, those that took the most time first; none without a
/// trace.
fn culprits(outages: &OutageSection) -> Option<Block> {
    let mut culprits = BTreeMap::<&str, (u64, f64)>::new();
    for ran in outages.worst.iter().flat_map(|case| &case.ran) {
        let (outages, us) = culprits.entry(&ran.who).or_default();
        (*outages, *us) = (*outages + 1, *us + ran.us);
    }
    let mut culprits: Vec<(&str, (u64, f64))> = culprits.into_iter().collect();
    culprits.sort_by(|a, b| b.1.1.total_cmp(&a.1.1));
    let rows = culprits.iter().take(WORST_SHOWN);
    let rows = rows.map(|(who, (outages, us))| row([who, outages, &format!("{us:.0}")]));
    let of = format!(
        "Ran in the longest {}",
        count(outages.worst.len() as u64, "outage")
    );
    (!culprits.is_empty()).then(|| table([of.as_str(), "outages", "us"], rows))
}

pub fn text(outages: &OutageSection) -> String {
    document::text(&list(outages))
}

fn with_stage(class: &str, stage: Option<&str>) -> String {
    stage.map_or_else(|| class.to_owned(), |stage| format!("{class}, {stage}"))
}

pub fn cause(count: &CauseCount) -> String {
    with_stage(count.class.words(), count.stage.as_deref())
}

/// When it was, how long, and its cause.
pub fn short_line(case: &OutageCase) -> String {
    let (tick, time_s, missed) = (case.tick, case.time_s, case.missed);
    let ticks = count(case.ticks, "tick");
    let cause = with_stage(case.class.words(), case.stage.as_deref());
    // Where no stage is known to be late, there is no delay.
    let delay = Some(case.delay_us).filter(|us| *us > 0.0);
    let delay = delay
        .map(|us| format!(", a delay of {us:.0} us"))
        .unwrap_or_default();
    format!("tick {tick} ({time_s:.3} s): {ticks}, {missed} missed{delay}: {cause}")
}

/// Its short line and the evidence.
pub fn line(case: &OutageCase) -> String {
    let faults = surrounded("; fault on: ", &phrase::list(&case.faults), "");
    format!("{} ({}{faults})", short_line(case), case.evidence)
}

fn case_text(case: &OutageCase) -> String {
    let mut text = format!("  {}\n", line(case));
    let mut next = case.timeline.first().map_or(0, |first| first.tick);
    for TimelineTick { tick, stages, .. } in &case.timeline {
        if *tick > next {
            text += "    ...\n";
        }
        next = tick.saturating_add(1);
        let stages: Vec<String> = stages.iter().map(stage_text).collect();
        let stages = match stages.is_empty() {
            true => "no stage published".into(),
            false => stages.join("  "),
        };
        text += &format!("    {:>+3}  {stages}\n", after(case, *tick));
    }
    text
}

fn after(case: &OutageCase, tick: u64) -> i64 {
    tick.cast_signed() - case.tick.cast_signed()
}

fn stage_text(stage: &TimelineStage) -> String {
    let stale = if stage.is_fresh { "" } else { "*" };
    let (role, wake_us, send_us) = (&stage.role, stage.wake_us, stage.send_us);
    format!("{role}{stale} {wake_us:.0} .. {send_us:.0}")
}

/// A row for each stage over the ticks of the timeline.
fn chart(case: &OutageCase, tick_us: f64, title: &str) -> Chart {
    let begin_us = |tick: u64| after(case, tick) as f64 * tick_us;
    // The ticks of the timeline that follow each other: first, last.
    let groups = case.timeline.chunk_by(|a, b| a.tick + 1 == b.tick);
    let windows = groups.map(|group| (group[0].tick, group[group.len() - 1].tick));
    let windows: Vec<(u64, u64)> = windows.collect();
    let ticks = windows.iter().flat_map(|(first, last)| *first..=last + 1);
    let instants = ticks.map(|tick| match after(case, tick) {
        0 => (begin_us(tick), "0".into()),
        after => (begin_us(tick), format!("{after:+}")),
    });
    let shown = windows.iter();
    let shown = shown.map(|(first, last)| (begin_us(*first), begin_us(last + 1)));
    let x = Scale::windows(shown.collect(), instants.collect());
    let rows = STAGES.len() as f64;
    let missed = case.timeline.iter().filter(|tick| tick.missed).map(|tick| {
        let corners = [(begin_us(tick.tick), 0.0), (begin_us(tick.tick + 1), rows)];
        let word = format!("tick {}: its command missed the deadline", tick.tick);
        (corners, word, String::new())
    });
    let mut layers = vec![Layer::Boxes("missed-tick late".into(), missed.collect())];
    for (i, role) in STAGES.into_iter().enumerate() {
        let (name, middle) = (role.name(), i as f64 + 0.5);
        if case.stage.as_deref() == Some(name) && case.delay_us > 0.0 {
            let ends = [(case.due_us, middle), (case.due_us + case.delay_us, middle)];
            layers.push(Layer::Segments(
                "late-stage late".into(),
                vec![(ends, String::new())],
            ));
        }
        let mut waited = Vec::new();
        let mut work: [Vec<_>; 2] = Default::default();
        for tick in &case.timeline {
            let of = |name: &str| tick.stages.iter().find(|it| it.role == name);
            let Some(it) = of(name) else { continue };
            let due = match i.checked_sub(1).map(|before| STAGES[before].name()) {
                None => Some(begin_us(tick.tick)),
                Some(before) => of(before).filter(|_| it.is_fresh).map(|it| it.send_us),
            };
            waited.extend(due.map(|due| ([(due, middle), (it.wake_us, middle)], String::new())));
            let input = match it.is_fresh {
                true => "",
                false => ", without the input of its tick",
            };
            let (tick, wake_us, send_us) = (tick.tick, it.wake_us, it.send_us);
            let word = format!("{name} in tick {tick}: {wake_us:.0} to {send_us:.0} us{input}");
            let corners = [(wake_us, middle - 0.3), (send_us, middle + 0.3)];
            work[usize::from(!it.is_fresh)].push((corners, word, String::new()));
        }
        layers.push(Layer::Segments(format!("waited {name}"), waited));
        for (class, boxes) in ["work", "work stale"].into_iter().zip(work) {
            let class = format!("{class} {name}");
            layers.push(Layer::Boxes(class, boxes));
        }
    }
    let length = match tick_us >= 1e3 {
        true => format!("{} ms", tick_us / 1e3),
        false => format!("{tick_us} us"),
    };
    let label = format!("ticks from {} on, each {length} long", case.tick);
    let names = STAGES.map(|role| role.name().to_owned());
    let y = Axis::new(Scale::rows(names.into()), "");
    Chart::new(format!("outage: {title}"), Axis::new(x, label), y, layers)
}
