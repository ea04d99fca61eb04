//! Reference trajectories with analytic derivatives up to snap.
//!
//! They are not in the paper, which only assumes a smooth reference. Each of x, y, z and psi is s(t) (c0 + c1 t + A
//! sin(w t + ph)). The ramp s(t) raises it from rest at the origin over 5 s, so no derivative up to snap jumps. Only
//! `step` has no ramp: it jumps on purpose.

mod knots;
mod spline;

use std::str::FromStr;
use std::sync::Arc;

pub use spline::{AXES, Deviation, Point, Spline, SplineError};

use control_api::guard::Route;
use messages::content::{Reference, State};
use messages::layout::wire_enum;
use messages::math::sin_cos_of_each;
use thiserror::Error;

/// Orders of derivative that a reference holds: value, rate, acceleration, jerk, snap.
pub(crate) const ORDERS: usize = 5;

/// Length of the ramp s(t) [s].
const RAMP_S: f64 = 5.0;

wire_enum! {
    /// A reference trajectory of position and yaw; its name is what the user types.
    #[derive(Hash)]
    pub enum Trajectory {
        /// Climb to 1 m and stay.
        Hover = 0 => "hover",
        /// Jump to (1, -1, 1) m and 0.5 rad of yaw at once.
        Step = 1 => "step",
        /// Circle of 1 m radius, climbing 0.1 m/s.
        Helix = 2 => "helix",
        /// Slow figure of 2 m by 1 m with changing height and yaw.
        Lissajous = 3 => "lissajous",
        /// Quicker figure that excites all three estimates.
        Fast = 4 => "fast",
        /// Targets of a ground station, from rest at the start.
        Mavlink = 5 => "mavlink",
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown trajectory `{0}`; known are {names}", names = Trajectory::ALL.map(Trajectory::name).join(", "))]
pub struct UnknownTrajectory(pub String);

/// One axis before the ramp: c0 + c1 t + A sin(w t + ph).
struct Axis {
    c0: f64,
    c1: f64,
    a: f64,
    w: f64,
    ph: f64,
}

impl Trajectory {
    /// The reference at time `t_s` since the start of the flight [s]; at rest at the origin before it.
    pub fn reference(self, t_s: f64) -> Reference {
        let ramp = match self {
            Self::Step => [1.0, 0.0, 0.0, 0.0, 0.0],
            _ => ramp(t_s),
        };
        let axes = self.axes();
        let phases = sin_cos_of_each(axes.each_ref().map(|axis| axis.w * t_s + axis.ph));
        reference_of(&std::array::from_fn(|i| {
            product(&ramp, &axes[i].derivatives(t_s, phases[i]))
        }))
    }

    /// After which time all that moves repeats, but for a climb [s]; none where it ends at rest.
    pub fn cycle_s(self) -> Option<f64> {
        const fn divisor(a: u64, b: u64) -> u64 {
            if b == 0 { a } else { divisor(b, a % b) }
        }
        // Every w is a multiple of 0.1 rad/s.
        let tenths = self
            .axes()
            .iter()
            .filter(|axis| axis.a != 0.0)
            .map(|axis| (axis.w * 10.0).round() as u64);
        match tenths.fold(0, divisor) {
            0 => None,
            tenths => Some(20.0 * std::f64::consts::PI / tenths as f64),
        }
    }

    /// When it has left its ramp [s].
    pub const fn begun_s(self) -> f64 {
        match self {
            Self::Step => 0.0,
            _ => RAMP_S,
        }
    }

    /// x, y, z and psi of the trajectory.
    const fn axes(self) -> &'static [Axis; 4] {
        const START: [Axis; 4] = [fixed(0.0), fixed(0.0), fixed(0.0), fixed(0.0)];
        const HOVER: [Axis; 4] = [fixed(0.0), fixed(0.0), fixed(1.0), fixed(0.0)];
        const STEP: [Axis; 4] = [fixed(1.0), fixed(-1.0), fixed(1.0), fixed(0.5)];
        const HELIX: [Axis; 4] = [
            Axis {
                ph: std::f64::consts::FRAC_PI_2,
                ..wave(0.0, 1.0, 0.6)
            },
            wave(0.0, 1.0, 0.6),
            Axis {
                c1: 0.1,
                ..fixed(1.0)
            },
            wave(0.0, 0.4, 0.5),
        ];
        const LISSAJOUS: [Axis; 4] = [
            wave(0.0, 2.0, 0.5),
            wave(0.0, 1.0, 1.0),
            wave(1.5, 0.3, 0.7),
            wave(0.0, 0.5, 0.4),
        ];
        const FAST: [Axis; 4] = [
            wave(0.0, 1.5, 1.2),
            wave(0.0, 0.6, 2.4),
            wave(1.5, 0.3, 1.7),
            wave(0.0, 0.3, 0.9),
        ];
        match self {
            Self::Hover => &HOVER,
            Self::Step => &STEP,
            Self::Helix => &HELIX,
            Self::Lissajous => &LISSAJOUS,
            Self::Fast => &FAST,
            Self::Mavlink => &START,
        }
    }
}

/// The reference whose x, y, z [m] and psi [rad] have these values and derivatives.
fn reference_of(&[x, y, z, psi]: &[[f64; ORDERS]; 4]) -> Reference {
    let order = |n: usize| [x[n], y[n], z[n]];
    Reference {
        position_w_m: order(0),
        velocity_w_m_s: order(1),
        acceleration_w_m_s2: order(2),
        jerk_w_m_s3: order(3),
        snap_w_m_s4: order(4),
        yaw_rad: psi[0],
        yaw_rate_rad_s: psi[1],
        yaw_acceleration_rad_s2: psi[2],
    }
}

impl FromStr for Trajectory {
    type Err = UnknownTrajectory;

    fn from_str(name: &str) -> Result<Self, UnknownTrajectory> {
        Self::ALL
            .into_iter()
            .find(|trajectory| trajectory.name() == name)
            .ok_or_else(|| UnknownTrajectory(name.to_owned()))
    }
}

/// An axis that stays where it is.
const fn fixed(c0: f64) -> Axis {
    wave(c0, 0.0, 1.0)
}

/// An axis that swings by `a` around `c0` at `w` [rad/s].
const fn wave(c0: f64, a: f64, w: f64) -> Axis {
    Axis {
        c0,
        c1: 0.0,
        a,
        w,
        ph: 0.0,
    }
}

impl Axis {
    /// Its value and derivatives before the ramp, with sine and cosine of w t + ph.
    fn derivatives(&self, t_s: f64, (sin, cos): (f64, f64)) -> [f64; ORDERS] {
        let &Self { c0, c1, a, w, .. } = self;
        let w2 = w * w;
        [
            c0 + c1 * t_s + a * sin,
            c1 + a * w * cos,
            -a * w2 * sin,
            -a * w2 * w * cos,
            a * w2 * w2 * sin,
        ]
    }
}

/// s(t) = 126 y^5 - 420 y^6 + 540 y^7 - 315 y^8 + 70 y^9, y = t/t_r, and its derivatives: 0 before, 1 after.
///
/// The derivatives are written in z = y (1 - y), since ds/dy = 630 z^4: the powers of y would cancel.
fn ramp(t_s: f64) -> [f64; ORDERS] {
    let y = (t_s / RAMP_S).clamp(0.0, 1.0);
    if y >= 1.0 {
        return [1.0, 0.0, 0.0, 0.0, 0.0];
    }
    let y2 = y * y;
    let s = y2 * y2 * y * (126.0 + y * (-420.0 + y * (540.0 + y * (-315.0 + y * 70.0))));
    let z = y * (1.0 - y);
    let dz = 1.0 - 2.0 * y;
    let z2 = z * z;
    [
        s,
        630.0 * z2 * z2 / RAMP_S,
        2520.0 * z2 * z * dz / (RAMP_S * RAMP_S),
        2520.0 * z2 * (3.0 * dz * dz - 2.0 * z) / (RAMP_S * RAMP_S * RAMP_S),
        15120.0 * z * dz * (dz * dz - 3.0 * z) / (RAMP_S * RAMP_S * RAMP_S * RAMP_S),
    ]
}

/// Leibniz: value and derivatives of a product.
fn product(a: &[f64; ORDERS], b: &[f64; ORDERS]) -> [f64; ORDERS] {
    [
        a[0] * b[0],
        a[1] * b[0] + a[0] * b[1],
        a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2],
        a[3] * b[0] + 3.0 * a[2] * b[1] + 3.0 * a[1] * b[2] + a[0] * b[3],
        a[4] * b[0] + 4.0 * a[3] * b[1] + 6.0 * a[2] * b[2] + 4.0 * a[1] * b[3] + a[0] * b[4],
    ]
}

