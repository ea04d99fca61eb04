//! Latency series: HdrHistograms, per flight and per interval of the log.

use crate::distribution::{Distribution, P999_COUNT, P9999_COUNT};
use errors::Failure;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriter, Tag};
use messages::role::{Role, STAGES};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::ops::Deref;
use std::time::Duration;

/// Resolution [ns].
const LOWEST_NS: u64 = 1;
/// Longest latency that a histogram has room for before it grows [ns].
const ROOM_NS: u64 = 10_000_000_000;
const DIGITS: u8 = 3;
/// Name of the series whose small values are the bad ones.
pub const SLACK: &str = "slack";

/// Latencies of the rig or of the machine [ns]: a histogram of three digits that grows with its values, so that none is
/// out of its range, and the exact smallest and largest value.
#[derive(Clone, Debug)]
pub struct Latencies {
    histogram: Histogram<u64>,
    min_ns: u64,
    max_ns: u64,
}

impl Latencies {
    pub fn new() -> Result<Self, Failure> {
        let mut histogram = Histogram::new_with_bounds(LOWEST_NS, ROOM_NS, DIGITS)
            .map_err(|e| Failure::failed(format!("cannot make a histogram: {e}")))?;
        histogram.auto(true);
        Ok(Self {
            histogram,
            min_ns: u64::MAX,
            max_ns: 0,
        })
    }

    pub fn record(&mut self, ns: u64) {
        let recorded = self.histogram.record(ns);
        debug_assert!(recorded.is_ok(), "room for 64 bits in 64 bits of memory");
        (self.min_ns, self.max_ns) = (self.min_ns.min(ns), self.max_ns.max(ns));
    }

    pub fn min_ns(&self) -> u64 {
        self.min_ns.min(self.max_ns)
    }

    pub const fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// The largest value of the share `q` of the smallest values, rounded up to three digits.
    pub fn quantile_ns(&self, q: f64) -> u64 {
        self.histogram.value_at_quantile(q).min(self.max_ns)
    }

    pub fn clear(&mut self) {
        self.histogram.reset();
        (self.min_ns, self.max_ns) = (u64::MAX, 0);
    }
}

impl Deref for Latencies {
    type Target = Histogram<u64>;

    fn deref(&self) -> &Histogram<u64> {
        &self.histogram
    }
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
    /// From waking to being done with the tick: for the plant with the integration, for the others with the notification.
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
            Self::Slack => SLACK.into(),
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
    flight: Latencies,
    interval: Latencies,
}

impl SeriesSet {
    pub fn new() -> Result<Self, Failure> {
        let entry = |series| {
            let (flight, interval) = (Latencies::new()?, Latencies::new()?);
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
            entry.flight.record(value_ns);
            entry.interval.record(value_ns);
        }
    }

    pub fn flight(&self, series: Series) -> Option<&Latencies> {
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
            entry.interval.clear();
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
    pub fn of(name: &str, latencies: &Latencies) -> Self {
        let us = |ns: u64| ns as f64 / 1e3;
        let quantile = |q: f64| us(latencies.quantile_ns(q));
        let count = latencies.len();
        Self {
            name: name.to_owned(),
            count,
            min_us: us(latencies.min_ns()),
            p50_us: quantile(0.5),
            p90_us: quantile(0.9),
            p99_us: quantile(0.99),
            p999_us: (count >= P999_COUNT).then(|| quantile(0.999)),
            p9999_us: (count >= P9999_COUNT).then(|| quantile(0.9999)),
            max_us: us(latencies.max_ns()),
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
    fn no_value_is_out_of_range_and_the_ends_are_exact() {
        let mut set = SeriesSet::new().unwrap();
        let late_ns = [9, 12, 25, 3600].map(|s| s * 1_000_000_000 + 1);
        let shares = [0.25, 0.5, 0.75, 1.0];
        late_ns.iter().for_each(|ns| set.record(Series::Late, *ns));
        let late = set.flight(Series::Late).unwrap();
        assert_eq!((late.min_ns(), late.max_ns()), (late_ns[0], late_ns[3]));
        for (share, ns) in shares.into_iter().zip(late_ns) {
            let (found, exact) = (late.quantile_ns(share) as f64, ns as f64);
            assert!((found / exact - 1.0).abs() < 1e-3, "{found} for {exact}");
        }
        let buckets = crate::distribution::buckets(late);
        assert_eq!(
            buckets.iter().map(|it| it.count).sum::<u64>(),
            4,
            "{buckets:?}"
        );
    }
}
