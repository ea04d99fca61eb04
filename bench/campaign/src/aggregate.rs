//! Makes the results of rows, a column at a time.

use crate::bins::{BINS_MAX, Bins, explained, success};
use crate::campaign::{Campaign, Factor};
use crate::chunk::{Identity, Rows};
use crate::distribution::Distribution as Drawn;
use crate::gates::METRICS;
use crate::metric_distribution::distribution;
use crate::results::{
    CampaignResults, Effect, FactorResults, GateResults, Map, MeanDifference, Of, Pair, SCHEMA,
    Side, VariantResults, Worst,
};
use crate::table::{HOLDS, unit_and_meaning};
use analysis::statistics::{Discordant, mean_interval, wilson};
use errors::Failure;
use messages::math;
use std::cmp::Ordering;

const WORST: usize = 10;
const MAPPED: usize = 3;
const MAP_BINS: usize = 6;
/// The metric by which flights are ranked, and on which effects are given besides success.
const ERROR: &str = "position_error_max_m";

struct CampaignRows<'a> {
    campaign: &'a Campaign,
    rows: &'a Rows,
    success: Vec<bool>,
    lost: Vec<bool>,
    error_m: Vec<f64>,
}

pub fn of(
    campaign: &Campaign,
    identity: &Identity,
    rows: &Rows,
) -> Result<CampaignResults, Failure> {
    let success = rows.flags("success")?.into_iter();
    let all = CampaignRows {
        campaign,
        rows,
        success: success.map(|it| it == Some(true)).collect(),
        lost: rows.filled("lost")?,
        error_m: rows.numbers(ERROR)?,
    };
    let mut arms: Vec<_> = (0..all.arm_count()).map(|arm| all.arm(arm)).collect();
    for gate in campaign.gates.names() {
        let flags = rows.flags(&format!("{HOLDS}{gate}"))?;
        for (arm, results) in arms.iter_mut().enumerate() {
            let known: Vec<bool> = all.of_arm(&flags, arm).flatten().collect();
            results
                .gates
                .extend((!known.is_empty()).then(|| GateResults {
                    name: gate.clone(),
                    held: count(known.iter().copied()),
                    asked: known.len() as u64,
                }));
        }
    }
    let flights = rows.flights()?;
    // Only the recovery may have no value, and without a fault none is missing.
    let is_known = |arm: usize, (value, flight): (f64, u64)| {
        !value.is_nan() || campaign.is_faulted(&campaign.arms[arm], flight)
    };
    let mut pairs = all.pairs();
    for metric in METRICS {
        let values = rows.numbers(metric.name)?;
        for (arm, results) in arms.iter_mut().enumerate() {
            let values = all.of_arm(&values, arm).zip(all.of_arm(&flights, arm));
            let known = values.filter(|of_flight| is_known(arm, *of_flight));
            results.metrics.push(Of {
                name: metric.name.into(),
                is: distribution(known.map(|(value, _)| value)),
            });
        }
        for ([first, second], pair) in &mut pairs {
            let of = |arm: &usize| all.of_arm(&values, *arm).zip(all.of_arm(&all.lost, *arm));
            let both = of(first).zip(of(second));
            let flown = both.filter(|((_, one_lost), (_, other_lost))| !one_lost && !other_lost);
            let flown: Vec<[f64; 2]> = flown.map(|((one, _), (other, _))| [one, other]).collect();
            let differences = flown.iter().map(|[one, other]| one - other);
            pair.metrics
                .extend(mean_interval(differences).map(|mean| Of {
                    name: metric.name.into(),
                    is: MeanDifference {
                        of: mean,
                        missing:
                            [0, 1].map(|i| count(flown.iter().map(|values| values[i].is_nan()))),
                    },
                }));
        }
    }
    let factors = all.factors()?;
    Ok(CampaignResults {
        schema: SCHEMA,
        name: identity.name.clone(),
        campaign: identity.campaign.clone(),
        build: identity.build.clone(),
        flights: (all.success.len() / campaign.arms.len()) as u64,
        planned: campaign.flights,
        intervals: "Wilson",
        arms,
        pairs: pairs.into_iter().map(|(_, pair)| pair).collect(),
        maps: all.maps(&factors)?,
        factors,
        worst: all.worst()?,
    })
}

fn count(flags: impl Iterator<Item = bool>) -> u64 {
    flags.filter(|flag| *flag).count() as u64
}

