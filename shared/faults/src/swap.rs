//! Swaps: sets of parameter values that take hold together, at a tick.
//!
//! A swap is how the airframe changes in flight: a fault, a payload, gyro noise switched on. This file owns the
//! validity of a swap and the order in which pending swaps are applied. [`crate::plant`] knows when the plant has reached
//! a tick.
//!
//! A ramp is a swap whose change takes more than one step: a straight line, one step a tick. What a parameter is at a tick
//! is a function of that tick and of the swap alone, so a swap's record is all that a replay needs. A later swap of the
//! same parameter replaces what is left of its ramp, and starts from the value that held until then.

use messages::content::{Change, SwapRecord};
use messages::parameters::{Airframe, PARAMETERS, Parameter, ParameterError};
use thiserror::Error;

/// Pending swaps that fit into the queue.
pub const PENDING_SWAPS: usize = 64;
/// Steps of the longest ramp: 30 days, the longest flight, at the shortest tick, 0.1 ms.
pub const STEPS_MAX: u64 = 30 * 86_400 * 10_000;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    pub parameter: Parameter,
    pub value: f64,
    /// Equal steps in which it gets there, one a tick from the swap's on; 1 is at once.
    pub steps: u64,
}

/// New values of some parameters, all from the same tick on.
#[derive(Clone, Debug, PartialEq)]
pub struct Swap {
    /// Grid tick from which on they are wanted.
    pub tick: u64,
    /// What the parameters are to become, each parameter once.
    pub targets: heapless::Vec<Target, PARAMETERS>,
    /// Number of the request; 0 for faults known before the flight.
    pub request_id: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct AppliedSwap {
    /// Grid tick from which on it holds.
    pub tick: u64,
    pub epoch: u64,
    pub request_id: u64,
    pub changes: heapless::Vec<Change, PARAMETERS>,
}

impl AppliedSwap {
    /// As it is published on topic `swaps`.
    pub fn record(&self) -> SwapRecord {
        let mut record = SwapRecord {
            parameter_epoch: self.epoch,
            count: self.changes.len() as u64,
            ..SwapRecord::default()
        };
        for (i, change) in self.changes.iter().enumerate() {
            record.parameter[i] = change.parameter as u64;
            record.old[i] = change.old;
            record.new[i] = change.new;
            record.steps[i] = change.steps;
        }
        record
    }
}

/// Why a swap was refused; nothing of it is applied then.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SwapError {
    #[error("a parameter change without a parameter: name at least one as `name=value`")]
    Empty,
    #[error("{parameter} is given twice in one change: keep one value, or make it two changes")]
    Twice { parameter: Parameter },
    /// A ramp of no step, or of more than a flight has ticks.
    #[error("{parameter}: a ramp of {steps} steps: allowed are 1 to {STEPS_MAX}")]
    Steps { parameter: Parameter, steps: u64 },
    /// A value is out of its range.
    #[error(transparent)]
    Value(#[from] ParameterError),
    /// Too many swaps wait for their tick.
    #[error(
        "{PENDING_SWAPS} parameter changes are pending already: send this one again when one of them has been applied"
    )]
    Full,
}

impl Swap {
    /// A valid swap to these values, which hold at once from `tick` on.
    pub fn new(tick: u64, changes: &[(Parameter, f64)]) -> Result<Self, SwapError> {
        Self::of(
            tick,
            changes.iter().map(|&(parameter, value)| Target {
                parameter,
                value,
                steps: 1,
            }),
        )
    }

    /// A valid swap to these targets, with the first step of each at `tick`.
    pub fn to(tick: u64, targets: &[Target]) -> Result<Self, SwapError> {
        Self::of(tick, targets.iter().copied())
    }

    fn of(tick: u64, targets: impl Iterator<Item = Target>) -> Result<Self, SwapError> {
        let mut swap = Self {
            tick,
            targets: heapless::Vec::new(),
            request_id: 0,
        };
        for target in targets {
            // More targets than there are parameters repeat one of them.
            swap.targets
                .push(target)
                .map_err(|Target { parameter, .. }| SwapError::Twice { parameter })?;
        }
        swap.check()?;
        Ok(swap)
    }

    /// Checks that it changes something, each parameter once, to a value that some airframe can have, in steps that fit
    /// into a flight.
    pub fn check(&self) -> Result<(), SwapError> {
        if self.targets.is_empty() {
            return Err(SwapError::Empty);
        }
        for (i, target) in self.targets.iter().enumerate() {
            let (parameter, steps) = (target.parameter, target.steps);
            parameter.widest().check(parameter, target.value)?;
            if !(1..=STEPS_MAX).contains(&steps) {
                return Err(SwapError::Steps { parameter, steps });
            }
            let is_same = |earlier: &Target| earlier.parameter == parameter;
            if self.targets[..i].iter().any(is_same) {
                return Err(SwapError::Twice { parameter });
            }
        }
        Ok(())
    }
}

/// Swaps that wait for their tick, of fixed capacity [`PENDING_SWAPS`].
#[derive(Clone, Debug, Default)]
pub struct SwapQueue {
    /// Latest first, so that the next one to apply is the last; of one tick, the later arrival is nearer the front.
    pending: heapless::Vec<Swap, PENDING_SWAPS>,
}

