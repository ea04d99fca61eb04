//! The three verdicts on a flight: tracking, timing and stability.
//!
//! They are judged apart from each other and from the gates: a flight in lockstep can track and has no timing, one
//! that is late can still track. Each comes with the numbers that it follows from.

use crate::host::{STEAL_LIMIT_PERCENT, Steal};
use crate::phrase::count;
use crate::schema::{
    ControlPerformance, DeadlineSection, NotFresh, RoleSection, RunSection, Ticks,
};
use crate::schema::{Explained, FlightVerdict, StabilityVerdict, TimingVerdict, Verdicts};
use crate::series::Statistics;
use crate::speed::Speed;
use crate::theorem::Theorem;
use messages::blackboards::EndReason;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// When a flight counts as tracked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackingLimits {
    /// Largest position error that is allowed in the last [`crate::tracking::RECENT_S`] [m].
    pub error_max_m: f64,
    /// Height below which the airframe has hit the ground [m].
    pub ground_z_m: f64,
}

/// What the words, and the gates, follow from.
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
    /// What the host took of the loops' processor.
    pub steal: &'a Steal,
    /// Messages that were lost before they were seen.
    pub lost: u64,
}

impl Verdicts {
    pub fn of(evidence: &Evidence<'_>, limits: &TrackingLimits) -> Self {
        let Evidence {
            run,
            ending,
            ticks,
            deadlines,
            performance,
            theorem,
            steal,
            ..
        } = evidence;
        let mut verdicts = Self {
            flight: flight_verdict(performance, *ending, limits),
            timing: timing_verdict(
                ticks,
                &deadlines.not_fresh.unwrap_or_default(),
                run.speed(),
                steal,
            ),
            theorem: stability_verdict(theorem),
        };
        match ending {
            Some(EndReason::Interrupted) => verdicts.cut_short("interrupted", run, ticks),
            Some(EndReason::Failed) => verdicts.cut_short("aborted", run, ticks),
            _ => {}
        }
        verdicts
    }

