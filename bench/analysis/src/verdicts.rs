//! The three verdicts on a flight: tracking, timing and stability.
//!
//! They are judged apart from each other and from the gates: a flight in lockstep can track and has no timing, one
//! that is late can still track. Each comes with the numbers that it follows from.

use crate::host::{STEAL_LIMIT_PERCENT, Steal};
use crate::phrase::{beside, count, list, surrounded};
use crate::schema::{
    ControlPerformance, Explained, FlightVerdict, NotFresh, QuantityError, Report, Speed,
    StabilityVerdict, Ticks, TimingVerdict, Verdicts,
};
use crate::theorem::Theorem;
use messages::blackboards::EndReason;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlightLimits {
    /// Largest position error that is allowed in the last [`crate::tracking::RECENT_S`] [m].
    pub error_max_m: f64,
    /// Largest yaw error that is allowed then [rad].
    pub yaw_error_max_rad: f64,
    /// Height below which the airframe has hit the ground [m].
    pub ground_z_m: f64,
    /// Position error beyond which a flight has left its envelope [m].
    pub position_error_max_m: f64,
}

impl Verdicts {
    /// The verdicts on a flight that ended so; nothing while it flies.
    pub fn of(report: &Report, ending: Option<EndReason>, limits: &FlightLimits) -> Self {
        let (run, ticks, theorem) = (&report.run, &report.ticks, &report.theorem);
        let not_fresh = report.deadlines.not_fresh.unwrap_or_default();
        let mut verdicts = Self {
            flight: flight_verdict(&report.flight, ending, limits),
            timing: timing_verdict(ticks, &not_fresh, run.speed(), &report.steal),
            theorem: stability_verdict(theorem),
        };
        verdicts.end(ending, ticks, ticks.flown_s(run));
        verdicts
    }

    /// Takes how the flight ended after its ticks and this time [s].
    pub fn end(&mut self, ending: Option<EndReason>, ticks: &Ticks, flown_s: f64) {
        match ending {
            Some(EndReason::Interrupted) => self.cut_short("interrupted", "", ticks, flown_s),
            Some(EndReason::Failed) => self.cut_short("aborted", "", ticks, flown_s),
            _ => {}
        }
    }

    /// The flight was aborted or interrupted: it is judged on what it flew, and nothing good is said of the rest. This
    /// replaces what a recorder has said of the end: it does not know why the plant was requested to end the flight.
    pub fn cut_short(&mut self, how: &str, reason: &str, ticks: &Ticks, flown_s: f64) {
        let flown = count(ticks.all(), "tick");
        let flown = format!("{how} after {flown} ({flown_s:.3} s)");
        if self.flight.word == FlightVerdict::Tracked {
            self.flight.word = FlightVerdict::CutShort;
        }
        if self.timing.word == TimingVerdict::InTime {
            self.timing.word = TimingVerdict::CutShort;
        }
        let because = match reason {
            "" => flown.clone(),
            _ => format!("{flown}: {reason}"),
        };
        self.flight.begin_with(&because);
        self.timing.begin_with(&flown);
        self.theorem.begin_with(&flown);
    }
}

/// The position error [m] with which a flight left its envelope, in words.
pub fn beyond(error_max_m: f64, limit_m: f64) -> String {
    let error = beside(error_max_m, limit_m, 2);
    format!("left its envelope: position error up to {error} m, allowed are {limit_m} m")
}

/// How a flight that ended so left its envelope; none if it stayed inside. The plant ends a flight for its position error
/// only in ticks with a setpoint, so the largest error is judged here.
pub fn departure(
    performance: &ControlPerformance,
    ending: Option<EndReason>,
    limits: &FlightLimits,
) -> Option<String> {
    let (lowest, ground) = (performance.lowest_z_m, limits.ground_z_m);
    let (error_m, limit_m) = (
        performance.position_error_max_m,
        limits.position_error_max_m,
    );
    if let Some(ending) = ending.filter(|ending| ending.left_envelope()) {
        let (ending, error) = (ending.name(), beside(error_m, limit_m, 2));
        Some(format!("{ending}; position error up to {error} m"))
    } else if lowest < ground {
        let at = performance.lowest_at_s;
        let at = at.map_or(String::new(), |at_s| format!(" at {at_s:.3} s"));
        let lowest = beside(lowest, ground, 2);
        Some(format!(
            "below ground: down to z = {lowest} m{at}, the ground is at {ground} m"
        ))
    } else {
        (error_m > limit_m).then(|| beyond(error_m, limit_m))
    }
}

