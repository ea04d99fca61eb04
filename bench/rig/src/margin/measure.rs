//! Measures one phase, and combines phases.

use campaign::gates::Gates;
use messages::fault::{LONGEST_DELAY, Port};
use report::comparison::Laws;
use report::margin::{
    Exception, LawMargins, LossMargin, OutageMargin, PatternMargin, Point, SteadyMargin,
};
use report::statistics::clopper_pearson;

use crate::margin::cases::{Asked, Judge, Judged};
use crate::margin::flights::Flights;
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
    pub asked: &'a Asked,
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
pub struct OfPhase {
    outages: Vec<(u64, Vec<(u64, bool)>)>,
    lags: Vec<Climb>,
    delays: Vec<Climb>,
    losses: Vec<Climb>,
    /// One per entry of [`LENGTHS`].
    patterns: Vec<Vec<u64>>,
    flights: u64,
}

impl Task<'_> {
    fn ticks(&self, time_s: f64) -> u64 {
        (time_s / self.period_s).round() as u64
    }

    fn inputs(&self) -> impl Iterator<Item = Port> {
        self.targets.iter().filter_map(|target| match target {
            Target::Input(port) => Some(*port),
            Target::Stage(_) | Target::Machine => None,
        })
    }

    /// Measures one phase; `is_sparse` adds the expensive measurements.
    pub fn at(
        &self,
        flights: &Flights<'_>,
        judge: &Judge,
        is_sparse: bool,
    ) -> Result<OfPhase, Failure> {
        let phase = Phase {
            task: self,
            flights,
            judge,
        };
        let outage = |target: &Target| phase.outage(*target, is_sparse);
        let steady = |word: &'static str| -> Result<Vec<_>, Failure> {
            if is_sparse {
                self.inputs().map(|port| phase.steady(port, word)).collect()
            } else {
                Ok(Vec::new())
            }
        };
        Ok(OfPhase {
            outages: self.targets.iter().map(outage).collect::<Result<_, _>>()?,
            lags: steady("lag")?,
            delays: steady("delay")?,
            losses: self
                .inputs()
                .map(|port| phase.loss(port))
                .collect::<Result<_, _>>()?,
            patterns: match is_sparse {
                true => self
                    .inputs()
                    .map(|port| phase.patterns(port))
                    .collect::<Result<_, _>>()?,
                false => Vec::new(),
            },
            flights: flights.count(),
        })
    }

    /// Per input: the largest loss rate [%] up to which every phase survived.
    pub fn shares(&self, phases: &[OfPhase]) -> Vec<u64> {
        let least = |(i, _): (usize, Port)| {
            phases
                .iter()
                .map(|phase| phase.losses[i].0)
                .min()
                .unwrap_or(0)
        };
        self.inputs().enumerate().map(least).collect()
    }

    /// Per input: whether this loss rate [%] is survived; nothing for 0.
    pub fn again(
        &self,
        flights: &Flights<'_>,
        judge: &Judge,
        shares: &[u64],
    ) -> Result<Vec<Option<bool>>, Failure> {
        let phase = Phase {
            task: self,
            flights,
            judge,
        };
        let fly = |(port, percent): (Port, &u64)| match percent {
            0 => Ok(None),
            _ => Ok(Some(phase.lose(port, *percent)?.0)),
        };
        self.inputs().zip(shares).map(fly).collect()
    }

    /// Combines the phases of one combination of laws: limits, results, and whether each phase survived the common loss
    /// rates once more.
    pub fn together(
        &self,
        law: Law,
        begins_s: &[f64],
        judged: &[Judged],
        phases: &[OfPhase],
        again: &[Vec<Option<bool>>],
    ) -> LawMargins {
        let Law { laws, fingerprint } = law;
        let largest = |of: fn(&Judged) -> f64| judged.iter().map(of).fold(0.0, f64::max);
        let shares = self.shares(phases);
        let outages = self
            .targets
            .iter()
            .enumerate()
            .map(|(i, target)| OutageMargin {
                of: target.name(),
                ticks: phases.iter().map(|phase| phase.outages[i].0).collect(),
                exceptions: phases
                    .iter()
                    .zip(begins_s)
                    .flat_map(|(phase, phase_s)| {
                        phase.outages[i].1.iter().map(move |it| (*phase_s, *it))
                    })
                    .map(|(phase_s, (ticks, survived))| Exception {
                        phase_s,
                        ticks,
                        survived,
                    })
                    .collect(),
            });
        let sparse: Vec<&OfPhase> = phases
            .iter()
            .filter(|phase| !phase.patterns.is_empty())
            .collect();
        let steady = |of: fn(&OfPhase) -> &[Climb]| -> Vec<SteadyMargin> {
            let margin = |(i, port): (usize, Port)| {
                let ticks = sparse.iter().map(|phase| of(phase)[i].0).min().unwrap_or(0);
                let points = merged(
                    sparse.iter().map(|phase| of(phase)[i].1.as_slice()),
                    sparse.len(),
                );
                SteadyMargin {
                    input: port.to_string(),
                    ticks,
                    is_most: ticks == MOST_TICKS,
                    points,
                }
            };
            self.inputs().enumerate().map(margin).collect()
        };
        let loss = |(i, port): (usize, Port)| {
            let mut each: Vec<u64> = phases.iter().map(|phase| phase.losses[i].0).collect();
            each.sort_unstable();
            let again: Vec<bool> = again
                .iter()
                .filter_map(|phase| phase.get(i).copied().flatten())
                .collect();
            let (flights, survived) = (
                again.len() as u64,
                again.iter().filter(|survived| **survived).count() as u64,
            );
            let interval = clopper_pearson(survived, flights);
            LossMargin {
                input: port.to_string(),
                share: shares[i] as f64 / 100.0,
                flights,
                survived,
                survival: [interval.low, interval.high],
                median_share: each
                    .get(each.len().saturating_sub(1) / 2)
                    .map_or(0.0, |it| *it as f64 / 100.0),
                points: merged(
                    phases.iter().map(|phase| phase.losses[i].1.as_slice()),
                    phases.len(),
                ),
            }
        };
        let pattern = |(i, port): (usize, Port)| PatternMargin {
            input: port.to_string(),
            most: LENGTHS
                .iter()
                .enumerate()
                .map(|(j, length)| {
                    [
                        sparse
                            .iter()
                            .map(|phase| phase.patterns[i][j])
                            .min()
                            .unwrap_or(0),
                        *length,
                    ]
                })
                .collect(),
        };
        LawMargins {
            laws,
            fingerprint,
            unfaulted_error_m: largest(|it| it.unfaulted.error_m),
            unfaulted_saturated_percent: largest(|it| it.unfaulted.saturated_percent),
            recovered_below_m: largest(|it| it.judge.outage.recovered_below_m),
            tracked_below_m: largest(|it| it.judge.steady.recovered_below_m),
            saturated_max_percent: largest(|it| it.judge.saturated_max_percent),
            outages: outages.collect(),
            lags: steady(|phase| &phase.lags),
            delays: steady(|phase| &phase.delays),
            losses: self.inputs().enumerate().map(loss).collect(),
            patterns: self.inputs().enumerate().map(pattern).collect(),
            flights: phases.iter().map(|phase| phase.flights).sum::<u64>()
                + again.iter().flatten().flatten().count() as u64,
        }
    }
}