impl CampaignRows<'_> {
    fn arm_count(&self) -> usize {
        self.campaign.arms.len()
    }

    fn of_arm<T: Copy>(&self, values: &[T], arm: usize) -> impl Iterator<Item = T> {
        values.iter().skip(arm).step_by(self.arm_count()).copied()
    }

    /// The results of an arm, without those by gate and by metric.
    fn arm(&self, arm: usize) -> VariantResults {
        let flights = self.of_arm(&self.success, arm).count() as u64;
        let successes = count(self.of_arm(&self.success, arm));
        VariantResults {
            name: self.campaign.arms[arm].name.clone(),
            flights,
            successes,
            interval: wilson(successes, flights),
            lost: count(self.of_arm(&self.lost, arm)),
            gates: Vec::new(),
            metrics: Vec::new(),
        }
    }

    /// Each pair of arms, without its metrics.
    fn pairs(&self) -> Vec<([usize; 2], Pair)> {
        let arms = self.arm_count();
        let pair = |[first, second]: [usize; 2]| {
            let [ones, others] = [first, second].map(|arm| self.of_arm(&self.success, arm));
            let both: Vec<(bool, bool)> = ones.zip(others).collect();
            let discordant = Discordant {
                first: count(both.iter().map(|(one, other)| *one && !other)),
                second: count(both.iter().map(|(one, other)| *other && !one)),
            };
            let pair = Pair {
                first: self.campaign.arms[first].name.clone(),
                second: self.campaign.arms[second].name.clone(),
                discordant,
                p_value: discordant.p_value(),
                difference: discordant.difference(both.len() as u64),
                metrics: Vec::new(),
            };
            ([first, second], pair)
        };
        let couples = (0..arms).flat_map(|first| (first + 1..arms).map(move |it| [first, it]));
        couples.map(pair).collect()
    }

    /// A factor's bins, which are the same for all arms; none where all flights drew alike.
    fn bins(&self, factor: &Factor, most: usize) -> Result<Option<Bins>, Failure> {
        if !factor.distribution.varies() || factor.distribution == Drawn::Seed {
            return Ok(None);
        }
        let mut ends = factor.distribution.ends().into_iter();
        let is_number = ends.all(|end| end.is_float() || end.is_integer());
        let bins = if is_number {
            let values = self.rows.numbers(&factor.name)?;
            Bins::of_numbers(&self.of_arm(&values, 0).collect::<Vec<_>>(), most)
        } else {
            let (places, names) = self.rows.words(&factor.name, BINS_MAX)?;
            Bins {
                of: self.of_arm(&places, 0).collect(),
                names,
                ranges: Vec::new(),
            }
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
                let successes: Vec<bool> = self.of_arm(&self.success, arm).collect();
                let shares = successes
                    .iter()
                    .map(|success| f64::from(u8::from(*success)));
                let errors_m = self.of_arm(&self.error_m, arm);
                Effect {
                    of_success: explained(&bins, shares),
                    of_error: explained(&bins, errors_m.map(|error_m| math::ln(error_m.max(1e-9)))),
                    bins: success(&bins, &successes),
                }
            };
            // What a part of a fault changes, too.
            let meaning = match unit_and_meaning(self.campaign, factor) {
                ("", meaning) => meaning,
                (unit, meaning) => format!("{meaning} [{unit}]"),
            };
            all.push(FactorResults {
                name: factor.name.clone(),
                meaning,
                arms: (0..self.arm_count()).map(effect).collect(),
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

    /// Success over the pairs of those factors that matter most, for each arm.
    fn maps(&self, factors: &[FactorResults]) -> Result<Vec<Map>, Failure> {
        let mut mapped = Vec::new();
        for FactorResults { name, .. } in factors.iter().take(MAPPED) {
            let factor = self.campaign.factors.iter().find(|it| it.name == *name);
            let bins = factor.map_or(Ok(None), |factor| self.bins(factor, MAP_BINS))?;
            mapped.extend(bins.map(|bins| (name, bins)));
        }
        let side = |name: &String, bins: &Bins| Side {
            factor: name.clone(),
            bins: bins.names.clone(),
        };
        let mut maps = Vec::new();
        for (i, (x_name, x)) in mapped.iter().enumerate() {
            for (y_name, y) in &mapped[i + 1..] {
                for (arm, named) in self.campaign.arms.iter().enumerate() {
                    let mut cells = vec![vec![[0; 2]; x.names.len()]; y.names.len()];
                    let places = x.of.iter().zip(&y.of);
                    for ((column, row), success) in places.zip(self.of_arm(&self.success, arm)) {
                        let row = cells.get_mut(*row as usize);
                        let cell = row.and_then(|row| row.get_mut(*column as usize));
                        if let Some([successes, flights]) = cell {
                            *successes += u64::from(success);
                            *flights += 1;
                        }
                    }
                    maps.push(Map {
                        arm: named.name.clone(),
                        x: side(x_name, x),
                        y: side(y_name, y),
                        cells,
                    });
                }
            }
        }
        Ok(maps)
    }

    /// Lost flights first, then those that failed, and the largest errors first among them.
    fn worst(&self) -> Result<Vec<Worst>, Failure> {
        let rank = |place: usize| (!self.lost[place], self.success[place]);
        let by_rank = |a: &usize, b: &usize| {
            let errors = self.error_m[*b].total_cmp(&self.error_m[*a]);
            rank(*a).cmp(&rank(*b)).then(errors).then(a.cmp(b))
        };
        let mut places: Vec<usize> = (0..self.success.len()).collect();
        if places.len() > WORST {
            places.select_nth_unstable_by(WORST, by_rank);
            places.truncate(WORST);
        }
        places.sort_by(by_rank);
        let flights = self.rows.flights()?;
        let mut worst = Vec::new();
        for place in places {
            let (flight, arm) = (flights[place], place % self.arm_count());
            let Some(cells) = self.rows.row(self.campaign, flight, arm)? else {
                continue;
            };
            let cell = |name: &str| {
                let cell = cells.iter().find(|(known, _)| known == name);
                cell.map(|(_, text)| text.clone())
            };
            let factors = self.campaign.factors.iter();
            let drawn = factors.filter(|it| it.distribution.varies());
            worst.push(Worst {
                flight,
                arm: self.campaign.arms[arm].name.clone(),
                success: self.success[place],
                position_error_max_m: self.error_m[place],
                lost: cell("lost").unwrap_or_default(),
                drew: drawn
                    .filter_map(|it| Some((it.name.clone(), cell(&it.name)?)))
                    .collect(),
            });
        }
        Ok(worst)
    }
}
