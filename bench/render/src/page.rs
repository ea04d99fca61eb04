//! The page of a flight, report.html: how it went on the first screen, then tracking and timing, then the rest in folds.

use crate::document::{Block, Document, Figure, Section};
use crate::figures::Figures;
use crate::flight::{self, ending, failure_line};
use crate::sentences::{self, count};
use analysis::schema::{FlightVerdict, Report};
use errors::harmless;

/// Charts that are shown at once, by name; the others of their section are in a fold.
const SHOWN_AT_ONCE: [&str; 12] = [
    "x",
    "y",
    "z",
    "position-error",
    "rotors",
    "i_r",
    "k_r",
    "delta",
    "loop",
    "histogram-loop",
    "waterfall-p99",
    "late",
];
/// Events in the list of what happened, and their kinds: of more events, the last of these kinds are left out.
const EVENTS: usize = 14;
const KINDS: [&str; 7] = [
    "end",
    "outage",
    "handover",
    "process",
    "fault",
    "parameter",
    "target",
];
/// Outages among them, the longest ones, and handovers, those after the longest outages of a channel.
const OUTAGES: usize = 3;
const HANDOVERS: usize = 3;

/// Draws the page from report.json alone.
pub fn render(report: &Report) -> String {
    let (run, verdict) = (&report.run, &report.verdict);
    let figures = Figures::of(report);
    let failed = !verdict.status.is_good() && !run.in_flight;
    let mut lead = vec![flight::verdicts(report)];
    lead.extend(flight::exceptions(report));
    let next = sentences::next_steps(report, Some("RUN"));
    lead.extend((!next.is_empty()).then_some(Block::NextSteps(next)));
    if let Some(figures) = figures {
        lead.push(Block::Overview(figures.replay(), figures.overview()));
        lead.push(flight::marks(report));
        let zoom = "Drag across a chart over time to zoom all of these; double-click to see the whole flight.";
        lead.push(Block::Note(zoom.into()));
    }
    lead.push(events(report));
    let document = Document {
        title: format!("{}, {}", heading(report), run.started),
        heading: heading(report),
        verdict: Some((sentences::acceptance(verdict), failed)),
        build: run.build.to_string(),
        lead,
        sections: sections(report),
        footer: format!(
            ", {} for {}, settings {}, run {}, report.json of {}",
            run.build, run.build.target, run.settings_fingerprint, run.run_id, run.started
        ),
        has_miss_lines: report.traces.is_some() && !report.deadlines.stretches.is_empty(),
    };
    harmless(&document.html())
}

/// `adaptive on lissajous, 2 channels, a.inner.kill`: what tells this flight from others.
fn heading(report: &Report) -> String {
    const FAULTS: usize = 3;
    let run = &report.run;
    let law = run.laws.get("inner").map(|law| format!("{} on ", law.name));
    let mut heading = law.unwrap_or_default() + &run.trajectory;
    if let Some(redundancy) = &report.redundancy {
        heading += &format!(", {}", count(redundancy.channels, "channel"));
    }
    let changed = report.swaps.iter().flat_map(|swap| &swap.changes);
    let changed = changed.map(|it| format!("{} {}", it.name, it.new));
    let injected = report.faults.iter().filter(|it| it.acted());
    let injected = injected.map(|fault| fault.what.clone());
    let faults: Vec<String> = injected.chain(changed).collect();
    for fault in faults.iter().take(FAULTS) {
        heading += &format!(", {fault}");
    }
    if faults.len() > FAULTS {
        heading += &format!(" and {} more", faults.len() - FAULTS);
    }
    heading
}

