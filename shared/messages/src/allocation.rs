//! Between rotor thrusts and thrust and torque: (7), and net rotor speed (4).
//!
//! Both directions of (7) are here. Row 4 uses kappa = d/k, not the printed d (docs/paper.md). Rotor 1 is rear left, 2
//! rear right, 3 front right, 4 front left; the diagonals share a spin direction.

use nalgebra::{Vector3, Vector4};

use crate::parameters::Airframe;

/// The allocation matrix A of an airframe, held by its two lever arms.
///
/// ```text
///     [u; tau] = A f,   A = [ 1 1 1 1 ; c -c -c c ; c c -c -c ; kappa -kappa kappa -kappa ]
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allocation {
    /// Lever arm of roll and pitch, l sqrt(2)/2 [m].
    c: f64,
    /// Drag torque per thrust, d/k [m].
    kappa: f64,
    /// 1/4c and 1/4kappa [1/m].
    per_4c: f64,
    per_4kappa: f64,
}

impl Allocation {
    #[inline]
    pub fn new(airframe: &Airframe) -> Self {
        let (c, kappa) = (
            airframe.l() * std::f64::consts::SQRT_2 / 2.0,
            airframe.d() / airframe.k(),
        );
        Self {
            c,
            kappa,
            per_4c: 1.0 / (4.0 * c),
            per_4kappa: 1.0 / (4.0 * kappa),
        }
    }

    /// Thrust u [N] and torque tau [N m] of the rotor thrusts f [N]: A f.
    #[inline]
    pub fn wrench(&self, f: &Vector4<f64>) -> (f64, Vector3<f64>) {
        let roll = f.x - f.y - f.z + f.w;
        let pitch = f.x + f.y - f.z - f.w;
        let yaw = f.x - f.y + f.z - f.w;
        (
            f.x + f.y + f.z + f.w,
            Vector3::new(self.c * roll, self.c * pitch, self.kappa * yaw),
        )
    }

    /// Rotor thrusts [N] that give thrust u [N] and torque tau [N m]: the rows of A are orthogonal, so its
    /// inverse is its transpose with rows scaled. Infinite or NaN where kappa is 0 and `tau.z` is not.
    #[inline]
    pub fn thrusts(&self, u: f64, tau: &Vector3<f64>) -> Vector4<f64> {
        let (roll, pitch) = (tau.x * self.per_4c, tau.y * self.per_4c);
        let yaw = if tau.z == 0.0 {
            0.0
        } else {
            tau.z * self.per_4kappa
        };
        let share = u / 4.0;
        Vector4::new(
            share + roll + pitch + yaw,
            share - roll + pitch - yaw,
            share - roll - pitch + yaw,
            share + roll - pitch - yaw,
        )
    }
}

/// (4): net rotor speed Om [rad/s] that the gyroscopic term sees.
#[inline]
pub fn net_speed(w: &Vector4<f64>) -> f64 {
    w.x - w.y + w.z - w.w
}
