//! `ironbird report diff`: compares two flights, as far as their samples allow.
//!
//! Each percentile has an interval that holds it with 97.5 % confidence ([`crate::tally::distribution`]). The ratio of
//! two percentiles then lies, with at least 95 %, between the ratios of opposite ends of the intervals. If that range
//! contains 1, no difference between the flights is shown.

pub mod text;

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use crate::run_facts::RunFacts;
use crate::schema::Report;
use crate::tally::distribution::{Distribution, PERCENTS, Percentile};
use flight_log::build::Build;

/// Version of the schema.
const SCHEMA: &str = "ironbird-report-diff/1";
/// Steal above which latencies tell of the host [%].
const STEAL_PERCENT: f64 = 1.0;

/// Two flights compared; every ratio is B over A.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diff {
    /// Version of the schema.
    pub schema: &'static str,
    /// The first flight.
    pub a: Side,
    /// The second one.
    pub b: Side,
    /// Settings that differ.
    pub settings: Vec<Difference>,
    /// How the builds compare.
    pub builds: &'static str,
    /// What differs of machine and granted scheduling.
    pub machine: Vec<Difference>,
    /// Latencies.
    pub series: Vec<SeriesDiff>,
    /// Ratios with an interval.
    pub ratios: usize,
    /// Those whose interval does not hold 1.
    pub ratios_apart: usize,
    /// What to keep in mind.
    pub notes: Vec<String>,
}

/// A flight, in a few numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Side {
    /// Its directory.
    pub run: String,
    /// The executable that flew.
    pub build: Build,
    /// Its start.
    pub started: String,
    /// Whether it passed.
    pub status: String,
    /// Ticks run.
    pub ticks: u64,
    /// Ticks skipped.
    pub skipped: u64,
    /// Deadlines missed.
    pub missed: u64,
    /// The same per million ticks.
    pub missed_ppm: f64,
    /// Stolen by the host [%].
    pub steal_percent: f64,
    /// Root mean square of the position error [m].
    pub position_error_rms_m: f64,
    /// The theorem's verdict.
    pub theorem: &'static str,
}

/// Something that is not the same.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// What.
    pub key: String,
    /// In the first flight; nothing where it has none.
    pub a: Value,
    /// In the second one.
    pub b: Value,
}

/// A series of both flights.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeriesDiff {
    /// Its name.
    pub name: String,
    /// Values in the first flight.
    pub count_a: u64,
    /// Values in the second one.
    pub count_b: u64,
    /// Its percentiles.
    pub percentiles: Vec<PercentileDiff>,
}

/// A percentile of both flights.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PercentileDiff {
    /// 99.9 for the 99.9th.
    pub percent: f64,
    /// In the first flight; none with too few values.
    pub a: Option<Percentile>,
    /// In the second one.
    pub b: Option<Percentile>,
    /// B over A; none where one is missing, or A is 0.
    pub ratio: Option<f64>,
    /// Between these it lies with 95 % at the least; no upper end where A may be 0.
    pub ratio_low: Option<f64>,
    /// The other end.
    pub ratio_high: Option<f64>,
    /// What can be said.
    pub says: Says,
}

/// What two percentiles say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Says {
    /// One of the flights has too few values for this percentile.
    TooFewValues,
    /// The difference is within what chance does.
    WithinTheSpread,
    /// B is above A.
    More,
    /// B is below A.
    Less,
}

/// What is compared of a flight.
#[derive(Clone, Debug)]
pub struct Flown {
    /// Its directory.
    pub run: String,
    /// Its final report.
    pub report: Report,
    /// What its run.json says.
    pub facts: RunFacts,
}

impl Flown {
    fn side(&self) -> Side {
        let report = &self.report;
        Side {
            run: self.run.clone(),
            build: self.facts.build.of_version(&self.facts.version),
            started: report.run.started.clone(),
            status: report.verdict.status.clone(),
            ticks: report.ticks.run,
            skipped: report.ticks.skipped,
            missed: report.deadlines.missed,
            missed_ppm: report.deadlines.missed_ppm,
            steal_percent: report.steal.percent,
            position_error_rms_m: report.flight.position_error_rms_m,
            theorem: report.theorem.verdict(),
        }
    }

    fn settings(&self) -> BTreeMap<String, Value> {
        let mut flat = BTreeMap::new();
        flatten("", &self.facts.settings, &mut flat);
        flat
    }

    fn machine(&self) -> BTreeMap<String, Value> {
        let mut flat = BTreeMap::new();
        flatten("", &serde_json::to_value(&self.facts.host).unwrap_or_default(), &mut flat);
        for (name, role) in &self.report.roles {
            flat.insert(format!("scheduling of {name}"), role.scheduling.clone().into());
        }
        flat
    }

    fn distribution(&self, name: &str) -> Option<&Distribution> {
        self.report.distributions.iter().find(|distribution| distribution.name == name)
    }

    fn count(&self, name: &str) -> u64 {
        self.report.series(name).map_or(0, |series| series.count)
    }
}

fn flatten(prefix: &str, value: &Value, into: &mut BTreeMap<String, Value>) {
    let Value::Object(map) = value else {
        into.insert(prefix.to_owned(), value.clone());
        return;
    };
    for (key, value) in map {
        let key = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        flatten(&key, value, into);
    }
}

fn differences(a: &BTreeMap<String, Value>, b: &BTreeMap<String, Value>) -> Vec<Difference> {
    let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    let of = |map: &BTreeMap<String, Value>, key: &String| map.get(key).cloned().unwrap_or_default();
    keys.into_iter()
        .map(|key| Difference { key: key.clone(), a: of(a, key), b: of(b, key) })
        .filter(|difference| difference.a != difference.b)
        .collect()
}