/// Faults, parameter changes, ends of processes, handovers, the longest outages and the end, in the order of time.
fn events(report: &Report) -> Block {
    let mut events: Vec<(f64, &str, String)> = Vec::new();
    let faults = report.faults.iter();
    events.extend(faults.map(|it| (it.time_s, "fault", sentences::short_fault(it))));
    let swaps = report.swaps.iter();
    events.extend(swaps.map(|it| (it.time_s, "parameter", sentences::swap(it))));
    let targets = report.targets.iter();
    events.extend(targets.map(|it| (it.time_s, "target", sentences::targets(it))));
    let deaths = report.deaths.iter();
    events.extend(deaths.map(|it| (it.time_s, "process", failure_line(report, it))));
    if let Some(redundancy) = &report.redundancy {
        let mut handovers: Vec<_> = redundancy.outages.iter().collect();
        handovers.retain(|it| it.handover);
        handovers.sort_by_key(|it| std::cmp::Reverse(it.ticks));
        let handovers = handovers.into_iter().take(HANDOVERS);
        events.extend(handovers.map(|it| {
            let (channel, reason) = (&it.channel, &it.reason);
            (
                it.time_s,
                "handover",
                format!("another channel took over from {channel}: {reason}"),
            )
        }));
    }
    let outages = report.autopsy.worst.iter().take(OUTAGES);
    events.extend(outages.map(|it| {
        let (ticks, delay_us, evidence) = (count(it.ticks, "tick"), it.delay_us, &it.evidence);
        let said = format!("{ticks}, a delay of {delay_us:.0} us: {evidence}");
        (it.time_s, "outage", said)
    }));
    let end_s = report.ticks.flown_s(&report.run);
    let flight = &report.words.flight;
    let end = match flight.word {
        FlightVerdict::Lost => format!("lost: {}", flight.why),
        _ => ending(report).to_owned(),
    };
    events.push((end_s, "end", end));
    let (outages, _) = report.autopsy.totals();
    let left_out = events.len().saturating_sub(EVENTS);
    let place = |it: &(f64, &str, String)| KINDS.iter().position(|kind| *kind == it.1);
    events.sort_by_key(place);
    events.truncate(EVENTS);
    events.sort_by(|a, b| a.0.total_cmp(&b.0).then(place(b).cmp(&place(a))));
    let rows = events
        .into_iter()
        .map(|(time_s, kind, what)| [format!("{time_s:.3} s"), kind.into(), what]);
    let rows = rows.collect();
    let mut title = "What happened".to_owned();
    if outages > OUTAGES as u64 {
        title += &format!("; of {outages} outages, the worst");
    }
    title += &match left_out {
        0 => String::new(),
        1 => "; one more event is in the sections below".to_owned(),
        n => format!("; {n} more events are in the sections below"),
    };
    Block::Events(title, rows)
}

/// Tracking, timing, and what only some readers look for, each of these in a fold.
fn sections(report: &Report) -> Vec<Section> {
    let parts = |name| Parts::of(flight::blocks(report, name));
    let [tracking, deadlines, outages, latencies] =
        ["tracking", "deadlines", "outages", "latencies"].map(parts);
    let detail = |title: &str, blocks| Block::Details(title.into(), blocks);
    let tracking = [
        tracking.text,
        vec![
            Block::Figures(tracking.shown),
            detail("More charts of the tracking", tracking.more),
        ],
    ];
    let timing = [
        vec![Block::KeyFigures(flight::key_figures(report))],
        deadlines.text,
        outages.text,
        vec![
            Block::Figures(latencies.shown),
            detail("The longest outages", outages.more),
            detail("All latencies", [latencies.text, latencies.more].concat()),
        ],
    ];
    let has_telemetry = report
        .run
        .laws
        .values()
        .any(|law| !law.telemetry.is_empty());
    let has_channels = report.redundancy.is_some() || !report.deaths.is_empty();
    let folded = [
        ("deaths", "Channels and ends of processes", has_channels),
        (
            "theorem",
            "Theorem",
            report.theorem.inapplicable().is_none(),
        ),
        ("telemetry", "Telemetry of the laws", has_telemetry),
        (
            "processes",
            "Processes, recorder and real-time rights",
            true,
        ),
        (
            "floors",
            "Floors: what the machine can do",
            report.beside.is_some(),
        ),
        ("gates", "Gates", !report.verdict.gates.is_empty()),
        ("machine", "Machine and build", true),
    ];
    let folded = folded.into_iter().filter(|(.., is_there)| *is_there);
    let folded = folded.map(|(id, title, _)| {
        let blocks = match id {
            "machine" => flight::machine(report),
            _ => flight::blocks(report, id),
        };
        Section {
            is_folded: true,
            ..Section::new(id, title, blocks)
        }
    });
    let open = [
        ("tracking", "Tracking", tracking.concat()),
        ("timing", "Timing", timing.concat()),
    ];
    let open = open.map(|(id, title, blocks)| Section::new(id, title, blocks));
    open.into_iter().chain(folded).collect()
}

/// The blocks of a section by where the page shows them.
#[derive(Default)]
struct Parts {
    text: Vec<Block>,
    shown: Vec<Figure>,
    more: Vec<Block>,
}

impl Parts {
    fn of(blocks: Vec<Block>) -> Self {
        let mut parts = Self::default();
        for block in blocks {
            match block {
                Block::Figures(figures) => {
                    let is_shown = |it: &Figure| SHOWN_AT_ONCE.contains(&it.name.as_str());
                    let (shown, more) = figures.into_iter().partition(is_shown);
                    parts.shown.extend::<Vec<_>>(shown);
                    parts.more.push(Block::Figures(more));
                }
                Block::Legend(_) | Block::Note(_) | Block::PageHeading(_) => parts.more.push(block),
                block => parts.text.push(block),
            }
        }
        parts
    }
}
