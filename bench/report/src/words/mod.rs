//! The three words of a flight: did it follow its reference, was it in time, does the theorem hold.
//!
//! They are judged apart from each other and from the gates: a flight in lockstep can track and has no timing, one
//! that is late can still track. Each comes with the numbers that it follows from.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::host::{STEAL_LIMIT_PERCENT, Steal};
use crate::schema::{ControlPerformance, DeadlineSection, RoleSection, RunSection, Ticks};
use crate::speed::Speed;
use crate::tally::series::Statistics;
use crate::tally::theorem::Theorem;
use crate::text::count;
use model::boards::Ending;

/// When a flight counts as tracked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackingLimits {
    /// Largest position error that is allowed in the last [`crate::tracking::RECENT_S`] [m].
    pub error_max_m: f64,
    /// Height below which the airframe has hit the ground [m].
    pub ground_z_m: f64,
}

/// Whether a flight followed its reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightWord {
    /// No state was seen.
    #[default]
    NotSeen,
    /// It did, at its end.
    Tracked,
    /// It did not, at its end.
    OffTrack,
    /// It left its envelope, or was below ground.
    Lost,
}

/// Whether a flight was in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimingWord {
    /// Its latencies tell nothing of the loops.
    #[default]
    NotMeasured,
    /// No deadline was missed, no tick skipped.
    InTime,
    /// Some were.
    Late,
}

/// Whether the theorem holds on a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TheoremWord {
    /// Nothing adapted that it speaks of.
    #[default]
    NotApplicable,
    /// It does, at every tick.
    Holds,
    /// It does where it was watched; it was not at every tick.
    PartlyWatched,
    /// It does not, and no cause is known.
    Broken,
}

/// A word with the numbers that it follows from, as a sentence without its full stop.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reasoned<W> {
    /// The word.
    pub word: W,
    /// Why.
    pub why: String,
}

/// All three.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Words {
    /// Of the control performance.
    pub flight: Reasoned<FlightWord>,
    /// Of the deadlines.
    pub timing: Reasoned<TimingWord>,
    /// Of the estimates.
    pub theorem: Reasoned<TheoremWord>,
}

/// What the words, and the gates, follow from.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// What was flown.
    pub run: &'a RunSection,
    /// How it ended; nothing while it flies.
    pub ending: Option<Ending>,
    /// Its ticks.
    pub ticks: &'a Ticks,
    /// Its deadlines.
    pub deadlines: &'a DeadlineSection,
    /// Its control performance.
    pub performance: &'a ControlPerformance,
    /// The theorem, watched.
    pub theorem: &'a Theorem,
    /// Its latencies.
    pub series: &'a [Statistics],
    /// The processes.
    pub roles: &'a BTreeMap<String, RoleSection>,
    /// What the host took of the loops' processor.
    pub steal: &'a Steal,
    /// Messages that were lost before they were seen.
    pub lost: u64,
}

impl Words {
    /// The words of a flight.
    #[must_use]
    pub fn of(evidence: &Evidence<'_>, limits: &TrackingLimits) -> Self {
        let Evidence { run, ending, ticks, deadlines, performance, theorem, steal, .. } = evidence;
        Self {
            flight: flight_word(performance, *ending, limits),
            timing: timing_word(ticks, deadlines.missed, run.speed(), steal),
            theorem: theorem_word(theorem),
        }
    }
}

