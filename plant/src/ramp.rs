//! Ramps: parameters on their way to a new value, in a straight line, one step a tick.
//!
//! A ramp is a swap whose change takes more than one step. What a parameter is at a tick is a function of that tick
//! and of the swap alone, so a swap's record is all that a replay needs. A later swap of the same parameter replaces
//! what is left of its ramp, and starts from the value that held until then.

use messages::content::Change;
use messages::parameters::{Airframe, PARAMETERS};

use crate::swap::{Swap, Target};

#[derive(Clone, Copy, Debug)]
struct Ramp {
    tick: u64,
    change: Change,
}

impl Ramp {
    /// Value of its parameter at a tick, from its first one on. The last step gives the target exactly.
    fn value(&self, tick: u64) -> f64 {
        let Change {
            old, new, steps, ..
        } = self.change;
        if self.is_over(tick) {
            return new;
        }
        let share = (tick - self.tick + 1) as f64 / steps as f64;
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
