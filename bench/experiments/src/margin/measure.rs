//! Measures one phase, and combines phases.

use analysis::comparison::Laws;
use analysis::margin::{
    Exception, LawMargins, LossMargin, OutageMargin, PatternMargin, Point, SteadyMargin,
};
use analysis::statistics::clopper_pearson;
use faults::{LONGEST_DELAY, Port};

use crate::margin::flights::Flights;
use crate::margin::limits::{GivenLimits, Judged, metric};
use crate::margin::search::{checked, climbed, largest};
use crate::margin::target::Target;
use errors::Failure;

/// Stop after this many failures in a row.
const MISSES: u32 = 3;
/// Message-loss rates to fly [%].
const SHARES: [u64; 14] = [1, 2, 5, 10, 15, 20, 25, 30, 40, 50, 60, 70, 80, 90];
/// Stop after this many failed loss rates.
const SHARE_MISSES: u32 = 2;
const LENGTHS: [u64; 6] = [2, 5, 10, 20, 50, 100];
/// Longest delay of a fault [ticks].
const MOST_TICKS: u64 = LONGEST_DELAY;

#[derive(Clone, Debug)]
pub struct Task<'a> {
    pub targets: Vec<Target>,
    pub given: &'a GivenLimits,
    /// Longest outage to try [ticks].
    pub longest: u64,
    /// Sample time [s].
    pub period_s: f64,
    /// Sample time [ns].
    pub tick_ns: u64,
}

/// Strongest fault survived, and the flights on the way.
type Climb = (u64, Vec<Point>);

/// Results of one phase, by target; the expensive ones are empty unless the phase is sparse.
#[derive(Clone, Debug)]
pub struct PhaseResults {
    outages: Vec<(u64, Vec<(u64, bool)>)>,
    lags: Vec<Climb>,
    delays: Vec<Climb>,
    losses: Vec<Climb>,
    /// One per entry of [`LENGTHS`].
    patterns: Vec<Vec<u64>>,
    flights: u64,
}

impl<'a> Task<'a> {
    pub fn ticks(&self, time_s: f64) -> u64 {
        (time_s / self.period_s).round() as u64
    }

    fn inputs(&self) -> impl Iterator<Item = Port> {
        self.targets.iter().filter_map(|target| match target {
            Target::Input(port) => Some(*port),
            Target::Stage(_) | Target::Machine => None,
        })
    }

