//! What is flown: a built-in trajectory or a curve through points, stretched in space and time.

use std::sync::Arc;

use control_api::guard::Route;
use messages::content::Reference;
use serde::{Deserialize, Serialize};

use crate::trajectory::{Spline, Trajectory, UnknownTrajectory};

/// A trajectory with its size and tempo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
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

    /// The reference at time `t_s` since the start of the flight [s].
    pub fn reference(&self, t_s: f64) -> Reference {
        let t_s = t_s / self.period;
        let reference = match self.shape {
            Shape::Named(trajectory) => trajectory.reference(t_s),
            Shape::Points(spline) => spline.reference(t_s),
        };
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

    /// The reference of each tick of `period_s` [s].
    pub fn route(self, period_s: f64) -> Route {
        Arc::new(move |tick| self.reference(tick as f64 * period_s))
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

impl From<Trajectory> for ScaledTrajectory {
    fn from(trajectory: Trajectory) -> Self {
        Self::of(trajectory)
    }
}

impl From<ScaledTrajectory> for String {
    /// Its name; a curve through points has none that could be read again.
    fn from(course: ScaledTrajectory) -> Self {
        match course.shape {
            Shape::Named(trajectory) => trajectory.name().into(),
            Shape::Points(_) => "points".into(),
        }
    }
}

impl TryFrom<String> for ScaledTrajectory {
    type Error = UnknownTrajectory;

    fn try_from(name: String) -> Result<Self, UnknownTrajectory> {
        name.parse().map(Self::of)
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
            assert!(
                (cycle_s - 2.0 * 62.83185307).abs() < 1e-6,
                "{trajectory}: {cycle_s}"
            );
            let off = |after_s: f64| {
                let [now, later] = [30.0, 30.0 + after_s].map(|t_s| course.reference(t_s));
                let [dx, dy] = [0, 1].map(|i| (now.position_w_m[i] - later.position_w_m[i]).abs());
                dx.max(dy).max((now.yaw_rad - later.yaw_rad).abs())
            };
            assert!(off(cycle_s) < 1e-9, "{trajectory}");
            assert!(off(cycle_s / 2.0) > 1e-3, "{trajectory}");
            assert_eq!(course.begun_s(), 10.0);
        }
        assert_eq!(
            [Trajectory::Hover, Trajectory::Step].map(|it| ScaledTrajectory::of(it).cycle_s()),
            [None; 2]
        );
        assert_eq!(ScaledTrajectory::of(Trajectory::Step).begun_s(), 0.0);
    }
}
