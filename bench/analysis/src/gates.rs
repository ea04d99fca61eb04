//! Whether a flight passed: the gates it was asked to hold, what was found, and its status.
//!
//! Two gates are every flight's; the others are asked for. A gate that measured nothing does not hold.

use crate::phrase::count;
use crate::schema::{
    AcceptanceResult, Explained, Gate, Report, RunSection, StabilityVerdict, TimingVerdict,
};
use crate::series::Series;
use crate::speed::Speed;
use crate::status::FlightStatus;
use crate::theorem::Theorem;
use crate::verdicts::{Evidence, stability_verdict};
use flight_log::writer::Fate;
use messages::blackboards::EndReason;
use messages::role::{Role, STAGES};
use std::fmt;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RequestedGates {
    /// Distance from the reference beyond which a flight ends [m].
    pub position_error_max_m: f64,
    /// Height below which the airframe has hit the ground [m].
    pub ground_z_m: f64,
    /// Angle between body z and the vertical beyond which a flight ends [rad].
    pub tilt_max_rad: f64,
    /// Ticks without a fresh command on time, per million at the most.
    pub max_miss_rate_ppm: Option<f64>,
    /// Ticks skipped per million at the most.
    pub max_skip_rate_ppm: Option<f64>,
    /// Ticks that a stage worked with a stale input, per million at the most.
    pub max_stale_rate_ppm: Option<f64>,
    /// 99.9th percentile of the plant's wake-up at the most [us].
    pub max_wake_p999_us: Option<f64>,
    pub max_loop_p999_us: Option<f64>,
    /// Position error in the last [`crate::tracking::RECENT_S`] at the most [m].
    pub max_tracking_error_m: Option<f64>,
    /// What the host may take of the loops' processor at the most [%].
    pub max_steal_percent: Option<f64>,
    pub theorem: bool,
}

const ENVELOPE: &str = "flight envelope";

pub fn gates(asked: &RequestedGates, evidence: &Evidence<'_>) -> Vec<Gate> {
    // Late commands, commands from older inputs and skipped ticks in one number.
    let not_fresh = evidence.deadlines.not_fresh.unwrap_or_default();
    let mut fresh = per_million(evidence, not_fresh.ticks);
    if not_fresh.ticks > 0 {
        fresh.words += &format!(" ({})", not_fresh.parts());
    }
    let skipped = per_million(evidence, evidence.ticks.skipped);
    let wake = p999(evidence, Series::Wake(Role::Plant));
    let whole = p999(evidence, Series::Loop);

    let steal = steal(evidence);
    let (stale, tracking) = (stale(evidence), tracking(evidence));
    let mut gates = vec![envelope(asked, evidence), ticks(evidence)];
    // Plant, stages and kernel count some of these themselves; the others are counted from messages.
    let mut add = |lost: u64, name: &str, limit: Option<f64>, found: Found| {
        gates.extend(limit.map(|limit| unless_lost(lost, at_most(name, limit, found))));
    };
    let (lost, fresh_name) = (evidence.lost, "ticks without a fresh command per million");
    add(lost, fresh_name, asked.max_miss_rate_ppm, fresh);
    add(
        0,
        "ticks skipped per million",
        asked.max_skip_rate_ppm,
        skipped,
    );
    add(
        0,
        "stale ticks per million",
        asked.max_stale_rate_ppm,
        stale,
    );
    add(0, "steal [%]", asked.max_steal_percent, steal);
    add(lost, "wake.plant p99.9 [us]", asked.max_wake_p999_us, wake);
    add(lost, "loop p99.9 [us]", asked.max_loop_p999_us, whole);
    let name = "position error in the last 5 s [m]";
    add(lost, name, asked.max_tracking_error_m, tracking);
    let theorem = asked.theorem.then(|| Gate::theorem(evidence.theorem));
    gates.extend(theorem.map(|gate| unless_lost(evidence.lost, gate)));
    gates
}

struct Found {
    words: String,
    /// The number that is held against the limit; none where nothing was measured.
    number: Option<f64>,
}

impl Found {
    fn number(number: f64, digits: usize) -> Self {
        Self {
            words: format!("{number:.digits$}"),
            number: Some(number),
        }
    }

    fn nothing(why: impl fmt::Display) -> Self {
        Self {
            words: format!("measured nothing: {why}"),
            number: None,
        }
    }