    pub fn phase(&'a self, flights: &'a Flights<'a>, limits: &'a Judged) -> Phase<'a> {
        Phase {
            task: self,
            flights,
            limits,
        }
    }

    /// Per input: the largest loss rate [%] up to which every phase survived.
    pub fn shares(&self, phases: &[PhaseResults]) -> Vec<u64> {
        let least = |(i, _): (usize, Port)| phases.iter().map(|phase| phase.losses[i].0).min();
        let least = self.inputs().enumerate().map(least);
        least.map(Option::unwrap_or_default).collect()
    }

    /// Combines the phases of one combination of laws: limits, results, and whether each phase survived the common loss
    /// rates once more. The caller adds the names of the laws.
    pub fn combine(
        &self,
        phases_s: &[f64],
        judged: &[Judged],
        phases: &[PhaseResults],
        repeated: &[Vec<Option<bool>>],
    ) -> LawMargins {
        let largest = |of: fn(&Judged) -> f64| judged.iter().map(of).fold(0.0, f64::max);
        let outage = |(i, target): (usize, &Target)| {
            let exception = |phase_s: f64, (ticks, survived): (u64, bool)| Exception {
                phase_s,
                ticks,
                survived,
            };
            let exceptions = phases.iter().zip(phases_s).flat_map(|(phase, phase_s)| {
                let exceptions = phase.outages[i].1.iter();
                exceptions.map(move |it| exception(*phase_s, *it))
            });
            OutageMargin {
                of: target.name(),
                ticks: phases.iter().map(|phase| phase.outages[i].0).collect(),
                exceptions: exceptions.collect(),
            }
        };
        let is_sparse = |phase: &&PhaseResults| !phase.patterns.is_empty();
        let sparse: Vec<&PhaseResults> = phases.iter().filter(is_sparse).collect();
        let steady = |of: fn(&PhaseResults) -> &[Climb]| -> Vec<SteadyMargin> {
            let margin = |(i, port): (usize, Port)| {
                let climbs: Vec<&Climb> = sparse.iter().map(|phase| &of(phase)[i]).collect();
                let ticks = climbs.iter().map(|(ticks, _)| *ticks).min().unwrap_or(0);
                SteadyMargin {
                    input: port.to_string(),
                    ticks,
                    is_most: ticks == MOST_TICKS,
                    points: merged(&climbs),
                }
            };
            self.inputs().enumerate().map(margin).collect()
        };
        let shares = self.shares(phases);
        let loss = |(i, port): (usize, Port)| {
            let climbs: Vec<&Climb> = phases.iter().map(|phase| &phase.losses[i]).collect();
            let mut each: Vec<u64> = climbs.iter().map(|(percent, _)| *percent).collect();
            each.sort_unstable();
            let median = each.get(each.len().saturating_sub(1) / 2);
            let repeated = repeated.iter().filter_map(|phase| *phase.get(i)?);
            let repeated: Vec<bool> = repeated.collect();
            let flights = repeated.len() as u64;
            let survived = repeated.iter().filter(|survived| **survived).count() as u64;
            let interval = clopper_pearson(survived, flights);
            LossMargin {
                input: port.to_string(),
                share: shares[i] as f64 / 100.0,
                flights,
                survived,
                survival: [interval.low, interval.high],
                median_share: median.map_or(0.0, |percent| *percent as f64 / 100.0),
                points: merged(&climbs),
            }
        };
        let pattern = |(i, port): (usize, Port)| {
            let least = |j: usize| sparse.iter().map(|phase| phase.patterns[i][j]).min();
            let most = LENGTHS.iter().enumerate();
            PatternMargin {
                input: port.to_string(),
                most: most.map(|(j, k)| [least(j).unwrap_or(0), *k]).collect(),
            }
        };
        let flights: u64 = phases.iter().map(|phase| phase.flights).sum();
        LawMargins {
            laws: Laws::default(),
            fingerprint: String::new(),
            unfaulted_error_m: largest(|it| it.unfaulted_error_m),
            unfaulted_saturated_percent: largest(|it| it.unfaulted_saturated_percent),
            recovered_below_m: largest(|it| it.outage.recovered_below_m),
            tracked_below_m: largest(|it| it.steady.recovered_below_m),
            saturated_max_percent: largest(|it| it.saturated_max_percent),
            outages: self.targets.iter().enumerate().map(outage).collect(),
            lags: steady(|phase| &phase.lags),
            delays: steady(|phase| &phase.delays),
            losses: self.inputs().enumerate().map(loss).collect(),
            patterns: self.inputs().enumerate().map(pattern).collect(),
            flights: flights + repeated.iter().flatten().flatten().count() as u64,
        }
    }
}

/// Faults that begin at one tick.
#[derive(Clone, Copy)]
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct Phase<'a> {
    task: &'a Task<'a>,
    flights: &'a Flights<'a>,
    limits: &'a Judged,
}

