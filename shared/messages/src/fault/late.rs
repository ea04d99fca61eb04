//! Stages that compute longer than they need: by how much, at which tick.

use crate::fault::{MOST, NotTaken, Span};
use crate::noise::uniform;
use crate::role::Role;

/// Streams of random numbers of late stages; those of messages lie below.
const FIRST_STREAM: u64 = 1 << 33;

/// A number in [0, 1) for a stage and a tick of the flight of `seed`: how far it is from the least to the most.
#[must_use]
pub fn share(role: Role, seed: u64, tick: u64) -> f64 {
    uniform(seed, tick, FIRST_STREAM + role as u64)
}

/// A stage computes longer: by a time between the two, each as likely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late {
    pub role: Role,
    /// The least [ns].
    pub least_ns: u64,
    /// The most [ns].
    pub most_ns: u64,
    pub span: Span,
}

/// The late stages of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateStages {
    seed: u64,
    lates: [Option<Late>; MOST],
}

impl LateStages {
    #[must_use]
    pub const fn none(seed: u64) -> Self {
        Self {
            seed,
            lates: [None; MOST],
        }
    }

    pub fn push(&mut self, late: Late) -> Result<(), NotTaken> {
        if self
            .lates
            .iter()
            .flatten()
            .any(|other| other.role == late.role && other.span.meets(late.span))
        {
            return Err(NotTaken::Contradiction);
        }
        let place = self
            .lates
            .iter_mut()
            .find(|place| place.is_none())
            .ok_or(NotTaken::NoRoom)?;
        *place = Some(late);
        Ok(())
    }

    /// Ends those of a stage from a tick on.
    pub fn end(&mut self, role: Role, tick: u64) -> Result<(), NotTaken> {
        let is_meant = |late: &&mut Late| late.role == role && late.span.to > tick;
        let mut meant = self.lates.iter_mut().flatten().filter(is_meant).peekable();
        meant.peek().ok_or(NotTaken::NothingToEnd)?;
        meant.for_each(|late| late.span = late.span.cut(tick));
        Ok(())
    }

    #[must_use]
    pub fn of(&self, role: Role) -> Self {
        Self {
            lates: self.lates.map(|late| late.filter(|late| late.role == role)),
            ..*self
        }
    }

    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lates.iter().all(Option::is_none)
    }

    /// How much longer a stage computes at a tick [ns].
    #[must_use]
    pub fn late_ns(&self, role: Role, tick: u64) -> u64 {
        let late = self
            .lates
            .iter()
            .flatten()
            .find(|late| late.role == role && late.span.holds(tick));
        late.map_or(0, |late| {
            let range_ns = late.most_ns.saturating_sub(late.least_ns) as f64;
            late.least_ns
                .saturating_add((range_ns * share(role, self.seed, tick)) as u64)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn late(role: Role, from: u64, to: u64) -> Late {
        Late {
            role,
            least_ns: 40_000,
            most_ns: 400_000,
            span: Span { from, to },
        }
    }

    #[test]
    fn a_stage_is_late_in_its_ticks_by_a_time_within_the_range() {
        let mut lates = LateStages::none(7);
        lates.push(late(Role::Inner, 10, 1010)).unwrap();
        let times: Vec<u64> = (10..1010)
            .map(|tick| lates.late_ns(Role::Inner, tick))
            .collect();
        assert!(
            times.iter().all(|ns| (40_000..400_000).contains(ns)),
            "{times:?}"
        );
        assert!(times.iter().any(|ns| *ns < 60_000) && times.iter().any(|ns| *ns > 380_000));
        assert_eq!(
            [9, 1010].map(|tick| lates.late_ns(Role::Inner, tick)),
            [0, 0]
        );
        assert_eq!(lates.late_ns(Role::Outer, 100), 0);
        assert_eq!(lates.of(Role::Inner).late_ns(Role::Inner, 77), times[67]);
        assert!(lates.of(Role::Outer).is_empty() && !lates.is_empty());
    }

    #[test]
    fn a_stage_is_late_once_at_a_time_and_until_it_is_ended() {
        let mut lates = LateStages::none(7);
        lates.push(late(Role::Inner, 10, Span::FOR_GOOD)).unwrap();
        assert_eq!(
            lates.push(late(Role::Inner, 500, 600)),
            Err(NotTaken::Contradiction)
        );
        assert_eq!(lates.push(late(Role::Mixer, 500, 600)), Ok(()));
        assert_eq!(lates.end(Role::Outer, 100), Err(NotTaken::NothingToEnd));
        lates.end(Role::Inner, 100).unwrap();
        assert_eq!(lates.end(Role::Inner, 100), Err(NotTaken::NothingToEnd));
        assert!(lates.late_ns(Role::Inner, 99) > 0);
        assert_eq!(lates.late_ns(Role::Inner, 100), 0);
        (1..)
            .find(|tick| lates.push(late(Role::Plant, *tick, tick + 1)) == Err(NotTaken::NoRoom))
            .unwrap();
    }
}
