//! The numbers of messages that faults can strike: fields, the names of their axes, and their units.
//!
//! What a stage reads is among them. What the plant says of itself (its accounts, and the truth) and what a law shows is
//! not: no law reads that, and faults there would only lie to the report.

use crate::content::{RotorSpeeds, Setpoint, State, Wrench};
use crate::topic::Topic;

/// A field that faults can strike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name; it ends in its unit.
    pub name: &'static str,
    /// Names of its numbers; none where it is one.
    pub axes: &'static [&'static str],
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
}

/// A content with fields that faults can strike.
pub trait Faulty: Topic {
    const STRUCK: &'static [Field];

    /// The numbers of a field; nothing where there is no such field.
    fn lend(&mut self, field: usize) -> &mut [f64];
}

const XYZ: &[&str] = &["x", "y", "z"];
const ANGLES: &[&str] = &["roll", "pitch", "yaw"];
const ROTOR: &[&str] = &["1", "2", "3", "4"];

const fn field(name: &'static str, axes: &'static [&'static str], unit: &'static str) -> Field {
    Field { name, axes, unit }
}

impl Faulty for State {
    const STRUCK: &'static [Field] = &[
        field("position_w_m", XYZ, "m"),
        field("velocity_w_m_s", XYZ, "m/s"),
        field("attitude_rad", ANGLES, "rad"),
        field("attitude_quaternion", &["w", "x", "y", "z"], ""),
        field("rate_b_rad_s", XYZ, "rad/s"),
        field("specific_force_b_m_s2", XYZ, "m/s^2"),
        field("rotor_speed_mean_rad_s", ROTOR, "rad/s"),
        field("rotor_speed_squared_mean_rad2_s2", ROTOR, "rad^2/s^2"),
        field("rotor_speed_command_rad_s", ROTOR, "rad/s"),
    ];

    fn lend(&mut self, field: usize) -> &mut [f64] {
        let measured = &mut self.measured;
        match field {
            0 => &mut measured.position_w_m,
            1 => &mut measured.velocity_w_m_s,
            2 => &mut measured.attitude_rad,
            3 => &mut measured.attitude_quaternion,
            4 => &mut measured.rate_b_rad_s,
            5 => &mut measured.specific_force_b_m_s2,
            6 => &mut measured.rotor_speed_mean_rad_s,
            7 => &mut measured.rotor_speed_squared_mean_rad2_s2,
            8 => &mut measured.rotor_speed_command_rad_s,
            _ => &mut [],
        }
    }
}

impl Faulty for Setpoint {
    const STRUCK: &'static [Field] = &[
        field("thrust_n", &[], "N"),
        field("attitude_rad", ANGLES, "rad"),
        field("attitude_rate_rad_s", ANGLES, "rad/s"),
        field("attitude_acceleration_rad_s2", ANGLES, "rad/s^2"),
    ];

    fn lend(&mut self, field: usize) -> &mut [f64] {
        match field {
            0 => std::slice::from_mut(&mut self.thrust_n),
            1 => &mut self.attitude_rad,
            2 => &mut self.attitude_rate_rad_s,
            3 => &mut self.attitude_acceleration_rad_s2,
            _ => &mut [],
        }
    }
}

impl Faulty for Wrench {
    const STRUCK: &'static [Field] = &[
        field("thrust_n", &[], "N"),
        field("torque_b_nm", XYZ, "N m"),
    ];

    fn lend(&mut self, field: usize) -> &mut [f64] {
        match field {
            0 => std::slice::from_mut(&mut self.thrust_n),
            1 => &mut self.torque_b_nm,
            _ => &mut [],
        }
    }
}

impl Faulty for RotorSpeeds {
    const STRUCK: &'static [Field] = &[field("speed_rad_s", ROTOR, "rad/s")];

    fn lend(&mut self, field: usize) -> &mut [f64] {
        match field {
            0 => &mut self.speed_rad_s,
            _ => &mut [],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Visit;

    /// Every field has as many numbers as names, and none is another's.
    fn check<C: Faulty + Visit>() {
        for (place, field) in C::STRUCK.iter().enumerate() {
            let mut content = C::default();
            let numbers = content.lend(place);
            assert_eq!(numbers.len(), field.axes.len().max(1), "{}", field.name);
            numbers.fill(-3.0);
            let others = (0..C::STRUCK.len()).filter(|other| *other != place);
            assert!(
                others
                    .into_iter()
                    .all(|other| !content.lend(other).contains(&-3.0)),
                "{}",
                field.name
            );
            assert!(
                format!("{content:?}").contains(&format!("{}: ", field.name)),
                "no field {}",
                field.name
            );
        }
        assert!(C::default().lend(C::STRUCK.len()).is_empty());
    }

    #[test]
    fn the_tables_are_those_of_the_messages() {
        check::<State>();
        check::<Setpoint>();
        check::<Wrench>();
        check::<RotorSpeeds>();
    }
}
