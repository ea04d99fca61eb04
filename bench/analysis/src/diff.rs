//! `ironbird report diff`: compares two flights, or two groups of flights.
//!
//! One flight a side shows numbers. What two groups differ in follows from a permutation of whole flights
//! ([`crate::statistics::permutation_test`]), because the ticks of one flight depend on each other: one stall delays
//! many of them.

use crate::distribution::tail_percents;
use crate::host::STEAL_LIMIT_PERCENT;
use crate::phrase::name_of;
use crate::report_file::RunFacts;
use crate::schema::{AGITATION, FlightStatus, NOT_FRESH, Report};
use crate::statistics::{Groups, median, permutation_test};
use flight_log::build::Build;
use serde::Serialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

const SCHEMA: &str = "ironbird-report-diff/2";
/// Probability of any false verdict that is accepted, with four flights a side and more.
const LEVEL: f64 = 0.05;
/// The same with three a side, which can be dealt out in 20 ways alone: a tenth is the least that they can show. Such
/// groups must therefore lie further apart as well than the wider one of them is wide.
pub const LEVEL_OF_THREE: f64 = 0.1;
/// Flights a side without which nothing can be judged.
const FLIGHTS_NEEDED: usize = 3;
/// Share of a figure by which two groups must differ at the least: less is no news to anybody.
const DIFFERENCE_MIN: f64 = 0.02;

/// Two groups of flights compared; every ratio is B over A.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diff {
    pub schema: &'static str,
    pub timing: Conclusion,
    pub tracking: Conclusion,
    pub a: Vec<Side>,
    pub b: Vec<Side>,
    pub settings: Vec<Difference>,
    pub builds: &'static str,
    pub machine: Vec<Difference>,
    pub figures: Vec<FigureDiff>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "says", rename_all = "snake_case")]
