//! The summary that `fly` prints at its end: at most 29 lines of 80 columns, the verdicts last, where a terminal shows them.

use crate::document::{Table, known, row, us};
use crate::latencies::notes;
use crate::{flight, outages as outage_section, sentences as shared};
use analysis::phrase::{INDENT, WIDTH, count, list, wrap};
use analysis::process_failures;
use analysis::schema::{FlightVerdict, Report, Speed};
use messages::role::{Role, STAGES};
use std::collections::BTreeMap;

/// Lines; with that of the result they are 30.
const HEIGHT: usize = 29;
/// Parameter changes in the line of faults.
const CHANGES: usize = 2;
/// Lines of a sentence; where it ends is in the whole report.
const LINES: usize = 3;
/// A space at which no line is broken.
const UNBROKEN: &str = "\u{a0}";
/// Last line of what there is no room for.
const MORE: &str = "          ... the rest is in the whole report";
/// The latencies that say how the loop did: those of the whole, then of each step.
const SERIES: [&str; 6] = [
    "loop",
    "timer",
    "wake.plant",
    "hop.plant_outer",
    "hop.outer_inner",
    "hop.inner_mixer",
];

/// Where the rest of a flight is, as far as it is there.
#[derive(Clone, Debug, Default)]
pub struct Left {
    pub page: Option<String>,
    pub log: Option<String>,
    /// The flight's directory, unless it is the latest one, which commands mean by themselves.
    pub run: Option<String>,
}

/// Renders the short report of a flight, with where the rest is.
pub fn render(report: &Report, left: &Left) -> String {
    let in_lines = |all: Vec<String>| all.iter().flat_map(|it| lines(it)).collect::<Vec<_>>();
    let tail = [latencies(report), foot(left)].concat();
    let run = left.run.as_deref();
    let (mut verdicts, mut details) = (in_lines(verdicts(report, run)), in_lines(details(report)));
    cut(&mut verdicts, HEIGHT - tail.len());
    cut(&mut details, HEIGHT - tail.len() - verdicts.len());
    [details, tail, verdicts].concat().join("\n") + "\n"
}

/// Cuts lines to the room that there is, and says so.
fn cut(lines: &mut Vec<String>, room: usize) {
    if lines.len() > room {
        lines.truncate(room.saturating_sub(1));
        lines.extend((room > 0).then(|| MORE.to_owned()));
    }
}

fn verdicts(report: &Report, run: Option<&str>) -> Vec<String> {
    let word = |(subject, word, why): (&str, String, &str)| {
        format!("{subject:<9} {}: {why}", word.to_uppercase())
    };
    let mut all = shared::verdicts(&report.words).map(word).to_vec();
    // Of a lost flight they may be the cause, and there is little room for details.
    all.extend(faults(report).filter(|_| is_lost(report)));
    let loss = report.loss.as_ref().map(shared::loss);
    all.extend(loss.map(|it| format!("Why lost  {it}")));
    all.extend(shared::warnings(report));
    all.push(format!("Gates     {}", shared::acceptance(&report.verdict)));
    let failed = report.verdict.gates.iter().filter(|gate| !gate.held);
    all.extend(failed.map(|gate| format!("  {}", shared::gate(gate))));
    let next = shared::next_steps(report, run).into_iter();
    let next = next.map(|(command, _)| format!("`{}`", unbroken(&command)));
    let next: Vec<String> = next.collect();
    all.extend((!next.is_empty()).then(|| format!("Next      {}", next.join(", "))));
    all
}

fn is_lost(report: &Report) -> bool {
    report.words.flight.word == FlightVerdict::Lost
}

/// Faults and parameter changes; of these the last ones.
fn faults(report: &Report) -> Option<String> {
    let more = report.swaps.len().saturating_sub(CHANGES);
    let changes = report.swaps[more..].iter();
    let changes = changes.map(|it| format!("{} at {:.3} s", shared::swap(it), it.time_s));
    let faults = report.faults.iter().map(shared::short_fault);
    let mut faults: Vec<String> = changes.chain(faults).collect();
    let more = more as u64 + report.swaps_left_out;
    faults.extend((more > 0).then(|| count(more, "more parameter change")));
    (!faults.is_empty()).then(|| format!("Faults    {}", faults.join(", ")))
}

fn details(report: &Report) -> Vec<String> {
    let mut all = vec![format!(
        "Flown     {}: {}; {:.1} s from {}",
        flight::ending(report),
        flight::pace(report),
        report.ticks.elapsed_s,
        report.run.started
    )];
    all.extend(faults(report).filter(|_| !is_lost(report)));
    let channels = report.redundancy.as_ref().map(shared::channels);
    all.extend(channels.map(|it| format!("Channels  {it}")));
    let firmware = report.firmware.as_ref().map(shared::firmware);
    all.extend(firmware.map(|it| format!("Firmware  {it}")));
    all.extend(report.deaths.last().map(|last| {
        let last = flight::failure_line(report, last);
        match process_failures::number(report) {
            1 => format!("Deaths    {last}"),
            number => format!("Deaths    {number}, the last one: {last}"),
        }
    }));
    all.extend(floors(report));
    // Refused real-time steps may be the cause of outages.
    all.extend(refusals(report));
    all.extend(outages(report));
    let attitude = match report.flight.errors() {
        [_, Some(yaw), Some(tilt)] => format!(
            "; {} up to {:.4} rad, tilt {:.4} rad",
            yaw.name, yaw.max, tilt.max
        ),
        _ => String::new(),
    };
    let position = shared::errors(&report.flight).into_iter().next();
    all.extend(position.map(|it| format!("Tracking  {it}{attitude}")));
    // How to measure can wait, as there is room for little.
    let margin = report.margin.as_ref();
    let is_known = margin.is_some_and(|it| it.unknown.is_none());
    let margin = shared::margin(report).map(|margin| format!("Margin    {margin}"));
    all.extend(margin.clone().filter(|_| is_known));
    let effort = shared::large_effort(&report.flight);
    all.extend(effort.map(|it| format!("Effort    {it}")));
    all.extend(margin.filter(|_| !is_known));
    all
}

