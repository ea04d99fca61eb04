//! The report of a flight, section by section.

use crate::document::{self, Block, Cell, Column, Figure, Table, known, row, table, us};
use crate::figures::Figures;
use crate::sentences::{self, count, name_of};
use crate::{latencies, outages, theorem};
use analysis::baseline::Baseline;
use analysis::faults::{InjectedFault, ProcessFailure, RecoveryPhases};
use analysis::host::{ContainerSection, InterruptCount, InterruptKind};
use analysis::laws::in_order;
use analysis::phrase::{list, surrounded};
use analysis::process_failures::{COST_S, number};
use analysis::schema::{
    ChannelOutage, LawSection, LogSection, LoopUsage, NOT_FRESH, RedundancySection, Report,
    RoleSection, RunSection, Speed, Switchover, sum,
};
use analysis::series::Statistics;
use analysis::timer_lead::LeadSection;
use flight_log::FILE;
use flight_log::facts::{AROUND_MISSES, OFF};
use messages::realtime::RealtimeStep;
use messages::role::{CHANNEL_ROLES, Role, STAGES};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

type Blocks = fn(&Report) -> Vec<Block>;

/// The sections of the text by name, in order.
const SECTIONS: [(&str, Blocks); 12] = [
    ("head", head),
    ("deadlines", deadlines),
    ("outages", outages::blocks),
    ("deaths", deaths),
    ("latencies", latencies::blocks),
    ("floors", floors),
    ("firmware", firmware),
    ("processes", processes),
    ("tracking", tracking),
    ("telemetry", telemetry),
    ("theorem", |report| {
        theorem::blocks(&report.theorem, Figures::of(report))
    }),
    ("gates", gates),
];

pub fn section_names() -> [&'static str; SECTIONS.len()] {
    SECTIONS.map(|(name, _)| name)
}

pub fn text(report: &Report) -> String {
    let mut sections = section_names().map(|name| section(report, name)).to_vec();
    sections.retain(|it| !it.is_empty());
    sections.join("\n")
}

pub fn section(report: &Report, name: &str) -> String {
    document::text(&blocks(report, name))
}

/// The blocks of a section; none of a name that is none.
pub(crate) fn blocks(report: &Report, name: &str) -> Vec<Block> {
    let section = SECTIONS.iter().find(|(it, _)| *it == name);
    section.map_or_else(Vec::new, |(_, blocks)| blocks(report))
}

/// What was flown, in the words of all that is said of a flight; `airframe` as of [`airframe`].
pub fn conditions(trajectory: impl Display, preset: impl Display, airframe: &str) -> String {
    let flown = format!("trajectory {trajectory}, gains {preset}");
    match airframe {
        "" => flown,
        airframe => format!("{flown}, airframe {airframe}"),
    }
}

/// An airframe in a word: its name, and of a file also the begin of its SHA-256.
pub fn airframe(name: &str, sha256: &str) -> String {
    match sha256.get(..12) {
        Some(begin) => format!("{name} (sha256 {begin})"),
        None => name.to_owned(),
    }
}

/// Trajectory, preset and airframe of a run.
fn run_conditions(run: &RunSection) -> String {
    let airframe = airframe(&run.airframe, &run.airframe_sha256);
    conditions(&run.trajectory, &run.preset, &airframe)
}

pub fn title(run: &RunSection) -> String {
    format!("{}, {}", run_conditions(run), run.started)
}

