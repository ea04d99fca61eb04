//! The outer loop: from position error to total thrust and wanted attitude.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (9)-(16). Differences from the paper:
//! * The right side of (10) is 0.
//! * The drag (k_t/m) v stands in all three components, with the measured v, so that (10) holds exactly.
//! * Acceleration and thrust are limited; the paper's are not.
//! * The derivatives of roll and pitch are fed forward along the reference ([`crate::flatness`]).

use control_api::description::{Description, Refused, Settings, number, settings, xyz};
use control_api::law::{Desired, Fields, Law, OuterInput, OuterLaw, Rig};
use messages::frames::RollPitch;
use messages::limits::RotorLimits;
use messages::parameters::Airframe;
use messages::role::Role;
use messages::telemetry::Telemetry;
use nalgebra::Vector3;

use crate::flatness::{desired, thrust_acceleration};
use crate::gains::{PRESET_NAMES, preset};
use crate::limits::{self, AccelerationLimits, Limits};

settings! {
    SETTINGS;
    pub POSITION_1_S2 = "position_1_s2", "1/s^2", number(1.0, f64::MIN_POSITIVE, f64::MAX), "K_P";
    pub VELOCITY_1_S = "velocity_1_s", "1/s", number(1.0, f64::MIN_POSITIVE, f64::MAX), "K_D";
    pub ACCELERATION_Z_MIN_G = "acceleration_z_min_g", "g", number(0.2, f64::MIN_POSITIVE, f64::MAX), "smallest vertical acceleration that the thrust gives";
    pub ACCELERATION_Z_MAX_G = "acceleration_z_max_g", "g", number(2.0, f64::MIN_POSITIVE, f64::MAX), "largest vertical acceleration that the thrust gives";
    pub TILT_MAX_RAD = "tilt_max_rad", "rad", number(0.610_865_238_198_015_3, 1e-3, 1.5), "largest angle between the thrust and the vertical"; // 35 degrees.
}

/// The paper's outer loop. It keeps nothing from one tick to the next.
#[derive(Clone, Debug)]
pub struct Pd {
    /// K_P [1/s^2].
    k_p: f64,
    /// K_D [1/s].
    k_d: f64,
    limits: AccelerationLimits,
    model: Airframe,
    /// k_t/m [1/s].
    drag: f64,
    rotor: RotorLimits,
}

impl Law for Pd {
    const DESCRIPTION: Description = Description {
        name: "pd",
        role: Role::Outer,
        version: "1",
        summary: "PD position loop with feedforward of acceleration, jerk and snap",
        source: "Imran and Montazeri, An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial \
                 Vehicle, (9)-(16); `ironbird docs paper` lists the differences",
        settings: SETTINGS,
        presets: &[
            preset(PRESET_NAMES[0], &[]),
            preset(PRESET_NAMES[1], &[]),
            preset(PRESET_NAMES[2], &[]),
        ],
        suited: Some(|settings, rig| {
            limits::suited(settings, &ACCELERATION_Z_MIN_G, &ACCELERATION_Z_MAX_G, rig)
        }),
        telemetry: &xyz!("acceleration_wanted", "m_s2", "m/s^2"),
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let names = [&ACCELERATION_Z_MIN_G, &ACCELERATION_Z_MAX_G, &TILT_MAX_RAD];
        let limits = Limits::new(settings, names);
        let (z_min_g, z_max_g) = (limits.acceleration_z_min_g, limits.acceleration_z_max_g);
        if z_min_g > z_max_g {
            return Err(Refused(format!(
                "outer.{} = {z_min_g} must not be above outer.{} = {z_max_g}",
                ACCELERATION_Z_MIN_G.name, ACCELERATION_Z_MAX_G.name
            )));
        }
        Ok(Self {
            k_p: settings.number(&POSITION_1_S2),
            k_d: settings.number(&VELOCITY_1_S),
            limits: AccelerationLimits::new(&limits, rig.airframe.g()),
            model: rig.airframe,
            drag: rig.airframe.k_t() / rig.airframe.m(),
            rotor: rig.rotor,
        })
    }

    fn state(&mut self, _: &mut Fields) {}
}

impl OuterLaw for Pd {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Desired {
        let (model, measured, reference) = (&self.model, &input.measured, &input.reference);
        let position = Vector3::from(measured.position_w_m);
        let velocity = Vector3::from(measured.velocity_w_m_s);
        let eta2 = Vector3::from(measured.attitude_rad);

        let wanted = Vector3::from(reference.acceleration_w_m_s2)
            + self.k_d * (Vector3::from(reference.velocity_w_m_s) - velocity)
            + self.k_p * (Vector3::from(reference.position_w_m) - position);
        telemetry.value[..3].copy_from_slice(wanted.as_slice());
        let (g, drag) = (model.g(), self.drag);
        let free = thrust_acceleration(&wanted, &velocity, g, drag);
        let (a, limited) = self.limits.limit(&free);
        let thrust_n = self.rotor.limit(thrust(&a, &eta2, model), model.k());
        desired(thrust_n, (&a, limited), reference, g, drag)
    }
}

/// (15), (16): total thrust u [N], the part of m `a` along the body's z axis at the measured attitude [rad].
pub fn thrust(a: &Vector3<f64>, eta2: &Vector3<f64>, model: &Airframe) -> f64 {
    model.m() * a.dot(&z_b(eta2))
}

/// J1 z_e: body z in the world frame, at the attitude `eta2` [rad].
pub fn z_b(eta2: &Vector3<f64>) -> Vector3<f64> {
    RollPitch::of(eta2).rot_wb(eta2.z).column(2).into_owned()
}