impl SwapQueue {
    /// Takes a swap in: sorted by tick, and by arrival within a tick.
    pub fn push(&mut self, swap: Swap) -> Result<(), SwapError> {
        swap.check()?;
        let place = self.pending.partition_point(|other| other.tick > swap.tick);
        self.pending
            .insert(place, swap)
            .map_err(|_| SwapError::Full)
    }

    /// Takes the next swap out whose tick is `tick` or earlier.
    pub fn pop_due(&mut self, tick: u64) -> Option<Swap> {
        if self.pending.last()?.tick <= tick {
            self.pending.pop()
        } else {
            None
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Ramp {
    tick: u64,
    change: Change,
}

impl Ramp {
    /// Value of its parameter at a tick, from its first one on. The last step gives the target exactly.
    fn value(&self, tick: u64) -> f64 {
        let (old, new) = (self.change.old, self.change.new);
        if self.is_over(tick) {
            return new;
        }
        let share = (tick - self.tick + 1) as f64 / self.change.steps as f64;
        // Rounding must not take it beyond either end, where a range may end too.
        (old + (new - old) * share).clamp(old.min(new), old.max(new))
    }

    const fn is_over(&self, tick: u64) -> bool {
        tick - self.tick + 1 >= self.change.steps
    }
}

/// The ramps of an airframe, at most one for each parameter.
#[derive(Clone, Debug, Default)]
pub struct Ramps {
    running: heapless::Vec<Ramp, PARAMETERS>,
}

impl Ramps {
    /// Takes the first step of a swap, and tells what it changes.
    pub fn begin(
        &mut self,
        swap: &Swap,
        tick: u64,
        airframe: &mut Airframe,
    ) -> heapless::Vec<Change, PARAMETERS> {
        let mut changes = heapless::Vec::new();
        for &Target {
            parameter,
            value: new,
            steps,
        } in &swap.targets
        {
            self.running
                .retain(|ramp| ramp.change.parameter != parameter);
            let change = Change {
                parameter,
                old: airframe.get(parameter),
                new,
                steps,
            };
            let ramp = Ramp { tick, change };
            // The plant let only targets within the airframe's ranges in, and what lies between two values of a range
            // is in it too: none is refused. There is a place for every parameter.
            let _ = airframe.set(parameter, ramp.value(tick));
            let _ = changes.push(change);
            if !ramp.is_over(tick) {
                let _ = self.running.push(ramp);
            }
        }
        changes
    }

    /// Brings all ramps to a tick; says whether there was one.
    pub fn step(&mut self, tick: u64, airframe: &mut Airframe) -> bool {
        let runs = !self.running.is_empty();
        self.running.retain(|ramp| {
            // As in `begin`, none is refused.
            let _ = airframe.set(ramp.change.parameter, ramp.value(tick));
            !ramp.is_over(tick)
        });
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swap_is_valid_or_says_why_not() {
        use Parameter::{GyroNoise, Mass};
        let twice = Err(SwapError::Twice { parameter: Mass });
        assert!(Swap::new(3, &[(Mass, 0.6), (GyroNoise, 0.01)]).is_ok());
        assert_eq!(Swap::new(3, &[]), Err(SwapError::Empty));
        assert_eq!(Swap::new(3, &[(Mass, 0.6), (Mass, 0.6)]), twice);
        assert_eq!(Swap::new(3, &[(Mass, 0.6); PARAMETERS + 1]), twice);
        for value in [-1.0, f64::NAN] {
            let refused = Swap::new(3, &[(GyroNoise, 0.0), (Mass, value)]);
            assert!(matches!(refused, Err(SwapError::Value(_))));
        }
        let ramp = |steps| {
            let (parameter, value) = (Mass, 0.6);
            let target = Target {
                parameter,
                value,
                steps,
            };
            Swap::to(3, &[target]).map_err(|e| e.to_string())
        };
        assert!(ramp(STEPS_MAX).is_ok());
        for steps in [0, STEPS_MAX + 1] {
            let refused = format!("mass_kg: a ramp of {steps} steps: allowed are 1 to 25920000000");
            assert_eq!(ramp(steps), Err(refused));
        }
    }

    #[test]
    fn the_queue_sorts_by_tick_and_then_by_arrival() {
        let mut queue = SwapQueue::default();
        for (arrival, tick) in [5, 3, 5, 9, 3].into_iter().enumerate() {
            queue
                .push(Swap::new(tick, &[(Parameter::Mass, 0.1 * (arrival + 1) as f64)]).unwrap())
                .unwrap();
        }
        assert_eq!(queue.pop_due(2), None);
        let order: Vec<(u64, f64)> = std::iter::from_fn(|| queue.pop_due(8))
            .map(|swap| (swap.tick, swap.targets[0].value))
            .collect();
        assert_eq!(order, [(3, 0.2), (3, 0.5), (5, 0.1), (5, 0.1 * 3.0)]);
        assert_eq!(queue.pop_due(9).map(|swap| swap.tick), Some(9));
    }
}
