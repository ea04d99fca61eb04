//! Between rotor thrusts and thrust and torque: (7), and net rotor speed (4).
//!
//! Both directions of (7) are here. Row 4 uses kappa = d/k, not the printed d (docs/paper.md). Rotor 1 is rear left, 2
//! rear right, 3 front right, 4 front left; the diagonals share a spin direction.

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::parameters::Airframe;

/// The allocation matrix A of an airframe, held by its two lever arms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allocation {
    /// Lever arm of roll and pitch, l sqrt(2)/2 [m].
    c: f64,
    /// Drag torque per thrust, d/k [m].
    kappa: f64,
}

impl Allocation {
    /// The allocation of an airframe.
    #[must_use]
    pub fn new(airframe: &Airframe) -> Self {
        Self { c: airframe.l() * std::f64::consts::SQRT_2 / 2.0, kappa: airframe.d() / airframe.k() }
    }

    /// A: columns are rotors; rows thrust [N/N] and torque about x, y, z [N m/N].
    #[must_use]
    #[rustfmt::skip]
    #[inline]
    pub fn matrix(&self) -> Matrix4<f64> {
        let Self { c, kappa } = *self;
        Matrix4::new(
            1.0,   1.0,    1.0,   1.0,
            c,     -c,     -c,    c,
            c,     c,      -c,    -c,
            kappa, -kappa, kappa, -kappa,
        )
    }

    /// Thrust u [N] and torque tau [N m] of the rotor thrusts f [N]: A f.
    #[must_use]
    #[inline]
    pub fn wrench(&self, f: &Vector4<f64>) -> (f64, Vector3<f64>) {
        let w = self.matrix() * f;
        (w.x, Vector3::new(w.y, w.z, w.w))
    }

    /// Rotor thrusts [N] that give thrust u [N] and torque tau [N m]: the rows of A are orthogonal, so its
    /// inverse is its transpose with rows scaled. Infinite or NaN where kappa is 0 and `tau.z` is not.
    #[must_use]
    #[inline]
    pub fn thrusts(&self, u: f64, tau: &Vector3<f64>) -> Vector4<f64> {
        let roll = tau.x / (4.0 * self.c);
        let pitch = tau.y / (4.0 * self.c);
        let yaw = if tau.z == 0.0 { 0.0 } else { tau.z / (4.0 * self.kappa) };
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
#[must_use]
#[inline]
pub fn net_speed(w: &Vector4<f64>) -> f64 {
    w.x - w.y + w.z - w.w
}