impl Phase<'_> {
    /// Measures the phase; `is_sparse` adds the expensive measurements.
    pub fn measure(&self, is_sparse: bool) -> Result<PhaseResults, Failure> {
        let task = self.task;
        let expensive = || task.inputs().filter(|_| is_sparse);
        let steady = |word: &'static str| expensive().map(move |port| self.steady(port, word));
        let outages = task
            .targets
            .iter()
            .map(|target| self.outage(*target, is_sparse));
        let losses = task.inputs().map(|port| self.loss(port));
        let patterns = expensive().map(|port| self.patterns(port));
        Ok(PhaseResults {
            outages: outages.collect::<Result<_, _>>()?,
            lags: steady("lag").collect::<Result<_, _>>()?,
            delays: steady("delay").collect::<Result<_, _>>()?,
            losses: losses.collect::<Result<_, _>>()?,
            patterns: patterns.collect::<Result<_, _>>()?,
            flights: self.flights.count.get(),
        })
    }

    /// Per input: whether this loss rate [%] is survived; nothing for 0.
    pub fn repeat(&self, shares: &[u64]) -> Result<Vec<Option<bool>>, Failure> {
        let fly = |(port, percent): (Port, &u64)| match percent {
            0 => Ok(None),
            _ => Ok(Some(self.lose(port, *percent)?.0)),
        };
        self.task.inputs().zip(shares).map(fly).collect()
    }

    fn outage(&self, target: Target, is_checked: bool) -> Result<(u64, Vec<(u64, bool)>), Failure> {
        let (task, gates) = (self.task, &self.limits.outage);
        let survives = |ticks: u64| -> Result<bool, Failure> {
            let (from, end) = (self.flights.from, self.flights.from + ticks);
            let last_tick = end + task.ticks(task.given.after_s());
            let fault = [target.outage(from, ticks, task.tick_ns)];
            let outcome = self
                .flights
                .fly(&fault, end, last_tick, gates.recovered_below_m)?;
            Ok(gates.is_success(&outcome))
        };
        let longest = largest(task.longest, survives)?;
        match is_checked {
            true => checked(longest, task.longest, survives),
            false => Ok((longest, Vec::new())),
        }
    }

    /// Flies under a steady fault.
    fn under(&self, fault: &str, at: f64) -> Result<(bool, Point), Failure> {
        let (from, gates) = (self.flights.from, &self.limits.steady);
        let last_tick = from + self.task.ticks(self.task.given.steady_s());
        let fault = [format!("{fault}@tick{from}")];
        let outcome = self
            .flights
            .fly(&fault, from, last_tick, gates.recovered_below_m)?;
        let survived = gates.is_success(&outcome);
        let error_m = metric(&outcome, "tracking_error_max_m");
        let point = Point {
            at,
            flights: 1,
            survived: u64::from(survived),
            error_m: error_m.filter(|_| outcome.lost.is_none()),
        };
        Ok((survived, point))
    }

    fn steady(&self, port: Port, word: &str) -> Result<Climb, Failure> {
        let mut points = Vec::new();
        let all = climbed(1..=MOST_TICKS, MISSES, |ticks| {
            let (survived, point) = self.under(&format!("{port}.{word}={ticks}"), ticks as f64)?;
            points.push(point);
            Ok(survived)
        })?;
        Ok((all as u64, points))
    }

    /// Flies with a loss rate [%].
    fn lose(&self, port: Port, percent: u64) -> Result<(bool, Point), Failure> {
        let share = percent as f64 / 100.0;
        self.under(&format!("{port}.drop={share}"), share)
    }

    /// Largest loss rate survived [%].
    fn loss(&self, port: Port) -> Result<Climb, Failure> {
        let mut points = Vec::new();
        let all = climbed(SHARES, SHARE_MISSES, |percent| {
            let (survived, point) = self.lose(port, percent)?;
            points.push(point);
            Ok(survived)
        })?;
        let low = all.checked_sub(1).map_or(0, |i| SHARES[i]);
        let high = SHARES.get(all).copied().unwrap_or(100);
        let more = largest(high - low - 1, |more| Ok(self.lose(port, low + more)?.0))?;
        Ok((low + more, points))
    }

    /// Per length: the most losses in a row.
    fn patterns(&self, port: Port) -> Result<Vec<u64>, Failure> {
        let survives =
            |lost, length| Ok(self.under(&format!("{port}.drop={lost}/{length}"), 0.0)?.0);
        let most = |length: u64| largest(length - 1, |lost| survives(lost, length));
        LENGTHS.into_iter().map(most).collect()
    }
}

/// Merges points of equal strength, ascending, up to the strength that the first phase did not survive: beyond it only the
/// more robust phases are represented.
fn merged(phases: &[&Climb]) -> Vec<Point> {
    let mut all: Vec<Point> = Vec::new();
    for point in phases.iter().flat_map(|(_, points)| points) {
        match all.iter_mut().find(|it| it.at == point.at) {
            Some(it) => {
                it.flights += point.flights;
                it.survived += point.survived;
                it.error_m = it.error_m.zip(point.error_m).map(|(a, b)| a.max(b));
            }
            None => all.push(*point),
        }
    }
    all.sort_by(|a, b| a.at.total_cmp(&b.at));
    let is_of_all = |it: &Point| it.flights == phases.len() as u64;
    all.into_iter().take_while(is_of_all).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(at: f64, flights: u64, survived: u64, error_m: Option<f64>) -> Point {
        Point {
            at,
            flights,
            survived,
            error_m,
        }
    }

    #[test]
    fn points_of_one_strength_are_one_with_the_worst_error() {
        let first = vec![point(1.0, 1, 1, Some(0.2)), point(2.0, 1, 0, None)];
        let second = vec![
            point(1.0, 1, 1, Some(0.3)),
            point(2.0, 1, 1, Some(0.1)),
            point(3.0, 1, 0, Some(2.0)),
        ];
        // What the first one did not fly is not drawn.
        let both = [point(1.0, 2, 2, Some(0.3)), point(2.0, 2, 1, None)];
        assert_eq!(merged(&[&(1, first), &(2, second)]), both);
    }
}