pub enum Conclusion {
    NotJudged {
        reason: String,
    },
    /// So many figures differ; the probability of even one false difference is `level` at most.
    Judged {
        differ: usize,
        judged: usize,
        level: f64,
        /// Figure with the largest ratio that is not said to differ, and the ratio.
        largest: Option<(String, f64)>,
    },
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Side {
    pub run: String,
    pub build: Build,
    pub started: String,
    pub status: FlightStatus,
    pub ticks: u64,
    pub skipped: u64,
    pub missed: u64,
    /// Ticks without a fresh command on time; none in lockstep.
    pub not_fresh: Option<u64>,
    pub steal_percent: f64,
    pub theorem: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    pub key: String,
    /// In the flights of the first group, each value once; nothing where they have none.
    pub a: Vec<Value>,
    pub b: Vec<Value>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FigureDiff {
    pub name: String,
    /// In the flights of the first group, in their order; nothing where one has too few values.
    pub a: Vec<Option<f64>>,
    pub b: Vec<Option<f64>>,
    /// Median of the first group; none where a flight has none.
    pub median_a: Option<f64>,
    pub median_b: Option<f64>,
    /// Ratio of the medians; none where one is missing, or that of A is 0.
    pub ratio: Option<f64>,
    /// Probability that chance alone sets any figure as far apart as this one is; none where it is not judged.
    pub probability: Option<f64>,
    pub says: Says,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Says {
    TooFewValues,
    NotJudged,
    /// The difference is within what chance does, or too small to matter.
    NoDifference,
    More,
    Less,
}

#[derive(Clone, Debug)]
pub struct ComparedRun {
    pub run: String,
    pub report: Report,
    pub facts: RunFacts,
}

impl ComparedRun {
    fn side(&self) -> Side {
        let report = &self.report;
        Side {
            run: self.run.clone(),
            build: self.facts.build.clone(),
            started: report.run.started.clone(),
            status: report.verdict.status,
            ticks: report.ticks.run,
            skipped: report.ticks.skipped,
            missed: report.deadlines.missed,
            not_fresh: report.deadlines.not_fresh.map(|it| it.ticks),
            steal_percent: report.steal.percent,
            theorem: name_of(&report.words.theorem.word),
        }
    }

    fn settings(&self) -> BTreeMap<String, Value> {
        let mut flat = BTreeMap::new();
        flatten("", &self.facts.settings, &mut flat);
        flat
    }

    fn machine(&self) -> BTreeMap<String, Value> {
        let mut flat = BTreeMap::new();
        let host = serde_json::to_value(&self.facts.host).unwrap_or_default();
        flatten("", &host, &mut flat);
        for (name, role) in &self.report.roles {
            let key = format!("scheduling of {name}");
            flat.insert(key, role.scheduling.clone().into());
        }
        flat
    }

    /// Why its latencies tell nothing of the loops.
    fn disturbed(&self) -> Option<String> {
        let (run, steal) = (&self.report.run, self.report.steal.percent);
        if let Some(why) = run.speed().why_not_real_time() {
            return Some(format!("{}: {why}", self.run));
        }
        (steal > STEAL_LIMIT_PERCENT).then(|| {
            format!("the host stole {steal:.2} % during {}: {STEAL_LIMIT_PERCENT} % at most allow a verdict", self.run)
        })
    }
}

fn flatten(prefix: &str, value: &Value, into: &mut BTreeMap<String, Value>) {
    let Value::Object(map) = value else {
        into.insert(prefix.to_owned(), value.clone());
        return;
    };
    for (key, value) in map {
        let dot = if prefix.is_empty() { "" } else { "." };
        flatten(&format!("{prefix}{dot}{key}"), value, into);
    }
}

/// Keys of which the flights do not all have one and the same value.
fn differences(a: &[BTreeMap<String, Value>], b: &[BTreeMap<String, Value>]) -> Vec<Difference> {
    let keys: BTreeSet<&String> = a.iter().chain(b).flat_map(BTreeMap::keys).collect();
    let of = |group: &[BTreeMap<String, Value>], key: &String| {
        let mut values: Vec<Value> = Vec::new();
        for flat in group {
            let value = flat.get(key).cloned().unwrap_or_default();
            if !values.contains(&value) {
                values.push(value);
            }
        }
        values
    };
    let all = keys.into_iter().map(|key| Difference {
        key: key.clone(),
        a: of(a, key),
        b: of(b, key),
    });
    all.filter(|it| it.a.len() > 1 || it.a != it.b).collect()
}

/// Compares two groups of flights, of at least one flight each.
pub fn compare(a: &[ComparedRun], b: &[ComparedRun]) -> Diff {
    let mut figures = paired(a, b);
    let few = a.len().min(b.len());
    let level = match few > FLIGHTS_NEEDED {
        true => LEVEL,
        false => LEVEL_OF_THREE,
    };
    let too_few = (few < FLIGHTS_NEEDED).then(|| {
        let some = match (a.len(), b.len()) {
            (1, 1) => "one flight a side shows".to_owned(),
            (a, b) => format!("{a} and {b} flights show"),
        };
        format!(
            "{some} numbers alone; compare {FLIGHTS_NEEDED} a side or more, flown in turns: ironbird report diff \
             A1 A2 A3 -- B1 B2 B3"
        )
    });
    let disturbed = a.iter().chain(b).find_map(ComparedRun::disturbed);
    let reason = |subject: Subject| {
        let disturbed = disturbed.clone().filter(|_| subject == Subject::Timing);
        too_few.clone().or(disturbed)
    };
    let judged: Vec<usize> = (0..figures.len())
        .filter(|i| reason(figures[*i].0).is_none() && figures[*i].1.says != Says::TooFewValues)
        .collect();
    let groups: Vec<Groups> = judged.iter().map(|i| figures[*i].1.groups()).collect();
    for (i, probability) in judged.iter().zip(permutation_test(&groups)) {
        figures[*i].1.judge(probability, level);
    }
    let conclusion = |subject: Subject| match reason(subject) {
        Some(reason) => Conclusion::NotJudged { reason },
        None => {
            let of = |wanted: &[Says]| {
                let is_it =
                    |(of, it): &&(Subject, FigureDiff)| *of == subject && wanted.contains(&it.says);
                figures.iter().filter(is_it).count()
            };
            let differ = of(&[Says::More, Says::Less]);
            let size = |ratio: &f64| ratio.ln().abs();
            let same = figures.iter().filter_map(|(of, it)| {
                let is_same = *of == subject && it.says == Says::NoDifference;
                let ratio = it.ratio.filter(|ratio| is_same && *ratio > 0.0)?;
                Some((it.name.clone(), ratio))
            });
            Conclusion::Judged {
                differ,
                judged: differ + of(&[Says::NoDifference]),
                level,
                largest: same.max_by(|a, b| size(&a.1).total_cmp(&size(&b.1))),
            }
        }
    };
    let (timing, tracking) = (conclusion(Subject::Timing), conclusion(Subject::Tracking));
    let flat = |of: fn(&ComparedRun) -> BTreeMap<String, Value>| {
        let [a, b] = [a, b].map(|group| group.iter().map(of).collect::<Vec<_>>());
        differences(&a, &b)
    };
    Diff {
        schema: SCHEMA,
        timing,
        tracking,
        a: a.iter().map(ComparedRun::side).collect(),
        b: b.iter().map(ComparedRun::side).collect(),
        builds: builds(a, b),
        settings: flat(ComparedRun::settings),
        machine: flat(ComparedRun::machine),
        figures: figures.into_iter().map(|(_, figure)| figure).collect(),
    }
}

/// How the builds of all flights compare: the worst that is said of any two.
fn builds(a: &[ComparedRun], b: &[ComparedRun]) -> &'static str {
    let mut all = a.iter().chain(b).map(|flown| &flown.facts.build);
    let Some(first) = all.next() else {
        return Build::default().compared_with(&Build::default());
    };
    let same = first.compared_with(first);
    let mut compared = all.map(|build| first.compared_with(build));
    compared.find(|said| *said != same).unwrap_or(same)
}

fn paired(a: &[ComparedRun], b: &[ComparedRun]) -> Vec<(Subject, FigureDiff)> {
    let of = |run: &ComparedRun| figures(&run.report);
    let [of_a, of_b] = [a, b].map(|group| group.iter().map(of).collect::<Vec<_>>());
    let values = |group: &[Vec<Figure>], name: &str| {
        let of = |all: &Vec<Figure>| all.iter().find(|figure| figure.1 == name)?.2;
        group.iter().map(of).collect()
    };
    // A figure that some flight lacks has too few values.
    let mut names: Vec<(Subject, &str)> = Vec::new();
    for (subject, name, _) in of_a.iter().chain(&of_b).flatten() {
        if !names.iter().any(|(_, known)| known == name) {
            names.push((*subject, name));
        }
    }
    let pair = |(subject, name)| {
        (
            subject,
            FigureDiff::of(name, values(&of_a, name), values(&of_b, name)),
        )
    };
    names.into_iter().map(pair).collect()
}

impl FigureDiff {
    fn of(name: &str, a: Vec<Option<f64>>, b: Vec<Option<f64>>) -> Self {
        let median_of = |group: &[Option<f64>]| {
            let all: Option<Vec<f64>> = group.iter().copied().collect();
            all.map(|values| median(&values))
        };
        let (median_a, median_b) = (median_of(&a), median_of(&b));
        let both = median_a.zip(median_b);
        let ratio = both.filter(|(a, _)| *a > 0.0).map(|(a, b)| b / a);
        let says = both.map_or(Says::TooFewValues, |_| Says::NotJudged);
        Self {
            name: name.to_owned(),
            a,
            b,
            median_a,
            median_b,
            ratio,
            probability: None,
            says,
        }
    }

    fn groups(&self) -> Groups {
        let of = |group: &[Option<f64>]| group.iter().copied().flatten().collect();
        Groups {
            a: of(&self.a),
            b: of(&self.b),
        }
    }

    fn judge(&mut self, probability: Option<f64>, level: f64) {
        self.probability = probability;
        let (Some(probability), Some((a, b))) = (probability, self.median_a.zip(self.median_b))
        else {
            return;
        };
        let matters = (a - b).abs() > DIFFERENCE_MIN * a.abs().max(b.abs());
        // Whole numbers of ways are divided by others: a probability of the level itself is within it.
        let is_clear = level < LEVEL_OF_THREE || self.groups().gap() > self.groups().width();
        self.says = match probability <= level * (1.0 + 1e-9) && matters && is_clear {
            true if b > a => Says::More,
            true => Says::Less,
            false => Says::NoDifference,
        };
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    /// How late the loops were: nothing, where they did not fly by the clock or the host stole from them.
    Timing,
    Tracking,
}

/// Subject, name with its unit, and value: none where the flight has too few values for it.
type Figure = (Subject, String, Option<f64>);

/// The figures of a flight; every flight has the same names in the same order, as long as it has the series.
fn figures(report: &Report) -> Vec<Figure> {
    use Subject::{Timing, Tracking};
    let (flight, deadlines) = (&report.flight, &report.deadlines);
    let ticks = (report.ticks.run + report.ticks.skipped) as f64;
    let per_million = |count: u64| (ticks > 0.0).then(|| count as f64 / ticks * 1e6);
    let rate = flight.rate_error_final_rad_s;
    let skipped = per_million(report.ticks.skipped);
    let not_fresh = deadlines.not_fresh.map(|it| it.per_million);
    // The number that leads the timing verdict comes first.
    let mut all = vec![(Timing, format!("{NOT_FRESH} [per million]"), not_fresh)];
    for error in flight.errors().into_iter().flatten() {
        let (name, unit) = (error.name, error.unit);
        let numbers = [
            ("rms", error.rms),
            ("largest", error.max),
            ("at the end", error.last),
        ];
        let named = |(which, value)| (Tracking, format!("{name}, {which} [{unit}]"), Some(value));
        all.extend(numbers.map(named));
    }
    all.push((Tracking, "rate error, at the end [rad/s]".into(), rate));
    all.extend(flight.effort.iter().flat_map(|it| {
        let saturated = ("rotors saturated [%]", it.saturated_percent);
        let both = [saturated, (AGITATION, it.agitation_rad_s)];
        both.map(|(name, value)| (Tracking, name.to_owned(), Some(value)))
    }));
    let missed = per_million(deadlines.missed);
    all.push((Timing, "deadlines missed [per million]".into(), missed));
    all.push((Timing, "ticks skipped [per million]".into(), skipped));
    for distribution in &report.distributions {
        all.extend(tail_percents(&distribution.name).map(|percent| {
            let name = format!("{} p{percent} [us]", distribution.name);
            let value = distribution.percentile(percent).map(|it| it.value_us);
            (Timing, name, value)
        }));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure(a: &[f64], b: &[f64]) -> FigureDiff {
        let some = |values: &[f64]| values.iter().copied().map(Some).collect();
        FigureDiff::of("loop p50 [us]", some(a), some(b))
    }

    #[test]
    fn a_difference_is_said_where_it_is_improbable_and_matters() {
        let (low, high) = ([10.0, 10.1, 10.2], [20.0, 20.1, 20.3]);
        for (a, b, probability, says) in [
            (low, high, 0.1, Says::More),
            (high, low, 0.1, Says::Less),
            (low, high, 0.2, Says::NoDifference),
            // Three a side are as far apart by chance once in ten times: they must be farther apart than each is wide.
            (
                [10.0, 10.1, 14.0],
                [16.0, 20.1, 20.3],
                0.1,
                Says::NoDifference,
            ),
            // Never mind how sure it is.
            ([10.0; 3], [10.1; 3], 0.001, Says::NoDifference),
        ] {
            let mut figure = figure(&a, &b);
            figure.judge(Some(probability), 0.1);
            assert_eq!(figure.says, says, "{a:?} {b:?} {probability}");
        }
    }
}
