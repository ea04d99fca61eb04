//! The reference of a vehicle that a ground station flies: it follows the newest target within fixed limits.
//!
//! Position and yaw are two instances of one tracker, a cascade whose gains follow from the lag of the acceleration:
//!
//! ```text
//!   velocity wanted      that of the target, and towards its position: proportional to the distance where that is short,
//!                        else as fast as half of the acceleration limit can brake; at most the speed limit
//!   acceleration wanted  proportional to the velocity that is missing, at most the acceleration limit
//!   jerk                 the acceleration follows the one wanted with a lag, so it never jumps
//! ```
//!
//! Near a target the cascade is linear with real poles, so the reference comes to rest without an overshoot.

use std::f64::consts::TAU;

use messages::content::{FlightTarget, Reference, TargetKind};
use messages::frames::wrap;
use nalgebra::{SVector, Vector1, Vector3};
use thiserror::Error;

/// Speed and acceleration of the reference at the most, in any direction.
pub const POSITION: Limits = Limits {
    speed: 3.0,
    acceleration: 2.0,
};
/// Limits of yaw [rad/s], [rad/s^2].
pub const YAW: Limits = Limits {
    speed: 1.0,
    acceleration: 2.0,
};
/// Lag of the acceleration behind the one wanted [s].
const LAG_S: f64 = 0.1;
/// Velocity gain [1/s]: the largest with which an acceleration with this lag does not overshoot.
const VELOCITY_GAIN: f64 = 1.0 / (4.0 * LAG_S);
/// Position gain [1/s]: the largest with which all poles are real.
const POSITION_GAIN: f64 = 2.0 / (27.0 * LAG_S);

/// Limits per second and per second squared.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub speed: f64,
    pub acceleration: f64,
}

/// Farthest target along each axis of the world [m].
pub const FARTHEST_M: f64 = 1000.0;
/// How long a target is followed at the most without another one [s].
pub const PATIENCE_S: f64 = 0.5;

/// Why a target is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum TargetError {
    #[error(
        "position of the target: {0} m is out of range: allowed are -{FARTHEST_M} to {FARTHEST_M} m"
    )]
    Position(f64),
    #[error("speed of the target: {0} m/s is out of range: allowed are up to {most} m/s", most = POSITION.speed)]
    Speed(f64),
    #[error("yaw of the target: {0} rad is out of range: allowed are -{TAU} to {TAU} rad")]
    Yaw(f64),
}

/// Checks what a ground station asks for.
pub fn check(target: &FlightTarget) -> Result<(), TargetError> {
    let is_near = |it: &f64| it.abs() <= FARTHEST_M;
    if let Some(far) = target.position_w_m.into_iter().find(|it| !is_near(it)) {
        return Err(TargetError::Position(far));
    }
    let speed = Vector3::from(target.velocity_w_m_s).norm();
    // A speed that is no number is no speed either.
    if !(0.0..=POSITION.speed).contains(&speed) {
        return Err(TargetError::Speed(speed));
    }
    match target.yaw_rad.abs() <= TAU {
        true => Ok(()),
        false => Err(TargetError::Yaw(target.yaw_rad)),
    }
}

/// The reference at a tick, and what it follows.
#[derive(Clone, Copy, Debug)]
pub struct Guidance {
    period_s: f64,
    target: FlightTarget,
    /// The target that holds from its first tick on.
    next: Option<FlightTarget>,
    reference: Reference,
}

impl Guidance {
    /// At rest at a position [m] and a yaw [rad].
    pub fn at(position_w_m: [f64; 3], yaw_rad: f64, period_s: f64) -> Self {
        Self {
            period_s,
            target: FlightTarget {
                yaw_rad,
                ..FlightTarget::default()
            },
            next: None,
            reference: Reference {
                position_w_m,
                yaw_rad,
                ..Reference::default()
            },
        }
    }

    /// The target in force.
    pub const fn target(&self) -> &FlightTarget {
        &self.target
    }

    /// The newest target, which may wait for its first tick.
    pub fn newest(&self) -> &FlightTarget {
        self.next.as_ref().unwrap_or(&self.target)
    }

    pub const fn reference(&self) -> &Reference {
        &self.reference
    }

    /// Takes a target that holds from its first tick on, in place of another one that waits for its first tick.
    pub const fn aim(&mut self, target: FlightTarget) {
        self.next = Some(target);
    }

