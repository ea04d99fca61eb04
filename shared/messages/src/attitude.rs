//! Attitude as a unit quaternion, body to world: free of singularities.
//!
//! The integrator carries the attitude in this form. Euler angles are derived from it, for the laws of the paper, for
//! monitors and for people ([`Attitude::euler_near`]). Components stand in the order w, x, y, z.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3, Vector4};

use crate::frames::quaternion_wb;
use crate::math::atan2;
use crate::vectors::numbers;

/// A rotation from the body into the world frame; q and -q are the same one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    q: Vector4<f64>,
}

numbers!(Attitude: q);

impl Default for Attitude {
    /// Level, nose along x of the world.
    fn default() -> Self {
        Self {
            q: Vector4::new(1.0, 0.0, 0.0, 0.0),
        }
    }
}

impl Attitude {
    /// Of w, x, y, z as [`Self::wxyz`] gives them.
    #[inline(always)]
    pub fn of_wxyz(wxyz: [f64; 4]) -> Self {
        Self { q: wxyz.into() }
    }

    /// That of the Euler angles `eta2` [rad], ZYX.
    pub fn of_euler(eta2: &Vector3<f64>) -> Self {
        let [x, y, z, w] = quaternion_wb(eta2);
        Self {
            q: Vector4::new(w, x, y, z),
        }
    }

    /// Of w, and the sine of half the angle along the axis.
    pub fn of_parts(w: f64, v: Vector3<f64>) -> Self {
        Self {
            q: Vector4::new(w, v.x, v.y, v.z),
        }
    }

    /// The shortest rotation that turns the unit vector `from` into `to`; `None` if they are opposite.
    pub fn between(from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Self> {
        // 1 + cos a = 2 cos^2(a/2); below this the axis is lost in rounding.
        let twice_w2 = 1.0 + from.dot(to);
        (twice_w2 > 1e-6).then(|| {
            let w = (0.5 * twice_w2).sqrt();
            Self::of_parts(w, from.cross(to) * (0.5 / w))
        })
    }

    pub fn scalar(&self) -> f64 {
        self.q.x
    }

    /// Sine of half the angle, along the axis.
    pub fn vector(&self) -> Vector3<f64> {
        Vector3::new(self.q.y, self.q.z, self.q.w)
    }

    pub fn inverse(&self) -> Self {
        Self::of_parts(self.scalar(), -self.vector())
    }

    /// The product of two rotations, as `rot_ac = rot_ab * rot_bc`.
    pub fn times(&self, other: &Self) -> Self {
        let ((w, v), (other_w, other_v)) = (
            (self.scalar(), self.vector()),
            (other.scalar(), other.vector()),
        );
        Self::of_parts(
            w * other_w - v.dot(&other_v),
            w * other_v + other_w * v + v.cross(&other_v),
        )
    }

    /// The same rotation, by the angle of at most pi.
    pub fn short_way(self) -> Self {
        if self.scalar() < 0.0 {
            Self { q: -self.q }
        } else {
            self
        }
    }

    /// A vector of the body frame in the world frame.
    pub fn to_world(&self, v_b: &Vector3<f64>) -> Vector3<f64> {
        self.rot_wb() * v_b
    }

    #[inline]
    pub fn wxyz(&self) -> [f64; 4] {
        self.q.into()
    }

    /// q_dot = 1/2 q (x) (0, nu2): the derivative at body rates `nu2` [rad/s].
    #[inline]
    pub fn rate(&self, nu2: &Vector3<f64>) -> Vector4<f64> {
        let [w, x, y, z] = self.wxyz();
        let half = nu2 * 0.5;
        let (p, q, r) = (half.x, half.y, half.z);
        Vector4::new(
            -x * p - y * q - z * r,
            w * p + y * r - z * q,
            w * q + z * p - x * r,
            w * r + x * q - y * p,
        )
    }

    /// Moved along a derivative for `dt_s` [s], without regard to its length.
    #[inline]
    pub fn along(&self, rate: &Vector4<f64>, dt_s: f64) -> Self {
        Self {
            q: self.q + rate * dt_s,
        }
    }

    /// The same rotation at length 1, from which steps of an integrator lead away.
    #[inline]
    pub fn normalised(&self) -> Self {
        Self {
            q: self.q * (1.0 / self.q.norm_squared().sqrt()),
        }
    }

    /// Body z in the world frame: the third column of J1, along which the rotors push.
    #[inline]
    pub fn z_b_in_w(&self) -> Vector3<f64> {
        let [w, x, y, z] = self.wxyz();
        Vector3::new(
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        )
    }

    /// J1^T `v_w`: a vector of the world frame in the body frame.
    #[inline]
    pub fn to_body(&self, v_w: &Vector3<f64>) -> Vector3<f64> {
        self.rot_wb().tr_mul(v_w)
    }

    /// J1: rotates a vector from the body into the world frame, `v_w = rot_wb * v_b`.
    #[rustfmt::skip]
    #[inline]
    pub fn rot_wb(&self) -> Matrix3<f64> {
        let [w, x, y, z] = self.wxyz();
        Matrix3::new(
            1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),       2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),       1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),       2.0 * (y * z + w * x),       1.0 - 2.0 * (x * x + y * y),
        )
    }

    /// Roll, pitch, yaw [rad]: pitch within +-90 degrees, roll and yaw on the turn that is nearest to `last` [rad].
    ///
    /// Followed tick by tick, roll and yaw are not wrapped. Where the pitch passes +-90 degrees both jump by 180
    /// degrees, which is in the nature of these angles; exactly there, roll and yaw are 0 on the nearest turn.
    #[inline]
    pub fn euler_near(&self, last: &Vector3<f64>) -> Vector3<f64> {
        let [roll, pitch, yaw] = self.arcs().map(|(y, x)| atan2(y, x));
        Vector3::new(followed(roll, last.x), pitch, followed(yaw, last.z))
    }

    /// What roll, pitch and yaw are the angles of: y and x of each.
    #[inline(always)]
    fn arcs(&self) -> [(f64, f64); 3] {
        let [w, x, y, z] = self.wxyz();
        let (r11, r21) = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z));
        let (r32, r33) = (2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y));
        [
            (r32, r33),
            (2.0 * (w * y - x * z), (r11 * r11 + r21 * r21).sqrt()),
            (r21, r11),
        ]
    }
}

/// As [`near`], without a division where no turn lies between.
#[inline(always)]
fn followed(angle_rad: f64, last_rad: f64) -> f64 {
    let off_rad = last_rad - angle_rad;
    if off_rad.abs() < 3.0 {
        // No turns, of the sign that they would have.
        angle_rad + off_rad * 0.0
    } else {
        near(angle_rad, last_rad)
    }
}

/// The angle plus the whole turns that bring it nearest to the last one; where it is near already, its very bits.
#[inline(always)]
pub fn near(angle_rad: f64, last_rad: f64) -> f64 {
    angle_rad + ((last_rad - angle_rad) / TAU).round() * TAU
}
