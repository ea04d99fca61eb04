//! Limits of the acceleration that a position loop asks of the thrust.
//!
//! The paper has none. They keep the vehicle upright, and leave the rotors room for the torque.

use control_api::description::{Description, Setting, Settings, Value};
use control_api::law::Rig;
use messages::math::tan;
use nalgebra::Vector3;

/// Limits of the thrust acceleration, as a law's settings have them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Smallest vertical part [g].
    pub acceleration_z_min_g: f64,
    /// Largest vertical part [g].
    pub acceleration_z_max_g: f64,
    pub tilt_max_rad: f64,
}

impl Limits {
    pub fn new(settings: &Settings, [z_min, z_max, tilt_max]: [&Setting; 3]) -> Self {
        Self {
            acceleration_z_min_g: settings.number(z_min),
            acceleration_z_max_g: settings.number(z_max),
            tilt_max_rad: settings.number(tilt_max),
        }
    }

    /// Those of a law whose settings have their names; none of another law.
    pub fn of(law: &Description, settings: &Settings) -> Option<Self> {
        let find = |name| law.settings.iter().find(|setting| setting.name == name);
        let names = [
            find("acceleration_z_min_g")?,
            find("acceleration_z_max_g")?,
            find("tilt_max_rad")?,
        ];
        Some(Self::new(settings, names))
    }
}

/// Settings of a law whose largest vertical acceleration `z_max` [g] the rotors of the airframe can keep.
///
/// Half of what they can give beyond hover is left for the torque; the paper's airframe, whose rotors carry three times
/// its weight, keeps 2 g.
pub fn suited(settings: &Settings, z_min: &Setting, z_max: &Setting, rig: &Rig) -> Settings {
    let (airframe, rotor) = (&rig.airframe, &rig.rotor);
    let most_g = 4.0 * rotor.f_max(airframe.k()) / (airframe.m() * airframe.g());
    let with_room_g = 1.0 + 0.5 * (most_g - 1.0);
    let given_g = settings.number(z_max);
    // Without gravity there is no weight to compare with.
    let max_g = if with_room_g > settings.number(z_min) {
        given_g.min(with_room_g)
    } else {
        given_g
    };
    settings.clone().with(z_max, Value::Number(max_g))
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelerationLimits {
    /// Of its vertical part [m/s^2].
    z_min: f64,
    z_max: f64,
    tilt_max: f64,
}

impl AccelerationLimits {
    /// Those of a law, where gravity is `g` [m/s^2].
    pub fn new(limits: &Limits, g: f64) -> Self {
        Self {
            z_min: limits.acceleration_z_min_g * g,
            z_max: limits.acceleration_z_max_g * g,
            tilt_max: tan(limits.tilt_max_rad),
        }
    }

    /// Keeps a thrust acceleration [m/s^2, world frame] inside the limits; true where one of them was active.
    ///
    /// The vertical part is limited first, then the tilt, by scaling the horizontal part: height before position.
    pub fn limit(&self, a: &Vector3<f64>) -> (Vector3<f64>, bool) {
        let z = a.z.clamp(self.z_min, self.z_max);
        let horizontal = a.xy().norm();
        let allowed = z * self.tilt_max;
        let is_tilted = horizontal > allowed;
        let scale = if is_tilted { allowed / horizontal } else { 1.0 };
        let limited = z != a.z || is_tilted;
        (Vector3::new(scale * a.x, scale * a.y, z), limited)
    }
}
