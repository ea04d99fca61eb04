//! Whether a flight passed: its gates, what was measured for them, and its status.
//!
//! Every flight has two gates; the others are requested. A gate that measured nothing does not hold.

use crate::phrase::{beside, count};
use crate::schema::{
    AGITATION, AcceptanceResult, ControlPerformance, Explained, FlightStatus, Gate, NOT_FRESH,
    QuantityError, RedundancySection, Report, RoleSection, RotorEffort, Speed, StabilityVerdict,
    TimingVerdict, Verdicts,
};
use crate::series::Series;
use crate::theorem::Theorem;
use crate::verdicts::{FlightLimits, departure, stability_verdict};
use flight_log::writer::Fate;
use messages::blackboards::EndReason;
use messages::role::Role;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RequestedGates {
    pub limits: FlightLimits,
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
    /// Yaw error then at the most [rad].
    pub max_yaw_error_rad: Option<f64>,
    /// Share of the rotor commands that could not deliver the demand at the most [%].
    pub max_saturated_percent: Option<f64>,
    /// Root mean square of the change of a rotor's command in a tick at the most [rad/s].
    pub max_agitation_rad_s: Option<f64>,
    /// What the host may take of the loops' processor at the most [%].
    pub max_steal_percent: Option<f64>,
    pub theorem: Option<TheoremGate>,
    /// Whether channels with the same laws, states and inputs must have the same commands.
    pub channels: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TheoremGate {
    /// A broken assumption excuses a rise of V_th.
    Lenient,
    /// Every step must be judged, V_th may rise in none, and the torque of (19) must act in each tick that is compared.
    Strict,
}

const ENVELOPE: &str = "flight envelope";

/// A quantity that a gate judges: its name with the unit, and its number, or why nothing was measured.
pub struct Measured {
    pub name: String,
    pub value: Result<Number, String>,
}

pub struct Number {
    pub value: f64,
    /// Digits after the point, at least.
    pub digits: usize,
    /// Words after it, with a blank before them.
    pub note: String,
}

impl Number {
    pub const fn new(value: f64, digits: usize) -> Self {
        Self {
            value,
            digits,
            note: String::new(),
        }
    }
}

/// Judges a flight by its numbers: the gates, the status and the three verdicts. It still flies without an ending.
pub fn judge(report: &mut Report, ending: Option<EndReason>, requested: &RequestedGates) {
    report.words = Verdicts::of(report, ending, &requested.limits);
    let result = AcceptanceResult::of(gates(report, ending, requested));
    let status = match ending {
        None => FlightStatus::Flying,
        Some(EndReason::Interrupted) => FlightStatus::Interrupted,
        Some(EndReason::Failed) => FlightStatus::Aborted,
        _ if result.status.is_good() && report.lost() > 0 => FlightStatus::Incomplete,
        _ => result.status,
    };
    report.verdict = AcceptanceResult {
        status,
        exit_code: status.exit_code(),
        ..result
    };
}

fn gates(report: &Report, ending: Option<EndReason>, requested: &RequestedGates) -> Vec<Gate> {
    // Late commands, commands from older inputs and skipped ticks in one number.
    let not_fresh = report.deadlines.not_fresh.unwrap_or_default();
    let mut fresh = per_million(report, NOT_FRESH, not_fresh.ticks);
    if let (Ok(number), 1..) = (&mut fresh.value, not_fresh.ticks) {
        number.note = format!(" ({})", not_fresh.parts());
    }
    let skipped = per_million(report, "ticks skipped", report.ticks.skipped);
    let wake = p999(report, Series::Wake(Role::Plant));
    let whole = p999(report, Series::Loop);
    let lost = report.lost();
    // Plant, stages and kernel count some of these themselves; the others are counted from messages.
    let limits = [
        (lost, requested.max_miss_rate_ppm, fresh),
        (0, requested.max_skip_rate_ppm, skipped),
        (0, requested.max_stale_rate_ppm, stale(report)),
        (0, requested.max_steal_percent, steal(report)),
        (lost, requested.max_wake_p999_us, wake),
        (lost, requested.max_loop_p999_us, whole),
    ];
    let flown = requested.of_flight(&report.flight);
    let limits = limits
        .into_iter()
        .chain(flown.map(|(limit, measured)| (lost, limit, measured)));
    let mut gates = vec![envelope(report, ending, requested), ticks(report)];
    for (lost, limit, measured) in limits {
        gates.extend(limit.map(|limit| unless_lost(lost, Gate::at_most(limit, measured))));
    }
    let theorem = requested.theorem;
    let theorem = theorem.map(|gate| Gate::theorem(&report.theorem, gate));
    gates.extend(theorem.map(|gate| unless_lost(lost, gate)));
    let redundancy = report.redundancy.as_ref();
    gates.extend(requested.channels.then(|| channels(redundancy)));
    gates
}

fn channels(section: Option<&RedundancySection>) -> Gate {
    let section = section.filter(|section| section.ticks_compared > 0);
    let value = section.map(|section| {
        let note = format!(" of {} ticks compared", section.ticks_compared);
        Number {
            note,
            ..Number::new(section.mismatches as f64, 0)
        }
    });
    let measured = Measured {
        name: "ticks in which channels disagreed".into(),
        value: value.ok_or_else(|| "no commands of two channels could be compared".into()),
    };
    Gate::at_most(0.0, measured)
}

fn nothing(why: String) -> String {
    format!("measured nothing: {why}")
}

/// What is measured from messages says nothing about those that were lost.
fn unless_lost(lost: u64, gate: Gate) -> Gate {
    match lost {
        0 => gate,
        _ => Gate {
            held: false,
            value: format!(
                "{}, and the recorder missed {}",
                gate.value,
                count(lost, "message")
            ),
            ..gate
        },
    }
}

fn envelope(report: &Report, ending: Option<EndReason>, requested: &RequestedGates) -> Gate {
    let departure = departure(&report.flight, ending, &requested.limits);
    let held = departure.is_none();
    let value = departure.unwrap_or_else(|| envelope_words(ending).into());
    Gate::envelope(requested, value, held)
}

/// Until when a flight is known to have stayed in its envelope, by how it ended; it still flies without an ending.
const fn envelope_words(ending: Option<EndReason>) -> &'static str {
    match ending {
        None => "not left so far",
        Some(EndReason::Completed) => "not left",
        Some(_) => "not left until the end of the record",
    }
}

