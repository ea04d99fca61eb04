//! Mixing: (7) inverted; priority is thrust, then roll and pitch, then yaw.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri).
//!
//! Differences from the paper (docs/paper.md lists them all):
//! * Row 4 of (7) uses kappa = d/k, not the printed d; see [`messages::allocation`].
//! * The paper's rotors have no limits. Here each thrust stays within [f_min, f_max]: the common thrust is granted
//!   first, then as much of roll and pitch as fits, then as much of yaw. An axis group is scaled as one, so its
//!   direction is kept: a demand for roll never becomes pitch. Yaw comes last, because it costs the most thrust for the
//!   least control and the vehicle stays upright without it.

use messages::allocation::Allocation;
use nalgebra::{Vector3, Vector4};

/// Rotor thrusts for a demand, as far as the rotors can meet it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix {
    /// Thrust of each rotor, within its limits [N].
    pub f: Vector4<f64>,
    /// Share of the roll and pitch torque that is met, 0 to 1.
    pub roll_pitch_share: f64,
    /// Share of the yaw torque that is met, 0 to 1.
    pub yaw_share: f64,
    /// Whether the demand could not be met in full, thrust included.
    pub saturated: bool,
}

/// (7) inverted: rotor thrusts [N] within `[f_min, f_max]` [N] for total thrust `u` [N] and torque `tau` [N m, body].
///
/// Of a demand that is not a number nothing is met: it counts as the smallest thrust or as no torque.
pub fn mix(allocation: &Allocation, u: f64, tau: &Vector3<f64>, f_min: f64, f_max: f64) -> Mix {
    // Not `clamp`, which hands a NaN on.
    let share = (u / 4.0).max(f_min).min(f_max);
    let common = Vector4::repeat(share);
    let roll_pitch = allocation.thrusts(0.0, &Vector3::new(tau.x, tau.y, 0.0));
    let (f, roll_pitch_share) = add_what_fits(&common, &roll_pitch, f_min, f_max);
    let yaw = allocation.thrusts(0.0, &Vector3::new(0.0, 0.0, tau.z));
    let (f, yaw_share) = add_what_fits(&f, &yaw, f_min, f_max);
    let saturated = share != u / 4.0 || roll_pitch_share < 1.0 || yaw_share < 1.0;
    Mix {
        f,
        roll_pitch_share,
        yaw_share,
        saturated,
    }
}

/// `f + s d` with the largest s in [0, 1] that keeps every rotor within `[f_min, f_max]`, and that s.
fn add_what_fits(
    f: &Vector4<f64>,
    d: &Vector4<f64>,
    f_min: f64,
    f_max: f64,
) -> (Vector4<f64>, f64) {
    // Without a drag torque in the model, no yaw can be given: the step is infinite.
    if !d.iter().all(|d_i| d_i.is_finite()) {
        return (*f, 0.0);
    }
    let mut s = 1.0_f64;
    for (f_i, d_i) in f.iter().zip(d) {
        let room = if *d_i > 0.0 { f_max - f_i } else { f_min - f_i };
        // A step that fits is not divided into, so that rounding cannot make it saturate.
        if room.abs() < d_i.abs() {
            s = s.min(room / d_i);
        }
    }
    // The exact sum is within the limits, the rounded one may be a bit outside.
    ((f + d * s).map(|f_i| f_i.max(f_min).min(f_max)), s)
}

/// (6) inverted: the speed [rad/s] at which a rotor gives each thrust `f` [N, not negative]; `k` in N s^2.
pub fn speeds(f: &Vector4<f64>, k: f64) -> Vector4<f64> {
    f.map(|f_i| (f_i / k).sqrt())
}