/// Whether a flight follows its reference; it still flies without an ending.
pub fn flight_verdict(
    performance: &ControlPerformance,
    ending: Option<EndReason>,
    limits: &FlightLimits,
) -> Explained<FlightVerdict> {
    let (word, why) = if performance.states == 0 {
        (FlightVerdict::NotSeen, "no state was seen".into())
    } else if let Some(why) = departure(performance, ending, limits) {
        (FlightVerdict::Lost, why)
    } else {
        let limits = [limits.error_max_m, limits.yaw_error_max_rad];
        let errors = performance.errors().into_iter().zip(limits);
        let judged = errors.filter_map(|(error, limit)| Some((error?, limit)));
        let judged: Vec<(QuantityError, f64)> = judged.collect();
        // Of a flight that is off its track, the errors that are too large.
        let is_over = |(error, limit): &&(QuantityError, f64)| error.recent_max > *limit;
        let (word, named) = match judged.iter().any(|it| is_over(&it)) {
            false => (FlightVerdict::Tracked, judged.iter().collect()),
            true => (
                FlightVerdict::OffTrack,
                judged.iter().filter(is_over).collect::<Vec<_>>(),
            ),
        };
        let words = named.iter().map(|(error, limit)| {
            let QuantityError { name, unit, .. } = error;
            let value = beside(error.recent_max, *limit, 4);
            format!("{name} up to {value} {unit} (limit {limit} {unit})")
        });
        let recent_s = performance.recent_s;
        let larger = judged.iter().filter(|(error, limit)| error.max > *limit);
        let larger = larger
            .filter(|(error, _)| error.max > error.recent_max)
            .map(|(error, _)| format!("{} up to {:.4} {}", error.name, error.max, error.unit));
        let before = surrounded("; before that ", &list(larger), "");
        let digits = if recent_s < 0.1 { 3 } else { 1 };
        let recent = format!("in the last {recent_s:.digits$} s");
        (word, format!("{} {recent}{before}", list(words)))
    };
    Explained::new(word, why)
}

pub fn timing_verdict(
    ticks: &Ticks,
    not_fresh: &NotFresh,
    speed: Speed,
    steal: &Steal,
) -> Explained<TimingVerdict> {
    let all = ticks.run.saturating_add(ticks.skipped);
    let (percent, counts) = (not_fresh.on_time_percent(), not_fresh.sentence(ticks));
    let share = format!("{percent:.2} % on time: {counts}");
    let (word, why) = if let Some(why) = speed.why_not_real_time() {
        (TimingVerdict::NotMeasured, why)
    } else if steal.percent > STEAL_LIMIT_PERCENT {
        let (percent, whose) = (steal.percent, steal.processors());
        let why = format!("the host stole {percent:.1} % of {whose}; {share}");
        (TimingVerdict::NotMeasured, why)
    } else if all == 0 {
        (TimingVerdict::NotMeasured, "no tick was flown".into())
    } else if not_fresh.ticks > 0 {
        (TimingVerdict::Late, share)
    } else {
        (TimingVerdict::InTime, counts)
    };
    Explained::new(word, why)
}

