//! The three words of a flight that is watched, as of now.

use machine::cpu_times::CpuTimes;
use machine::sampler::Watch;
use model::messages::NO_TICK;
use model::role::STAGES;
use report::host::Steal;
use report::speed::Speed;
use report::words::{Reasoned, TrackingLimits, Words, flight_word, theorem_word, timing_word};

use super::model::WatchedFlight;

/// What the host takes of the loops' processor, since the dashboard knows which one that is.
#[derive(Clone, Copy, Debug, Default)]
pub struct StealWatch {
    begin: Option<(Option<u64>, CpuTimes)>,
    /// So far.
    pub steal: Steal,
}

impl StealWatch {
    /// Looks at the processor of these loops.
    pub fn look(&mut self, flight: &WatchedFlight) {
        let loops = STAGES.map(|role| flight.crew.get(&role).copied().unwrap_or_default());
        let processor = Watch::new(&loops, true).processor;
        let now = CpuTimes::read(processor);
        match &self.begin {
            Some((of, begin)) if *of == processor => self.steal = begin.steal_until(&now),
            _ => self.begin = Some((processor, now)),
        }
    }
}

/// The words of a flight as the dashboard has seen it.
#[must_use]
pub fn words(flight: &WatchedFlight) -> Words {
    let (run, tally) = (&flight.run, &flight.tally);
    let speed = Speed::of(run.period_ns, run.sample_time_ns);
    // Counted by the plant, from the flight's begin on.
    let mut ticks = tally.ticks(run);
    ticks.skipped = run.ticks_skipped;
    let begun = if flight.tick() == NO_TICK { 0 } else { flight.tick() + 1 };
    ticks.run = begun.saturating_sub(run.ticks_skipped);
    let limit = |key: &str| flight.setting(key).parse::<f64>().ok();
    let limits = limit("flight.tracking_error_max_m").zip(limit("flight.ground_z_m"));
    let unknown = || Reasoned { why: "the limits of the flight are not known".into(), ..Reasoned::default() };
    let tracked = |(error_max_m, ground_z_m)| {
        flight_word(&tally.flight(), flight.ending, &TrackingLimits { error_max_m, ground_z_m })
    };
    Words {
        flight: limits.map_or_else(unknown, tracked),
        timing: timing_word(&ticks, run.deadlines_missed, speed, &flight.steal.steal),
        theorem: theorem_word(&tally.theorem.section()),
    }
}
