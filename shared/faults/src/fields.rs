//! The message fields that faults can change, with the names of their axes and their units.
//!
//! These are the fields that a stage reads. The plant's accounts, ground truth and telemetry are not among them: no law
//! reads them, and a fault there would only falsify the report.

use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::layout::FieldType;
use messages::topic::Topic;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name; it ends in its unit.
    pub name: &'static str,
    /// Names of its numbers; none where it is one.
    pub axes: &'static [&'static str],
    pub unit: &'static str,
}

/// A content with fields that faults can change.
pub trait Faulty: Topic {
    const FAULT_FIELDS: &'static [Field];

    /// The numbers of a field; nothing where there is no such field.
    fn field_mut(&mut self, field: usize) -> &mut [f64];
}

const XYZ: &[&str] = &["x", "y", "z"];
const ANGLES: &[&str] = &["roll", "pitch", "yaw"];
const ROTOR: &[&str] = &["1", "2", "3", "4"];

/// Gives a content its fields that faults can change, each with the names of its numbers and its unit.
macro_rules! faulty {
    ($content:ident $(. $part:ident)? { $($name:ident: $axes:expr, $unit:literal;)+ }) => {
        impl Faulty for $content {
            const FAULT_FIELDS: &'static [Field] = &[$(Field {
                name: stringify!($name),
                axes: $axes,
                unit: $unit,
            }),+];

            fn field_mut(&mut self, field: usize) -> &mut [f64] {
                let content = &mut (*self)$(.$part)?;
                match Self::FAULT_FIELDS.get(field).map(|field| field.name) {
                    $(Some(stringify!($name)) => FieldType::items_mut(&mut content.$name),)+
                    _ => &mut [],
                }
            }
        }
    };
}

faulty!(State.measured {
    position_w_m: XYZ, "m";
    velocity_w_m_s: XYZ, "m/s";
    attitude_rad: ANGLES, "rad";
    attitude_quaternion: &["w", "x", "y", "z"], "";
    rate_b_rad_s: XYZ, "rad/s";
    specific_force_b_m_s2: XYZ, "m/s^2";
    rotor_speed_mean_rad_s: ROTOR, "rad/s";
    rotor_speed_squared_mean_rad2_s2: ROTOR, "rad^2/s^2";
    rotor_speed_command_rad_s: ROTOR, "rad/s";
});
faulty!(Setpoint {
    thrust_n: &[], "N";
    attitude_rad: ANGLES, "rad";
    attitude_rate_rad_s: ANGLES, "rad/s";
    attitude_acceleration_rad_s2: ANGLES, "rad/s^2";
});
faulty!(Wrench {
    thrust_n: &[], "N";
    torque_b_nm: XYZ, "N m";
});
faulty!(RotorSpeeds {
    speed_rad_s: ROTOR, "rad/s";
});

#[cfg(test)]
mod tests {
    use super::*;

    /// Every field has as many numbers as names.
    fn check<C: Faulty>() {
        for (place, field) in C::FAULT_FIELDS.iter().enumerate() {
            let length = C::default().field_mut(place).len();
            assert_eq!(length, field.axes.len().max(1), "{}", field.name);
        }
        assert!(C::default().field_mut(C::FAULT_FIELDS.len()).is_empty());
    }

    #[test]
    fn the_tables_are_those_of_the_messages() {
        check::<State>();
        check::<Setpoint>();
        check::<Wrench>();
        check::<RotorSpeeds>();
    }
}
