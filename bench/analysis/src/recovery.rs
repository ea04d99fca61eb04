//! Recovery from faults: from when on the errors of position and heading stay below their bounds.
//!
//! An error that moves around its bound is below it at the end of every flight, for a while. So a flight has recovered only
//! if the error then stays below for long enough to tell: for [`STAYING_S`], for [`STAYING_SHARE`] of the time from the fault
//! to the next one or to the end, and for longer than it had been below before it rose again ([`LONGER`]).

/// Least time for which an error must stay below the bound [s].
pub const STAYING_S: f64 = 1.0;
/// Least part of the time after a fault for which an error must stay below the bound.
pub const STAYING_SHARE: f64 = 0.2;
/// Least ratio of the time for which an error stays below the bound to that for which it was below before.
pub const LONGER: f64 = 1.1;

/// True errors up to which a flight is on its trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecoveryBounds {
    pub position_m: f64,
    pub yaw_rad: f64,
}

impl RecoveryBounds {
    pub fn hold(&self, position_error_m: f64, yaw_error_rad: f64) -> bool {
        position_error_m <= self.position_m && yaw_error_rad <= self.yaw_rad
    }
}

/// Whether so many ticks after a fault are too few to tell a recovery.
pub fn is_too_short(ticks: u64, period_s: f64) -> bool {
    ticks < staying_ticks(period_s)
}

fn staying_ticks(period_s: f64) -> u64 {
    (STAYING_S / period_s).round() as u64
}

#[derive(Clone, Debug)]
pub struct Recoveries {
    faults: Vec<Fault>,
    last_tick: u64,
    staying_ticks: u64,
    next_tick: u64,
}

#[derive(Clone, Copy, Debug)]
struct Fault {
    tick: u64,
    /// First tick from which the errors have been below their bounds.
    back: u64,
    /// Longest time for which they were below before that [ticks].
    longest_below: u64,
}

impl Recoveries {
    /// Of faults at these ticks in their order; of several at one tick, each has the recovery of the last one.
    pub fn new(faults: impl IntoIterator<Item = u64>, last_tick: u64, period_s: f64) -> Self {
        let fault = |tick| Fault {
            tick,
            back: tick,
            longest_below: 0,
        };
        Self {
            faults: faults.into_iter().map(fault).collect(),
            last_tick,
            staying_ticks: staying_ticks(period_s),
            next_tick: 0,
        }
    }

    /// Takes whether the errors of a tick are below their bounds.
    pub fn take(&mut self, tick: u64, is_below: bool) {
        self.next_tick = tick + 1;
        let begun = self.faults.partition_point(|fault| fault.tick <= tick);
        if !is_below && let Some(fault) = self.faults[..begun].last_mut() {
            fault.longest_below = fault.longest_below.max(tick - fault.back);
            fault.back = tick + 1;
        }
    }

    /// Per fault, how long it took until the errors stayed below their bounds [ticks]; none where it did not, or where the
    /// flight ended before its time.
    pub fn ticks(&self) -> Vec<Option<u64>> {
        let later = self.faults.iter().skip(1).map(|fault| fault.tick);
        let ends = later.chain([self.last_tick + 1]);
        let recovered = |(fault, end): (&Fault, u64)| {
            let share = STAYING_SHARE * end.saturating_sub(fault.tick) as f64;
            let least = share.max(LONGER * fault.longest_below as f64).ceil() as u64;
            let staying = least.max(self.staying_ticks);
            let stays = end <= self.next_tick && end.saturating_sub(fault.back) >= staying;
            stays.then(|| fault.back - fault.tick)
        };
        self.faults.iter().zip(ends).map(recovered).collect()
    }

    /// The longest of them; none without a fault, and where there was no recovery from one.
    pub fn longest_ticks(&self) -> Option<u64> {
        let each: Option<Vec<u64>> = self.ticks().into_iter().collect();
        each?.into_iter().max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recovered(faults: &[u64], errors_m: &[f64], last_tick: u64) -> Vec<Option<u64>> {
        let mut recoveries = Recoveries::new(faults.iter().copied(), last_tick, 1.0 / 3.0);
        let errors_m = (0..).zip(errors_m);
        errors_m.for_each(|(tick, error_m)| recoveries.take(tick, *error_m <= 0.5));
        recoveries.ticks()
    }

    #[test]
    fn a_flight_is_on_its_trajectory_with_position_and_heading() {
        let bounds = RecoveryBounds {
            position_m: 0.1,
            yaw_rad: 0.2,
        };
        for (position_m, yaw_rad, expected) in [
            (0.1, 0.2, true),
            (0.11, 0.0, false),
            (0.0, 0.21, false),
            (f64::NAN, 0.0, false),
        ] {
            assert_eq!(
                bounds.hold(position_m, yaw_rad),
                expected,
                "{position_m} {yaw_rad}"
            );
        }
    }

    #[test]
    fn a_recovery_lasts_until_the_error_stays_below_the_bound() {
        let errors = [0.0, 0.9, 0.9, 0.1, 0.9, 0.2, 0.2, 0.2];
        let twice = [0.9, 0.1, 0.1, 0.1, 0.1, 0.9, 0.9, 0.1, 0.1, 0.1];
        let slow = [0.9, 0.9, 0.9, 0.1, 0.1, 0.1, 0.1];
        for (faults, errors_m, last_tick, expected) in [
            // The error came back once more.
            (&[1][..], &errors[..], 7, &[Some(4)][..]),
            (&[], &errors, 7, &[]),
            // Two ticks are too short to stay.
            (&[1], &errors[..7], 6, &[None]),
            // Of a flight that ended early nothing is known.
            (&[1], &errors, 9, &[None]),
            // The error never left.
            (&[5], &errors, 7, &[Some(0)]),
            (&[0, 5], &twice, 9, &[Some(1), Some(2)]),
            (&[0, 3], &slow, 6, &[None, Some(0)]),
        ] {
            let found = recovered(faults, errors_m, last_tick);
            assert_eq!(found, expected, "{faults:?} {errors_m:?}");
        }
    }

    #[test]
    fn an_error_that_moves_around_the_bound_has_not_recovered_wherever_the_flight_ends() {
        let errors: Vec<f64> = (0..400)
            .map(|tick| 0.5 + (f64::from(tick) / 6.0).sin())
            .collect();
        for end in 60..400 {
            assert_eq!(
                recovered(&[0], &errors[..end], end as u64 - 1),
                [None],
                "{end}"
            );
        }
        // Nor has one that came below in the last fifth alone.
        let late = |last: usize| [vec![0.9; 100 - last], vec![0.1; last]].concat();
        let found = [19, 20].map(|last| recovered(&[0], &late(last), 99)[0]);
        assert_eq!(found, [None, Some(80)]);
    }
}