/// A trajectory with its size and tempo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaledTrajectory {
    shape: Shape,
    size: f64,
    period: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    Named(Trajectory),
    /// It is made once, before the flight, and lives as long as the process: so a law may copy its settings.
    Points(&'static Spline),
}

impl ScaledTrajectory {
    pub const fn of(trajectory: Trajectory) -> Self {
        Self {
            shape: Shape::Named(trajectory),
            size: 1.0,
            period: 1.0,
        }
    }

    /// The curve through points. It is never given back: make one per flight.
    pub fn along(spline: Spline) -> Self {
        Self {
            shape: Shape::Points(Box::leak(Box::new(spline))),
            size: 1.0,
            period: 1.0,
        }
    }

    /// The same, `size` times as large in x, y and z, and taking `period` times as long.
    pub const fn stretched(self, size: f64, period: f64) -> Self {
        Self {
            size,
            period,
            ..self
        }
    }

    /// The reference at time `t_s` since the start of the flight [s]; of a vehicle that a ground station flies, rest at the
    /// origin.
    pub fn reference(&self, t_s: f64) -> Reference {
        let t_s = t_s / self.period;
        let reference = match self.shape {
            Shape::Named(trajectory) => trajectory.reference(t_s),
            Shape::Points(spline) => spline.reference(t_s),
        };
        if self.size == 1.0 && self.period == 1.0 {
            return reference;
        }
        let stretched =
            |vector: [f64; 3], order: u8| vector.map(|value| value * self.factor(self.size, order));
        Reference {
            position_w_m: stretched(reference.position_w_m, 0),
            velocity_w_m_s: stretched(reference.velocity_w_m_s, 1),
            acceleration_w_m_s2: stretched(reference.acceleration_w_m_s2, 2),
            jerk_w_m_s3: stretched(reference.jerk_w_m_s3, 3),
            snap_w_m_s4: stretched(reference.snap_w_m_s4, 4),
            yaw_rad: reference.yaw_rad,
            yaw_rate_rad_s: reference.yaw_rate_rad_s * self.factor(1.0, 1),
            yaw_acceleration_rad_s2: reference.yaw_acceleration_rad_s2 * self.factor(1.0, 2),
        }
    }