/// Compares two flights.
#[must_use]
pub fn compare(a: &Flown, b: &Flown) -> Diff {
    let of_both = a.report.distributions.iter().filter(|distribution| b.distribution(&distribution.name).is_some());
    let series: Vec<SeriesDiff> = of_both
        .map(|distribution| {
            let name = &distribution.name;
            let pair = |percent: f64| {
                let percentile = |side: &Flown| side.distribution(name).and_then(|d| d.percentile(percent)).copied();
                PercentileDiff::new(percent, percentile(a), percentile(b))
            };
            SeriesDiff {
                name: name.clone(),
                count_a: a.count(name),
                count_b: b.count(name),
                percentiles: PERCENTS.into_iter().map(|(percent, _)| pair(percent)).collect(),
            }
        })
        .collect();
    let said = |wanted: &[Says]| {
        let all = series.iter().flat_map(|series| &series.percentiles);
        all.filter(|percentile| wanted.contains(&percentile.says)).count()
    };
    let apart = said(&[Says::More, Says::Less]);
    let ratios = apart + said(&[Says::WithinTheSpread]);
    let mut diff = Diff {
        schema: SCHEMA,
        a: a.side(),
        b: b.side(),
        builds: a.facts.build.compared_with(&b.facts.build),
        settings: differences(&a.settings(), &b.settings()),
        machine: differences(&a.machine(), &b.machine()),
        series,
        ratios,
        ratios_apart: apart,
        notes: Vec::new(),
    };
    diff.notes = notes(&diff, [a, b]);
    diff
}

fn notes(diff: &Diff, both: [&Flown; 2]) -> Vec<String> {
    let mut notes = Vec::new();
    if !diff.settings.is_empty() {
        notes.push("The flights had different settings.".to_owned());
    }
    if !diff.machine.is_empty() {
        notes.push("Machine or granted scheduling differ.".to_owned());
    }
    if diff.builds != "the same" {
        notes.push(format!("The builds are {}: what differs may be the program's.", diff.builds));
    }
    for (name, flown) in ["A", "B"].into_iter().zip(both) {
        let run = &flown.report.run;
        if run.wall_period_us != run.period_us {
            notes.push(format!(
                "{name} did not fly at the speed of the clock: its latencies are not real-time latencies."
            ));
        }
        if flown.report.steal.percent > STEAL_PERCENT {
            notes.push(format!(
                "The host stole {:.2} % of the time during {name}: more than {STEAL_PERCENT} % is too much for a verdict.",
                flown.report.steal.percent
            ));
        }
    }
    notes.push(format!(
        "If the flights were alike and all values independent, chance alone would set up to {:.0} of {} ratios apart.",
        0.05 * diff.ratios as f64,
        diff.ratios
    ));
    notes.push(
        "They are not quite independent: one stall of the machine delays several ticks in a row, which widens the true \
         spread, of rare percentiles most. Believe a difference that repeated flights, in turns, show again."
            .to_owned(),
    );
    notes
}

impl PercentileDiff {
    fn new(percent: f64, a: Option<Percentile>, b: Option<Percentile>) -> Self {
        let (Some(from), Some(to)) = (a, b) else {
            let (ratio, says) = (None, Says::TooFewValues);
            return Self { percent, a, b, ratio, ratio_low: ratio, ratio_high: ratio, says };
        };
        let over = |value: f64, by: f64| (by > 0.0).then(|| value / by);
        let says = if to.low_us > from.high_us {
            Says::More
        } else if to.high_us < from.low_us {
            Says::Less
        } else {
            Says::WithinTheSpread
        };
        Self {
            percent,
            a,
            b,
            ratio: over(to.value_us, from.value_us),
            ratio_low: over(to.low_us, from.high_us),
            ratio_high: over(to.high_us, from.low_us),
            says,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn percentile(value_us: f64, low_us: f64, high_us: f64) -> Option<Percentile> {
        Some(Percentile { percent: 99.0, value_us, low_us, high_us })
    }

    #[test]
    fn only_intervals_that_do_not_meet_show_a_difference() {
        let a = percentile(20.0, 18.0, 25.0);
        for (b, says) in [
            (percentile(30.0, 26.0, 40.0), Says::More),
            (percentile(30.0, 25.0, 40.0), Says::WithinTheSpread),
            (percentile(15.0, 14.0, 17.9), Says::Less),
            (None, Says::TooFewValues),
        ] {
            assert_eq!(PercentileDiff::new(99.0, a, b).says, says, "{b:?}");
        }
        let diff = PercentileDiff::new(99.0, a, percentile(30.0, 26.0, 40.0));
        assert_eq!((diff.ratio, diff.ratio_low, diff.ratio_high), (Some(1.5), Some(26.0 / 25.0), Some(40.0 / 18.0)));
    }

    #[test]
    fn a_percentile_of_0_has_no_ratio() {
        let diff = PercentileDiff::new(50.0, percentile(0.0, 0.0, 0.1), percentile(3.0, 2.0, 4.0));
        assert_eq!((diff.ratio, diff.ratio_low, diff.ratio_high, diff.says), (None, Some(20.0), None, Says::More));
    }

    #[test]
    fn differences_name_keys_of_either_side() {
        let flat = |text: &str| {
            let mut flat = BTreeMap::new();
            flatten("", &serde_json::from_str(text).unwrap(), &mut flat);
            flat
        };
        let found = differences(&flat(r#"{"a": {"b": 1, "c": [1]}}"#), &flat(r#"{"a": {"b": 1, "c": [2]}, "d": "x"}"#));
        let keys: Vec<&str> = found.iter().map(|difference| difference.key.as_str()).collect();
        assert_eq!(keys, ["a.c", "d"]);
        assert_eq!((&found[1].a, &found[1].b), (&Value::Null, &Value::from("x")));
    }
}