pub fn result_line(report: &Report, directory: &str) -> String {
    let percentile = |name: &str, pick: fn(&Statistics) -> Option<f64>| {
        let value = report.series(name).and_then(pick);
        value.map_or_else(|| "none".into(), us)
    };
    let plant = report.roles.get("plant");
    let rt = plant.map_or_else(|| "other".into(), |plant| plant.scheduling.replace(' ', ""));
    let (held, asked) = report.verdict.requested();
    let pairs = sentences::verdicts(&report.words)
        .map(|(subject, word, _)| format!("{}={}", subject.to_lowercase(), word.replace(' ', "-")));
    let redundancy = report.redundancy.as_ref();
    let disagreements = redundancy.map(|it| format!("disagreements={} ", it.mismatches));
    format!(
        "RESULT status={} gates={held}/{asked} {} {} ticks={} skipped={} misses={} loop_p50_us={} loop_p999_us={} \
         wake_p99_us={} rt={rt} steal={:.2} deaths={} lost={} unlogged={} {}build={} run={directory}",
        report.verdict.status,
        pairs.join(" "),
        sentences::error_tokens(&report.flight),
        report.ticks.run,
        report.ticks.skipped,
        report.deadlines.missed,
        percentile("loop", |series| Some(series.p50_us)),
        percentile("loop", |series| series.p999_us),
        percentile("wake.plant", |series| Some(series.p99_us)),
        report.steal.percent,
        number(report),
        report.lost(),
        report.unlogged(),
        disagreements.unwrap_or_default(),
        report.run.build.token()
    )
}

pub(crate) fn verdicts(report: &Report) -> Block {
    let tone = |word: &str| match word {
        "tracked" | "in time" | "holds" => "good",
        "off track" | "lost" | "late" | "broken" => "bad",
        _ => "open",
    };
    let verdicts = sentences::verdicts(&report.words);
    Block::Verdicts(verdicts.map(|(subject, word, why)| {
        let tone = tone(&word);
        (subject, word, why.to_owned(), tone)
    }))
}