    /// What stretching makes of a derivative of some order, where the value is stretched by `size`.
    fn factor(&self, size: f64, order: u8) -> f64 {
        (0..order).fold(size, |factor, _| factor * (1.0 / self.period))
    }

    /// Whether a ground station flies the vehicle: the plant then makes the reference.
    pub fn follows_targets(&self) -> bool {
        self.shape == Shape::Named(Trajectory::Mavlink)
    }

    /// The reference at time `t_s` [s], at which the plant has published this state.
    pub fn flown(&self, t_s: f64, state: &State) -> Reference {
        match self.follows_targets() {
            true => state.reference,
            false => self.reference(t_s),
        }
    }

    /// The reference of each tick of `period_s` [s].
    pub fn route(self, period_s: f64) -> Route {
        Arc::new(move |tick, state| self.flown(tick as f64 * period_s, state))
    }

    /// When it has left its ramp [s].
    pub fn begun_s(&self) -> f64 {
        match self.shape {
            Shape::Named(trajectory) => trajectory.begun_s() * self.period,
            Shape::Points(_) => 0.0,
        }
    }

    /// After which time it repeats, but for a climb [s]; none where it ends at rest.
    pub fn cycle_s(&self) -> Option<f64> {
        match self.shape {
            Shape::Named(trajectory) => Some(trajectory.cycle_s()? * self.period),
            Shape::Points(_) => None,
        }
    }

    /// When it has come to rest for good [s], if it does.
    pub fn end_s(&self) -> Option<f64> {
        match self.shape {
            Shape::Named(_) => None,
            Shape::Points(spline) => Some(spline.end_s() * self.period),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_repeats_after_its_cycle_and_not_sooner() {
        for trajectory in [Trajectory::Lissajous, Trajectory::Fast, Trajectory::Helix] {
            let course = ScaledTrajectory::of(trajectory).stretched(1.0, 2.0);
            let cycle_s = course.cycle_s().unwrap();
            let error = cycle_s - 2.0 * 62.83185307;
            assert!(error.abs() < 1e-6, "{trajectory}: {cycle_s}");
            let off = |after_s: f64| {
                let [now, later] = [30.0, 30.0 + after_s].map(|t_s| course.reference(t_s));
                let [dx, dy] = [0, 1].map(|i| (now.position_w_m[i] - later.position_w_m[i]).abs());
                dx.max(dy).max((now.yaw_rad - later.yaw_rad).abs())
            };
            assert!(off(cycle_s) < 1e-9, "{trajectory}");
            assert!(off(cycle_s / 2.0) > 1e-3, "{trajectory}");
            assert_eq!(course.begun_s(), 10.0);
        }
        let at_rest = [Trajectory::Hover, Trajectory::Step].map(Trajectory::cycle_s);
        assert_eq!(at_rest, [None; 2]);
        assert_eq!(ScaledTrajectory::of(Trajectory::Step).begun_s(), 0.0);
    }
}
