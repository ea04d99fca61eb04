//! What is flown: a built-in trajectory or a curve through points, stretched in space and time.

use serde::{Deserialize, Serialize};

use crate::trajectory::{ORDERS, Reference, Spline, Trajectory, UnknownTrajectory};

/// A trajectory with its size and tempo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Course {
    shape: Shape,
    size: f64,
    period: f64,
}

/// What the curve is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    Named(Trajectory),
    /// It is made once, before the flight, and lives as long as the process: so a law may copy its settings.
    Points(&'static Spline),
}

impl Course {
    /// A built-in trajectory as it is.
    #[must_use]
    pub const fn of(trajectory: Trajectory) -> Self {
        Self { shape: Shape::Named(trajectory), size: 1.0, period: 1.0 }
    }

    /// The curve through points. It is never given back: make one per flight.
    #[must_use]
    pub fn along(spline: Spline) -> Self {
        Self { shape: Shape::Points(Box::leak(Box::new(spline))), size: 1.0, period: 1.0 }
    }

    /// The same, `size` times as large in x, y and z, and taking `period` times as long.
    #[must_use]
    pub const fn stretched(self, size: f64, period: f64) -> Self {
        Self { size, period, ..self }
    }

    /// The reference at time `t_s` since the start of the flight [s].
    #[must_use]
    pub fn reference(&self, t_s: f64) -> Reference {
        let t_s = t_s / self.period;
        let mut reference = match self.shape {
            Shape::Named(trajectory) => trajectory.reference(t_s),
            Shape::Points(spline) => spline.reference(t_s),
        };
        let tempo = 1.0 / self.period;
        for (i, axis) in reference.axis.iter_mut().enumerate() {
            let mut factor = if i < 3 { self.size } else { 1.0 };
            for derivative in axis.iter_mut().take(ORDERS) {
                *derivative *= factor;
                factor *= tempo;
            }
        }
        reference
    }

    /// When it has come to rest for good [s], if it does.
    #[must_use]
    pub fn end_s(&self) -> Option<f64> {
        match self.shape {
            Shape::Named(_) => None,
            Shape::Points(spline) => Some(spline.end_s() * self.period),
        }
    }
}

impl From<Trajectory> for Course {
    fn from(trajectory: Trajectory) -> Self {
        Self::of(trajectory)
    }
}

impl From<Course> for String {
    /// Its name; a curve through points has none that could be read again.
    fn from(course: Course) -> Self {
        match course.shape {
            Shape::Named(trajectory) => trajectory.name().into(),
            Shape::Points(_) => "points".into(),
        }
    }
}

impl TryFrom<String> for Course {
    type Error = UnknownTrajectory;

    fn try_from(name: String) -> Result<Self, UnknownTrajectory> {
        name.parse().map(Self::of)
    }
}
