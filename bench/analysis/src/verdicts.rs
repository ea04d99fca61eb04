//! The three verdicts on a flight: tracking, timing and stability.
//!
//! They are judged apart from each other and from the gates: a flight in lockstep can track and has no timing, one
//! that is late can still track. Each comes with the numbers that it follows from.

use crate::host::{STEAL_LIMIT_PERCENT, Steal};
use crate::phrase::count;
use crate::schema::{
    ControlPerformance, Explained, FlightVerdict, NotFresh, QuantityError, Report, RunSection,
    Speed, StabilityVerdict, Ticks, TimingVerdict, Verdicts,
};
use crate::theorem::Theorem;
use messages::blackboards::EndReason;
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackingLimits {
    /// Largest position error that is allowed in the last [`crate::tracking::RECENT_S`] [m].
    pub error_max_m: f64,
    /// Largest yaw error that is allowed then [rad].
    pub yaw_error_max_rad: f64,
    /// Height below which the airframe has hit the ground [m].
    pub ground_z_m: f64,
}

impl Verdicts {
    /// The verdicts on a flight that ended so; nothing while it flies.
    pub fn of(report: &Report, ending: Option<EndReason>, limits: &TrackingLimits) -> Self {
        let (run, ticks, theorem) = (&report.run, &report.ticks, &report.theorem);
        let not_fresh = report.deadlines.not_fresh.unwrap_or_default();
        let mut verdicts = Self {
            flight: flight_verdict(&report.flight, ending, limits),
            timing: timing_verdict(ticks, &not_fresh, run.speed(), &report.steal),
            theorem: stability_verdict(theorem),
        };
        match ending {
            Some(EndReason::Interrupted) => verdicts.cut_short("interrupted", "", run, ticks),
            Some(EndReason::Failed) => verdicts.cut_short("aborted", "", run, ticks),
            _ => {}
        }
        verdicts
    }

    /// The flight was aborted or interrupted: it is judged on what it flew, and nothing good is said of the rest. This
    /// replaces what a recorder has said of the end: it does not know why the plant was requested to end the flight.
    pub fn cut_short(&mut self, how: &str, reason: &str, run: &RunSection, ticks: &Ticks) {
        const UNTIL_THEN: &str = "; until then ";
        let all = ticks.run.saturating_add(ticks.skipped);
        let (flown, flown_s) = (count(all, "tick"), all as f64 * run.period_us / 1e6);
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
        for (why, flown) in [
            (&mut self.flight.why, &because),
            (&mut self.timing.why, &flown),
            (&mut self.theorem.why, &flown),
        ] {
            let before = why.split_once(UNTIL_THEN).map_or(why.as_str(), |it| it.1);
            *why = format!("{flown}{UNTIL_THEN}{before}");
        }
    }
}

/// Whether a flight follows its reference; it still flies without an ending.
pub fn flight_verdict(
    performance: &ControlPerformance,
    ending: Option<EndReason>,
    limits: &TrackingLimits,
) -> Explained<FlightVerdict> {
    let (lowest, ground) = (performance.lowest_z_m, limits.ground_z_m);
    let (word, why) = if performance.states == 0 {
        (FlightVerdict::NotSeen, "no state was seen".into())
    } else if let Some(ending) = ending.filter(|ending| ending.left_envelope()) {
        let (ending, error) = (ending.name(), performance.position_error_max_m);
        let why = format!("{ending}; position error up to {error:.2} m");
        (FlightVerdict::Lost, why)
    } else if lowest < ground {
        let why = format!("below ground: down to z = {lowest:.2} m, the ground is at {ground} m");
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
            format!(
                "{name} up to {:.4} {unit} (limit {limit} {unit})",
                error.recent_max
            )
        });
        let words = words.collect::<Vec<_>>().join(", ");
        let recent_s = performance.recent_s;
        let larger = judged.iter().filter(|(error, limit)| error.max > *limit);
        let larger = larger
            .filter(|(error, _)| error.max > error.recent_max)
            .map(|(error, _)| format!("{} up to {:.4} {}", error.name, error.max, error.unit));
        let larger: Vec<String> = larger.collect();
        let before = match larger.is_empty() {
            true => String::new(),
            false => format!("; before that {}", larger.join(", ")),
        };
        (word, format!("{words} in the last {recent_s:.1} s{before}"))
    };
    Explained { word, why }
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
    Explained { word, why }
}

