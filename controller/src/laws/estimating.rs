//! Outer law `estimating`: the paper's, which learns thrust scale and drag.
//!
//! Source of the loop: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran,
//! Montazeri), (9)-(16), with the differences of [`crate::laws::pd`]. The paper takes mass and k_t as known: where the
//! mass is 30 % off, its vehicle sags by metres. Here both are estimated, by the same normalised gradient as in the
//! paper's inner loop (docs/theorem.md), from the velocity that was gained over the last tick:
//!
//! ```text
//!     lam = m_nominal/m, sig = k_t/m                          (1):  dv = -g z_e + lam p1 + sig p2
//!     p1 = R_ z_e u_m/m_nominal,  u_m = sum k mean(w^2),  p2 = -v_
//!     z = v - v_ - T(-g z_e + lam p1 + sig p2)
//!     D = 1 + T(g_l |p1|^2 + g_s |p2|^2)
//!     lam <- clip(lam + g_l p1.z/D, 0.4, 2)
//!     sig <- clip(sig + g_s p2.z/D, 0, 10)
//! ```
//!
//! R_ and v_ are those at the start of the tick, u_m is what the rotors really did in it. So a saturated or late
//! command teaches nothing wrong. Rotors that lose thrust look like a heavier vehicle, and are treated as one.

use control_api::description::{Description, Refused, Settings, number, settings, signal};
use control_api::law::{Desired, Fields, Law, OuterInput, OuterLaw, Rig};
use control_api::saved_state::saved_fields;
use messages::role::Role;
use messages::telemetry::Telemetry;
use nalgebra::Vector3;

use crate::flatness::{desired, thrust_acceleration};
use crate::laws::cascade::check_limits;
use crate::laws::pd::z_b;
use crate::limits::{self, AccelerationLimits, Limits};

const THRUST_SCALE: (f64, f64) = (0.4, 2.0);
/// Bounds of sig [1/s].
const DRAG: (f64, f64) = (0.0, 10.0);

settings! {
    SETTINGS;
    POSITION = "position_1_s2", "1/s^2", number(4.0, 0.01, 100.0), "K_P of the position loop";
    VELOCITY = "velocity_1_s", "1/s", number(3.4, 0.01, 100.0), "K_D of the position loop";
    THRUST_SCALE_GAIN = "thrust_scale_gain_s3_m2", "s^3/m^2", number(0.02, 0.0, 10.0), "g_l, gain of the estimate of the thrust scale; 0 keeps the nominal mass";
    DRAG_GAIN = "drag_gain_s_m2", "s/m^2", number(2.0, 0.0, 1000.0), "g_s, gain of the estimate of the drag; 0 keeps the nominal drag";
    ACCELERATION_Z_MIN = "acceleration_z_min_g", "g", number(0.2, 0.01, 1.0), "smallest vertical thrust acceleration";
    ACCELERATION_Z_MAX = "acceleration_z_max_g", "g", number(2.0, 1.0, 20.0), "largest vertical thrust acceleration";
    TILT_MAX = "tilt_max_rad", "rad", number(35_f64.to_radians(), 0.001, 1.5), "largest angle between the thrust asked for and the vertical";
}

#[derive(Clone, Debug)]
pub struct Estimating {
    rig: Rig,
    k_p: f64,
    k_d: f64,
    limits: AccelerationLimits,
    g_l: f64,
    g_s: f64,
    lam: f64,
    /// Drag k_t/m [1/s].
    sig: f64,
    last: Option<Sample>,
}

/// What is kept of a tick for the next one.
#[derive(Clone, Copy, Debug, Default)]
struct Sample {
    tick: u64,
    /// Velocity, world frame [m/s].
    v: Vector3<f64>,
    z_b: Vector3<f64>,
}

saved_fields!(Sample: tick, v, z_b);