    /// Of a measurement in the clock's time, which a flight in lockstep has not.
    fn on_the_clock(run: &RunSection, found: impl FnOnce() -> Self) -> Self {
        match run.speed() {
            speed @ Speed::Lockstep => Self::nothing(speed.why_not_real_time().unwrap_or_default()),
            Speed::Clock | Speed::Slowed(_) => found(),
        }
    }
}

fn at_most(name: &str, limit: f64, found: Found) -> Gate {
    let held = found.number.is_some_and(|number| number <= limit);
    Gate {
        name: name.into(),
        limit: format!("<= {limit}"),
        value: found.words,
        held,
        asked: true,
    }
}

/// What is measured from messages tells nothing of those that were lost.
fn unless_lost(lost: u64, gate: Gate) -> Gate {
    if lost == 0 {
        return gate;
    }
    Gate {
        held: false,
        value: format!("{}, and {lost} messages were not seen", gate.value),
        ..gate
    }
}

fn envelope(asked: &RequestedGates, evidence: &Evidence<'_>) -> Gate {
    let (error_max_m, ground_z_m) = (asked.position_error_max_m, asked.ground_z_m);
    let tilt_max_deg = asked.tilt_max_rad.to_degrees();
    let (ending, lowest_z_m) = (evidence.ending, evidence.performance.lowest_z_m);
    let has_left = ending.is_some_and(EndReason::left_envelope);
    let has_hit = lowest_z_m < ground_z_m;
    let value = match has_hit && !has_left {
        true => format!("below ground: down to z = {lowest_z_m:.2} m"),
        false => envelope_words(ending).into(),
    };
    Gate {
        name: ENVELOPE.into(),
        limit: format!(
            "position error <= {error_max_m} m, tilt <= {tilt_max_deg:.0} deg, z >= {ground_z_m} m"
        ),
        value,
        held: !has_left && !has_hit,
        asked: false,
    }
}

/// What is known of the envelope, by how the flight ended; none while it flies.
const fn envelope_words(ending: Option<EndReason>) -> &'static str {
    match ending {
        None => "not left so far",
        Some(ending) if ending.left_envelope() => ending.name(),
        Some(EndReason::Completed) => "not left",
        Some(_) => "not left until the end of the record",
    }
}

fn ticks(evidence: &Evidence<'_>) -> Gate {
    let ticks = evidence.ticks;
    Gate {
        name: "ticks run + skipped = elapsed / period".into(),
        limit: ticks.elapsed_periods.to_string(),
        value: (ticks.run + ticks.skipped).to_string(),
        held: ticks.identity_holds,
        asked: false,
    }
}

fn per_million(evidence: &Evidence<'_>, of: u64) -> Found {
    let all = evidence.ticks.run + evidence.ticks.skipped;
    Found::on_the_clock(evidence.run, || match all {
        0 => Found::nothing("no tick was flown"),
        _ => Found::number(of as f64 * 1e6 / all as f64, 1),
    })
}

/// Of the stage that has most of them: the plant has no input that could be stale.
fn stale(evidence: &Evidence<'_>) -> Found {
    let rate = |role: &Role| {
        let stage = evidence.roles.get(role.name())?;
        let rate = stage.ticks_stale as f64 * 1e6 / stage.ticks_run as f64;
        (stage.ticks_run > 0).then_some((rate, *role))
    };
    let rates = STAGES[1..].iter().filter_map(rate);
    let worst = rates.max_by(|a, b| a.0.total_cmp(&b.0));
    Found::on_the_clock(evidence.run, || match worst {
        None => Found::nothing("no stage worked a tick"),
        Some((rate, role)) => Found {
            words: format!("{rate:.1} ({role})"),
            number: Some(rate),
        },
    })
}

fn p999(evidence: &Evidence<'_>, series: Series) -> Found {
    let statistics = evidence.series.iter().find(|it| it.name == series.name());
    Found::on_the_clock(evidence.run, || {
        match statistics.map(|it| (it.count, it.p999_us)) {
            None => Found::nothing("it has no values"),
            Some((values, None)) => Found::nothing(format!("too few values for p99.9: {values}")),
            Some((_, Some(us))) => Found::number(us, 1),
        }
    })
}

fn tracking(evidence: &Evidence<'_>) -> Found {
    let performance = evidence.performance;
    match performance.states {
        0 => Found::nothing("no state was seen"),
        _ => Found::number(performance.recent_error_max_m, 4),
    }
}