/// Of the timing, with their units.
pub(crate) fn key_figures(report: &Report) -> Vec<(&'static str, String, String)> {
    let (ticks, deadlines) = (&report.ticks, &report.deadlines);
    let [whole, wake] = ["loop", "wake.plant"].map(|name| report.series(name));
    let latency = |name, value: Option<f64>| Some((name, us(value?), "us".to_owned()));
    let late = deadlines.not_fresh.map(|sum| {
        let ppm = format!("{:.1} ppm", sum.per_million);
        (NOT_FRESH, sum.ticks.to_string(), ppm)
    });
    [
        latency("loop p50", whole.map(|it| it.p50_us)),
        latency("loop p99", whole.map(|it| it.p99_us)),
        latency("loop p99.9", whole.and_then(|it| it.p999_us)),
        latency("wake p99", wake.map(|it| it.p99_us)),
        late,
        Some(("ticks skipped", ticks.skipped.to_string(), String::new())),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn head(report: &Report) -> Vec<Block> {
    [vec![verdicts(report)], machine(report), exceptions(report)].concat()
}

/// Gaps of the record, the cause of a loss, and the last messages of a process that died.
pub(crate) fn exceptions(report: &Report) -> Vec<Block> {
    let missing = sentences::warnings(report).into_iter();
    let mut blocks: Vec<Block> = missing.map(Block::Warning).collect();
    let loss = report.loss.as_ref().map(sentences::loss);
    blocks.extend(loss.map(|why| Block::Fact("Why lost", why)));
    let messages = &report.run.last_words;
    if !messages.is_empty() {
        blocks.push(Block::Paragraph("Last messages of the process".into()));
        blocks.push(Block::Items(messages.clone()));
    }
    blocks
}

/// The vehicle, laws and machine of a flight.
pub(crate) fn machine(report: &Report) -> Vec<Block> {
    let (run, host, steal) = (&report.run, &report.host, &report.steal);
    let mut blocks = Vec::new();
    let mut say = |line: String| blocks.push(Block::Paragraph(line));
    let (build, ending) = (&run.build, ending(report));
    let (started, instance) = (&run.started, &run.instance);
    say(format!(
        "ironbird {build}  {started}  instance {instance}  {ending}"
    ));
    say(pace(report));
    if !run.laws.is_empty() {
        say(format!("laws {}", laws(&run.laws)));
    }
    let (kernel, preemption) = (&host.kernel, &host.preemption);
    let (cpus, cpu, below) = (host.cpus, &host.cpu, host.below());
    say(format!("{kernel} ({preemption}), {cpus} x {cpu}{below}"));
    say(format!(
        "clock {}, sched_rt_runtime_us {}, stolen by the host during the flight {} ms ({:.2} % of {})",
        host.clock_source,
        host.rt_runtime_us,
        steal.stolen_ms,
        steal.percent,
        steal.processors()
    ));
    let doctor = &report.doctor;
    let (class, reasons) = (name_of(&doctor.verdict), doctor.reasons.join("; "));
    let reasons = surrounded(" (", &reasons, ")");
    say(format!("real time by the set-up: {class}{reasons}"));
    if report.container != ContainerSection::default() {
        say(container(&report.container));
    }
    blocks
}

pub fn ending(report: &Report) -> &str {
    if report.run.in_flight {
        "IN FLIGHT, numbers so far"
    } else {
        &report.run.ending
    }
}

fn container(it: &ContainerSection) -> String {
    let quota = known(it.processors.map(|quota| format!("{quota:.2}")));
    let memory = known(it.memory_mib.map(|mib| format!("{mib:.0} MiB")));
    let (periods, ms) = (it.throttled_periods, it.throttled_us / 1000);
    format!(
        "container: processor quota {quota}, used up in {periods} periods ({ms} ms); memory {memory}"
    )
}

pub fn pace(report: &Report) -> String {
    let run = &report.run;
    let flown_s = report.ticks.flown_s(run);
    let times = flown_s / report.ticks.elapsed_s;
    let pace = match run.speed() {
        Speed::Lockstep => {
            let times = match report.ticks.elapsed_s > 0.0 {
                true => format!(" at {times:.1} times real time"),
                false => String::new(),
            };
            format!(", in lockstep{times}: its latencies are not real-time latencies")
        }
        speed => (speed.why_not_real_time()).map_or_else(String::new, |why| format!(", {why}")),
    };
    let period_us = (run.period_us * 1e3).round() / 1e3;
    format!("{}, T = {period_us} us{pace}", run_conditions(run))
}

/// Laws that flew, in words.
pub fn laws(laws: &BTreeMap<String, LawSection>) -> String {
    let named = |(role, law): (&str, &LawSection)| {
        let slow = if law.not_real_time {
            ", not real-time"
        } else {
            ""
        };
        let file = law.file_name().map(|name| format!(" ({name}{slow})"));
        format!("{role} {}{}", law.name, file.unwrap_or_default())
    };
    list(in_order(laws).map(named))
}

fn deadlines(report: &Report) -> Vec<Block> {
    let (ticks, deadlines) = (&report.ticks, &report.deadlines);
    let is = if ticks.identity_holds { "=" } else { "IS NOT" };
    let (all, elapsed_s, periods) = (ticks.all(), ticks.elapsed_s, ticks.elapsed_periods);
    let in_time = match report.run.speed() {
        // No clock moves the ticks.
        Speed::Lockstep => format!("in {elapsed_s:.3} s"),
        _ => format!("{is} elapsed {elapsed_s:.3} s / period = {periods}"),
    };
    let (run, skipped) = (ticks.run, ticks.skipped);
    let counted = format!("run {run} + skipped {skipped} = {all} {in_time}");
    let mut blocks = vec![Block::Fact("Ticks", counted)];
    let not_fresh = deadlines.not_fresh.as_ref();
    blocks.extend(not_fresh.map(|it| Block::Fact("Commands", it.sentence(ticks))));
    let (missed, ppm, by_stamps) = (
        deadlines.missed,
        deadlines.missed_ppm,
        deadlines.missed_by_stamps,
    );
    let said = format!(
        "missed {missed} ({ppm:.1} per million); by the stamps of the commands {by_stamps}"
    );
    blocks.push(Block::Fact("Deadlines", said));
    let most = deadlines.late.iter().map(|bucket| bucket.count).max();
    let most = most.unwrap_or(1).max(1);
    let late = deadlines.late.iter().map(|bucket| {
        let bar = "#".repeat((bucket.count * 40).div_ceil(most) as usize);
        let range = format!("{} .. {}", bucket.from_us, bucket.below_us);
        row([&range, &bucket.count, &bar])
    });
    let runs = deadlines.runs.iter();
    let runs = runs.map(|run| row([&run.length_ticks, &run.count]));
    for table in [
        Table::new(["missed by [us]", "deadlines", ""], late),
        Table::new(["missed in a row", "times"], runs),
    ] {
        if !table.rows.is_empty() {
            blocks.push(Block::Terminal(table.text()));
        }
    }
    blocks
}

fn redundancy(section: &RedundancySection) -> Vec<Block> {
    let mut blocks = vec![
        Block::Fact("Channels", sentences::channels(section)),
        Block::Fact(
            "Without redundancy",
            format!(
                "{}, longest {:.0} ms; misses that another channel masked: {}; ticks run in which no channel's command was fresh and on time: {} (the timing verdict counts skipped ticks, too)",
                count(section.ticks_unprotected, "tick"),
                section.longest_unprotected_ms,
                section.ticks_masked,
                section.ticks_not_fresh
            ),
        ),
    ];
    let contradicted = sentences::contradiction(section);
    blocks.push(Block::Fact("Commands that differed", contradicted));
    for (channel, it) in &section.differences {
        let (rms_rad_s, max_rad_s) = (it.rms_rad_s, it.max_rad_s);
        blocks.push(Block::Fact(
            "Other laws",
            format!(
                "a rotor's command of channel {channel} differed from the one that flew by {rms_rad_s:.2} rad/s (rms), at most \
                 {max_rad_s:.2}, in {}",
                count(it.ticks, "tick")
            ),
        ));
    }
    let switched = |it: &Switchover| {
        format!(
            "channel {} took over from {} at tick {} ({:.3} s): {}; a rotor's command changed by {:.2} rad/s",
            it.to, it.from, it.tick, it.time_s, it.reason, it.command_step_rad_s
        )
    };
    let switchovers: Vec<String> = section.switchovers.iter().map(switched).collect();
    if !switchovers.is_empty() {
        blocks.push(Block::Items(switchovers));
    }
    let line = |it: &ChannelOutage| {
        let (channel, tick, time_s, reason) = (&it.channel, it.tick, it.time_s, &it.reason);
        let handover = match it.handover {
            true => ", another channel took over",
            false => "",
        };
        let ticks = count(it.ticks, "tick");
        format!(
            "channel {channel} out for {ticks} from tick {tick} ({time_s:.3} s): {reason}{handover}"
        )
    };
    let mut items: Vec<String> = section.outages.iter().map(line).collect();
    if section.outages_left_out > 0 {
        items.push(format!("and {} more", section.outages_left_out));
    }
    if !items.is_empty() {
        blocks.push(Block::Items(items));
    }
    blocks
}

fn deaths(report: &Report) -> Vec<Block> {
    let mut blocks = report.redundancy.as_ref().map_or_else(Vec::new, redundancy);
    if report.deaths.is_empty() {
        blocks.push(Block::Fact("Deaths", "none".into()));
        return blocks;
    }
    let mut items = Vec::new();
    for death in &report.deaths {
        items.push(failure_line(report, death));
        items.extend(death.back_parts.as_ref().map(|phases| {
            let phases = recovery_phases(phases).map(|(phase, ms)| format!("{phase} {ms:.2}"));
            format!("  a new process [ms]: {}", list(phases))
        }));
    }
    if report.deaths_left_out > 0 {
        items.push(format!("and {} later ones", report.deaths_left_out));
    }
    blocks.push(Block::Fact("Deaths", number(report).to_string()));
    blocks.push(Block::Items(items));
    blocks
}

/// Who, when and how, and what it cost, in one line.
pub fn failure_line(report: &Report, failure: &ProcessFailure) -> String {
    let (role, tick, time_s) = (&failure.role, failure.tick, failure.time_s);
    // Names of channel a are those of a flight with one channel.
    let is_of_a = CHANNEL_ROLES.iter().any(|it| it.name() == role);
    let is_named = report.redundancy.is_some() && is_of_a;
    let channel = if is_named { "a." } else { "" };
    let how = match failure.how.as_str() {
        "" => "cause of the end unknown",
        how => how,
    };
    let mut line = format!("{channel}{role} at tick {tick} ({time_s:.3} s): {how}");
    let noticed = failure.noticed_after_ms;
    line.extend(noticed.map(|ms| format!(", noticed after {ms:.0} ms")));
    match (failure.back_after_ms, failure.ticks_lost) {
        (Some(ms), _) => line += &format!(", back after {ms:.0} ms"),
        (None, Some(_)) => line += ", not back",
        (None, None) => {}
    }
    line.extend(failure.within.map(|tick| {
        format!(", before its first message: its ticks are those lost at tick {tick}")
    }));
    let lost = failure.ticks_lost.map(|ticks| count(ticks, "tick"));
    line.extend(lost.map(|lost| format!(", {lost} lost")));
    // Where the flight ended with it, nothing was seen of what it cost.
    if let (Some(_), Some(m)) = (failure.back_after_ms, failure.position_error_max_m) {
        line += &format!(", position error up to {m:.4} m within {COST_S} s");
    }
    line
}

/// The parts in their order, each with what it is called [ms].
pub const fn recovery_phases(phases: &RecoveryPhases) -> [(&'static str, f64); 9] {
    [
        ("noticed", phases.noticed_ms),
        ("cleaned up", phases.cleaned_ms),
        ("started", phases.begun_ms),
        ("settings and law", phases.made_ms),
        ("place", phases.placed_ms),
        ("ports", phases.ported_ms),
        ("real time", phases.engaged_ms),
        ("joined", phases.armed_ms),
        ("first tick", phases.first_tick_ms),
    ]
}

/// A series of the flight beside its floor, at p50, p99 and p99.9.
#[derive(Clone, Copy, Debug)]
pub struct BaselineRatio<'a> {
    pub series: &'a str,
    pub floor: &'a str,
    ours_us: [Option<f64>; 3],
    floor_us: [Option<f64>; 3],
    pub times: [Option<f64>; 3],
}

/// Every floor that was measured, with the series of the flight that it is of.
pub fn baseline_ratios<'a>(
    beside: &'a Baseline,
    report: &'a Report,
) -> impl Iterator<Item = BaselineRatio<'a>> {
    let percentiles = |it: &Statistics| [Some(it.p50_us), Some(it.p99_us), it.p999_us];
    beside.floors.iter().filter_map(move |floor| {
        let both = [report.series(&floor.series)?, &floor.statistics];
        let [ours_us, floor_us] = both.map(percentiles);
        Some(BaselineRatio {
            series: &floor.series,
            floor: &floor.what,
            ours_us,
            floor_us,
            times: std::array::from_fn(|i| Some(ours_us[i]? / floor_us[i]?)),
        })
    })
}

