//! Sentences that several results share: faults, parameter changes, laws, gates, verdicts, lost messages and margins.

use std::collections::BTreeMap;

use analysis::faults::{AppliedSwap, InjectedFault, ParameterChange};
use analysis::miss_causes::MissCause;
use analysis::outages::OutageCase;
use analysis::process_failures::number;
use analysis::schema::{
    AGITATION, AcceptanceResult, ControlPerformance, FirmwareSection, FlightStatus, FlightVerdict,
    Gate, LawSection, LossSection, MarginSection, QuantityError, RedundancySection, Report,
    RobustnessMargin, RoleSection, RotorEffort, SimulatedLoss, Speed, TimingVerdict, Verdicts, sum,
};
use analysis::targets::FollowedTarget;
use flight_log::facts::OFF;
use messages::role::Role;

pub use analysis::phrase::{count, name_of};
use analysis::phrase::{list, surrounded};

/// The errors of a flight, a sentence for each of position, yaw and tilt.
pub fn errors(flight: &ControlPerformance) -> Vec<String> {
    let states = count(flight.states, "state");
    let without = match flight.ticks_without_state {
        0 => String::new(),
        1 => "; 1 tick has none".into(),
        ticks => format!("; {ticks} ticks without one"),
    };
    let sentence = |QuantityError {
                        name,
                        unit,
                        rms,
                        max,
                        last,
                        ..
                    }: QuantityError| {
        format!("{name} rms {rms:.4} {unit}, largest {max:.4} {unit}, at the end {last:.4} {unit}")
    };
    let mut all: Vec<String> = flight
        .errors()
        .into_iter()
        .flatten()
        .map(sentence)
        .collect();
    match all.first_mut() {
        Some(position) => *position += &format!(", over {states}{without}"),
        None => all.push("no state was seen".into()),
    }
    all
}

/// `rotors saturated in 3523 of 8001 ticks (44.03 %), change of a rotor's command in a tick, rms [rad/s]: 29.5`.
pub fn effort(flight: &ControlPerformance) -> Option<String> {
    let it = flight.effort.as_ref()?;
    Some(format!(
        "rotors saturated in {} of {} ({:.2} %), {AGITATION}: {:.2}",
        flight.saturated_ticks,
        count(it.commands, "tick"),
        it.saturated_percent,
        it.agitation_rad_s
    ))
}

/// The effort, where a summary should name it.
pub fn large_effort(flight: &ControlPerformance) -> Option<String> {
    let is_large = flight.effort.as_ref().is_some_and(RotorEffort::is_large);
    effort(flight).filter(|_| is_large)
}

/// `position_error_m=0.0017 yaw_error_rad=0.0002`: the largest of the last 5 s, for programs.
pub fn error_tokens(flight: &ControlPerformance) -> String {
    let [position, yaw, _] = flight.errors();
    let value = |error: Option<QuantityError>| {
        error.map_or_else(|| "-".into(), |error| format!("{:.4}", error.recent_max))
    };
    format!(
        "position_error_m={} yaw_error_rad={}",
        value(position),
        value(yaw)
    )
}

/// `setpoint.drop=0.1 from tick 8000 (8.000 s) to tick 9000 (9.000 s)`.
pub fn fault(fault: &InjectedFault) -> String {
    let at = |tick: u64, time_s: f64| format!("tick {tick} ({time_s:.3} s)");
    let (what, from) = (&fault.what, at(fault.tick, fault.time_s));
    let when = match fault.to_tick.zip(fault.to_s) {
        _ if fault.is_cancelled() => format!("from {from}, called off before"),
        Some((tick, time_s)) => format!("from {from} to {}", at(tick, time_s)),
        None if fault.happens_once() => format!("at {from}"),
        None => format!("from {from}"),
    };
    let live = if fault.live {
        ", injected in flight"
    } else {
        ""
    };
    let delayed = fault.delayed_ticks;
    let delayed = delayed.map(|ticks| format!(", begun {} later", count(ticks, "tick")));
    format!("{what} {when}{live}{}", delayed.unwrap_or_default())
}