pub fn stability_verdict(theorem: &Theorem) -> Explained<StabilityVerdict> {
    let unexplained = theorem.unexplained();
    let counts = theorem.counts();
    use StabilityVerdict::{Broken, Holds, NotApplicable, NotJudged, PartlyWatched};
    let (word, why) = if let Some(why) = theorem.inapplicable() {
        (NotApplicable, why)
    } else if theorem.ticks_checked == 0 && theorem.ticks_unwatched > 0 {
        (NotJudged, counts)
    } else if theorem.ticks_checked == 0 {
        (NotApplicable, "no step of the estimates was checked".into())
    } else if theorem.holds && theorem.steps_adapted == 0 {
        let why = "no estimate moved: adaptation is off, or its bounds pin it";
        (NotApplicable, why.into())
    } else if theorem.holds && theorem.ticks_unwatched > 0 {
        (PartlyWatched, counts)
    } else if theorem.holds && theorem.is_hardly_judged() {
        (NotJudged, format!("{counts}; {}", theorem.torque()))
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
    Explained { word, why }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phrase::name_of;
    use crate::sample::{good, not_fresh};

    const LIMITS: TrackingLimits = TrackingLimits {
        error_max_m: 0.1,
        yaw_error_max_rad: 0.2,
        ground_z_m: -0.25,
    };

    fn words(verdicts: &Verdicts) -> [String; 3] {
        [
            name_of(&verdicts.flight.word),
            name_of(&verdicts.timing.word),
            name_of(&verdicts.theorem.word),
        ]
    }

    #[test]
    fn a_good_flight_is_tracked_in_time_and_holds_and_each_change_has_its_word() {
        const GOOD: [&str; 3] = ["tracked", "in time", "holds"];
        fn periods(report: &mut Report, period_us: f64, wall_period_us: f64) {
            (report.run.period_us, report.run.wall_period_us) = (period_us, wall_period_us);
        }
        type Change = fn(&mut Report);
        let check = |verdict: usize, word: &'static str, changes: &[Change]| {
            for (i, change) in changes.iter().enumerate() {
                let mut report = good();
                change(&mut report);
                let verdicts = Verdicts::of(&report, Some(EndReason::Completed), &LIMITS);
                let mut expected = GOOD;
                expected[verdict] = word;
                assert_eq!(words(&verdicts), expected, "{word} {i}");
            }
        };
        fn yaw(report: &mut Report, recent_max_rad: f64) {
            report.flight.yaw_error.as_mut().unwrap().recent_max_rad = recent_max_rad;
        }
        let tracked: [Change; 4] = [
            |it| yaw(it, 0.2),
            |it| it.flight.recent_error_max_m = 0.1,
            |it| it.flight.position_error_max_m = 3.0,
            |it| it.flight.lowest_z_m = -0.25,
        ];
        check(0, "tracked", &tracked);
        let off_track: [Change; 3] = [
            |it| it.flight.recent_error_max_m = 0.1001,
            |it| yaw(it, 0.2001),
            |it| (it.flight.recent_error_max_m, it.flight.yaw_error) = (0.2, None),
        ];
        check(0, "off track", &off_track);
        // Only what is too large is named.
        for (error_m, yaw_rad, expected) in [
            (
                0.1,
                0.3,
                "yaw error up to 0.3000 rad (limit 0.2 rad) in the last 5.0 s",
            ),
            (
                0.3,
                0.1,
                "position error up to 0.3000 m (limit 0.1 m) in the last 5.0 s",
            ),
        ] {
            let mut report = good();
            report.flight.recent_error_max_m = error_m;
            yaw(&mut report, yaw_rad);
            assert_eq!(Verdicts::of(&report, None, &LIMITS).flight.why, expected);
        }
        // An excursion before the last seconds is named, though the flight is tracked in these.
        let mut report = good();
        report.flight.position_error_max_m = 1.34;
        let why = Verdicts::of(&report, None, &LIMITS).flight.why;
        let end = "in the last 5.0 s; before that position error up to 1.3400 m";
        assert!(why.ends_with(end), "{why}");
        check(0, "lost", &[|it| it.flight.lowest_z_m = -0.26]);
        check(0, "not seen", &[|it| it.flight.states = 0]);
        let late: [Change; 3] = [
            |it| not_fresh(it, 1, 0, 0),
            |it| not_fresh(it, 0, 1, 0),
            |it| not_fresh(it, 0, 0, 1),
        ];
        check(1, "late", &late);
        let not_measured: [Change; 4] = [
            |it| periods(it, 1000.0, 0.0),
            |it| periods(it, 1000.0, 5000.0),
            |it| it.steal.percent = 1.01,
            |it| it.ticks.run = 0,
        ];
        check(1, "not measured", &not_measured);
        // A sample time need not be a whole number of nanoseconds.
        let in_time: [Change; 3] = [
            |it| periods(it, 1666.6667, 1666.667),
            |it| periods(it, 333.3333, 333.333),
            |it| it.steal.percent = 1.0,
        ];
        check(1, "in time", &in_time);
        let not_applicable: [Change; 3] = [
            |it| it.theorem.ticks_checked = 0,
            |it| it.theorem.steps_adapted = 0,
            |it| it.theorem.law_without = Some("pid".into()),
        ];
        check(2, "not applicable", &not_applicable);
        let broken: [Change; 3] = [
            |it| it.theorem.holds = false,
            |it| (it.theorem.ticks_unwatched, it.theorem.holds) = (1, false),
            |it| (it.theorem.steps_adapted, it.theorem.holds) = (0, false),
        ];
        check(2, "broken", &broken);
        check(2, "partly watched", &[|it| it.theorem.ticks_unwatched = 1]);
        let not_judged: [Change; 2] = [
            |it| it.theorem.ticks_judged = 9_999,
            |it| (it.theorem.ticks_checked, it.theorem.ticks_unwatched) = (0, 1),
        ];
        check(2, "not judged", &not_judged);
        let lost = Verdicts::of(&good(), Some(EndReason::Position), &LIMITS);
        assert_eq!(words(&lost)[0], "lost");
        // A share is never rounded up to all.
        for (missed, share) in [(1, "99.99"), (16, "99.92"), (10_000, "50.00")] {
            let mut report = good();
            not_fresh(&mut report, missed, 0, 0);
            let why = Verdicts::of(&report, None, &LIMITS).timing.why;
            let begin = format!("{share} % on time: {missed} of 20000 ticks without");
            assert!(why.starts_with(&begin), "{why}");
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