fn floors(report: &Report) -> Vec<Block> {
    let Some(beside) = &report.beside else {
        let how = "not measured: `ironbird fly --floor 11s` does so after the flight";
        return vec![Block::Fact("Floors", how.into())];
    };
    let title = format!(
        "Compared with the machine's baseline, {} s each right after the flight ({}, stolen by the host {:.2} %)",
        beside.seconds, beside.scheduling, beside.steal.percent
    );
    let line = |name: &str, values: [Option<f64>; 3], digits: usize| {
        let [p50, p99, p999] = values.map(|value| known(value.map(|it| format!("{it:.digits$}"))));
        row([&name, &p50, &p99, &p999])
    };
    let rows = baseline_ratios(beside, report).flat_map(|it| {
        let (ours, floor) = (
            line(it.series, it.ours_us, 1),
            line(it.floor, it.floor_us, 1),
        );
        [ours, floor, line("times its floor", it.times, 2)]
    });
    let refused = beside.refused.iter().map(|it| format!("refused: {it}"));
    let note = "The timer does nothing but wake; the ring's four processes hand on a token and compute as long as the \
                laws did in the median.";
    vec![
        Block::Paragraph(title),
        table(["us", "p50", "p99", "p99.9"], rows),
        Block::Items(refused.collect()),
        Block::Note(note.into()),
    ]
}

