//! Latency series: HdrHistograms with fixed bounds, per flight and per interval of the log.

use crate::distribution::{Distribution, P999_COUNT, P9999_COUNT};
use errors::Failure;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriter, Tag};
use messages::role::{Role, STAGES};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::time::Duration;

/// Resolution [ns].
const LOWEST_NS: u64 = 1;
/// Largest value; longer ones count as this [ns].
pub const HIGHEST_NS: u64 = 10_000_000_000;
const DIGITS: u8 = 3;

/// An empty histogram of nanoseconds, with the bounds of every latency of the rig and its floors.
pub fn histogram() -> Result<Histogram<u64>, Failure> {
    Histogram::new_with_bounds(LOWEST_NS, HIGHEST_NS, DIGITS)
        .map_err(|e| Failure::failed(format!("cannot make a histogram: {e}")))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// From the instant that the plant's timer was set to, to its waking.
    Timer,
    /// From the beginning of the tick on the grid to the stage's waking, skipped ticks included.
    Wake(Role),
    Period(Role),
    /// From one stage's publishing to the next one's having the message in hand.
    Hop(Role, Role),
    /// From having the input in hand to publishing.
    Compute(Role),
    /// From waking to being done with the tick: for the plant with the integration, for the others with the bell.
    Busy(Role),
    /// From the sampling of the state to the publishing of the rotor command made from it.
    Loop,
    /// From the publishing of a rotor command to its deadline, for those in time.
    Slack,
    /// From a missed deadline to the publishing of the command that ended the miss.
    Late,
}

impl Series {
    pub fn all() -> Vec<Self> {
        let mut all = vec![Self::Loop, Self::Slack, Self::Late, Self::Timer];
        all.extend(STAGES.map(Self::Wake));
        all.extend(STAGES.windows(2).map(|pair| Self::Hop(pair[0], pair[1])));
        all.extend(STAGES.map(Self::Compute));
        all.extend(STAGES.map(Self::Busy));
        all.extend(STAGES.map(Self::Period));
        all
    }

    pub fn name(self) -> String {
        match self {
            Self::Timer => "timer".into(),
            Self::Wake(role) => format!("wake.{role}"),
            Self::Period(role) => format!("period.{role}"),
            Self::Hop(from, to) => format!("hop.{from}_{to}"),
            Self::Compute(role) => format!("compute.{role}"),
            Self::Busy(role) => format!("busy.{role}"),
            Self::Loop => "loop".into(),
            Self::Slack => "slack".into(),
            Self::Late => "late".into(),
        }
    }
}

#[derive(Debug)]
pub struct SeriesSet {
    entries: Vec<Entry>,
}

#[derive(Debug)]
struct Entry {
    series: Series,
    flight: Histogram<u64>,
    interval: Histogram<u64>,
}

impl SeriesSet {
    pub fn new() -> Result<Self, Failure> {
        let entry = |series| {
            let (flight, interval) = (histogram()?, histogram()?);
            Ok(Entry {
                series,
                flight,
                interval,
            })
        };
        let entries = Series::all()
            .into_iter()
            .map(entry)
            .collect::<Result<_, Failure>>()?;
        Ok(Self { entries })
    }

    pub fn record(&mut self, series: Series, value_ns: u64) {
        if let Some(entry) = self.entries.iter_mut().find(|entry| entry.series == series) {
            entry.flight.saturating_record(value_ns);
            entry.interval.saturating_record(value_ns);
        }
    }

    pub fn flight(&self, series: Series) -> Option<&Histogram<u64>> {
        let mut entries = self.entries.iter();
        entries
            .find(|entry| entry.series == series)
            .map(|entry| &entry.flight)
    }

    /// Writes the present interval to an interval log and begins the next one.
    ///
    /// `start` counts from the log's base time.
    pub fn close_interval<W: Write>(
        &mut self,
        log: &mut IntervalLogWriter<'_, '_, W, V2DeflateSerializer>,
        start: Duration,
        length: Duration,
    ) -> Result<(), Failure> {
        let entries = self.entries.iter_mut();
        for entry in entries.filter(|entry| !entry.interval.is_empty()) {
            let name = entry.series.name();
            log.write_histogram(&entry.interval, start, length, Tag::new(&name))
                .map_err(|e| Failure::failed(format!("cannot write latency.hlog: {e:?}")))?;
            entry.interval.reset();
        }
        Ok(())
    }

    /// Distributions of every series that has values; a tick is `tick_ns` long, 0 where it has no length.
    pub fn distributions(&self, tick_ns: u64) -> Vec<Distribution> {
        let distribution = |entry: &Entry| {
            let is_period = matches!(entry.series, Series::Period(_));
            let about_ns = if is_period { tick_ns } else { 0 };
            Distribution::of(&entry.series.name(), &entry.flight, about_ns)
        };
        self.with_values().map(distribution).collect()
    }

    pub fn statistics(&self) -> Vec<Statistics> {
        let of = |entry: &Entry| Statistics::of(&entry.series.name(), &entry.flight);
        self.with_values().map(of).collect()
    }

    fn with_values(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|entry| !entry.flight.is_empty())
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    pub name: String,
    pub count: u64,
    pub min_us: f64,
    pub p50_us: f64,
    pub p90_us: f64,
    pub p99_us: f64,
    pub p999_us: Option<f64>,
    pub p9999_us: Option<f64>,
    /// Largest: on a shared machine usually the host's doing.
    pub max_us: f64,
}

impl Statistics {
    pub fn of(name: &str, histogram: &Histogram<u64>) -> Self {
        let us = |ns: u64| ns as f64 / 1e3;
        let quantile = |q: f64| us(histogram.value_at_quantile(q));
        let count = histogram.len();
        Self {
            name: name.to_owned(),
            count,
            min_us: us(histogram.min()),
            p50_us: quantile(0.5),
            p90_us: quantile(0.9),
            p99_us: quantile(0.99),
            p999_us: (count >= P999_COUNT).then(|| quantile(0.999)),
            p9999_us: (count >= P9999_COUNT).then(|| quantile(0.9999)),
            max_us: us(histogram.max()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rare_percentiles_need_enough_values() {
        let mut set = SeriesSet::new().unwrap();
        for value in 1..P999_COUNT {
            set.record(Series::Loop, value * 100);
        }
        assert_eq!(set.statistics()[0].p999_us, None);
        set.record(Series::Loop, P999_COUNT * 100);
        let statistics = &set.statistics()[0];
        assert_eq!((statistics.count, statistics.p9999_us), (P999_COUNT, None));
        assert!((statistics.p50_us - 500.0).abs() < 1.0, "{statistics:?}");
        assert!((statistics.p999_us.unwrap() - 999.0).abs() < 1.0);
    }

    #[test]
    fn values_beyond_the_bounds_are_kept_at_the_bound() {
        let mut set = SeriesSet::new().unwrap();
        set.record(Series::Late, u64::MAX);
        assert!(set.flight(Series::Late).unwrap().max() >= HIGHEST_NS);
    }
}