    /// Settles what is followed from a tick on: call it for every tick.
    pub fn enter(&mut self, tick: u64) {
        if let Some(next) = self.next.take_if(|next| next.from_tick <= tick) {
            self.target = next;
        }
        let target = &self.target;
        let (velocity, position) = match TargetKind::from_wire(target.kind) {
            Some(TargetKind::Position) => (target.velocity_w_m_s, Some(target.position_w_m)),
            Some(TargetKind::Velocity) => (target.velocity_w_m_s, None),
            Some(TargetKind::Hold) | None => ([0.0; 3], None),
        };
        let motion = self.motion();
        let distance = position.map(|it| Vector3::from(it) - motion.value);
        let jerk = motion.jerk(&POSITION, distance, velocity.into());
        self.reference.jerk_w_m_s3 = jerk.into();
    }

    /// Moves the reference on to the next tick.
    pub fn advance(&mut self) {
        let (motion, yaw) = (self.motion(), self.yaw());
        let way = Vector1::new(wrap(self.target.yaw_rad - yaw.value.x));
        let yaw_jerk = yaw.jerk(&YAW, Some(way), Vector1::zeros());
        let yaw = yaw.after(self.period_s, &yaw_jerk);
        let motion = motion.after(self.period_s, &self.reference.jerk_w_m_s3.into());
        self.reference = Reference {
            position_w_m: motion.value.into(),
            velocity_w_m_s: motion.rate.into(),
            acceleration_w_m_s2: motion.acceleration.into(),
            yaw_rad: yaw.value.x,
            yaw_rate_rad_s: yaw.rate.x,
            yaw_acceleration_rad_s2: yaw.acceleration.x,
            ..self.reference
        };
    }

    fn motion(&self) -> Motion<3> {
        Motion {
            value: self.reference.position_w_m.into(),
            rate: self.reference.velocity_w_m_s.into(),
            acceleration: self.reference.acceleration_w_m_s2.into(),
        }
    }

    fn yaw(&self) -> Motion<1> {
        Motion {
            value: Vector1::new(self.reference.yaw_rad),
            rate: Vector1::new(self.reference.yaw_rate_rad_s),
            acceleration: Vector1::new(self.reference.yaw_acceleration_rad_s2),
        }
    }
}

/// A value that moves, and its first two derivatives.
struct Motion<const N: usize> {
    value: SVector<f64, N>,
    rate: SVector<f64, N>,
    acceleration: SVector<f64, N>,
}

impl<const N: usize> Motion<N> {
    /// Third derivative on the way to a target this far away, if it has a place, with a rate besides.
    fn jerk(
        &self,
        limits: &Limits,
        distance: Option<SVector<f64, N>>,
        rate: SVector<f64, N>,
    ) -> SVector<f64, N> {
        let towards = distance.map_or_else(SVector::zeros, |it| it * approach(limits, it.norm()));
        let wanted = within(limits.speed, rate + towards);
        let wanted = within(limits.acceleration, (wanted - self.rate) * VELOCITY_GAIN);
        (wanted - self.acceleration) / LAG_S
    }

    fn after(&self, time_s: f64, jerk: &SVector<f64, N>) -> Self {
        let Self {
            value,
            rate,
            acceleration,
        } = self;
        Self {
            value: value
                + (rate + (acceleration + jerk * (time_s / 3.0)) * (time_s / 2.0)) * time_s,
            rate: rate + (acceleration + jerk * (time_s / 2.0)) * time_s,
            acceleration: acceleration + jerk * time_s,
        }
    }
}

/// Speed towards a target per distance [1/s].
fn approach(limits: &Limits, distance: f64) -> f64 {
    let braking = limits.acceleration / 2.0;
    let linear = braking / (POSITION_GAIN * POSITION_GAIN);
    if distance <= linear {
        return POSITION_GAIN;
    }
    let speed = (2.0 * braking * (distance - linear / 2.0)).sqrt();
    speed.min(limits.speed) / distance
}