/// `setpoint.drop=0.1 8.000 to 9.000 s`.
pub fn short_fault(fault: &InjectedFault) -> String {
    let InjectedFault { what, time_s, .. } = fault;
    match fault.to_s {
        _ if fault.is_cancelled() => format!("{what} called off before {time_s:.3} s"),
        Some(to_s) => format!("{what} {time_s:.3} to {to_s:.3} s"),
        None if fault.happens_once() => format!("{what} at {time_s:.3} s"),
        None => format!("{what} from {time_s:.3} s on"),
    }
}

/// What changed: `mass_kg 0.52 -> 0.676`, and of a ramp also `over 2 s from tick 8000`.
pub fn swap(swap: &AppliedSwap) -> String {
    let change = |it: &ParameterChange| {
        let change = format!("{} {} -> {}", it.name, it.old, it.new);
        // Whole microseconds, as a sum of ticks is not.
        match (it.over_s * 1e6).round() / 1e6 {
            0.0 => change,
            over_s => format!("{change} over {over_s} s from tick {}", swap.tick),
        }
    };
    list(swap.changes.iter().map(change))
}

/// A target in words: `position (1, 2, 3) m`, `velocity (1, 0, 0) m/s`, `hold`.
pub fn target(target: &FollowedTarget) -> String {
    let vector = |[x, y, z]: [f64; 3], unit: &str| format!(" ({x:.3}, {y:.3}, {z:.3}) {unit}");
    let place = match &*target.kind {
        "position" => vector(target.position_w_m, "m"),
        "velocity" => vector(target.velocity_w_m_s, "m/s"),
        _ => String::new(),
    };
    format!("{}{place}, yaw {:.3} rad", target.kind, target.yaw_rad)
}

/// A target in words, with the number of targets that followed in its stream.
pub fn targets(stream: &FollowedTarget) -> String {
    let target = target(stream);
    match stream.later {
        0 => target,
        later => format!("{target}; {later} more until {:.3} s", stream.last_s),
    }
}

pub fn channels(section: &RedundancySection) -> String {
    let (channels, active) = (section.channels, &section.active);
    let flown = by_channel(&section.ticks_flown);
    let laws = section
        .laws
        .iter()
        .map(|(stage, law)| format!("; law of {stage}: {law}"));
    let laws: String = laws.collect();
    let differed = match section.first_mismatch_s {
        None => String::new(),
        Some(_) => format!("; COMMANDS DIFFERED in {}", contradiction(section)),
    };
    format!("{channels}, ticks flown: {flown}; active at the end: {active}{laws}{differed}")
}

/// Ticks in which channels with the same laws, states and inputs had different commands, and what is known of the cause.
pub fn contradiction(section: &RedundancySection) -> String {
    let differed = format!(
        "{} of {} compared",
        section.mismatches,
        count(section.ticks_compared, "tick")
    );
    match section.first_mismatch_s {
        None => differed,
        Some(first_s) if section.ticks_outvoted.values().all(|ticks| *ticks == 0) => format!(
            "{differed}, from {first_s:.3} s on; two channels do not show which one is wrong"
        ),
        Some(first_s) => format!(
            "{differed}, from {first_s:.3} s on; contradicted by two channels, in ticks: {}",
            by_channel(&section.ticks_outvoted)
        ),
    }
}

/// The known cause of a lost flight.
pub fn loss(section: &LossSection) -> String {
    let at = |lost: &SimulatedLoss| lost.lost_at_s.map(|s| format!("at {s:.2} s"));
    let with = section.with_delays.as_ref();
    let why = match (at(&section.without_delays), with.map(at)) {
        (Some(at), _) => {
            format!("not by the machine's delays: simulated without them, it is lost as well, {at}")
        }
        (None, Some(Some(at))) => format!(
            "by the machine's delays: simulated without them, it is not lost, and with them it is, {at}"
        ),
        (None, Some(None)) => {
            "not known: simulated, it is lost neither without the machine's delays nor with them"
                .into()
        }
        (None, None) => {
            let why_not = section.why_not.as_deref().unwrap_or("not said why");
            format!(
                "not known: simulated without the machine's delays, it is not lost; with them it was not simulated ({why_not})"
            )
        }
    };
    let held_by = section.held_by.as_ref();
    let held_by = held_by.map(|flag| format!(". With `{flag}` it is not lost"));
    why + &held_by.unwrap_or_default()
}