    /// The flight was aborted or interrupted: it is judged on what it flew, and nothing good is said of the rest.
    pub fn cut_short(&mut self, how: &str, run: &RunSection, ticks: &Ticks) {
        let all = ticks.run.saturating_add(ticks.skipped);
        let flown = format!(
            "{how} after {} ({:.3} s)",
            count(all, "tick"),
            all as f64 * run.period_us / 1e6
        );
        if self.flight.word == FlightVerdict::Tracked {
            self.flight.word = FlightVerdict::CutShort;
        }
        if self.timing.word == TimingVerdict::InTime {
            self.timing.word = TimingVerdict::CutShort;
        }
        for why in [
            &mut self.flight.why,
            &mut self.timing.why,
            &mut self.theorem.why,
        ] {
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
    let (word, why) = if performance.states == 0 {
        (FlightVerdict::NotSeen, "no state was seen".into())
    } else if let Some(ending) = ending.filter(|ending| ending.left_envelope()) {
        (
            FlightVerdict::Lost,
            format!(
                "{}; position error up to {:.2} m",
                ending.words(),
                performance.position_error_max_m
            ),
        )
    } else if performance.lowest_z_m < limits.ground_z_m {
        let (lowest, ground) = (performance.lowest_z_m, limits.ground_z_m);
        (
            FlightVerdict::Lost,
            format!("below ground: down to z = {lowest:.2} m, the ground is at {ground} m"),
        )
    } else {
        let (error, limit) = (performance.recent_error_max_m, limits.error_max_m);
        let word = if error <= limit {
            FlightVerdict::Tracked
        } else {
            FlightVerdict::OffTrack
        };
        let recent_s = performance.recent_s;
        (
            word,
            format!(
                "position error up to {error:.4} m in the last {recent_s:.1} s, limit {limit} m"
            ),
        )
    };
    Explained { word, why }
}

/// Whether a flight was in time.
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
        let stolen = format!(
            "the host stole {:.1} % of {}",
            steal.percent,
            steal.processors()
        );
        (TimingVerdict::NotMeasured, format!("{stolen}; {counts}"))
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
    let (word, why) = if let Some(why) = theorem.inapplicable() {
        (StabilityVerdict::NotApplicable, why)
    } else if theorem.ticks_checked == 0 {
        (
            StabilityVerdict::NotApplicable,
            "no step of the estimates was checked".into(),
        )
    } else if theorem.holds && theorem.steps_adapted == 0 {
        (
            StabilityVerdict::NotApplicable,
            "no estimate moved: adaptation is off, or its bounds pin it".into(),
        )
    } else if theorem.holds && theorem.ticks_unwatched > 0 {
        (
            StabilityVerdict::PartlyWatched,
            format!(
                "{counts}, {} not watched",
                count(theorem.ticks_unwatched, "tick")
            ),
        )
    } else if theorem.holds {
        (StabilityVerdict::Holds, counts)
    } else if unexplained == 0 {
        (
            StabilityVerdict::Broken,
            "the estimates did not move as predicted".into(),
        )
    } else {
        (StabilityVerdict::Broken, counts)
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

impl Verdicts {
    /// Subject, word and reason of each, in order.
    pub fn each(&self) -> [(&'static str, &'static str, &str); 3] {
        [
            ("Flight", self.flight.word.words(), &self.flight.why),
            ("Timing", self.timing.word.words(), &self.timing.why),
            ("Theorem", self.theorem.word.words(), &self.theorem.why),
        ]
    }

    /// As `key=value` pairs of a line for programs.
    pub fn pairs(&self) -> String {
        let pair = |(subject, word, _): (&str, &str, &str)| {
            format!("{}={}", subject.to_lowercase(), word.replace(' ', "-"))
        };
        self.each().map(pair).join(" ")
    }
}

impl fmt::Display for Verdicts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (subject, word, why) in self.each() {
            writeln!(f, "{subject:<9} {word:<14} {why}")?;
        }
        Ok(())
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

    /// The words of a good flight that was changed.
    fn words(change: impl FnOnce(&mut Sample)) -> [&'static str; 3] {
        let mut sample = Sample::good();
        change(&mut sample);
        Verdicts::of(&sample.evidence(), &LIMITS)
            .each()
            .map(|(_, word, _)| word)
    }

    #[test]
    fn a_good_flight_tracks_in_time_and_the_theorem_holds() {
        assert_eq!(words(|_| ()), ["tracked", "in time", "holds"]);
    }

    #[test]
    fn a_flight_is_tracked_by_its_end_and_lost_by_the_ground_or_its_envelope() {
        let flight = |change: fn(&mut Sample)| words(change)[0];
        assert_eq!(
            flight(|it| it.performance.recent_error_max_m = 0.1),
            "tracked"
        );
        assert_eq!(
            flight(|it| it.performance.recent_error_max_m = 0.1001),
            "off track"
        );
        assert_eq!(
            flight(|it| it.performance.position_error_max_m = 3.0),
            "tracked"
        );
        assert_eq!(flight(|it| it.performance.lowest_z_m = -0.25), "tracked");
        assert_eq!(flight(|it| it.performance.lowest_z_m = -0.26), "lost");
        assert_eq!(flight(|it| it.ending = Some(EndReason::Position)), "lost");
        assert_eq!(flight(|it| it.performance.states = 0), "not seen");
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
            assert_eq!(
                short.each().map(|(_, word, _)| word),
                ["cut short", "cut short", "holds"]
            );
            for (_, _, why) in short.each() {
                let begin = format!("{how} after 1 tick (0.001 s); until then ");
                assert!(why.starts_with(&begin), "{why}");
            }
            sample.performance.recent_error_max_m = 1.0;
            sample.not_fresh(0, 1, 0);
            let bad = Verdicts::of(&sample.evidence(), &LIMITS);
            assert_eq!(
                bad.each().map(|(_, word, _)| word),
                ["off track", "late", "holds"]
            );
        }
    }

    #[test]
    fn the_timing_begins_with_one_number_and_its_parts() {
        let mut sample = Sample::good();
        sample.not_fresh(24, 6, 94);
        let words = Verdicts::of(&sample.evidence(), &LIMITS);
        assert_eq!(
            words.timing.why,
            "124 of 20094 ticks without a fresh command on time (6171.0 per million): \
             24 missed + 6 stale + 94 skipped"
        );
    }

    #[test]
    fn one_miss_or_skip_is_late_and_what_measures_nothing_is_not_in_time() {
        let timing = |change: fn(&mut Sample)| words(change)[1];
        assert_eq!(timing(|it| it.not_fresh(1, 0, 0)), "late");
        assert_eq!(timing(|it| it.not_fresh(0, 1, 0)), "late");
        assert_eq!(timing(|it| it.not_fresh(0, 0, 1)), "late");
        assert_eq!(timing(|it| it.run.wall_period_us = 0.0), "not measured");
        assert_eq!(timing(|it| it.run.wall_period_us = 5000.0), "not measured");
        // A sample time need not be a whole number of nanoseconds.
        assert_eq!(
            timing(|it| (it.run.period_us, it.run.wall_period_us) = (1666.6667, 1666.667)),
            "in time"
        );
        assert_eq!(
            timing(|it| (it.run.period_us, it.run.wall_period_us) = (333.3333, 333.333)),
            "in time"
        );
        assert_eq!(timing(|it| it.steal.percent = 1.0), "in time");
        assert_eq!(timing(|it| it.steal.percent = 1.01), "not measured");
        assert_eq!(timing(|it| it.ticks.run = 0), "not measured");
    }

    #[test]
    fn estimates_that_should_move_and_do_not_break_the_theorem_and_pinned_ones_have_none() {
        let theorem = |change: fn(&mut Sample)| words(change)[2];
        assert_eq!(theorem(|it| it.theorem.ticks_checked = 0), "not applicable");
        assert_eq!(theorem(|it| it.theorem.steps_adapted = 0), "not applicable");
        assert_eq!(
            theorem(|it| it.theorem.law_without = Some("pid".into())),
            "not applicable"
        );
        assert_eq!(theorem(|it| it.theorem.holds = false), "broken");
        assert_eq!(
            theorem(|it| it.theorem.ticks_unwatched = 1),
            "partly watched"
        );
        assert_eq!(
            theorem(|it| (it.theorem.ticks_unwatched, it.theorem.holds) = (1, false)),
            "broken"
        );
        let lifeless = |it: &mut Sample| (it.theorem.steps_adapted, it.theorem.holds) = (0, false);
        assert_eq!(theorem(lifeless), "broken");
    }
}