/// A vector, shortened to a length that it may have.
fn within<const N: usize>(most: f64, vector: SVector<f64, N>) -> SVector<f64, N> {
    let length = vector.norm();
    if length > most {
        vector * (most / length)
    } else {
        vector
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_S: f64 = 1e-3;

    fn length(vector: [f64; 3]) -> f64 {
        Vector3::from(vector).norm()
    }

    /// Flies targets, each so many ticks after the one before, for so many ticks more; looks at each step.
    fn fly(
        targets: &[(u64, FlightTarget)],
        ticks: u64,
        mut look: impl FnMut(u64, &Reference, &Reference),
    ) -> Reference {
        let mut guidance = Guidance::at([1.0, 2.0, 3.0], 0.5, PERIOD_S);
        let mut tick = 0;
        let mut fly_to = |guidance: &mut Guidance, end: u64| {
            while tick < end {
                guidance.enter(tick);
                let before = guidance.reference;
                guidance.advance();
                tick += 1;
                look(tick, &before, &guidance.reference);
            }
        };
        let mut from_tick = 0;
        for (after, target) in targets {
            from_tick += after;
            fly_to(&mut guidance, from_tick);
            guidance.aim(FlightTarget {
                from_tick,
                ..*target
            });
        }
        fly_to(&mut guidance, from_tick + ticks);
        guidance.reference
    }

    fn target() -> impl Strategy<Value = FlightTarget> {
        let position = prop::array::uniform3(-20.0..20.0);
        let velocity = prop::array::uniform3(-1.7..1.7);
        (0..3_u64, position, velocity, -4.0..4.0).prop_map(
            |(kind, position_w_m, velocity_w_m_s, yaw_rad)| FlightTarget {
                kind,
                position_w_m,
                velocity_w_m_s,
                yaw_rad,
                ..FlightTarget::default()
            },
        )
    }

    proptest! {
        #[test]
        fn whatever_the_targets_nothing_jumps_and_no_limit_is_exceeded(
            targets in prop::collection::vec((0..3000_u64, target()), 1..8),
        ) {
            let mut faults = Vec::new();
            fly(&targets, 5000, |tick, before, after| {
                let [speed, acceleration] = [after.velocity_w_m_s, after.acceleration_w_m_s2].map(length);
                let [rate, turn] = [after.yaw_rate_rad_s, after.yaw_acceleration_rad_s2].map(f64::abs);
                let step = std::array::from_fn(|i| after.position_w_m[i] - before.position_w_m[i]);
                let kick = std::array::from_fn(|i| after.acceleration_w_m_s2[i] - before.acceleration_w_m_s2[i]);
                let most = 1.0 + 1e-9;
                let is_within = speed <= POSITION.speed * most
                    && acceleration <= POSITION.acceleration * most
                    && rate <= YAW.speed * most
                    && turn <= YAW.acceleration * most
                    && length(step) <= POSITION.speed * PERIOD_S * most
                    && length(kick) <= 2.0 * POSITION.acceleration / LAG_S * PERIOD_S * most;
                if !is_within {
                    faults.push((tick, speed, acceleration, rate, turn));
                }
            });
            prop_assert!(faults.is_empty(), "{:?}", faults.first());
        }

        #[test]
        fn a_target_is_reached_without_an_overshoot_and_a_hold_stops(to in target()) {
            let (kind, velocity_w_m_s) = (TargetKind::Position as u64, [0.0; 3]);
            let to = FlightTarget { kind, velocity_w_m_s, ..to };
            let (start, end) = (Vector3::new(1.0, 2.0, 3.0), Vector3::from(to.position_w_m));
            let (way, mut beyond) = ((end - start).normalize(), 0.0_f64);
            let last = fly(&[(0, to)], 40_000, |_, _, after| {
                beyond = beyond.max((Vector3::from(after.position_w_m) - end).dot(&way));
            });
            let away = Vector3::from(last.position_w_m) - end;
            prop_assert!(away.norm() < 1e-6, "{away:?}");
            prop_assert!(wrap(last.yaw_rad - to.yaw_rad).abs() < 1e-6);
            prop_assert!(beyond < 1e-3, "{beyond}");
            let mut stopped = Vec::new();
            fly(&[(0, to), (2000, FlightTarget::default())], 6000, |tick, _, after| {
                if tick > 7900 {
                    stopped.push(length(after.velocity_w_m_s));
                }
            });
            prop_assert!(stopped.iter().all(|speed| *speed < 1e-3), "{:?}", stopped.first());
        }
    }

    #[test]
    fn a_target_waits_for_its_first_tick() {
        let mut guidance = Guidance::at([0.0; 3], 0.0, PERIOD_S);
        let kind = TargetKind::Position as u64;
        guidance.aim(FlightTarget {
            from_tick: 7,
            kind,
            position_w_m: [1.0; 3],
            ..FlightTarget::default()
        });
        for tick in 0..20 {
            guidance.enter(tick);
            assert_eq!(guidance.target().kind == kind, tick >= 7);
            assert_eq!(
                guidance.reference().jerk_w_m_s3 != [0.0; 3],
                tick >= 7,
                "{tick}"
            );
            guidance.advance();
        }
    }
}
