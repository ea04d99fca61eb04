//! The pace of a flight: real time, slow motion or lockstep.

use crate::schema::RunSection;
use messages::blackboards::LOCKSTEP;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Speed {
    Lockstep,
    Clock,
    Slowed(u64),
}

impl Speed {
    /// Of ticks that are so long on the clock, or [`LOCKSTEP`], of laws with this sample time [ns].
    pub const fn of(period_ns: u64, sample_time_ns: u64) -> Self {
        match period_ns
            .saturating_add(sample_time_ns / 2)
            .checked_div(sample_time_ns)
        {
            _ if period_ns == LOCKSTEP => Self::Lockstep,
            None | Some(0 | 1) => Self::Clock,
            Some(times) => Self::Slowed(times),
        }
    }

    /// Why latencies tell nothing of real time, where they do not.
    pub fn why_not_real_time(self) -> Option<String> {
        match self {
            Self::Lockstep => Some("in lockstep there are no deadlines".into()),
            Self::Clock => None,
            Self::Slowed(times) => Some(format!("slowed {times} times: latencies of a slow clock")),
        }
    }
}

impl RunSection {
    pub fn speed(&self) -> Speed {
        let [period_ns, sample_time_ns] =
            [self.wall_period_us, self.period_us].map(|us| (us * 1e3).round() as u64);
        Speed::of(period_ns, sample_time_ns)
    }
}
