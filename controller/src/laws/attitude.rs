//! Attitudes as rotations: unit quaternions, and what an outer law wants as one.
//!
//! Nothing here is singular, whatever the roll and pitch. Signs and frames are those of [`messages::frames`].

use control_api::law::Desired;
use messages::frames::{RollPitch, quaternion_wb};
use nalgebra::{Matrix3, Vector3};

/// A rotation from one frame into another, as a unit quaternion w + v.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    pub w: f64,
    /// Sine of half the angle, along the axis.
    pub v: Vector3<f64>,
}

impl Attitude {
    /// The rotation of w, x, y, z, of norm 1.
    pub const fn new([w, x, y, z]: [f64; 4]) -> Self {
        Self {
            w,
            v: Vector3::new(x, y, z),
        }
    }

    /// Body to world at roll, pitch, yaw `eta2` [rad].
    pub fn of(eta2: &Vector3<f64>) -> Self {
        let [x, y, z, w] = quaternion_wb(eta2);
        Self::new([w, x, y, z])
    }

    /// The shortest rotation that turns the unit vector `from` into `to`; none where they are opposite.
    pub fn between(from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Self> {
        // 1 + cos a = 2 cos^2(a/2); below this the axis is lost in rounding.
        let twice_w2 = 1.0 + from.dot(to);
        (twice_w2 > 1e-6).then(|| {
            let w = (0.5 * twice_w2).sqrt();
            Self {
                w,
                v: from.cross(to) * (0.5 / w),
            }
        })
    }

    pub fn inverse(&self) -> Self {
        Self {
            w: self.w,
            v: -self.v,
        }
    }

    /// The product of two rotations, as `rot_ac = rot_ab * rot_bc`.
    pub fn times(&self, other: &Self) -> Self {
        Self {
            w: self.w * other.w - self.v.dot(&other.v),
            v: self.w * other.v + other.w * self.v + self.v.cross(&other.v),
        }
    }

    /// The same rotation, by the angle of at most pi.
    pub fn short_way(self) -> Self {
        if self.w < 0.0 {
            Self {
                w: -self.w,
                v: -self.v,
            }
        } else {
            self
        }
    }

    #[rustfmt::skip]
    pub fn matrix(&self) -> Matrix3<f64> {
        let Self { w, v } = *self;
        let (x, y, z) = (v.x, v.y, v.z);
        Matrix3::new(
            1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),       2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),       1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),       2.0 * (y * z + w * x),       1.0 - 2.0 * (x * x + y * y),
        )
    }

    pub fn turn(&self, a: &Vector3<f64>) -> Vector3<f64> {
        self.matrix() * a
    }
}

/// The attitude that an outer law wants, with body rates and their derivative along the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesiredAttitude {
    pub attitude: Attitude,
    /// Body rates of the wanted frame, in that frame [rad/s].
    pub nu2: Vector3<f64>,
    /// Their derivative [rad/s^2].
    pub dnu2: Vector3<f64>,
}

impl DesiredAttitude {
    /// Of the Euler angles wanted and their derivatives: W d(eta2), and its derivative.
    pub fn of(wanted: &Desired) -> Self {
        let eta2 = Vector3::from(wanted.attitude_rad);
        let d_eta2 = Vector3::from(wanted.attitude_rate_rad_s);
        let dd_eta2 = Vector3::from(wanted.attitude_acceleration_rad_s2);
        let roll_pitch = RollPitch::of(&eta2);
        Self {
            attitude: Attitude::of(&eta2),
            nu2: roll_pitch.body_rate(&d_eta2),
            dnu2: roll_pitch.body_rate(&dd_eta2) + roll_pitch.body_rate_dot(&d_eta2, &d_eta2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &Vector3<f64>, b: &Vector3<f64>) {
        assert!((a - b).amax() < 1e-14, "{a} for {b}");
    }

    #[test]
    fn a_quaternion_turns_as_the_matrix_of_its_euler_angles() {
        let eta2 = Vector3::new(2.9, -1.2, 0.7);
        let matrix = RollPitch::of(&eta2).rot_wb(eta2.z);
        assert!((Attitude::of(&eta2).matrix() - matrix).amax() < 1e-15);
        let (a, b) = (
            Attitude::of(&eta2),
            Attitude::of(&Vector3::new(-0.4, 0.3, -2.0)),
        );
        assert!((a.times(&b).matrix() - a.matrix() * b.matrix()).amax() < 1e-15);
        let there_and_back = a.inverse().times(&a);
        close(&there_and_back.v, &Vector3::zeros());
        let minus = Attitude { w: -a.w, v: -a.v };
        assert_eq!(minus.short_way(), a.short_way());
        assert!(a.short_way().w >= 0.0);
    }

    #[test]
    fn the_shortest_turn_leads_from_one_vector_to_the_other() {
        let (from, to) = (Vector3::new(0.6, 0.0, 0.8), Vector3::new(0.0, -0.28, -0.96));
        let turn = Attitude::between(&from, &to).expect("they are not opposite");
        close(&turn.turn(&from), &to);
        close(&turn.turn(&from.cross(&to)), &from.cross(&to));
        assert_eq!(Attitude::between(&from, &-from), None);
    }

    #[test]
    fn wanted_rates_are_those_of_the_wanted_attitude() {
        let wanted = |t: f64| Desired {
            attitude_rad: [0.4 * t, 0.3 - t, t * t],
            attitude_rate_rad_s: [0.4, -1.0, 2.0 * t],
            attitude_acceleration_rad_s2: [0.0, 0.0, 2.0],
            ..Desired::default()
        };
        let (t, h) = (0.7, 1e-5);
        let [before, at, after] = [t - h, t, t + h].map(|t| DesiredAttitude::of(&wanted(t)));
        let spin = at.attitude.matrix().transpose()
            * (after.attitude.matrix() - before.attitude.matrix())
            / (2.0 * h);
        assert!((at.nu2 - Vector3::new(spin.m32, spin.m13, spin.m21)).amax() < 1e-9);
        assert!((at.dnu2 - (after.nu2 - before.nu2) / (2.0 * h)).amax() < 1e-9);
    }
}