impl Law for Estimating {
    const DESCRIPTION: Description = Description {
        name: "estimating",
        role: Role::Outer,
        version: "1",
        summary: "PD position loop that learns thrust scale and drag: for wrong mass, weak rotors, changed drag",
        source: "Imran, Montazeri, An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle, \
                 (9)-(16); with a normalised-gradient estimate of m and k_t that is not in the paper",
        settings: SETTINGS,
        presets: &[],
        suited: Some(|settings, rig| {
            limits::suited(settings, &ACCELERATION_Z_MIN, &ACCELERATION_Z_MAX, rig)
        }),
        telemetry: &[
            signal("thrust_scale", ""),
            signal("mass_kg", "kg"),
            signal("drag_1_s", "1/s"),
        ],
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let names = [&ACCELERATION_Z_MIN, &ACCELERATION_Z_MAX, &TILT_MAX];
        let limits = Limits::new(settings, names);
        check_limits(&limits)?;
        let sig = rig.airframe.k_t() / rig.airframe.m();
        if sig > DRAG.1 {
            return Err(Refused(format!(
                "translational_drag_kg_s / mass_kg = {sig:.3} 1/s is beyond what `estimating` estimates: allowed is \
                 up to {} 1/s; change the airframe, or fly another outer law",
                DRAG.1
            )));
        }
        Ok(Self {
            rig: *rig,
            k_p: settings.number(&POSITION),
            k_d: settings.number(&VELOCITY),
            limits: AccelerationLimits::new(&limits, rig.airframe.g()),
            g_l: settings.number(&THRUST_SCALE_GAIN),
            g_s: settings.number(&DRAG_GAIN),
            lam: 1.0,
            sig,
            last: None,
        })
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.lam, &mut self.sig, &mut self.last]);
    }
}

impl Estimating {
    /// Learns from the tick that ended at velocity `v` [m/s]; `last` stood at its start.
    fn learn(&mut self, last: &Sample, v: &Vector3<f64>, speed_squared: &[f64; 4]) {
        let (t, airframe) = (self.rig.period_s, &self.rig.airframe);
        let u_m = airframe.k() * speed_squared.iter().sum::<f64>();
        let p1 = last.z_b * (u_m / airframe.m());
        let p2 = -last.v;
        let known = self.lam * p1 + self.sig * p2 - airframe.g() * Vector3::z();
        let z = v - last.v - t * known;
        let d = 1.0 + t * (self.g_l * p1.norm_squared() + self.g_s * p2.norm_squared());
        self.lam = (self.lam + self.g_l * p1.dot(&z) / d).clamp(THRUST_SCALE.0, THRUST_SCALE.1);
        self.sig = (self.sig + self.g_s * p2.dot(&z) / d).clamp(DRAG.0, DRAG.1);
    }
}

impl OuterLaw for Estimating {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Desired {
        let (airframe, rotor) = (self.rig.airframe, self.rig.rotor);
        let (tick, measured, reference) = (input.tick, &input.measured, &input.reference);
        let p = Vector3::from(measured.position_w_m);
        let v = Vector3::from(measured.velocity_w_m_s);
        let eta2 = Vector3::from(measured.attitude_rad);
        let z_b = z_b(&eta2);
        // The rotors' means cover one tick: after a gap nothing is known of the ticks in it.
        let last = self.last.replace(Sample { tick, v, z_b });
        if let Some(last) = last.filter(|last| last.tick + 1 == tick) {
            self.learn(&last, &v, &measured.rotor_speed_squared_mean_rad2_s2);
        }

        let p_d = Vector3::from(reference.position_w_m);
        let v_d = Vector3::from(reference.velocity_w_m_s);
        let dv_d = Vector3::from(reference.acceleration_w_m_s2);
        let wanted = dv_d + self.k_d * (v_d - v) + self.k_p * (p_d - p);
        let (g, k) = (airframe.g(), airframe.k());
        let (a, limited) = self
            .limits
            .limit(&thrust_acceleration(&wanted, &v, g, self.sig));
        // (15), (16), as `pd` has them.
        let u = airframe.m() * a.dot(&z_b) / self.lam;
        telemetry.value[..3].copy_from_slice(&[self.lam, airframe.m() / self.lam, self.sig]);
        desired(rotor.limit(u, k), (&a, limited), reference, g, self.sig)
    }
}
