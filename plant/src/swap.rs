//! Swaps: sets of parameter values that take hold together, at a tick.
//!
//! A swap is how the airframe changes in flight: a fault, a payload, gyro noise switched on. This file owns the
//! validity of a swap and the order in which pending swaps are applied. [`crate::plant`] knows when the plant has
//! reached a tick.

use model::parameters::{Airframe, PARAMETERS, Parameter, ParameterError};
use thiserror::Error;

/// Pending swaps that fit into the queue.
pub const PENDING_SWAPS: usize = 64;

/// New values of some parameters, all from the same tick on.
#[derive(Clone, Debug, PartialEq)]
pub struct Swap {
    /// Grid tick from which on they are wanted.
    pub tick: u64,
    /// Parameters with their new values, each parameter once.
    pub changes: heapless::Vec<(Parameter, f64), PARAMETERS>,
    /// Number by which the asker knows it again; 0 for faults known before the flight.
    pub ticket: u64,
}

/// A swap that has taken hold.
#[derive(Clone, Debug, PartialEq)]
pub struct AppliedSwap {
    /// Grid tick from which on it holds.
    pub tick: u64,
    /// Parameter epoch that began with it.
    pub epoch: u64,
    /// Number by which the asker knows it again.
    pub ticket: u64,
    /// What it changed.
    pub changes: heapless::Vec<Change, PARAMETERS>,
}

/// A parameter's value before and after a swap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// The parameter.
    pub parameter: Parameter,
    /// Value until the swap, in the parameter's unit.
    pub old: f64,
    /// Value from the swap on.
    pub new: f64,
}

/// Why a swap was refused; nothing of it is applied then.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SwapError {
    /// The swap changes nothing.
    #[error("a swap of no parameter: name at least one as `name=value`")]
    Empty,
    /// Two values for one parameter.
    #[error("{parameter} is given twice in one swap: keep one value, or make it two swaps")]
    Twice {
        /// The parameter.
        parameter: Parameter,
    },
    /// A value is out of its range.
    #[error(transparent)]
    Value(#[from] ParameterError),
    /// Too many swaps wait for their tick.
    #[error("{PENDING_SWAPS} swaps are pending already: send this one again when one of them has been applied")]
    Full,
}

impl Swap {
    /// A valid swap of `changes` from `tick` on.
    ///
    /// # Errors
    /// As [`Swap::check`].
    pub fn new(tick: u64, changes: &[(Parameter, f64)]) -> Result<Self, SwapError> {
        let mut swap = Self { tick, changes: heapless::Vec::new(), ticket: 0 };
        for &(parameter, value) in changes {
            // More changes than there are parameters repeat one of them.
            swap.changes.push((parameter, value)).map_err(|(parameter, _)| SwapError::Twice { parameter })?;
        }
        swap.check()?;
        Ok(swap)
    }

    /// Checks that it changes something, each parameter once, to a value that some airframe can have.
    ///
    /// # Errors
    /// [`SwapError::Empty`], [`SwapError::Twice`] or [`SwapError::Value`].
    pub fn check(&self) -> Result<(), SwapError> {
        if self.changes.is_empty() {
            return Err(SwapError::Empty);
        }
        for (i, &(parameter, value)) in self.changes.iter().enumerate() {
            parameter.widest().check(parameter, value)?;
            if self.changes[..i].iter().any(|&(earlier, _)| earlier == parameter) {
                return Err(SwapError::Twice { parameter });
            }
        }
        Ok(())
    }

    /// Gives the airframe its new values, and tells what they replaced.
    pub(crate) fn apply(&self, airframe: &mut Airframe) -> heapless::Vec<Change, PARAMETERS> {
        let before = *airframe;
        self.changes
            .iter()
            // The plant let only values within the airframe's ranges in, so none is refused here.
            .filter(|&&(parameter, value)| airframe.set(parameter, value).is_ok())
            .map(|&(parameter, new)| Change { parameter, old: before.get(parameter), new })
            .collect()
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
    ///
    /// # Errors
    /// As [`Swap::check`], and [`SwapError::Full`]; the queue is unchanged then.
    pub fn push(&mut self, swap: Swap) -> Result<(), SwapError> {
        swap.check()?;
        let place = self.pending.partition_point(|other| other.tick > swap.tick);
        self.pending.insert(place, swap).map_err(|_| SwapError::Full)
    }

    /// Takes the next swap out whose tick is `tick` or earlier.
    pub fn pop_due(&mut self, tick: u64) -> Option<Swap> {
        if self.pending.last()?.tick <= tick { self.pending.pop() } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swap_is_valid_or_says_why_not() {
        use Parameter::{GyroNoise, Mass};
        assert!(Swap::new(3, &[(Mass, 0.6), (GyroNoise, 0.01)]).is_ok());
        assert_eq!(Swap::new(3, &[]), Err(SwapError::Empty));
        assert_eq!(Swap::new(3, &[(Mass, 0.6), (Mass, 0.6)]), Err(SwapError::Twice { parameter: Mass }));
        for value in [-1.0, f64::NAN] {
            assert!(matches!(Swap::new(3, &[(GyroNoise, 0.0), (Mass, value)]), Err(SwapError::Value(_))));
        }
        let too_many = [(Mass, 0.6); PARAMETERS + 1];
        assert_eq!(Swap::new(3, &too_many), Err(SwapError::Twice { parameter: Mass }));
    }

    #[test]
    fn the_queue_sorts_by_tick_and_then_by_arrival() {
        let mut queue = SwapQueue::default();
        for (arrival, tick) in [5, 3, 5, 9, 3].into_iter().enumerate() {
            queue.push(Swap::new(tick, &[(Parameter::Mass, 0.1 * (arrival + 1) as f64)]).unwrap()).unwrap();
        }
        assert_eq!(queue.pop_due(2), None);
        let order: Vec<(u64, f64)> =
            std::iter::from_fn(|| queue.pop_due(8)).map(|swap| (swap.tick, swap.changes[0].1)).collect();
        assert_eq!(order, [(3, 0.2), (3, 0.5), (5, 0.1), (5, 0.1 * 3.0)]);
        assert_eq!(queue.pop_due(9).map(|swap| swap.tick), Some(9));
    }

    #[test]
    fn a_full_queue_refuses_and_keeps_what_it_has() {
        let mut queue = SwapQueue::default();
        let swap = |tick| Swap::new(tick, &[(Parameter::Mass, 0.6)]).unwrap();
        for tick in 0..PENDING_SWAPS as u64 {
            queue.push(swap(tick)).unwrap();
        }
        assert_eq!(queue.push(swap(0)), Err(SwapError::Full));
        assert_eq!(std::iter::from_fn(|| queue.pop_due(u64::MAX)).count(), PENDING_SWAPS);
    }
}