#[derive(Clone, Debug)]
pub struct Law {
    pub laws: Laws,
    pub fingerprint: String,
}

struct Phase<'a> {
    task: &'a Task<'a>,
    flights: &'a Flights<'a>,
    judge: &'a Judge,
}

impl Phase<'_> {
    fn outage(&self, target: Target, is_checked: bool) -> Result<(u64, Vec<(u64, bool)>), Failure> {
        let Task {
            asked,
            longest,
            tick_ns,
            ..
        } = *self.task;
        let survives = |ticks: u64| -> Result<bool, Failure> {
            let (from, end) = (self.flights.from, self.flights.from + ticks);
            let gates = &self.judge.outage;
            let last_tick = end + self.task.ticks(asked.after_s());
            let fault = target.outage(from, ticks, tick_ns);
            let flown = self
                .flights
                .fly(&[fault], end, last_tick, gates.recovered_below_m)?;
            Ok(gates.is_success(&flown.outcome))
        };
        let found = largest(longest, survives)?;
        if is_checked {
            checked(found, longest, survives)
        } else {
            Ok((found, Vec::new()))
        }
    }

    /// Flies under a steady fault.
    fn under(&self, fault: &str, at: f64) -> Result<(bool, Point), Failure> {
        let from = self.flights.from;
        let gates: &Gates = &self.judge.steady;
        let last_tick = from + self.task.ticks(self.task.asked.steady_s());
        let flown = self.flights.fly(
            &[format!("{fault}@tick{from}")],
            from,
            last_tick,
            gates.recovered_below_m,
        )?;
        let survived = gates.is_success(&flown.outcome);
        Ok((
            survived,
            Point {
                at,
                flights: 1,
                survived: u64::from(survived),
                error_m: flown.error_m(),
            },
        ))
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
        let most = |length: &u64| {
            largest(length - 1, |lost| {
                Ok(self.under(&format!("{port}.drop={lost}/{length}"), 0.0)?.0)
            })
        };
        LENGTHS.iter().map(most).collect()
    }
}