fn ticks(report: &Report) -> Gate {
    let ticks = &report.ticks;
    Gate {
        name: "ticks run + skipped = elapsed / period".into(),
        limit: ticks.elapsed_periods.to_string(),
        value: (ticks.run + ticks.skipped).to_string(),
        held: ticks.identity_holds,
        asked: false,
    }
}

/// A measurement in the clock's time, which a flight in lockstep does not have.
fn on_the_clock(
    report: &Report,
    name: String,
    measure: impl FnOnce() -> Result<Number, String>,
) -> Measured {
    let value = match report.run.speed() {
        speed @ Speed::Lockstep => Err(speed.why_not_real_time().unwrap_or_default()),
        Speed::Clock | Speed::Slowed(_) => measure(),
    };
    Measured { name, value }
}

fn per_million(report: &Report, what: &str, count: u64) -> Measured {
    on_the_clock(report, format!("{what} per million"), || {
        match report.ticks.run + report.ticks.skipped {
            0 => Err("no tick was flown".into()),
            all => Ok(Number::new(count as f64 * 1e6 / all as f64, 1)),
        }
    })
}

/// Of the stage of all channels that has most of them: the plant has no input that could be stale, nor has the recorder.
/// A process counts its own ticks, so nothing is known of a stage whose process was replaced.
fn stale(report: &Report) -> Measured {
    let rate = |(name, stage): (&String, &RoleSection)| {
        let rate = stage.ticks_stale as f64 * 1e6 / stage.ticks_run as f64;
        let has_input = ![Role::Plant, Role::Record]
            .map(Role::name)
            .contains(&name.as_str());
        (has_input && stage.ticks_run > 0).then(|| (rate, name.clone()))
    };
    on_the_clock(report, "stale ticks per million".into(), || {
        let mut stages = report.roles.iter();
        if let Some((stage, _)) = stages.find(|(name, it)| it.is_successor && *name != "record") {
            return Err(format!(
                "the {stage} process was replaced; the stale ticks of its predecessor are unknown"
            ));
        }
        let rates = report.roles.iter().filter_map(rate);
        let worst = rates.max_by(|a, b| a.0.total_cmp(&b.0));
        let (rate, stage) = worst.ok_or("no stage worked a tick")?;
        Ok(Number {
            note: format!(" ({stage})"),
            ..Number::new(rate, 1)
        })
    })
}

