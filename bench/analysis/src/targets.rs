//! Targets of a ground station that a flight has followed, and holds, as a report lists them.

use messages::content::{FlightTarget, TargetKind};
use serde::{Deserialize, Serialize};

/// Entries that are kept, the first ones.
const TARGETS_KEPT: usize = 500;
/// Targets of a kind that follow each other within this time are one entry [s].
const STREAM_S: f64 = 0.5;

/// A target, and those of its kind that followed in a stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FollowedTarget {
    pub tick: u64,
    pub time_s: f64,
    /// `position`, `velocity` or `hold`.
    pub kind: String,
    /// Of a position [m], world frame.
    pub position_w_m: [f64; 3],
    /// Of a position or a velocity [m/s], world frame.
    pub velocity_w_m_s: [f64; 3],
    pub yaw_rad: f64,
    /// Targets that followed in its stream, and the time of the last one [s].
    pub later: u64,
    pub last_s: f64,
}

#[derive(Clone, Debug, Default)]
pub struct TargetStatistics {
    pub followed: Vec<FollowedTarget>,
    pub left_out: u64,
    newest: FlightTarget,
}

impl TargetStatistics {
    /// Takes the target of a state; `period_s` is T [s].
    pub fn take(&mut self, target: &FlightTarget, period_s: f64) {
        // No target begins at tick 0.
        if target.from_tick == self.newest.from_tick {
            return;
        }
        let before_s = self.newest.from_tick as f64 * period_s;
        self.newest = *target;
        let kind = TargetKind::from_wire(target.kind).unwrap_or(TargetKind::Hold);
        let time_s = target.from_tick as f64 * period_s;
        let last = self.followed.last_mut();
        let goes_on = |it: &&mut FollowedTarget| {
            it.kind == kind.name() && it.last_s == before_s && time_s - before_s <= STREAM_S
        };
        if let Some(stream) = last.filter(goes_on) {
            (stream.later, stream.last_s) = (stream.later + 1, time_s);
        } else if self.followed.len() == TARGETS_KEPT {
            self.left_out += 1;
        } else {
            self.followed.push(FollowedTarget {
                tick: target.from_tick,
                time_s,
                kind: kind.name().into(),
                position_w_m: target.position_w_m,
                velocity_w_m_s: target.velocity_w_m_s,
                yaw_rad: target.yaw_rad,
                later: 0,
                last_s: time_s,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_that_follow_closely_are_one_entry_and_many_are_counted() {
        let mut statistics = TargetStatistics::default();
        let mut take = |ticks: &[u64], kind: TargetKind| {
            for &from_tick in ticks {
                let kind = kind as u64;
                let target = FlightTarget {
                    from_tick,
                    kind,
                    ..FlightTarget::default()
                };
                // Each is in several states.
                (0..3).for_each(|_| statistics.take(&target, 1e-3));
            }
        };
        take(&[0], TargetKind::Hold);
        take(&[100, 150, 650, 1151], TargetKind::Velocity);
        take(&[1200], TargetKind::Position);
        take(&[1700], TargetKind::Hold);
        let many: Vec<u64> = (0..600).map(|i| 10_000 + 1000 * i).collect();
        take(&many, TargetKind::Position);
        let brief = |it: &FollowedTarget| (it.tick, it.later);
        let first: Vec<_> = statistics.followed.iter().take(4).map(brief).collect();
        assert_eq!(first, [(100, 2), (1151, 0), (1200, 0), (1700, 0)]);
        assert_eq!(
            (statistics.followed.len(), statistics.left_out),
            (TARGETS_KEPT, 104)
        );
    }
}