/// Whether a flight follows its reference; it still flies without an ending.
#[must_use]
pub fn flight_word(
    performance: &ControlPerformance,
    ending: Option<Ending>,
    limits: &TrackingLimits,
) -> Reasoned<FlightWord> {
    let (word, why) = if performance.states == 0 {
        (FlightWord::NotSeen, "no state was seen".into())
    } else if let Some(ending) = ending.filter(|ending| ending.left_envelope()) {
        (
            FlightWord::Lost,
            format!("{}; position error up to {:.2} m", ending.words(), performance.position_error_max_m),
        )
    } else if performance.lowest_z_m < limits.ground_z_m {
        let (lowest, ground) = (performance.lowest_z_m, limits.ground_z_m);
        (FlightWord::Lost, format!("below ground: down to z = {lowest:.2} m, the ground is at {ground} m"))
    } else {
        let (error, limit) = (performance.recent_error_max_m, limits.error_max_m);
        let word = if error <= limit { FlightWord::Tracked } else { FlightWord::OffTrack };
        let recent_s = performance.recent_s;
        (word, format!("position error up to {error:.4} m in the last {recent_s:.1} s, limit {limit} m"))
    };
    Reasoned { word, why }
}

/// Whether a flight was in time.
#[must_use]
pub fn timing_word(ticks: &Ticks, missed: u64, speed: Speed, steal: &Steal) -> Reasoned<TimingWord> {
    let all = ticks.run + ticks.skipped;
    let missed_ppm = missed as f64 * 1e6 / all.max(1) as f64;
    let skipped = count(ticks.skipped, "tick");
    let counts = format!("{missed} of {all} deadlines missed ({missed_ppm:.1} per million), {skipped} skipped");
    let (word, why) = if let Some(why) = speed.why_not_real_time() {
        (TimingWord::NotMeasured, why)
    } else if steal.percent > STEAL_LIMIT_PERCENT {
        let stolen = format!("the host stole {:.1} % of {}", steal.percent, steal.processors());
        (TimingWord::NotMeasured, format!("{stolen}; {counts}"))
    } else if all == 0 {
        (TimingWord::NotMeasured, "no tick was flown".into())
    } else if missed > 0 || ticks.skipped > 0 {
        (TimingWord::Late, counts)
    } else {
        (TimingWord::InTime, counts)
    };
    Reasoned { word, why }
}

/// Whether the theorem holds.
#[must_use]
pub fn theorem_word(theorem: &Theorem) -> Reasoned<TheoremWord> {
    let unexplained = theorem.unexplained();
    let counts = theorem.counts();
    let (word, why) = if let Some(why) = theorem.inapplicable() {
        (TheoremWord::NotApplicable, why)
    } else if theorem.ticks_checked == 0 {
        (TheoremWord::NotApplicable, "no step of the estimates was checked".into())
    } else if theorem.holds && theorem.steps_adapted == 0 {
        (TheoremWord::NotApplicable, "no estimate moved: adaptation is off, or its bounds pin it".into())
    } else if theorem.holds && theorem.ticks_unwatched > 0 {
        (TheoremWord::PartlyWatched, format!("{counts}, {} not watched", count(theorem.ticks_unwatched, "tick")))
    } else if theorem.holds {
        (TheoremWord::Holds, counts)
    } else if unexplained == 0 {
        (TheoremWord::Broken, "the estimates did not move as predicted".into())
    } else {
        (TheoremWord::Broken, counts)
    };
    Reasoned { word, why }
}

impl FlightWord {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotSeen => "not seen",
            Self::Tracked => "tracked",
            Self::OffTrack => "off track",
            Self::Lost => "lost",
        }
    }
}

impl TimingWord {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotMeasured => "not measured",
            Self::InTime => "in time",
            Self::Late => "late",
        }
    }
}

impl TheoremWord {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::NotApplicable => "not applicable",
            Self::Holds => "holds",
            Self::PartlyWatched => "partly watched",
            Self::Broken => "broken",
        }
    }
}

impl Words {
    /// Subject, word and reason of each, in order.
    #[must_use]
    pub fn each(&self) -> [(&'static str, &'static str, &str); 3] {
        [
            ("Flight", self.flight.word.words(), &self.flight.why),
            ("Timing", self.timing.word.words(), &self.timing.why),
            ("Theorem", self.theorem.word.words(), &self.theorem.why),
        ]
    }