pub fn stability_verdict(theorem: &Theorem) -> Explained<StabilityVerdict> {
    let unexplained = theorem.unexplained();
    let counts = theorem.counts();
    use StabilityVerdict::{Broken, Holds, NotApplicable, NotJudged, PartlyWatched};
    let (word, why) = if let Some(why) = theorem.inapplicable() {
        (NotApplicable, why)
    } else if theorem.ticks_checked == 0 {
        let why = "no step of the estimates was checked";
        (NotJudged, format!("{why}: {counts}"))
    } else if theorem.holds && theorem.steps_adapted == 0 {
        let why = "no estimate moved: adaptation is off, or its bounds pin it";
        (NotApplicable, why.into())
    } else if theorem.holds && theorem.is_hardly_judged() {
        (NotJudged, format!("{counts}; {}", theorem.torque()))
    } else if theorem.holds && theorem.ticks_unwatched > 0 {
        (PartlyWatched, counts)
    } else if theorem.holds {
        // (22) is proven without delay alone: how small e becomes is no part of the verdict.
        let (torque, e) = (theorem.torque(), theorem.rate_error_rms_rad_s);
        let why = format!("{counts}; {torque}; e {e:.1e} rad/s rms in the last second");
        (Holds, why)
    } else if theorem.torque.unexplained() > 0 {
        (Broken, format!("{}; {counts}", theorem.torque()))
    } else if unexplained == 0 {
        let why = "the estimates did not move as predicted";
        (Broken, why.into())
    } else {
        (Broken, counts)
    };
    Explained::new(word, why)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phrase::name_of;
    use crate::sample::{good, not_fresh};
    use crate::theorem::Torque;

    const LIMITS: FlightLimits = FlightLimits {
        error_max_m: 0.1,
        yaw_error_max_rad: 0.2,
        ground_z_m: -0.25,
        position_error_max_m: 10.0,
    };

    fn words(verdicts: &Verdicts) -> [String; 3] {
        [
            name_of(&verdicts.flight.word),
            name_of(&verdicts.timing.word),
            name_of(&verdicts.theorem.word),
        ]
    }

    fn periods(report: &mut Report, period_us: f64, wall_period_us: f64) {
        (report.run.period_us, report.run.wall_period_us) = (period_us, wall_period_us);
    }

    fn yaw(report: &mut Report, recent_max_rad: f64) {
        report.flight.yaw_error.as_mut().unwrap().recent_max_rad = recent_max_rad;
    }

    type Change = (usize, &'static str, fn(&mut Report));

    /// Place of a verdict, its word, and a change of a good flight that has no consequence for the other two.
    const CHANGES: [Change; 34] = [
        (0, "tracked", |it| yaw(it, 0.2)),
        (0, "tracked", |it| it.flight.recent_error_max_m = 0.1),
        (0, "tracked", |it| it.flight.position_error_max_m = 3.0),
        (0, "tracked", |it| it.flight.lowest_z_m = -0.25),
        (0, "off track", |it| it.flight.recent_error_max_m = 0.1001),
        (0, "off track", |it| yaw(it, 0.2001)),
        (0, "off track", |it| {
            (it.flight.recent_error_max_m, it.flight.yaw_error) = (0.2, None)
        }),
        (0, "lost", |it| it.flight.lowest_z_m = -0.26),
        (0, "tracked", |it| it.flight.position_error_max_m = 10.0),
        (0, "lost", |it| it.flight.position_error_max_m = 10.01),
        (0, "not seen", |it| it.flight.states = 0),
        (1, "late", |it| not_fresh(it, 1, 0, 0)),
        (1, "late", |it| not_fresh(it, 0, 1, 0)),
        (1, "late", |it| not_fresh(it, 0, 0, 1)),
        (1, "not measured", |it| periods(it, 1000.0, 0.0)),
        (1, "not measured", |it| periods(it, 1000.0, 5000.0)),
        (1, "not measured", |it| it.steal.percent = 1.01),
        (1, "not measured", |it| it.ticks.run = 0),
        // A sample time need not be a whole number of nanoseconds.
        (1, "in time", |it| periods(it, 1666.6667, 1666.667)),
        (1, "in time", |it| periods(it, 333.3333, 333.333)),
        (1, "in time", |it| it.steal.percent = 1.0),
        (2, "not judged", |it| it.theorem.ticks_checked = 0),
        (2, "not judged", |it| {
            (it.theorem.ticks_judged, it.theorem.ticks_unwatched) = (0, 1)
        }),
        (2, "not applicable", |it| it.theorem.steps_adapted = 0),
        (2, "not applicable", |it| {
            it.theorem.law_without = Some("pid".into())
        }),
        (2, "broken", |it| it.theorem.holds = false),
        (2, "broken", |it| {
            (it.theorem.ticks_unwatched, it.theorem.holds) = (1, false)
        }),
        (2, "broken", |it| {
            (it.theorem.steps_adapted, it.theorem.holds) = (0, false)
        }),
        (2, "partly watched", |it| it.theorem.ticks_unwatched = 1),
        (2, "not judged", |it| it.theorem.ticks_judged = 9_999),
        (2, "not judged", |it| it.theorem.torque = Torque::default()),
        (2, "not judged", |it| it.theorem.torque.wrenches = 9_997),
        (2, "not judged", |it| {
            (it.theorem.ticks, it.theorem.torque.rotors) = (1, 0)
        }),
        (2, "not judged", |it| {
            (it.theorem.ticks_checked, it.theorem.ticks_unwatched) = (0, 1)
        }),
    ];

    #[test]
    fn each_change_of_a_good_flight_has_its_word() {
        for (i, (verdict, word, change)) in CHANGES.into_iter().enumerate() {
            let mut report = good();
            change(&mut report);
            let verdicts = Verdicts::of(&report, Some(EndReason::Completed), &LIMITS);
            let mut expected = ["tracked", "in time", "holds"];
            expected[verdict] = word;
            assert_eq!(words(&verdicts), expected, "{word} {i}");
        }
        let lost = Verdicts::of(&good(), Some(EndReason::Position), &LIMITS);
        assert_eq!(words(&lost)[0], "lost");
    }

    #[test]
    fn a_verdict_names_what_is_too_large_and_never_rounds_a_share_up_to_all() {
        let why = |change: &dyn Fn(&mut Report)| {
            let mut report = good();
            change(&mut report);
            let Verdicts { flight, timing, .. } = Verdicts::of(&report, None, &LIMITS);
            [flight.why, timing.why]
        };
        for (error_m, yaw_rad, expected) in [
            (0.1, 0.3, "yaw error up to 0.3000 rad (limit 0.2 rad)"),
            (0.3, 0.1, "position error up to 0.3000 m (limit 0.1 m)"),
            // The value has as many digits as show that it is too large.
            (
                0.100_003,
                0.1,
                "position error up to 0.100003 m (limit 0.1 m)",
            ),
        ] {
            let [flight, _] = why(&|it| {
                it.flight.recent_error_max_m = error_m;
                yaw(it, yaw_rad);
            });
            assert_eq!(flight, format!("{expected} in the last 5.0 s"));
        }
        let [flight, _] = why(&|it| it.flight.recent_s = 0.002);
        assert!(flight.ends_with("in the last 0.002 s"), "{flight}");
        // An excursion before the last seconds is named, though the flight is tracked in these.
        let [flight, _] = why(&|it| it.flight.position_error_max_m = 1.34);
        let end = "in the last 5.0 s; before that position error up to 1.3400 m";
        assert!(flight.ends_with(end), "{flight}");
        for (missed, share) in [(1, "99.99"), (16, "99.92"), (10_000, "50.00")] {
            let [_, timing] = why(&|it| not_fresh(it, missed, 0, 0));
            let begin = format!("{share} % on time: {missed} of 20000 ticks without");
            assert!(timing.starts_with(&begin), "{timing}");
        }
    }

    #[test]
    fn a_flight_that_was_cut_short_is_judged_on_what_it_flew() {
        for (ending, how) in [
            (EndReason::Failed, "aborted"),
            (EndReason::Interrupted, "interrupted"),
        ] {
            let mut report = good();
            report.ticks.run = 1;
            let short = Verdicts::of(&report, Some(ending), &LIMITS);
            assert_eq!(words(&short), ["cut short", "cut short", "holds"]);
            let begin = format!("{how} after 1 tick (0.001 s); until then ");
            for why in [short.flight.why, short.timing.why, short.theorem.why] {
                assert!(why.starts_with(&begin), "{why}");
            }
            report.flight.recent_error_max_m = 1.0;
            not_fresh(&mut report, 0, 1, 0);
            let bad = Verdicts::of(&report, Some(ending), &LIMITS);
            assert_eq!(words(&bad), ["off track", "late", "holds"]);
        }
    }
}