type Process<'a> = (&'static str, &'a RoleSection);

/// The processes of the loop, in the order of the data's way.
fn stages_of(report: &Report) -> impl Iterator<Item = Process<'_>> {
    let stages = STAGES.into_iter();
    stages.filter_map(|role| Some((role.name(), report.roles.get(role.name())?)))
}

fn processes<'a>(report: &'a Report) -> Vec<Block> {
    let columns: [Column<Process<'a>>; 12] = [
        ("Processes", |(name, _)| (*name).into()),
        ("scheduling", |(_, it)| it.scheduling.clone()),
        ("ticks", |(_, it)| it.ticks_run.to_string()),
        ("skipped", |(_, it)| it.ticks_skipped.to_string()),
        ("stale", |(_, it)| it.ticks_stale.to_string()),
        ("rejected", |(_, it)| sum(&it.rejected).to_string()),
        ("alloc/tick", |(_, it)| {
            let allocations = it.usage.as_ref().and_then(|usage| usage.allocations);
            known(allocations.map(|all| per_tick(all, it.ticks_run)))
        }),
        ("faults", |it| {
            usage_count(it, |usage| usage.minor_faults + usage.major_faults)
        }),
        ("with disk", |it| {
            usage_count(it, |usage| usage.major_faults)
        }),
        ("waits", |it| {
            usage_count(it, |usage| usage.voluntary_switches)
        }),
        ("preempted", |it| {
            usage_count(it, |usage| usage.involuntary_switches)
        }),
        ("cpu us/tick", |(_, it)| {
            known(it.usage.as_ref().map(|usage| us(usage.cpu_per_tick_us)))
        }),
    ];
    let stages: Vec<Process<'a>> = stages_of(report).collect();
    let mut blocks = vec![
        Block::Table(Table::of(&columns, &stages)),
        Block::Items(messages_and_log(report, &stages)),
        Block::Heading("Real time: requested and granted".into()),
    ];
    let granted = stages
        .iter()
        .map(|(name, role)| format!("{name:<9} {}", grants(role)));
    blocks.push(Block::Items(granted.collect()));
    let affinity = name_of(&RealtimeStep::Affinity);
    let steps = stages.iter().flat_map(|(_, role)| &role.realtime);
    let granted = steps.filter(|it| it.step == affinity && it.granted);
    let cpus: BTreeSet<u64> = granted.filter_map(|it| it.asked).collect();
    if cpus.len() > 1 {
        blocks.push(Block::Paragraph(format!(
            "The loops share {} CPUs: each stage wakes up before its input comes, and polls for it.",
            cpus.len()
        )));
    }
    // In lockstep the plant has no timer.
    if report.run.speed() != Speed::Lockstep {
        // The mixer's process counts the warm-up runs.
        let mixer = report.roles.get(Role::Mixer.name());
        let ticks = mixer.map_or(report.ticks.run, |it| it.ticks_run);
        blocks.push(Block::Paragraph(lead_line(&report.lead, ticks)));
    }
    let interrupts = &report.interrupts;
    if !interrupts.counts.is_empty() {
        let place = match interrupts.processor {
            None => "all processors".into(),
            Some(number) => format!("processor {number}, the loops'"),
        };
        let rows = interrupts.counts.iter();
        let rows = rows.map(|it| interrupt(it, report.ticks.run));
        let name = format!("Interrupts of {place}");
        blocks.push(table([name.as_str(), "count", "per tick"], rows));
    }
    blocks
}