fn p999(report: &Report, series: Series) -> Measured {
    let name = series.name();
    on_the_clock(report, format!("{name} p99.9 [us]"), || {
        let statistics = report.series(&name).ok_or("it has no values")?;
        let few = || format!("too few values for p99.9: {}", statistics.count);
        Ok(Number::new(statistics.p999_us.ok_or_else(few)?, 1))
    })
}

impl RequestedGates {
    /// The gates that need no clock: on tracking errors and effort. Each has its limit, if it was requested.
    fn of_flight(&self, flight: &ControlPerformance) -> [(Option<f64>, Measured); 4] {
        let [position, yaw, _] = flight.errors();
        let error = |error: Option<QuantityError>| error.map(|it| Number::new(it.recent_max, 4));
        let effort = |of: fn(&RotorEffort) -> f64| {
            let effort = flight.effort.as_ref().map(of);
            effort.map(|value| Number::new(value, 2))
        };
        let saturated = effort(|it| it.saturated_percent);
        let agitation = effort(|it| it.agitation_rad_s);
        let measured = |limit, name: &str, value: Option<Number>, lacks: &str| {
            let value = value.ok_or_else(|| format!("no {lacks} was seen"));
            let name = name.into();
            (limit, Measured { name, value })
        };
        let (error_m, error_rad) = (self.max_tracking_error_m, self.max_yaw_error_rad);
        let (percent, rad_s) = (self.max_saturated_percent, self.max_agitation_rad_s);
        let [of_position, of_yaw, of_rotors] = [
            "position error in the last 5 s [m]",
            "yaw error in the last 5 s [rad]",
            "rotors saturated [% of ticks]",
        ];
        [
            measured(error_m, of_position, error(position), "state"),
            measured(error_rad, of_yaw, error(yaw), "state"),
            measured(percent, of_rotors, saturated, "rotor command"),
            measured(rad_s, AGITATION, agitation, "rotor command"),
        ]
    }
}

fn steal(report: &Report) -> Measured {
    let (percent, processors) = (report.steal.percent, report.steal.processors());
    Measured {
        name: "steal [%]".into(),
        value: match report.steal.of_ms {
            0 => Err("the kernel counted no time".into()),
            _ => Ok(Number {
                note: format!(" of {processors}"),
                ..Number::new(percent, 2)
            }),
        },
    }
}

impl Gate {
    /// The gates of a flight without a clock: its envelope, with why it was left, and those requested of it.
    pub fn of_simulation(
        requested: &RequestedGates,
        departure: Option<&str>,
        flight: &ControlPerformance,
        theorem: &Theorem,
    ) -> Vec<Self> {
        let value = departure.unwrap_or("not left").to_owned();
        let envelope = Self::envelope(requested, value, departure.is_none());
        let flown = requested.of_flight(flight).into_iter();
        let flown = flown.filter_map(|(limit, measured)| Some(Self::at_most(limit?, measured)));
        let theorem = requested.theorem.map(|gate| Self::theorem(theorem, gate));
        let channels = requested.channels.then(|| channels(None));
        let requested = flown.chain(theorem).chain(channels);
        [envelope].into_iter().chain(requested).collect()
    }