fn lines(sentence: &str) -> Vec<String> {
    const CUT: &str = " ...";
    let mut lines = wrap(sentence);
    for line in &mut lines {
        *line = line.replace(UNBROKEN, " ");
    }
    if lines.len() > LINES {
        lines.truncate(LINES);
        let last = &mut lines[LINES - 1];
        if let Some((end, _)) = last.char_indices().nth(WIDTH - CUT.len()) {
            let words = last[..end].rfind(' ').unwrap_or(end);
            last.truncate(words);
        }
        last.push_str(CUT);
    }
    lines
}

fn latencies(report: &Report) -> Vec<String> {
    let series = SERIES.iter().filter_map(|name| report.series(name));
    let rows = series.map(|it| {
        let [p50, p99, max] = [it.p50_us, it.p99_us, it.max_us].map(us);
        let p999 = known(it.p999_us.map(us));
        row([&it.name, &it.count, &p50, &p99, &p999, &max])
    });
    let columns = ["Latencies [us]", "count", "p50", "p99", "p99.9", "max"];
    let table = Table::new(columns, rows).text();
    let notes = notes(report).into_iter().map(|note| format!("  {note}"));
    table.lines().map(str::to_owned).chain(notes).collect()
}

fn foot(left: &Left) -> Vec<String> {
    let files = [("Page", &left.page), ("Log", &left.log)];
    let path = |(what, path): (&str, &Option<String>)| {
        Some(format!("{what:<9} {}", shorten(path.as_ref()?)))
    };
    let more = left.run.as_ref().map_or(
        "More      ironbird report --full, or a part of it: --section NAME".into(),
        |run| {
            format!(
                "More      {}",
                unbroken(&format!("ironbird report {run} --full"))
            )
        },
    );
    files
        .into_iter()
        .filter_map(path)
        .chain(lines(&more))
        .collect()
}

/// A command, which stands in one line, from where it can be copied.
fn unbroken(command: &str) -> String {
    command.replace(' ', UNBROKEN)
}

/// A path without its middle, where the line has no room for it: the line of the result has the whole directory.
fn shorten(path: &str) -> String {
    const ROOM: usize = WIDTH - INDENT.len();
    const HEAD: usize = 20;
    let length = path.chars().count();
    if length <= ROOM {
        return path.to_owned();
    }
    let head: String = path.chars().take(HEAD).collect();
    let tail = path.chars().skip(length - (ROOM - HEAD - "...".len()));
    format!("{head}...{}", tail.collect::<String>())
}

/// How many outages there were, what most misses were due to, and the longest one.
fn outages(report: &Report) -> Option<String> {
    let first = report.autopsy.classes.first()?;
    let (outages, missed) = report.autopsy.totals();
    let cause = outage_section::cause(first);
    let due = match missed {
        0 => format!("{} of them: {cause}", first.outages),
        _ => format!("{} of these: {cause}", first.missed),
    };
    let longest = report.autopsy.worst.first();
    let longest =
        longest.map(|case| format!("; the longest: {}", outage_section::short_line(case)));
    // Misses that no outage was seen with are counted under the first class, too.
    let with = match outages {
        0 => "none seen".into(),
        _ => outages.to_string(),
    };
    let missed = count(missed, "missed deadline");
    let longest = longest.unwrap_or_default();
    Some(format!("Outages   {with} with {missed}, {due}{longest}"))
}

/// How many times its floor each latency is that has one.
fn floors(report: &Report) -> Option<String> {
    let beside = report.beside.as_ref()?;
    let times = |it: flight::BaselineRatio<'_>| {
        let times = list(it.times.map(|it| known(it.map(|it| format!("{it:.2}")))));
        format!("{} is {times} times a {}", it.series, it.floor)
    };
    let all: Vec<String> = flight::baseline_ratios(beside, report).map(times).collect();
    Some(format!("Floors    at p50, p99, p99.9: {}", all.join("; ")))
}

/// What the system refused, once for all processes that it refused it to, and what can be flown without it.
fn refusals(report: &Report) -> Vec<String> {
    let mut by_step = BTreeMap::<(&str, &str), Vec<&str>>::new();
    for (name, role) in &report.roles {
        for step in &role.realtime {
            if let Some(reason) = &step.refused {
                by_step.entry((&step.step, reason)).or_default().push(name);
            }
        }
    }
    if by_step.is_empty() {
        let role = |stage: &Role| report.roles.get(stage.name());
        let is_plain = |stage| role(stage).is_some_and(|it| it.scheduling == "other");
        let is_on_the_clock = report.run.speed() != Speed::Lockstep && STAGES.iter().all(is_plain);
        let plain = "Real time not requested: the loops were scheduled like any other program";
        return Vec::from_iter(is_on_the_clock.then(|| plain.to_owned()));
    }
    let part = |((step, reason), roles): (&(&str, &str), &Vec<&str>)| {
        let whom = match STAGES.iter().all(|stage| roles.contains(&stage.name())) {
            true => "all loops".into(),
            false => roles.join(", "),
        };
        let reason = reason.split(" (os error").next().unwrap_or(reason);
        format!("{} to {whom}: {reason}", step.replace('_', " "))
    };
    let parts: Vec<String> = by_step.iter().map(part).collect();
    vec![format!("Refused   {}", parts.join("; "))]
}
