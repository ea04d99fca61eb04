//! Makes findings of rows, a column at a time.

use crate::bins::{BINS_MAX, Bins, explained, success};
use crate::campaign::{Campaign, Factor, Variant};
use crate::chunk::Identity;
use crate::distribution::Distribution as Drawn;
use crate::gates::METRICS;
use crate::metric_distribution::distribution;
use crate::results::{
    CampaignResults, Effect, FactorResults, GateResults, Map, Of, Pair, SCHEMA, Side,
    VariantResults, Worst,
};
use crate::rows::Rows;
use crate::table::{HOLDS, unit_and_meaning};
use errors::Failure;
use report::statistics::{Discordant, clopper_pearson, mean_interval, wilson};
use std::cmp::Ordering;

/// Flights that are named as the worst.
const WORST: usize = 10;
/// Factors whose pairs are mapped: those that matter most.
const MAPPED: usize = 3;
/// Bins of a map along each side.
const MAP_BINS: usize = 6;
/// The metric that flights are ranked by, and that effects are told on besides success.
const ERROR: &str = "position_error_max_m";

/// Rows with what is asked of all of them.
struct Asked<'a> {
    campaign: &'a Campaign,
    rows: &'a Rows,
    success: Vec<bool>,
    /// Largest position error of each row [m].
    error_m: Vec<f64>,
}

/// What the rows of a campaign show.
pub fn of(
    campaign: &Campaign,
    identity: &Identity,
    rows: &Rows,
    exact: bool,
) -> Result<CampaignResults, Failure> {
    let success: Vec<bool> = rows
        .flags("success")?
        .into_iter()
        .map(|it| it == Some(true))
        .collect();
    let asked = Asked {
        campaign,
        rows,
        success,
        error_m: rows.numbers(ERROR)?,
    };
    let flights = (asked.success.len() / campaign.arms.len()) as u64;
    let lost = rows.filled("lost")?;
    let mut arms = asked.arms(&lost, exact)?;
    let mut pairs = asked.pairs();
    for metric in METRICS {
        let values = rows.numbers(metric.name)?;
        for (arm, findings) in arms.iter_mut().enumerate() {
            let is = distribution(asked.of_arm(&values, arm));
            findings.metrics.push(Of {
                name: metric.name.into(),
                is,
            });
        }
        for (pair, (first, second)) in pairs.iter_mut().zip(asked.couples()) {
            let differences = (0..flights as usize).map(|flight| {
                let [one, other] = [first, second].map(|arm| flight * asked.arm_count() + arm);
                if lost[one] || lost[other] {
                    f64::NAN
                } else {
                    values[one] - values[other]
                }
            });
            pair.metrics.extend(mean_interval(differences).map(|is| Of {
                name: metric.name.into(),
                is,
            }));
        }
    }
    let factors = asked.factors()?;
    let maps = asked.maps(&factors)?;
    Ok(CampaignResults {
        schema: SCHEMA,
        name: identity.name.clone(),
        campaign: identity.campaign.clone(),
        build: identity.build.clone(),
        flights,
        planned: campaign.flights,
        intervals: if exact { "Clopper-Pearson" } else { "Wilson" },
        arms,
        pairs,
        factors,
        maps,
        worst: asked.worst(&lost)?,
        audit: None,
    })
}