    /// As `key=value` pairs of a line for programs.
    #[must_use]
    pub fn pairs(&self) -> String {
        let pair =
            |(subject, word, _): (&str, &str, &str)| format!("{}={}", subject.to_lowercase(), word.replace(' ', "-"));
        self.each().map(pair).join(" ")
    }
}

impl fmt::Display for Words {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (subject, word, why) in self.each() {
            writeln!(f, "{subject:<9} {word:<14} {why}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod sample;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::words::sample::Sample;

    const LIMITS: TrackingLimits = TrackingLimits { error_max_m: 0.1, ground_z_m: -0.25 };

    /// The words of a good flight that was changed.
    fn words(change: impl FnOnce(&mut Sample)) -> [&'static str; 3] {
        let mut sample = Sample::good();
        change(&mut sample);
        Words::of(&sample.evidence(), &LIMITS).each().map(|(_, word, _)| word)
    }

    #[test]
    fn a_good_flight_tracks_in_time_and_the_theorem_holds() {
        assert_eq!(words(|_| ()), ["tracked", "in time", "holds"]);
    }

    #[test]
    fn a_flight_is_tracked_by_its_end_and_lost_by_the_ground_or_its_envelope() {
        let flight = |change: fn(&mut Sample)| words(change)[0];
        assert_eq!(flight(|it| it.performance.recent_error_max_m = 0.1), "tracked");
        assert_eq!(flight(|it| it.performance.recent_error_max_m = 0.1001), "off track");
        assert_eq!(flight(|it| it.performance.position_error_max_m = 3.0), "tracked");
        assert_eq!(flight(|it| it.performance.lowest_z_m = -0.25), "tracked");
        assert_eq!(flight(|it| it.performance.lowest_z_m = -0.26), "lost");
        assert_eq!(flight(|it| it.ending = Some(Ending::Position)), "lost");
        assert_eq!(flight(|it| it.performance.states = 0), "not seen");
    }

    #[test]
    fn one_miss_or_skip_is_late_and_what_measures_nothing_is_not_in_time() {
        let timing = |change: fn(&mut Sample)| words(change)[1];
        assert_eq!(timing(|it| it.deadlines.missed = 1), "late");
        assert_eq!(timing(|it| it.ticks.skipped = 1), "late");
        assert_eq!(timing(|it| it.run.wall_period_us = 0.0), "not measured");
        assert_eq!(timing(|it| it.run.wall_period_us = 5000.0), "not measured");
        // A sample time need not be a whole number of nanoseconds.
        assert_eq!(timing(|it| (it.run.period_us, it.run.wall_period_us) = (1666.6667, 1666.667)), "in time");
        assert_eq!(timing(|it| (it.run.period_us, it.run.wall_period_us) = (333.3333, 333.333)), "in time");
        assert_eq!(timing(|it| it.steal.percent = 1.0), "in time");
        assert_eq!(timing(|it| it.steal.percent = 1.01), "not measured");
        assert_eq!(timing(|it| it.ticks.run = 0), "not measured");
    }

    #[test]
    fn estimates_that_should_move_and_do_not_break_the_theorem_and_pinned_ones_have_none() {
        let theorem = |change: fn(&mut Sample)| words(change)[2];
        assert_eq!(theorem(|it| it.theorem.ticks_checked = 0), "not applicable");
        assert_eq!(theorem(|it| it.theorem.steps_adapted = 0), "not applicable");
        assert_eq!(theorem(|it| it.theorem.law_without = Some("pid".into())), "not applicable");
        assert_eq!(theorem(|it| it.theorem.holds = false), "broken");
        assert_eq!(theorem(|it| it.theorem.ticks_unwatched = 1), "partly watched");
        assert_eq!(theorem(|it| (it.theorem.ticks_unwatched, it.theorem.holds) = (1, false)), "broken");
        let lifeless = |it: &mut Sample| (it.theorem.steps_adapted, it.theorem.holds) = (0, false);
        assert_eq!(theorem(lifeless), "broken");
    }
}
