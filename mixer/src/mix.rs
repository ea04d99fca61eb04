//! Mixing: (7) inverted, and what is granted of a demand that exceeds the rotors' limits.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri).
//!
//! Differences from the paper (docs/paper.md lists them all):
//! * Row 4 of (7) uses kappa = d/k, not the printed d; see [`messages::allocation`].
//! * The paper's rotors have no limits. Here each thrust stays within [f_min, f_max]. [`roll_pitch_first`] grants roll
//!   and pitch, then a reserve of yaw, then thrust, then the rest of yaw: without roll and pitch a vehicle tumbles,
//!   while it only sinks or climbs with another thrust. [`thrust_first`] grants thrust, then roll and pitch, then yaw.
//!   In both, roll and pitch are scaled as one, so that their direction is kept.

use messages::allocation::Allocation;
use nalgebra::{Vector3, Vector4};

/// Share of the rotors' range up to which yaw is granted before thrust, as in PX4.
pub const YAW_RESERVE: f64 = 0.15;

/// Rotor thrusts for a demand, as far as the rotors can meet it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix {
    /// Thrust of each rotor, within its limits [N].
    pub f: Vector4<f64>,
    /// Share of the roll and pitch torque that is met, 0 to 1.
    pub roll_pitch_share: f64,
    /// Share of the yaw torque that is met, 0 to 1.
    pub yaw_share: f64,
    /// Thrust given over thrust demanded, less 1: 0 where it is met, NaN where none is demanded and some is given.
    pub thrust_excess_share: f64,
    /// Whether the demand could not be met in full, thrust included.
    pub saturated: bool,
}

/// (7) inverted: rotor thrusts [N] within `[f_min, f_max]` [N] for total thrust `u` [N] and torque `tau` [N m, body];
/// roll and pitch first, then yaw up to [`YAW_RESERVE`], then thrust, then the rest of yaw.
///
/// Of a demand that is not a number nothing is met: it counts as the smallest thrust or as no torque.
pub fn roll_pitch_first(
    allocation: &Allocation,
    u: f64,
    tau: &Vector3<f64>,
    f_min: f64,
    f_max: f64,
) -> Mix {
    let room = f_max - f_min;
    let [(roll_pitch, roll_pitch_possible), (yaw, yaw_possible)] = torques(allocation, tau);
    let (low, high) = range(&roll_pitch);
    let span = high - low;
    let roll_pitch_fits = if span > room { room / span } else { 1.0 };
    let roll_pitch = roll_pitch * roll_pitch_fits;
    let reserve = reserved_share(&roll_pitch, &yaw, room);
    let (low, high) = range(&(roll_pitch + yaw * reserve));
    // Not `clamp`, which hands a NaN on.
    let common = (u / 4.0).max(f_min - low).min(f_max - high);
    let f = Vector4::repeat(common) + roll_pitch;
    let yaw_fits = largest_share(&f, &yaw, f_min, f_max).max(reserve);
    Mix::new(
        u,
        common,
        (f + yaw * yaw_fits).map(|f_i| f_i.max(f_min).min(f_max)),
        roll_pitch_fits * roll_pitch_possible,
        yaw_fits * yaw_possible,
    )
}

/// As [`roll_pitch_first`], but thrust first, then roll and pitch, then yaw.
pub fn thrust_first(
    allocation: &Allocation,
    u: f64,
    tau: &Vector3<f64>,
    f_min: f64,
    f_max: f64,
) -> Mix {
    let common = (u / 4.0).max(f_min).min(f_max);
    let mut f = Vector4::repeat(common);
    let [roll_pitch_share, yaw_share] = torques(allocation, tau).map(|(torque, possible)| {
        let share = largest_share(&f, &torque, f_min, f_max);
        // The exact sum is within the limits, the rounded one may be a bit outside.
        f = (f + torque * share).map(|f_i| f_i.max(f_min).min(f_max));
        share * possible
    });
    Mix::new(u, common, f, roll_pitch_share, yaw_share)
}

impl Mix {
    fn new(u: f64, common: f64, f: Vector4<f64>, roll_pitch_share: f64, yaw_share: f64) -> Self {
        let asked = u / 4.0;
        let is_met = common == asked;
        let thrust_excess_share = match common / asked - 1.0 {
            _ if is_met => 0.0,
            excess if asked > 0.0 => excess,
            _ => f64::NAN,
        };
        Self {
            f,
            roll_pitch_share,
            yaw_share,
            thrust_excess_share,
            saturated: !is_met || roll_pitch_share < 1.0 || yaw_share < 1.0,
        }
    }
}

/// Rotor thrusts [N] for roll and pitch, and for yaw, and the share of each that is possible: 0 of one that is not a
/// number. Without a drag torque in the model no yaw is possible.
fn torques(allocation: &Allocation, tau: &Vector3<f64>) -> [(Vector4<f64>, f64); 2] {
    [
        Vector3::new(tau.x, tau.y, 0.0),
        Vector3::new(0.0, 0.0, tau.z),
    ]
    .map(|tau| match allocation.thrusts(0.0, &tau) {
        f if f.iter().all(|f_i| f_i.is_finite()) => (f, 1.0),
        _ => (Vector4::zeros(), 0.0),
    })
}

/// The smallest and the largest of four finite thrusts [N]; `min` and `max` take NaN into account, which takes longer.
fn range(f: &Vector4<f64>) -> (f64, f64) {
    f.iter().fold((f.x, f.x), |(low, high), f_i| {
        let low = if *f_i < low { *f_i } else { low };
        let high = if *f_i > high { *f_i } else { high };
        (low, high)
    })
}

/// Share of the yaw that is granted before thrust: within the reserve, and within the range that roll and pitch leave.
fn reserved_share(roll_pitch: &Vector4<f64>, yaw: &Vector4<f64>, room: f64) -> f64 {
    let d = roll_pitch;
    let (raised, lowered) = ([d.x, d.z], [d.y, d.w]);
    let ([a, b], [c, d]) = if yaw.x > 0.0 {
        (raised, lowered)
    } else {
        (lowered, raised)
    };
    let left = room - (a.max(b) - c.min(d));
    let (step, most) = (yaw.x.abs(), (YAW_RESERVE * room).min(left).max(0.0) / 2.0);
    if step > most { most / step } else { 1.0 }
}

/// The largest s in [0, 1] that keeps every rotor of `f + s d` within `[f_min, f_max]`.
fn largest_share(f: &Vector4<f64>, d: &Vector4<f64>, f_min: f64, f_max: f64) -> f64 {
    let mut s = 1.0_f64;
    for (f_i, d_i) in f.iter().zip(d) {
        let room = if *d_i > 0.0 { f_max - f_i } else { f_min - f_i };
        // A step that fits is not divided into, so that rounding cannot make it saturate.
        if room.abs() < d_i.abs() {
            s = s.min(room / d_i);
        }
    }
    s
}

/// (6) inverted: the speed [rad/s] at which a rotor gives each thrust `f` [N, not negative]; `k` in N s^2.
pub fn speeds(f: &Vector4<f64>, k: f64) -> Vector4<f64> {
    f.map(|f_i| (f_i / k).sqrt())
}
