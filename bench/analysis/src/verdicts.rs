//! The three verdicts on a flight: tracking, timing and stability.
//!
//! They are judged apart from each other and from the gates: a flight in lockstep can track and has no timing, one
//! that is late can still track. Each comes with the numbers that it follows from.

use crate::host::{STEAL_LIMIT_PERCENT, Steal};
use crate::phrase::count;
use crate::schema::{
    ControlPerformance, DeadlineSection, Explained, FlightVerdict, NotFresh, RoleSection,
    RunSection, StabilityVerdict, Ticks, TimingVerdict, Verdicts,
};
use crate::series::Statistics;
use crate::speed::Speed;
use crate::theorem::Theorem;
use messages::blackboards::EndReason;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackingLimits {
    /// Largest position error that is allowed in the last [`crate::tracking::RECENT_S`] [m].
    pub error_max_m: f64,
    /// Height below which the airframe has hit the ground [m].
    pub ground_z_m: f64,
}

#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    pub run: &'a RunSection,
    /// How it ended; nothing while it flies.
    pub ending: Option<EndReason>,
    pub ticks: &'a Ticks,
    pub deadlines: &'a DeadlineSection,
    pub performance: &'a ControlPerformance,
    pub theorem: &'a Theorem,
    pub series: &'a [Statistics],
    pub roles: &'a BTreeMap<String, RoleSection>,
    pub steal: &'a Steal,
    pub lost: u64,
}

impl Verdicts {
    pub fn of(evidence: &Evidence<'_>, limits: &TrackingLimits) -> Self {
        let (run, ticks, theorem) = (evidence.run, evidence.ticks, evidence.theorem);
        let not_fresh = evidence.deadlines.not_fresh.unwrap_or_default();
        let mut verdicts = Self {
            flight: flight_verdict(evidence.performance, evidence.ending, limits),
            timing: timing_verdict(ticks, &not_fresh, run.speed(), evidence.steal),
            theorem: stability_verdict(theorem),
        };
        match evidence.ending {
            Some(EndReason::Interrupted) => verdicts.cut_short("interrupted", run, ticks),
            Some(EndReason::Failed) => verdicts.cut_short("aborted", run, ticks),
            _ => {}
        }
        verdicts
    }

    /// The flight was aborted or interrupted: it is judged on what it flew, and nothing good is said of the rest.
    pub fn cut_short(&mut self, how: &str, run: &RunSection, ticks: &Ticks) {
        let all = ticks.run.saturating_add(ticks.skipped);
        let (flown, flown_s) = (count(all, "tick"), all as f64 * run.period_us / 1e6);
        let flown = format!("{how} after {flown} ({flown_s:.3} s)");
        if self.flight.word == FlightVerdict::Tracked {
            self.flight.word = FlightVerdict::CutShort;
        }
        if self.timing.word == TimingVerdict::InTime {
            self.timing.word = TimingVerdict::CutShort;
        }
        let (flight, timing) = (&mut self.flight.why, &mut self.timing.why);
        for why in [flight, timing, &mut self.theorem.why] {
            *why = format!("{flown}; until then {why}");
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
        let (error, limit) = (performance.recent_error_max_m, limits.error_max_m);
        let word = match error <= limit {
            true => FlightVerdict::Tracked,
            false => FlightVerdict::OffTrack,
        };
        let recent_s = performance.recent_s;
        let last = format!("in the last {recent_s:.1} s, limit {limit} m");
        (word, format!("position error up to {error:.4} m {last}"))
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
    let counts = format!(
        "{} of {all} ticks without a fresh command on time ({:.1} per million): {}",
        not_fresh.ticks,
        not_fresh.per_million,
        not_fresh.parts()
    );
    let (word, why) = if let Some(why) = speed.why_not_real_time() {
        (TimingVerdict::NotMeasured, why)
    } else if steal.percent > STEAL_LIMIT_PERCENT {
        let (percent, whose) = (steal.percent, steal.processors());
        let why = format!("the host stole {percent:.1} % of {whose}; {counts}");
        (TimingVerdict::NotMeasured, why)
    } else if all == 0 {
        (TimingVerdict::NotMeasured, "no tick was flown".into())
    } else if not_fresh.ticks > 0 {
        (TimingVerdict::Late, counts)
    } else {
        (TimingVerdict::InTime, counts)
    };
    Explained { word, why }
}

pub fn stability_verdict(theorem: &Theorem) -> Explained<StabilityVerdict> {
    let unexplained = theorem.unexplained();
    let counts = theorem.counts();
    use StabilityVerdict::{Broken, Holds, NotApplicable, PartlyWatched};
    let (word, why) = if let Some(why) = theorem.inapplicable() {
        (NotApplicable, why)
    } else if theorem.ticks_checked == 0 {
        (NotApplicable, "no step of the estimates was checked".into())
    } else if theorem.holds && theorem.steps_adapted == 0 {
        let why = "no estimate moved: adaptation is off, or its bounds pin it";
        (NotApplicable, why.into())
    } else if theorem.holds && theorem.ticks_unwatched > 0 {
        let unwatched = count(theorem.ticks_unwatched, "tick");
        (PartlyWatched, format!("{counts}, {unwatched} not watched"))
    } else if theorem.holds {
        (Holds, counts)
    } else if unexplained == 0 {
        let why = "the estimates did not move as predicted";
        (Broken, why.into())
    } else {
        (Broken, counts)
    };
    Explained { word, why }
}

impl FlightVerdict {
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotSeen => "not seen",
            Self::Tracked => "tracked",
            Self::CutShort => "cut short",
            Self::OffTrack => "off track",
            Self::Lost => "lost",
        }
    }
}

