//! The fields that a stage reads, each declared once: names of its numbers, and what is plausible.
//!
//! Inspection takes what is plausible from here, and faults the fields that they can change. The plant's accounts, ground
//! truth and telemetry are not among them: no law reads them, and a fault there would only falsify the report.

use crate::content::{Measured, RotorSpeeds, Setpoint, State, Wrench};
use crate::layout::{FieldType, layout};
use crate::topic::Bound::{self, Positive, Size};
use crate::topic::{
    ACCELERATION_M_S2, ACCELERATION_RAD_S2, ANGLE_RAD, POSITION_M, QUATERNION, RATE_RAD_S,
    ROTOR_SPEED_RAD_S, THRUST_N, TORQUE_NM, Topic, VELOCITY_M_S,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name; it ends in its unit.
    pub name: &'static str,
    /// Names of its numbers; none where it is one.
    pub axes: &'static [&'static str],
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

/// Declares the fields of a content, or of the part of it that a law is given, and then the part's layout.
macro_rules! fields {
    ($content:ident . $part:ident: $layout:ident $fields:tt) => {
        fields!(@layout $layout $fields);
        fields!(@content $content (. $part) $fields);
    };
    ($content:ident $fields:tt) => {
        fields!(@content $content () $fields);
    };
    (@layout $layout:ident { $($name:ident: $axes:expr, $bound:expr;)+ }) => {
        layout!($layout { $($name),+ });
    };
    (@content $content:ident ($($part:tt)*) { $($name:ident: $axes:expr, $bound:expr;)+ }) => {
        impl $content {
            /// Calls `look` on the numbers of each field, with what is plausible of them.
            #[inline]
            pub(crate) fn fields(&self, look: &mut impl FnMut(&[f64], Bound)) {
                let content = &self $($part)*;
                $(look(FieldType::items(&content.$name), $bound);)+
            }
        }

        impl Faulty for $content {
            const FAULT_FIELDS: &'static [Field] = &[$(Field {
                name: stringify!($name),
                axes: $axes,
            }),+];

            fn field_mut(&mut self, field: usize) -> &mut [f64] {
                let content = &mut (*self) $($part)*;
                match Self::FAULT_FIELDS.get(field).map(|field| field.name) {
                    $(Some(stringify!($name)) => FieldType::items_mut(&mut content.$name),)+
                    _ => &mut [],
                }
            }
        }
    };
}

fields!(State.measured: Measured {
    position_w_m: XYZ, Size(POSITION_M);
    velocity_w_m_s: XYZ, Size(VELOCITY_M_S);
    attitude_rad: ANGLES, Size(ANGLE_RAD);
    attitude_quaternion: &["w", "x", "y", "z"], Size(QUATERNION);
    rate_b_rad_s: XYZ, Size(RATE_RAD_S);
    specific_force_b_m_s2: XYZ, Size(ACCELERATION_M_S2);
    rotor_speed_mean_rad_s: ROTOR, Positive(ROTOR_SPEED_RAD_S);
    rotor_speed_squared_mean_rad2_s2: ROTOR, Positive(ROTOR_SPEED_RAD_S * ROTOR_SPEED_RAD_S);
    rotor_speed_command_rad_s: ROTOR, Positive(ROTOR_SPEED_RAD_S);
});
fields!(Setpoint {
    thrust_n: &[], Positive(THRUST_N);
    attitude_rad: ANGLES, Size(ANGLE_RAD);
    attitude_rate_rad_s: ANGLES, Size(RATE_RAD_S);
    attitude_acceleration_rad_s2: ANGLES, Size(ACCELERATION_RAD_S2);
});
fields!(Wrench {
    thrust_n: &[], Positive(THRUST_N);
    torque_b_nm: XYZ, Size(TORQUE_NM);
});
fields!(RotorSpeeds {
    speed_rad_s: ROTOR, Positive(ROTOR_SPEED_RAD_S);
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