fn steal(evidence: &Evidence<'_>) -> Found {
    let steal = evidence.steal;
    if steal.of_ms == 0 {
        return Found::nothing("the kernel counted no time");
    }
    Found {
        words: format!("{:.2} of {}", steal.percent, steal.processors()),
        number: Some(steal.percent),
    }
}

impl Gate {
    pub fn theorem(theorem: &Theorem) -> Self {
        let Explained { word, why } = stability_verdict(theorem);
        Self {
            name: "theorem".into(),
            limit: "0 unexplained, estimates live".into(),
            value: match (word, theorem.ticks_unwatched) {
                (StabilityVerdict::NotApplicable, _) => Found::nothing(why).words,
                (_, 0) => theorem.found(),
                (_, unwatched) => {
                    let unwatched = count(unwatched, "tick");
                    format!("{}, {unwatched} not watched", theorem.found())
                }
            },
            held: word == StabilityVerdict::Holds,
            asked: true,
        }
    }
}

/// Whether a flight passed, from its gates, the messages that were lost, and how it ended; nothing while it flies.
pub fn verdict(gates: Vec<Gate>, lost: u64, ending: Option<EndReason>) -> AcceptanceResult {
    let held = gates.iter().all(|gate| gate.held);
    let status = match ending {
        None => FlightStatus::Flying,
        Some(EndReason::Interrupted) => FlightStatus::Interrupted,
        Some(EndReason::Failed) => FlightStatus::Aborted,
        _ if held && lost > 0 => FlightStatus::Incomplete,
        _ if held => FlightStatus::Pass,
        _ => FlightStatus::Fail,
    };
    AcceptanceResult {
        status,
        exit_code: status.exit_code(),
        gates,
    }
}

impl AcceptanceResult {
    /// How many of the gates that were asked for held, and how many were asked for.
    pub fn requested(&self) -> (usize, usize) {
        let asked = || self.gates.iter().filter(|gate| gate.asked);
        (asked().filter(|gate| gate.held).count(), asked().count())
    }
}

/// Ends the report of a flight in the air, whose recorder will not do so.
pub fn break_off(report: &mut Report, status: FlightStatus, mut ending: String) {
    if report.run.in_flight {
        let elapsed_s = report.ticks.elapsed_s;
        ending += &format!("; the numbers end {elapsed_s:.1} s into the flight");
        for gate in &mut report.verdict.gates {
            if gate.name == ENVELOPE && gate.held {
                gate.value = envelope_words(Some(EndReason::None)).into();
            }
        }
    }
    let timing = &mut report.words.timing;
    let was_in_time = matches!(timing.word, TimingVerdict::InTime | TimingVerdict::CutShort);
    if let Some(outage) = report.autopsy.worst.first().filter(|_| was_in_time) {
        let then = count(outage.ticks, "tick");
        timing.word = TimingVerdict::Late;
        timing.why += &format!(", then nothing for {then}");
    }
    let how = match status {
        FlightStatus::Interrupted => "interrupted",
        _ => "aborted",
    };
    // A recorder that knew so has said so.
    let known = report.verdict.status;
    if !matches!(known, FlightStatus::Interrupted | FlightStatus::Aborted) {
        report.words.cut_short(how, &report.run, &report.ticks);
    }
    (report.verdict.status, report.verdict.exit_code) = (status, status.exit_code());
    (report.run.ending, report.run.in_flight) = (ending, false);
}