/// Merges points of equal strength, ascending, up to the strength that the first phase did not survive: beyond it only the
/// more robust phases are represented.
fn merged<'a>(phases: impl Iterator<Item = &'a [Point]>, number: usize) -> Vec<Point> {
    let mut all: Vec<Point> = Vec::new();
    for point in phases.flatten() {
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
    all.into_iter()
        .take_while(|it| it.flights == number as u64)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::margin::cases::Unfaulted;
    use crate::settings::Settings;

    #[test]
    fn points_of_one_strength_are_one_with_the_worst_error() {
        let point = |at, survived, error_m| Point {
            at,
            flights: 1,
            survived,
            error_m,
        };
        let first = [point(1.0, 1, Some(0.2)), point(2.0, 0, None)];
        let second = [
            point(1.0, 1, Some(0.3)),
            point(2.0, 1, Some(0.1)),
            point(3.0, 0, Some(2.0)),
        ];
        let all = merged([&first[..], &second].into_iter(), 2);
        let both = |at, survived, error_m| Point {
            at,
            flights: 2,
            survived,
            error_m,
        };
        assert_eq!(
            all,
            [both(1.0, 2, Some(0.3)), both(2.0, 1, None)],
            "what the first one did not fly is not drawn"
        );
    }

    #[test]
    fn survival_is_told_of_the_flights_that_were_flown_again() {
        let asked = Asked::new(&[]).unwrap();
        let targets = vec![
            Target::Input(Port::InnerState),
            Target::Input(Port::MixerWrench),
        ];
        let task = Task {
            targets,
            asked: &asked,
            longest: 2000,
            period_s: 1e-3,
            tick_ns: 1_000_000,
        };
        let phase = |shares: [u64; 2]| OfPhase {
            outages: vec![(100, Vec::new()); 2],
            lags: Vec::new(),
            delays: Vec::new(),
            losses: shares.map(|share| (share, Vec::new())).into(),
            patterns: Vec::new(),
            flights: 10,
        };
        let phases = [phase([40, 0]), phase([30, 20]), phase([50, 60])];
        assert_eq!(task.shares(&phases), [30, 0]);
        let unfaulted = |error_m| Unfaulted {
            error_m,
            saturated_percent: 0.0,
        };
        let settings = Settings::resolve(None, &Vec::new()).unwrap();
        let judged = [0.004, 0.02, 0.001].map(|error_m| asked.judge(unfaulted(error_m), &settings));
        assert_eq!(
            judged
                .each_ref()
                .map(|it| it.judge.outage.recovered_below_m),
            [0.01, 0.04, 0.01],
            "each its own"
        );
        let laws = Laws {
            outer: "pd".into(),
            inner: "adaptive".into(),
            mixer: "priority".into(),
        };
        let law = Law {
            laws,
            fingerprint: String::new(),
        };
        let again = [
            vec![Some(true), None],
            vec![Some(false), None],
            vec![Some(true), None],
        ];
        let margins = task.together(law, &[10.0, 11.0, 12.0], &judged, &phases, &again);
        let [state, wrench] = &margins.losses[..] else {
            panic!("{margins:?}")
        };
        assert_eq!(
            (
                state.share,
                state.flights,
                state.survived,
                state.median_share
            ),
            (0.3, 3, 2, 0.4)
        );
        let interval = clopper_pearson(2, 3);
        assert_eq!(state.survival, [interval.low, interval.high]);
        assert!(state.survival[1] < 1.0, "one of three was lost");
        assert_eq!(
            (wrench.share, wrench.flights, wrench.survival),
            (0.0, 0, [0.0, 1.0]),
            "nothing is known"
        );
        assert_eq!((margins.flights, margins.recovered_below_m), (33, 0.04));
    }
}