    fn envelope(requested: &RequestedGates, value: String, held: bool) -> Self {
        let limits = &requested.limits;
        let (error_max_m, ground_z_m) = (limits.position_error_max_m, limits.ground_z_m);
        let tilt_max_deg = requested.tilt_max_rad.to_degrees();
        Self {
            name: ENVELOPE.into(),
            limit: format!(
                "position error <= {error_max_m} m, tilt <= {tilt_max_deg:.0} deg, z >= {ground_z_m} m"
            ),
            value,
            held,
            asked: false,
        }
    }

    pub fn at_most(limit: f64, Measured { name, value }: Measured) -> Self {
        let held = value.as_ref().is_ok_and(|number| number.value <= limit);
        let words = |it: Number| beside(it.value, limit, it.digits) + &it.note;
        Self {
            name,
            limit: format!("<= {limit}"),
            value: value.map_or_else(nothing, words),
            held,
            asked: true,
        }
    }

    pub fn theorem(theorem: &Theorem, gate: TheoremGate) -> Self {
        let Explained { word, why, .. } = stability_verdict(theorem);
        let unwatched = theorem.ticks_unwatched;
        let (name, limit, held) = match gate {
            TheoremGate::Lenient => {
                let limit = "0 unexplained, estimates live, half of the ticks judged";
                ("theorem", limit, word == StabilityVerdict::Holds)
            }
            TheoremGate::Strict => {
                let is_judged = theorem.ticks_judged == theorem.ticks_checked;
                let acted = theorem.torque.acted() == theorem.torque.rotors;
                let is_proven = is_judged && theorem.rises() == 0 && acted;
                let held = word == StabilityVerdict::Holds && is_proven;
                let limit = "V_th judged in each checked step, 0 rises, estimates live, (19) acted in each tick compared";
                ("theorem=strict", limit, held)
            }
        };
        let value = match word {
            StabilityVerdict::NotApplicable => nothing(why),
            _ if theorem.ticks_judged == 0 => nothing(theorem.counts()),
            StabilityVerdict::NotJudged => format!("{}, {why}", theorem.summary()),
            _ if gate == TheoremGate::Strict => {
                let (summary, counts) = (theorem.summary(), theorem.counts());
                format!("{summary}, {counts}; {}", theorem.torque())
            }
            _ if unwatched > 0 => format!(
                "{}, {} not watched",
                theorem.summary(),
                count(unwatched, "tick")
            ),
            _ => theorem.summary(),
        };
        Self {
            name: name.into(),
            limit: limit.into(),
            value,
            held,
            asked: true,
        }
    }
}

impl AcceptanceResult {
    /// The result of a flight to its end.
    pub fn of(gates: Vec<Gate>) -> Self {
        let status = match gates.iter().all(|gate| gate.held) {
            true if gates.iter().any(|gate| gate.asked) => FlightStatus::Pass,
            true => FlightStatus::Completed,
            false => FlightStatus::Fail,
        };
        Self {
            status,
            exit_code: status.exit_code(),
            gates,
        }
    }

    /// How many of the requested gates held, and how many were requested.
    pub fn requested(&self) -> (usize, usize) {
        let asked = || self.gates.iter().filter(|gate| gate.asked);
        (asked().filter(|gate| gate.held).count(), asked().count())
    }
}

/// Closes the report of a flight whose recorder ended before its final report, or did not know how the flight ended.
/// `reason` is why it was cut short, where that is known.
pub fn break_off(report: &mut Report, status: FlightStatus, mut ending: String, reason: &str) {
    if report.run.in_flight {
        let flown_s = report.ticks.flown_s(&report.run);
        ending += &format!("; the numbers end {flown_s:.1} s into the flight");
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
        *timing.numbers() += &format!(", then nothing for {then}");
    }
    let how = match status {
        FlightStatus::Interrupted => "interrupted",
        _ => "aborted",
    };
    let flown_s = report.ticks.flown_s(&report.run);
    report.words.cut_short(how, reason, &report.ticks, flown_s);
    (report.verdict.status, report.verdict.exit_code) = (status, status.exit_code());
    (report.run.ending, report.run.in_flight) = (ending, false);
}