impl Asked<'_> {
    fn arm_count(&self) -> usize {
        self.campaign.arms.len()
    }

    /// The values of an arm's rows.
    fn of_arm<T: Copy>(&self, values: &[T], arm: usize) -> impl Iterator<Item = T> {
        values.iter().skip(arm).step_by(self.arm_count()).copied()
    }

    fn couples(&self) -> impl Iterator<Item = (usize, usize)> {
        let arms = self.arm_count();
        (0..arms).flat_map(move |first| (first + 1..arms).map(move |second| (first, second)))
    }

    fn arms(&self, lost: &[bool], exact: bool) -> Result<Vec<VariantResults>, Failure> {
        let interval = if exact { clopper_pearson } else { wilson };
        let held: Vec<(String, Vec<Option<bool>>)> = self
            .campaign
            .gates
            .names()
            .map(|gate| Ok((gate.clone(), self.rows.flags(&format!("{HOLDS}{gate}"))?)))
            .collect::<Result<_, Failure>>()?;
        let count =
            |flags: &[bool], arm| self.of_arm(flags, arm).filter(|flag| *flag).count() as u64;
        let findings = |(arm, named): (usize, &Variant)| {
            let (successes, flights) = (
                count(&self.success, arm),
                self.of_arm(&self.success, arm).count() as u64,
            );
            let gates = held.iter().map(|(gate, held)| {
                let asked: Vec<bool> = self.of_arm(held, arm).flatten().collect();
                let held = asked.iter().filter(|held| **held).count() as u64;
                GateResults {
                    name: gate.clone(),
                    held,
                    asked: asked.len() as u64,
                }
            });
            VariantResults {
                name: named.name.clone(),
                flights,
                successes,
                interval: interval(successes, flights),
                lost: count(lost, arm),
                gates: gates.filter(|gate| gate.asked > 0).collect(),
                metrics: Vec::new(),
            }
        };
        Ok(self
            .campaign
            .arms
            .iter()
            .enumerate()
            .map(findings)
            .collect())
    }

    fn pairs(&self) -> Vec<Pair> {
        let pair = |(first, second): (usize, usize)| {
            let (mut discordant, mut flights) = (
                Discordant {
                    first: 0,
                    second: 0,
                },
                0,
            );
            for (one, other) in self
                .of_arm(&self.success, first)
                .zip(self.of_arm(&self.success, second))
            {
                flights += 1;
                discordant.first += u64::from(one && !other);
                discordant.second += u64::from(other && !one);
            }
            Pair {
                first: self.campaign.arms[first].name.clone(),
                second: self.campaign.arms[second].name.clone(),
                discordant,
                p_value: discordant.p_value(),
                difference: discordant.difference(flights),
                metrics: Vec::new(),
            }
        };
        self.couples().map(pair).collect()
    }

    /// A factor's bins, which are the same for all arms; none where all flights drew alike.
    fn bins(&self, factor: &Factor, most: usize) -> Result<Option<Bins>, Failure> {
        if !factor.distribution.varies() || factor.distribution == Drawn::Seed {
            return Ok(None);
        }
        let is_number = factor
            .distribution
            .ends()
            .iter()
            .all(|end| end.is_float() || end.is_integer());
        let bins = if is_number {
            let values = self.rows.numbers(&factor.name)?;
            Bins::of_numbers(&self.of_arm(&values, 0).collect::<Vec<_>>(), most)
        } else {
            let (places, words) = self.rows.words(&factor.name, BINS_MAX)?;
            Bins::of_words(self.of_arm(&places, 0).collect(), words)
        };
        Ok(Some(bins).filter(|bins| bins.names.len() > 1))
    }

    fn factors(&self) -> Result<Vec<FactorResults>, Failure> {
        let mut all = Vec::new();
        for factor in &self.campaign.factors {
            let Some(bins) = self.bins(factor, BINS_MAX)? else {
                continue;
            };
            let effect = |arm: usize| {
                let success_of: Vec<bool> = self.of_arm(&self.success, arm).collect();
                let error = self
                    .of_arm(&self.error_m, arm)
                    .map(|error_m| error_m.max(1e-9).ln());
                Effect {
                    of_success: explained(
                        &bins,
                        success_of
                            .iter()
                            .map(|success| f64::from(u8::from(*success))),
                    ),
                    of_error: explained(&bins, error),
                    bins: success(&bins, &success_of),
                }
            };
            let arms = (0..self.arm_count()).map(effect).collect();
            all.push(FactorResults {
                name: factor.name.clone(),
                meaning: self.meaning(factor),
                arms,
            });
        }
        let weight = |factor: &FactorResults| {
            let of = |share: fn(&Effect) -> Option<f64>| {
                factor.arms.iter().filter_map(share).fold(0.0, f64::max)
            };
            (of(|it| it.of_success), of(|it| it.of_error))
        };
        all.sort_by(|a, b| weight(b).partial_cmp(&weight(a)).unwrap_or(Ordering::Equal));
        Ok(all)
    }

    /// What a part of a fault changes.
    fn meaning(&self, factor: &Factor) -> String {
        match unit_and_meaning(self.campaign, factor) {
            ("", meaning) => meaning,
            (unit, meaning) => format!("{meaning} [{unit}]"),
        }
    }

    /// Success over the pairs of those factors that matter most, for each arm.
    fn maps(&self, factors: &[FactorResults]) -> Result<Vec<Map>, Failure> {
        let mut mapped = Vec::new();
        for findings in factors.iter().take(MAPPED) {
            let factor = self
                .campaign
                .factors
                .iter()
                .find(|factor| factor.name == findings.name);
            let bins = factor.map_or(Ok(None), |factor| self.bins(factor, MAP_BINS))?;
            mapped.extend(bins.map(|bins| (findings.name.clone(), bins)));
        }
        let mut maps = Vec::new();
        for (i, (x_name, x)) in mapped.iter().enumerate() {
            for (y_name, y) in &mapped[i + 1..] {
                for (arm, named) in self.campaign.arms.iter().enumerate() {
                    let mut cells = vec![vec![[0; 2]; x.names.len()]; y.names.len()];
                    for ((column, row), success) in
                        x.of.iter().zip(&y.of).zip(self.of_arm(&self.success, arm))
                    {
                        let cell = cells
                            .get_mut(*row as usize)
                            .and_then(|row| row.get_mut(*column as usize));
                        if let Some([successes, flights]) = cell {
                            *successes += u64::from(success);
                            *flights += 1;
                        }
                    }
                    maps.push(Map {
                        arm: named.name.clone(),
                        x: Side {
                            factor: x_name.clone(),
                            bins: x.names.clone(),
                        },
                        y: Side {
                            factor: y_name.clone(),
                            bins: y.names.clone(),
                        },
                        cells,
                    });
                }
            }
        }
        Ok(maps)
    }

    /// Lost flights first, then those that failed, and the largest errors first among them.
    fn worst(&self, lost: &[bool]) -> Result<Vec<Worst>, Failure> {
        let mut places: Vec<usize> = (0..self.success.len()).collect();
        let rank = |place: &usize| (!lost[*place], self.success[*place], -self.error_m[*place]);
        let by_rank = |a: &usize, b: &usize| {
            let ((lost_a, success_a, error_a), (lost_b, success_b, error_b)) = (rank(a), rank(b));
            (lost_a, success_a)
                .cmp(&(lost_b, success_b))
                .then(error_a.total_cmp(&error_b))
                .then(a.cmp(b))
        };
        if places.len() > WORST {
            places.select_nth_unstable_by(WORST, by_rank);
            places.truncate(WORST);
        }
        places.sort_by(by_rank);
        let flights = self.rows.whole("flight")?;
        let mut worst = Vec::new();
        for place in places {
            let (flight, arm) = (flights[place], place % self.arm_count());
            let Some(cells) = self.rows.row(self.campaign, flight, arm)? else {
                continue;
            };
            let cell = |name: &str| {
                cells
                    .iter()
                    .find(|(known, _)| known == name)
                    .map(|(_, text)| text.clone())
            };
            let drew = self
                .campaign
                .factors
                .iter()
                .filter(|it| it.distribution.varies());
            worst.push(Worst {
                flight,
                arm: self.campaign.arms[arm].name.clone(),
                success: self.success[place],
                position_error_max_m: self.error_m[place],
                lost: cell("lost").unwrap_or_default(),
                drew: drew
                    .filter_map(|it| Some((it.name.clone(), cell(&it.name)?)))
                    .collect(),
            });
        }
        Ok(worst)
    }
}