impl TimingVerdict {
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotMeasured => "not measured",
            Self::InTime => "in time",
            Self::CutShort => "cut short",
            Self::Late => "late",
        }
    }
}

impl StabilityVerdict {
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotApplicable => "not applicable",
            Self::Holds => "holds",
            Self::PartlyWatched => "partly watched",
            Self::Broken => "broken",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;

    const LIMITS: TrackingLimits = TrackingLimits {
        error_max_m: 0.1,
        ground_z_m: -0.25,
    };

    fn words(change: impl FnOnce(&mut Sample)) -> [&'static str; 3] {
        let mut sample = Sample::good();
        change(&mut sample);
        let verdicts = Verdicts::of(&sample.evidence(), &LIMITS);
        words_of(&verdicts)
    }

    const fn words_of(of: &Verdicts) -> [&'static str; 3] {
        let Verdicts {
            flight,
            timing,
            theorem,
        } = of;
        [
            flight.word.words(),
            timing.word.words(),
            theorem.word.words(),
        ]
    }

    #[test]
    fn a_good_flight_tracks_in_time_and_the_theorem_holds() {
        assert_eq!(words(|_| ()), ["tracked", "in time", "holds"]);
    }

    type Row = (fn(&mut Sample), &'static str);

    /// What changes a good flight, and the word that one of its verdicts then has.
    fn check(verdict: usize, rows: &[Row]) {
        for (i, (change, word)) in rows.iter().enumerate() {
            assert_eq!(words(change)[verdict], *word, "row {i}");
        }
    }

    #[test]
    fn a_flight_is_tracked_by_its_end_and_lost_by_the_ground_or_its_envelope() {
        let rows: [Row; 7] = [
            (|it| it.performance.recent_error_max_m = 0.1, "tracked"),
            (|it| it.performance.recent_error_max_m = 0.1001, "off track"),
            (|it| it.performance.position_error_max_m = 3.0, "tracked"),
            (|it| it.performance.lowest_z_m = -0.25, "tracked"),
            (|it| it.performance.lowest_z_m = -0.26, "lost"),
            (|it| it.ending = Some(EndReason::Position), "lost"),
            (|it| it.performance.states = 0, "not seen"),
        ];
        check(0, &rows);
    }

    #[test]
    fn one_miss_or_skip_is_late_and_what_measures_nothing_is_not_in_time() {
        fn periods(sample: &mut Sample, period_us: f64, wall_period_us: f64) {
            sample.run.period_us = period_us;
            sample.run.wall_period_us = wall_period_us;
        }
        let rows: [Row; 10] = [
            (|it| it.not_fresh(1, 0, 0), "late"),
            (|it| it.not_fresh(0, 1, 0), "late"),
            (|it| it.not_fresh(0, 0, 1), "late"),
            (|it| periods(it, 1000.0, 0.0), "not measured"),
            (|it| periods(it, 1000.0, 5000.0), "not measured"),
            // A sample time need not be a whole number of nanoseconds.
            (|it| periods(it, 1666.6667, 1666.667), "in time"),
            (|it| periods(it, 333.3333, 333.333), "in time"),
            (|it| it.steal.percent = 1.0, "in time"),
            (|it| it.steal.percent = 1.01, "not measured"),
            (|it| it.ticks.run = 0, "not measured"),
        ];
        check(1, &rows);
    }

    #[test]
    fn estimates_that_should_move_and_do_not_break_the_theorem_and_pinned_ones_have_none() {
        let rows: [Row; 7] = [
            (|it| it.theorem.ticks_checked = 0, "not applicable"),
            (|it| it.theorem.steps_adapted = 0, "not applicable"),
            (
                |it| it.theorem.law_without = Some("pid".into()),
                "not applicable",
            ),
            (|it| it.theorem.holds = false, "broken"),
            (|it| it.theorem.ticks_unwatched = 1, "partly watched"),
            (
                |it| (it.theorem.ticks_unwatched, it.theorem.holds) = (1, false),
                "broken",
            ),
            (
                |it| (it.theorem.steps_adapted, it.theorem.holds) = (0, false),
                "broken",
            ),
        ];
        check(2, &rows);
    }

    #[test]
    fn a_flight_that_was_cut_short_is_judged_on_what_it_flew() {
        for (ending, how) in [
            (EndReason::Failed, "aborted"),
            (EndReason::Interrupted, "interrupted"),
        ] {
            let mut sample = Sample::good();
            (sample.ending, sample.ticks.run) = (Some(ending), 1);
            let short = Verdicts::of(&sample.evidence(), &LIMITS);
            let words = words_of(&short);
            assert_eq!(words, ["cut short", "cut short", "holds"]);
            let begin = format!("{how} after 1 tick (0.001 s); until then ");
            for why in [short.flight.why, short.timing.why, short.theorem.why] {
                assert!(why.starts_with(&begin), "{why}");
            }
            sample.performance.recent_error_max_m = 1.0;
            sample.not_fresh(0, 1, 0);
            let bad = Verdicts::of(&sample.evidence(), &LIMITS);
            let words = words_of(&bad);
            assert_eq!(words, ["off track", "late", "holds"]);
        }
    }

    #[test]
    fn the_timing_begins_with_one_number_and_its_parts() {
        let mut sample = Sample::good();
        sample.not_fresh(24, 6, 94);
        let verdicts = Verdicts::of(&sample.evidence(), &LIMITS);
        let why = "124 of 20094 ticks without a fresh command on time (6171.0 per million): \
                   24 missed + 6 stale + 94 skipped";
        assert_eq!(verdicts.timing.why, why);
    }
}