/// Puts in what became of the messages on their way to the flight log.
pub fn take_log(report: &mut Report, kept: &str, fate: &Fate) {
    report.recorder.log = crate::sections::log_section(kept, fate);
    if report.unlogged() > 0 {
        mark_incomplete(report);
    }
}

/// A flight that lacks something is no plain PASS.
pub fn mark_incomplete(report: &mut Report) {
    if report.verdict.status.is_good() {
        report.verdict.status = FlightStatus::Incomplete;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{good, not_fresh};

    const REQUESTED: RequestedGates = RequestedGates {
        limits: FlightLimits {
            error_max_m: 0.1,
            yaw_error_max_rad: 0.1,
            ground_z_m: -0.25,
            position_error_max_m: 10.0,
        },
        tilt_max_rad: std::f64::consts::PI,
        max_miss_rate_ppm: Some(0.0),
        max_skip_rate_ppm: Some(0.0),
        max_stale_rate_ppm: Some(0.0),
        max_wake_p999_us: Some(51.0),
        max_loop_p999_us: Some(51.0),
        max_tracking_error_m: Some(0.01),
        max_yaw_error_rad: Some(0.01),
        max_saturated_percent: Some(1.0),
        max_agitation_rad_s: Some(10.0),
        max_steal_percent: Some(0.0),
        channels: false,
        theorem: Some(TheoremGate::Lenient),
    };

    /// What was measured for the gates that a changed flight does not hold.
    fn broken(change: impl FnOnce(&mut Report)) -> Vec<String> {
        let mut report = good();
        change(&mut report);
        let gates = gates(&report, Some(EndReason::Completed), &REQUESTED).into_iter();
        let failed = gates.filter(|gate| !gate.held);
        let failed = failed.map(|gate| format!("{}: {}", gate.name, gate.value));
        failed.collect()
    }

    type Change = fn(&mut Report);

    #[test]
    fn a_flight_that_passed_is_incomplete_if_its_log_lacks_messages() {
        use FlightStatus::{Fail, Incomplete, Pass};
        for (dropped, before, after) in [(0, Pass, Pass), (1, Pass, Incomplete), (1, Fail, Fail)] {
            let (mut report, mut fate) = (good(), Fate::default());
            fate.dropped[0] = dropped;
            report.verdict.status = before;
            take_log(&mut report, "all", &fate);
            assert_eq!(report.verdict.status, after);
        }
    }

    #[test]
    fn only_the_strict_gate_fails_if_another_torque_has_a_cause() {
        let mut theorem = good().theorem;
        let (wrenches, rotors) = (theorem.ticks, theorem.ticks);
        (theorem.torque.wrenches, theorem.torque.rotors) = (wrenches, rotors);
        let held = |theorem: &Theorem| {
            let gates = [TheoremGate::Lenient, TheoremGate::Strict];
            gates.map(|gate| Gate::theorem(theorem, gate).held)
        };
        assert_eq!(held(&theorem), [true, true]);
        for cause in ["stale_input", "delay", "saturation", "motor_lag"] {
            theorem.torque.rotors_wrong = [(cause.to_owned(), 1)].into();
            assert_eq!(held(&theorem), [true, false], "{cause}");
        }
    }

    #[test]
    fn each_gate_breaks_by_its_own_number_alone() {
        let check = |change: Change, failed: &str| assert_eq!(broken(change).join("; "), failed);
        check(|_| (), "");
        let low = "flight envelope: below ground: down to z = -0.26 m, the ground is at -0.25 m";
        check(|it| it.flight.lowest_z_m = -0.26, low);
        let far =
            "flight envelope: left its envelope: position error up to 10.001 m, allowed are 10 m";
        check(|it| it.flight.position_error_max_m = 10.001, far);
        let fresh = |rest: &str| format!("{NOT_FRESH} per million: {rest}");
        let missed = fresh("100.0 (2 late + 0 stale + 0 skipped)");
        check(|it| not_fresh(it, 2, 0, 0), &missed);
        let stale = fresh("4950.0 (0 late + 99 stale + 0 skipped)");
        check(|it| not_fresh(it, 0, 99, 0), &stale);
        let skipped = "50.0 (0 late + 0 stale + 1 skipped); ticks skipped per million: 50.0";
        check(|it| not_fresh(it, 0, 0, 1), &fresh(skipped));
        let stolen = "steal [%]: 0.25 of processor 1";
        check(|it| it.steal.percent = 0.25, stolen);
        let worst = |it: &mut Report| {
            let stage = it.roles["inner"].clone();
            for (name, ticks_stale) in [("outer", 1), ("b.inner", 3), ("mixer", 2), ("record", 9)] {
                let stage = stage.clone();
                let stage = RoleSection {
                    ticks_stale,
                    ..stage
                };
                it.roles.insert(name.into(), stage);
            }
        };
        check(worst, "stale ticks per million: 150.0 (b.inner)");
        let replaced = |it: &mut Report| {
            it.roles
                .entry("inner".into())
                .and_modify(|it| it.is_successor = true);
        };
        let unknown = "stale ticks per million: measured nothing: the inner process was replaced; the stale ticks of \
                       its predecessor are unknown";
        check(replaced, unknown);
        let whole = "loop p99.9 [us]: 51.1";
        check(|it| it.series[0].p999_us = Some(51.1), whole);
        let wake = "wake.plant p99.9 [us]: 51.1";
        check(|it| it.series[1].p999_us = Some(51.1), wake);
        let error = "position error in the last 5 s [m]: 0.0200";
        check(|it| it.flight.recent_error_max_m = 0.02, error);
        let rounded = "position error in the last 5 s [m]: 0.010004";
        check(|it| it.flight.recent_error_max_m = 0.010_004, rounded);
        let yaw: Change = |it| it.flight.yaw_error.as_mut().unwrap().recent_max_rad = 0.569;
        check(yaw, "yaw error in the last 5 s [rad]: 0.5690");
        let saturated: Change = |it| it.flight.effort.as_mut().unwrap().saturated_percent = 44.03;
        check(saturated, "rotors saturated [% of ticks]: 44.03");
        let agitation: Change = |it| it.flight.effort.as_mut().unwrap().agitation_rad_s = 23.5;
        check(
            agitation,
            "change of a rotor's command in a tick, rms [rad/s]: 23.50",
        );
        let unwatched = "theorem: 0 unexplained, estimates live, 1 tick not watched";
        check(|it| it.theorem.ticks_unwatched = 1, unwatched);
        let hardly = "theorem: 0 unexplained, estimates live, V_th judged in 49 of 10001 ticks; it rose in none; the torque of (19) acted in 19998 of 19998 ticks";
        let change: Change = |it| (it.theorem.ticks, it.theorem.ticks_judged) = (10_001, 49);
        check(change, hardly);
        let lifeless = "theorem: 0 unexplained, estimates do not move as predicted";
        let change: Change = |it| (it.theorem.holds, it.theorem.is_live) = (false, false);
        check(change, lifeless);
    }

    #[test]
    fn a_measurement_without_values_does_not_hold() {
        let check = |change: Change, end: &str, failed: usize| {
            let broken = broken(change);
            let is_it = broken.iter().filter(|it| it.ends_with(end));
            assert_eq!(
                (is_it.count(), broken.len()),
                (failed, failed),
                "{broken:?}"
            );
        };
        check(|it| it.steal.of_ms = 0, "the kernel counted no time", 1);
        let unseen: Change = |it| it.flight = ControlPerformance::default();
        check(unseen, " was seen", 4);
        check(|it| it.roles.clear(), "no stage worked a tick", 1);
        check(|it| it.series.clear(), "it has no values", 2);
        let lockstep = "in lockstep there are no deadlines";
        check(|it| it.run.wall_period_us = 0.0, lockstep, 5);
        // Fresh commands, wake-up, loop, errors, effort and theorem are measured from messages.
        let lost: Change = |it| it.recorder.lost = [("state".to_owned(), 3)].into();
        check(lost, ", and the recorder missed 3 messages", 8);
    }
}