pub fn by_channel(ticks: &BTreeMap<String, u64>) -> String {
    let of = |(channel, ticks): (&String, &u64)| format!("{channel} {ticks}");
    list(ticks.iter().map(of))
}

pub fn law(law: &LawSection) -> String {
    match law.file_name() {
        Some(file) => format!("`{}` ({file})", law.name),
        None => format!("`{}`", law.name),
    }
}

/// The verdicts with their subjects: subject, verdict, reason.
pub fn verdicts(verdicts: &Verdicts) -> [(&'static str, String, &str); 3] {
    let (flight, timing, theorem) = (&verdicts.flight, &verdicts.timing, &verdicts.theorem);
    [
        ("Flight", name_of(&flight.word), &flight.why),
        ("Timing", name_of(&timing.word), &timing.why),
        ("Theorem", name_of(&theorem.word), &theorem.why),
    ]
}

/// At most three commands after a flight that was lost, late or refused its rights, each with what it shows. The recorded
/// causes decide: the machine is not suspected of what a fault, a law or the end of a process did.
///
/// `run` is the flight's directory; none if it is the latest one.
pub fn next_steps(report: &Report, run: Option<&str>) -> Vec<(String, &'static str)> {
    let mut steps = Vec::new();
    let mut step = |command: &str, shows| steps.push((format!("ironbird {command}"), shows));
    let of_run = run.map_or_else(String::new, |run| format!(" {run}"));
    let section = |name| format!("report{of_run} --section {name}");
    let mut granted = report.roles.values().flat_map(|role| &role.realtime);
    let was_refused = granted.any(|step| step.refused.is_some());
    let (flight, timing) = (report.words.flight.word, report.words.timing.word);
    let is_lost = matches!(flight, FlightVerdict::Lost | FlightVerdict::OffTrack);
    let is_late = timing == TimingVerdict::Late;
    // The failure of a role makes a flight late, too.
    let is_aborted = report.verdict.status == FlightStatus::Aborted;
    let mut laws = report.run.laws.values();
    let has_failed_law = laws.any(|law| law.first_not_finite.is_some());
    let has_lost_process = number(report) > 0;
    let is_explained = |it: &OutageCase| {
        let of_itself = matches!(it.class, MissCause::StoppedOrDead | MissCause::MessageFault);
        of_itself || !it.faults.is_empty()
    };
    let worst = &report.autopsy.worst;
    let is_unexplained = worst.is_empty() || !worst.iter().all(is_explained);
    let is_disturbed = is_late && !is_aborted && is_unexplained;
    if (is_lost || is_late) && has_failed_law {
        let replay = format!("replay {}", run.unwrap_or("latest"));
        step(&replay, "runs the laws again on their inputs");
    }
    if (is_lost || is_late) && has_lost_process {
        step(&section("deaths"), "says how each process ended");
    }
    let loss = report.loss.as_ref();
    let is_lost_by_delays = loss.is_some_and(|it| it.without_delays.lost_at_s.is_none());
    if is_lost && !is_lost_by_delays && !has_failed_law {
        if let Some(law) = loss.and_then(|it| it.held_by.as_ref()) {
            step(
                &format!("fly {law} ..."),
                "with the same flags: a law with which the simulated flight is not lost",
            );
        }
        if !has_lost_process {
            step(
                "simulate ...",
                "with the same flags: what was planned, without the machine's delays",
            );
        }
        step(
            "margin",
            "measures the outage, delay and loss that the loop survives",
        );
    }
    if was_refused || is_disturbed {
        step("doctor", "names what disturbs the loops, and remedies");
    }
    if is_late && !is_aborted {
        step(&section("outages"), "lists the longest outages");
    }
    if was_refused {
        step("fly --pace lockstep", "needs no clock and no rights");
    } else if is_disturbed {
        step("fly --floor 11s", "measures this machine beside the flight");
    }
    steps.truncate(3);
    steps
}

pub fn gate(gate: &Gate) -> String {
    let word = if gate.held { "ok" } else { "FAIL" };
    let (name, value, limit) = (&gate.name, &gate.value, &gate.limit);
    format!("{word:<4} {name}: {value} (limit {limit})")
}

pub fn acceptance(result: &AcceptanceResult) -> String {
    let status = result.status;
    match result.requested() {
        (_, 0) if status.is_good() => format!("{status}: no gate was requested"),
        (_, 0) => status.to_string(),
        (held, requested) => format!("{status}: {held} of {requested} gates held"),
    }
}

/// What is missing in the record, and what laws did that no law should, a sentence each.
pub fn warnings(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    let (lost, unlogged) = (report.lost(), report.unlogged());
    let (recorder, log) = (&report.recorder, &report.recorder.log);
    if lost > 0 {
        let all = [&log.messages, &log.dropped, &log.left_out, &log.removed];
        let all = all.into_iter().map(sum).fold(lost, u64::saturating_add);
        let of = recorder.lost.iter().filter(|(_, n)| **n > 0);
        let of = of.map(|(topic, n)| format!("{topic} {n}"));
        // Without a log they are not counted.
        let of_all = match log.kept == OFF {
            true => String::new(),
            false => format!(" of {all}"),
        };
        sentences.push(format!(
            "the recorder missed {}{of_all} ({}): their latency is unknown",
            count(lost, "message"),
            list(of)
        ));
    }
    if unlogged > 0 {
        let why = log.refused.iter().map(|why| format!(": {why}"));
        let why = String::from_iter(why);
        let unlogged = count(unlogged, "message");
        sentences.push(format!("flight.mcap lacks {unlogged}{why}"));
    }
    let mut reasons: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (file, why) in &recorder.unwritten {
        reasons.entry(why).or_default().push(file);
    }
    sentences.extend(
        reasons
            .iter()
            .map(|(why, files)| format!("{}: {why}", files.join(", "))),
    );
    for sentence in &mut sentences {
        sentence.insert_str(0, "INCOMPLETE RECORD: ");
    }
    sentences.extend(law_warnings(report));
    sentences
}

/// Of every law its outputs that could not be used; of one of a file also its time, its allocations and its page faults.
fn law_warnings(report: &Report) -> Vec<String> {
    let mut warnings = Vec::new();
    for (role, section) in &report.run.laws {
        let law = law(section);
        let others = report.redundancy.iter().flat_map(|it| &it.laws);
        let others = others.filter(|(stage, _)| stage.ends_with(&format!(".{role}")));
        let others: Vec<&str> = others.map(|(_, law)| law.as_str()).collect();
        warnings.extend(not_finite(section, role, &others));
        if section.file.is_some() {
            let process = report.roles.get(role);
            let costs = process.map(|process| unsteady(role, process));
            let all = too_long(report, role).into_iter();
            let all = all.chain(costs.into_iter().flatten());
            warnings.extend(all.map(|what| format!("{role} law {law} {what}")));
        }
    }
    warnings
}

/// Outputs of a law that could not be used, where there were some. Which channel's law gave them is not counted: it may
/// also be one of `others`.
pub fn not_finite(section: &LawSection, role: &str, others: &[&str]) -> Option<String> {
    let (first, mut law) = (section.first_not_finite?, law(section));
    for other in others {
        law += &format!(" or `{other}`");
    }
    let ticks = count(section.ticks_not_finite, "tick");
    Some(format!(
        "{role} law {law} gave a number that is not finite, or beyond any airframe, in {ticks}, first at tick {first}"
    ))
}

/// Whether a stage computed for longer than a tick, in more than a hundredth of its ticks: a host's stalls are rarer.
fn too_long(report: &Report, role: &str) -> Option<String> {
    let computed = report.series(&format!("compute.{role}"))?;
    let tick_us = report.run.wall_period_us;
    let is_on_the_clock = report.run.speed() != Speed::Lockstep;
    (is_on_the_clock && computed.p99_us > tick_us).then(|| {
        format!(
            "took longer than a tick of {tick_us} us: {:.1} us in the median, {:.1} us at the most",
            computed.p50_us, computed.max_us
        )
    })
}

/// Allocations and page faults of a law's process in flight.
fn unsteady(name: &str, role: &RoleSection) -> Vec<String> {
    let Some(usage) = &role.usage else {
        return Vec::new();
    };
    let mut sentences = Vec::new();
    // The middleware lends one message a tick, and the mixer's last word.
    let last_word = u64::from(name == Role::Mixer.name());
    let lent = role.ticks_run.saturating_add(last_word);
    let own = usage.allocations.map_or(0, |all| all.saturating_sub(lent));
    if own > 0 {
        let calls = count(own, "call");
        sentences.push(format!(
            "allocated memory in flight: {calls} besides the middleware's one per tick"
        ));
    }
    let is_granted = |name: &str| {
        let mut steps = role.realtime.iter();
        steps.any(|step| step.step == name && step.granted)
    };
    let is_locked = is_granted("memory_lock") && is_granted("prefault");
    let faults = usage.minor_faults.saturating_add(usage.major_faults);
    if is_locked && faults > 0 {
        let faults = count(faults, "page fault");
        sentences.push(format!(
            "caused {faults} in flight, although its memory was locked"
        ));
    }
    sentences
}

/// The worst outage against the loop's margin, where it has one. A margin is of one airframe: that of the settings.
pub fn margin(report: &Report) -> Option<String> {
    let margin = report.margin.as_ref()?;
    let swaps = report.swaps.len() as u64 + report.swaps_left_out;
    let sentence = margin_of_flight(margin);
    if margin.unknown.is_some() || swaps == 0 {
        return Some(sentence);
    }
    let swaps = count(swaps, "parameter change");
    Some(format!(
        "{sentence}; of the airframe before {swaps} in flight"
    ))
}

fn margin_of_flight(margin: &MarginSection) -> String {
    if let Some(command) = &margin.unknown {
        return format!("not known: run {command}");
    }
    let by = margin.measured_by.iter();
    let mut by: String = by
        .map(|build| format!("; measured by another build, {build}"))
        .collect();
    if margin.unmeasured > 0 {
        let outages = count(margin.unmeasured, "outage");
        by += &format!("; not in it: {outages}, of which messages were lost");
    }
    let most = |tolerated: &RobustnessMargin| if tolerated.is_most { "more than " } else { "" };
    let phases = count(margin.phases, "phase");
    let nearest = margin.nearest.as_ref();
    let nearest =
        nearest.and_then(|it| Some((it, margin.tolerated.get(it)?, margin.outages.get(it)?)));
    let Some((stage, tolerated, outage)) = nearest else {
        let each = margin.tolerated.iter();
        let more = |it: &RobustnessMargin| if it.is_most { "> " } else { "" };
        let each = list(each.map(|(stage, it)| format!("{stage} {}{}", more(it), it.ticks)));
        return format!(
            "no stage had an outage in this flight; this loop survives, in ticks: {each} (least of {phases}){by}"
        );
    };
    let least = if tolerated.is_most { "at least " } else { "" };
    let recovers = margin.recovers.get(stage);
    let recovers =
        recovers.map(|it| format!(" and recovers in time from {}{}", most(it), it.ticks));
    format!(
        "worst outage in this flight {} ({stage}); this loop survives {}{}{} (least of {phases}): margin {least}{:.1}{by}",
        count(*outage, "tick"),
        most(tolerated),
        tolerated.ticks,
        recovers.unwrap_or_default(),
        margin.margin.unwrap_or_default()
    )
}

/// The answers of a program that flew as the inner law: what went wrong first.
pub fn firmware(section: &FirmwareSection) -> String {
    let mut parts = Vec::new();
    if let Some(ended_s) = section.ended_at_s {
        let status = section.exit_status;
        let status = status.map_or(String::new(), |it| match it {
            129.. => format!(", killed by signal {}", it - 128),
            _ => format!(", exit status {it}"),
        });
        parts.push(format!("ended at {ended_s:.3} s{status}"));
    }
    if let Some(disarmed_s) = section.disarmed_at_s {
        parts.push(format!("disarmed in flight at {disarmed_s:.3} s"));
    }
    let causes = [
        (section.silent, "silent"),
        (section.wrong_size, "wrong size"),
        (section.not_finite, "not finite"),
        (section.after_its_end, "after its end"),
    ];
    let causes = causes.into_iter().filter(|(ticks, _)| *ticks > 0);
    let causes: Vec<String> = causes
        .map(|(ticks, name)| format!("{ticks} {name}"))
        .collect();
    let unanswered = section.asked - section.answered;
    let causes = surrounded(": ", &causes.join(" + "), "");
    parts.push(format!(
        "{unanswered} of {} ticks unanswered ({:.3} %){causes}",
        section.asked, section.unanswered_percent
    ));
    let others = [
        (section.late, "late answer", ""),
        (section.repeated, "repeated answer", ""),
        (section.not_asked, "tick", " without a state to send"),
    ];
    let others = others.into_iter().filter(|(number, ..)| *number > 0);
    parts.extend(others.map(|(number, thing, rest)| count(number, thing) + rest));
    let latencies = [
        ("p50", section.latency_p50_us),
        ("p99", section.latency_p99_us),
        ("p99.9", section.latency_p999_us),
        ("max", section.latency_max_us),
    ];
    let known = latencies
        .into_iter()
        .filter_map(|(name, us)| Some(format!("{name} {:.0}", us?)));
    let known = list(known);
    if !known.is_empty() {
        parts.push(format!("answer latency [us] {known}"));
    }
    parts.join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_has_its_instants() {
        let freeze = |to_tick| InjectedFault::new("state.freeze".to_owned(), 500, to_tick, 0.002);
        for (it, long, short) in [
            (
                freeze(Some(400)),
                "state.freeze from tick 500 (1.000 s), called off before",
                "state.freeze called off before 1.000 s",
            ),
            (
                InjectedFault {
                    delayed_ticks: Some(7),
                    ..freeze(None).in_flight()
                },
                "state.freeze from tick 500 (1.000 s), injected in flight, begun 7 ticks later",
                "state.freeze from 1.000 s on",
            ),
        ] {
            assert_eq!((&*fault(&it), &*short_fault(&it)), (long, short));
        }
    }

    #[test]
    fn a_firmware_that_ended_has_its_status_or_its_signal() {
        for (status, expected) in [
            (Some(1), "ended at 2.500 s, exit status 1"),
            (Some(137), "ended at 2.500 s, killed by signal 9"),
            (None, "ended at 2.500 s"),
        ] {
            let section = FirmwareSection {
                ended_at_s: Some(2.5),
                exit_status: status,
                ..FirmwareSection::default()
            };
            let sentence = firmware(&section);
            assert!(sentence.contains(expected), "{sentence}");
            let has_more = sentence.contains(&format!("{expected},"));
            assert!(!has_more, "{sentence}");
        }
    }

    #[test]
    fn the_margin_names_the_nearest_stage_and_what_is_not_known() {
        let tolerated = |(stage, ticks): (&str, u64)| {
            let is_most = ticks >= 2000;
            (stage.to_owned(), RobustnessMargin { ticks, is_most })
        };
        let known = MarginSection {
            tolerated: [("outer", 2000), ("inner", 118)].map(tolerated).into(),
            recovers: [("inner", 71)].map(tolerated).into(),
            phases: 32,
            ..MarginSection::default()
        };
        let near = |stage: &str, ticks: u64, margin: f64| MarginSection {
            outages: [(stage.to_owned(), ticks)].into(),
            nearest: Some(stage.into()),
            margin: Some(margin),
            ..known.clone()
        };
        let other = MarginSection {
            measured_by: Some("7fa27a4-release".into()),
            unmeasured: 2,
            ..near("inner", 47, 2.51)
        };
        for (section, sentence) in [
            (
                near("outer", 1, 2000.0),
                "worst outage in this flight 1 tick (outer); this loop survives more than 2000 (least of 32 phases): \
                 margin at least 2000.0",
            ),
            (
                other,
                "worst outage in this flight 47 ticks (inner); this loop survives 118 and recovers in time from 71 (least \
                 of 32 phases): margin 2.5; measured by another build, 7fa27a4-release; not in it: 2 outages, of which messages were lost",
            ),
        ] {
            assert_eq!(margin_of_flight(&section), sentence);
        }
    }
}