/// Puts in what became of the messages on their way to the flight log. A flight that lacks some is no plain PASS.
pub fn take_log(report: &mut Report, kept: &str, fate: &Fate) {
    report.recorder.log = crate::sections::log_section(kept, fate);
    if report.unlogged() > 0 && report.verdict.status == FlightStatus::Pass {
        report.verdict.status = FlightStatus::Incomplete;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;

    const ASKED: RequestedGates = RequestedGates {
        position_error_max_m: 10.0,
        ground_z_m: -0.25,
        tilt_max_rad: std::f64::consts::PI,
        max_miss_rate_ppm: Some(0.0),
        max_skip_rate_ppm: Some(0.0),
        max_stale_rate_ppm: Some(0.0),
        max_wake_p999_us: Some(51.0),
        max_loop_p999_us: Some(51.0),
        max_tracking_error_m: Some(0.01),
        max_steal_percent: Some(0.0),
        theorem: true,
    };

    /// What was found by the gates that a changed flight does not hold.
    fn broken(change: impl FnOnce(&mut Sample)) -> Vec<String> {
        let mut sample = Sample::good();
        change(&mut sample);
        let gates = gates(&ASKED, &sample.evidence()).into_iter();
        let failed = gates.filter(|gate| !gate.held);
        failed
            .map(|gate| format!("{}: {}", gate.name, gate.value))
            .collect()
    }

    #[test]
    fn each_gate_breaks_by_its_own_number_alone() {
        let check =
            |change: fn(&mut Sample), failed: &str| assert_eq!(broken(change).join("; "), failed);
        check(|_| (), "");
        let low = "flight envelope: below ground: down to z = -0.26 m";
        check(|it| it.performance.lowest_z_m = -0.26, low);
        let fresh = "ticks without a fresh command per million";
        let missed = format!("{fresh}: 100.0 (2 missed + 0 stale + 0 skipped)");
        check(|it| it.not_fresh(2, 0, 0), &missed);
        let stale = format!("{fresh}: 4950.0 (0 missed + 99 stale + 0 skipped)");
        check(|it| it.not_fresh(0, 99, 0), &stale);
        let skipped = format!(
            "{fresh}: 50.0 (0 missed + 0 stale + 1 skipped); ticks skipped per million: 50.0"
        );
        check(|it| it.not_fresh(0, 0, 1), &skipped);
        check(
            |it| it.steal.percent = 0.25,
            "steal [%]: 0.25 of processor 1",
        );
        let worst = |it: &mut Sample| {
            for (role, stale) in [("outer", 1), ("inner", 3), ("mixer", 2)] {
                it.roles.get_mut(role).unwrap().ticks_stale = stale;
            }
        };
        check(worst, "stale ticks per million: 150.0 (inner)");
        check(
            |it| it.series[0].p999_us = Some(51.1),
            "loop p99.9 [us]: 51.1",
        );
        let wake = "wake.plant p99.9 [us]: 51.1";
        check(|it| it.series[1].p999_us = Some(51.1), wake);
        let error = "position error in the last 5 s [m]: 0.0200";
        check(|it| it.performance.recent_error_max_m = 0.02, error);
        let unwatched = "theorem: 0 unexplained, estimates live, 1 tick not watched";
        check(|it| it.theorem.ticks_unwatched = 1, unwatched);
        let lifeless = |it: &mut Sample| (it.theorem.holds, it.theorem.is_live) = (false, false);
        check(
            lifeless,
            "theorem: 0 unexplained, estimates do not move as predicted",
        );
    }

    #[test]
    fn what_measured_nothing_does_not_hold() {
        let steal = broken(|it| it.steal.of_ms = 0);
        assert_eq!(
            steal,
            ["steal [%]: measured nothing: the kernel counted no time"]
        );
        let unseen = broken(|it| it.performance.states = 0);
        assert_eq!(
            unseen,
            ["position error in the last 5 s [m]: measured nothing: no state was seen"]
        );
        let idle = broken(|it| it.roles.clear());
        assert_eq!(
            idle,
            ["stale ticks per million: measured nothing: no stage worked a tick"]
        );
        assert_eq!(broken(|it| it.series.clear()).len(), 2);
        let mut lockstep = broken(|it| it.run.wall_period_us = 0.0);
        lockstep.retain(|it| it.ends_with("in lockstep there are no deadlines"));
        assert_eq!(lockstep.len(), 5);
    }

    #[test]
    fn lost_messages_fail_what_is_measured_from_messages_alone() {
        let lost = broken(|it| it.lost = 3);
        // Fresh commands, wake-up, loop, position error and theorem.
        assert_eq!(lost.len(), 5, "{lost:?}");
        assert!(
            lost.iter()
                .all(|it| it.ends_with(", and 3 messages were not seen")),
            "{lost:?}"
        );
    }

    #[test]
    fn the_status_names_how_many_gates_were_asked_for() {
        let none = RequestedGates {
            position_error_max_m: 10.0,
            ground_z_m: -0.25,
            ..RequestedGates::default()
        };
        let miss = RequestedGates {
            max_loop_p999_us: Some(1.0),
            ..ASKED
        };
        for (asked, held, status) in [
            (ASKED, (8, 8), FlightStatus::Pass),
            (none, (0, 0), FlightStatus::Pass),
            (miss, (7, 8), FlightStatus::Fail),
        ] {
            let sample = Sample::good();
            let verdict = verdict(gates(&asked, &sample.evidence()), 0, sample.ending);
            assert_eq!((verdict.requested(), verdict.status), (held, status));
        }
    }
}