/// Which messages were rejected or lost, and what the recorder wrote.
fn messages_and_log(report: &Report, stages: &[Process<'_>]) -> Vec<String> {
    let recorder = &report.recorder;
    let stages_rejected = stages.iter().map(|(name, role)| (*name, &role.rejected));
    let mut items = Vec::new();
    for (name, reasons) in stages_rejected.chain([("record", &recorder.rejected)]) {
        for (reason, number) in reasons.iter().filter(|(_, number)| **number > 0) {
            let messages = count(*number, "message");
            items.push(format!("{name} rejected {messages}: {reason}"));
        }
    }
    items.push(format!(
        "recorder: lost {}, {} incomplete, {:.1} % of a processor",
        count(report.lost(), "message"),
        count(recorder.incomplete_ticks, "tick"),
        recorder.cpu_percent
    ));
    items.push(log(&recorder.log));
    let unwritten = recorder.unwritten.iter();
    items.extend(unwritten.map(|(file, reason)| format!("{file}: {reason}")));
    items
}

fn usage_count((_, role): &Process<'_>, count: fn(&LoopUsage) -> u64) -> String {
    known(role.usage.as_ref().map(count))
}

fn per_tick(all: u64, ticks: u64) -> String {
    format!("{:.3}", all as f64 / ticks.max(1) as f64)
}

fn interrupt(counted: &InterruptCount, ticks: u64) -> Vec<Cell> {
    let is_soft = counted.kind == InterruptKind::Soft;
    let soft = if is_soft { "soft " } else { "" };
    let what = format!("{soft}{} {}", counted.name, counted.source);
    row([
        &what.trim_end(),
        &counted.count,
        &per_tick(counted.count, ticks),
    ])
}

fn grants(role: &RoleSection) -> String {
    let steps = role.realtime.iter().map(|step| {
        let asked = step
            .asked
            .map(|value| format!(" {value}"))
            .unwrap_or_default();
        match &step.refused {
            None => format!("{}{asked} ok", step.step),
            Some(reason) => format!("{}{asked} REFUSED ({reason})", step.step),
        }
    });
    match role.realtime.is_empty() {
        true => "nothing requested: not real-time".into(),
        false => list(steps),
    }
}

/// As a line of text; of a mixer that ran `ticks`.
fn lead_line(lead: &LeadSection, ticks: u64) -> String {
    let (lead_us, timer_us, rehearsal_us) = (lead.lead_us, lead.timer_p90_us, lead.rehearsal_us);
    if lead_us == 0.0 {
        return "Lead none: the plant's timer is set to the beginning of the tick".into();
    }
    let (least_us, median_us, most_us) = (lead.least_us, lead.median_us, lead.most_us);
    let in_flight = match least_us < most_us {
        true => format!(
            " at take-off, {least_us:.0} to {most_us:.0} us in flight, {median_us:.0} us in the median"
        ),
        false => String::new(),
    };
    let (warm_up, warm_ups) = match rehearsal_us > 0.0 {
        true => (
            format!(", warm-up run p90 {rehearsal_us:.0} us"),
            format!("warm-up runs in {} of {ticks} ticks", lead.rehearsals),
        ),
        false => (String::new(), "no warm-up runs".into()),
    };
    format!(
        "Lead {lead_us:.0} us before the tick{in_flight} (before take-off: timer p90 {timer_us:.0} \
         us{warm_up}); {warm_ups}; waiting took {:.1} % of the loops' processor",
        lead.processor_percent
    )
}

fn log(log: &LogSection) -> String {
    if log.kept == OFF {
        return "flight.mcap: none, as configured (recorder.log = off)".into();
    }
    let mut text = match log.files {
        0 | 1 => format!("{FILE}: "),
        files => format!("flight*.mcap: {files} files, "),
    };
    let megabytes = log.file_bytes as f64 / 1e6;
    let (messages, dropped) = (count(sum(&log.messages), "message"), sum(&log.dropped));
    text += &format!("{messages} in {megabytes:.1} MB, {dropped} dropped");
    text.extend(log.refused.iter().map(|reason| format!(" ({reason})")));
    if log.kept == AROUND_MISSES {
        let (excerpts, left_out) = (count(log.stretches, "excerpt"), sum(&log.left_out));
        text += &format!("; {excerpts} kept, {left_out} left out as configured");
    }
    let removed = sum(&log.removed);
    if removed > 0 {
        text += &format!("; {removed} in older files, removed as configured");
    }
    text
}

fn tracking(report: &Report) -> Vec<Block> {
    let flight = &report.flight;
    let mut errors = sentences::errors(flight).into_iter();
    let tracking = Block::Fact("Tracking", errors.next().unwrap_or_default());
    let mut items: Vec<String> = errors.chain(sentences::effort(flight)).collect();
    let rate_error = flight.rate_error_final_rad_s;
    let rate_error =
        rate_error.map(|e| format!("rate error of the inner law at the end {e:.3e} rad/s"));
    items.extend(rate_error);
    items.extend(report.swaps.iter().map(|swap| {
        let (epoch, tick, time_s) = (swap.parameter_epoch, swap.tick, swap.time_s);
        let words = sentences::swap(swap);
        format!("parameter change {epoch} at tick {tick} ({time_s:.3} s): {words}")
    }));
    if report.swaps_left_out > 0 {
        items.push(format!("and {} later ones", report.swaps_left_out));
    }
    items.extend(report.targets.iter().map(|it| {
        let (time_s, words) = (it.time_s, sentences::targets(it));
        format!("target at {time_s:.3} s: {words}")
    }));
    let left_out = report.targets_left_out;
    items.extend(left_out.map(|it| format!("and {it} later targets")));
    let faults = report.faults.iter();
    items.extend(faults.map(|fault| format!("fault {}", sentences::fault(fault))));
    let mut blocks = vec![tracking, Block::Items(items)];
    if !flight.estimates.is_empty() {
        let rows = flight.estimates.iter().map(|it| {
            let [estimated, actual] = [it.estimated, it.actual].map(|it| format!("{it:.6e}"));
            row([&it.name, &estimated, &actual])
        });
        let columns = ["estimates at the end", "estimated", "true"];
        blocks.push(table(columns, rows));
    }
    if let Some(figures) = Figures::of(report) {
        let stretch = count(figures.traces.flight.every_ticks, "tick");
        blocks.push(Block::Figures(figures.flight()));
        blocks.push(Block::Note(format!(
            "Each line over time is drawn through the smallest and the largest value of {stretch}. Paths show at most \
             the last minute; both axes have the same scale. Path and vehicle at the top are in the middle between these."
        )));
    }
    blocks
}

/// The legend of the lines at parameter changes, which faults share.
pub(crate) fn change_mark(faults: &[InjectedFault]) -> &'static str {
    match faults.iter().any(InjectedFault::acted) {
        false => "parameter change",
        true => "parameter change, fault",
    }
}

/// The legend of vertical lines in charts.
pub(crate) fn marks(report: &Report) -> Block {
    let legend = [
        ("mark swap", change_mark(&report.faults)),
        ("mark missed", "missed deadline"),
        ("mark handover", "handover"),
    ];
    let has_handovers = report
        .redundancy
        .as_ref()
        .is_some_and(|it| it.handovers > 0);
    let legend = legend.into_iter().take(2 + usize::from(has_handovers));
    Block::Legend(legend.map(|(class, word)| (class, word.into())).collect())
}

fn firmware(report: &Report) -> Vec<Block> {
    let section = report.firmware.iter();
    let fact = |it| Block::Fact("Firmware", sentences::firmware(it));
    section.map(fact).collect()
}

/// Signals of the laws, as a table and charts.
fn telemetry(report: &Report) -> Vec<Block> {
    let laws = &report.run.laws;
    let number = |value: Option<f64>| known(value.map(|value| format!("{value:.4e}")));
    let signals =
        in_order(laws).flat_map(|(role, law)| law.telemetry.iter().map(move |it| (role, it)));
    let rows = signals.map(|(role, it)| {
        let name = format!("{role} {}", it.name);
        let [last, min, max] = [it.last, it.min, it.max].map(number);
        row([&name, &last, &min, &max, &it.unit])
    });
    let rows: Vec<Vec<Cell>> = rows.collect();
    if rows.is_empty() {
        let none = "Telemetry none: no law shows anything of itself";
        return vec![Block::Paragraph(none.into())];
    }
    let columns = [
        "Telemetry of the laws",
        "at the end",
        "smallest",
        "largest",
        "",
    ];
    let mut blocks = vec![table(columns, rows)];
    if let Some(figures) = Figures::of(report) {
        let figures =
            in_order(laws).flat_map(|(role, law)| figures.telemetry(role, &law.telemetry));
        let figures: Vec<Figure> = figures.collect();
        blocks.push(Block::Figures(figures));
    }
    blocks
}

fn gates(report: &Report) -> Vec<Block> {
    let rows = report.verdict.gates.iter().map(|gate| {
        let word = match gate.held {
            true => Cell::colored("ok", "good"),
            false => Cell::colored("FAIL", "bad"),
        };
        let mut cells = row([&gate.name, &gate.value, &gate.limit]);
        cells.push(word);
        cells
    });
    vec![
        Block::Fact("Gates", sentences::acceptance(&report.verdict)),
        table(["gate", "found", "limit", ""], rows),
    ]
}
