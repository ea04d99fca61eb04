//! `MAV_CMD_INJECT_FAILURE` in the words of `ironbird inject`, by one table.

use mavlink::dialects::common::{FailureType, FailureUnit, MavResult};

/// Why a failure cannot be injected.
pub type Refused = (MavResult, String);

pub fn denied(why: impl Into<String>) -> Refused {
    (MavResult::MAV_RESULT_DENIED, why.into())
}

fn unsupported(why: String) -> Refused {
    (MavResult::MAV_RESULT_UNSUPPORTED, why)
}

/// Failures by unit and type, as `ironbird inject` takes them; `{n}` is the instance. A sensor stands for the messages of the stage that uses
/// it, the receiver for what the inner loop is commanded, the servos for what the mixer commands.
pub const FAILURES: &[(FailureUnit, FailureType, &str)] = {
    use FailureType::{
        FAILURE_TYPE_DELAYED as DELAYED, FAILURE_TYPE_GARBAGE as GARBAGE,
        FAILURE_TYPE_INTERMITTENT as INTERMITTENT, FAILURE_TYPE_OFF as OFF,
        FAILURE_TYPE_SLOW as SLOW, FAILURE_TYPE_STUCK as STUCK, FAILURE_TYPE_WRONG as WRONG,
    };
    use FailureUnit::{
        FAILURE_UNIT_SENSOR_ACCEL as ACCEL, FAILURE_UNIT_SENSOR_GPS as GPS,
        FAILURE_UNIT_SENSOR_GYRO as GYRO, FAILURE_UNIT_SYSTEM_MOTOR as MOTOR,
        FAILURE_UNIT_SYSTEM_RC_SIGNAL as RC_SIGNAL, FAILURE_UNIT_SYSTEM_SERVO as SERVO,
    };
    &[
        (GYRO, OFF, "inner.state.drop=1"),
        (GYRO, STUCK, "inner.state.freeze"),
        (GYRO, GARBAGE, "inner.state.rate_b_rad_s.noise=0.5"),
        (GYRO, WRONG, "inner.state.rate_b_rad_s.bias=0.05"),
        (GYRO, SLOW, "inner.state.drop=4/5"),
        (GYRO, DELAYED, "inner.state.lag=5"),
        (GYRO, INTERMITTENT, "inner.state.drop=0.2"),
        (ACCEL, GARBAGE, "state.specific_force_b_m_s2.noise=2"),
        (ACCEL, WRONG, "state.specific_force_b_m_s2.bias=0.5"),
        (GPS, OFF, "outer.state.drop=1"),
        (GPS, STUCK, "outer.state.freeze"),
        (GPS, GARBAGE, "outer.state.position_w_m.noise=0.5"),
        (GPS, WRONG, "outer.state.position_w_m.bias=0.2"),
        (GPS, SLOW, "outer.state.drop=9/10"),
        (GPS, DELAYED, "outer.state.lag=20"),
        (GPS, INTERMITTENT, "outer.state.drop=0.2"),
        (MOTOR, OFF, "rotor_efficiency_{n}=0"),
        (MOTOR, WRONG, "rotor_efficiency_{n}=0.7"),
        (SERVO, OFF, "plant.rotor_speeds.drop=1"),
        (SERVO, STUCK, "plant.rotor_speeds.freeze"),
        (SERVO, GARBAGE, "plant.rotor_speeds.speed_rad_s.noise=20"),
        (SERVO, WRONG, "plant.rotor_speeds.speed_rad_s.bias=-20"),
        (SERVO, SLOW, "plant.rotor_speeds.drop=4/5"),
        (SERVO, DELAYED, "plant.rotor_speeds.delay=5"),
        (SERVO, INTERMITTENT, "plant.rotor_speeds.drop=0.2"),
        (RC_SIGNAL, OFF, "inner.setpoint.drop=1"),
        (RC_SIGNAL, STUCK, "inner.setpoint.freeze"),
        (RC_SIGNAL, SLOW, "inner.setpoint.drop=4/5"),
        (RC_SIGNAL, DELAYED, "inner.setpoint.lag=20"),
        (RC_SIGNAL, INTERMITTENT, "inner.setpoint.drop=0.2"),
    ]
};

const ROTORS: u64 = 4;

/// A failure to inject, or the end of those that were.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    pub unit: FailureUnit,
    /// True of a command that ends the injected failures of its unit.
    pub is_end: bool,
    /// Request to the plant, as `ironbird inject` takes it; none if nothing of the unit is to be ended.
    pub what: Option<String>,
}

impl Failure {
    /// The failure of a command's parameters. `begun` has what has been injected into this flight and not been ended.
    pub fn of(
        [unit, kind, instance]: [f32; 3],
        begun: &[(FailureUnit, String)],
    ) -> Result<Self, Refused> {
        let unit = whole("unit", unit)?;
        let of_unit = FAILURES.iter().filter(|(of, ..)| *of as u64 == unit);
        let Some(&(unit, ..)) = of_unit.clone().next() else {
            return Err(unsupported(format!("unit {unit} cannot fail here")));
        };
        let (number, instance) = (whole("type", kind)?, whole("instance", instance)?);
        let is_motor = unit == FailureUnit::FAILURE_UNIT_SYSTEM_MOTOR;
        let last = if is_motor { ROTORS } else { 1 };
        if instance > last {
            let why = format!("instance {instance}: allowed are 0 (all) to {last}");
            return Err(denied(why));
        }
        // 0 stands for all.
        let rotors = (1..=ROTORS).filter(|rotor| [0, *rotor].contains(&instance));
        let each = |what: &str| match is_motor {
            true => joined(rotors.map(|n| what.replace("{n}", &n.to_string()))),
            false => what.to_owned(),
        };
        let is_end = number == FailureType::FAILURE_TYPE_OK as u64;
        let mut of_kind = of_unit.filter(|(_, kind, _)| *kind as u64 == number);
        let what = match of_kind.next() {
            _ if is_end && is_motor => each("rotor_efficiency_{n}=nominal"),
            _ if is_end => {
                let ends =
                    |what: &str| format!("{}=off", what.split('=').next().unwrap_or_default());
                let begun = begun.iter().filter(|(of, _)| *of == unit);
                joined(begun.map(|(_, what)| ends(what)))
            }
            Some((.., what)) => each(what),
            None => {
                let name = format!("{unit:?}");
                let name = name.trim_start_matches("FAILURE_UNIT_");
                let why = format!("failure type {number} of {name} does not exist here");
                return Err(unsupported(why));
            }
        };
        Ok(Self {
            unit,
            is_end,
            what: Some(what).filter(|what| !what.is_empty()),
        })
    }
}

/// A whole number that a command has as a float.
fn whole(name: &str, value: f32) -> Result<u64, Refused> {
    match value {
        _ if value.fract() == 0.0 && (0.0..=255.0).contains(&value) => Ok(value as u64),
        _ => Err(denied(format!(
            "{name} of the failure = {value}: write a whole number"
        ))),
    }
}

/// Changes in a line, each once in a row.
fn joined(changes: impl Iterator<Item = String>) -> String {
    let mut changes: Vec<String> = changes.collect();
    changes.dedup();
    changes.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inject::parse_line;

    #[test]
    fn every_row_is_what_can_be_injected_and_nothing_is_there_twice() {
        for (place, (unit, kind, what)) in FAILURES.iter().enumerate() {
            let parameters = [*unit as u32 as f32, *kind as u32 as f32, 1.0];
            let failure = Failure::of(parameters, &[]).unwrap();
            let what = failure.what.unwrap_or_else(|| panic!("{what}"));
            parse_line(&what).unwrap_or_else(|why| panic!("{what}: {why}"));
            let again = FAILURES[..place]
                .iter()
                .any(|row| (row.0, row.1) == (*unit, *kind));
            assert!(!again, "{unit:?} {kind:?}");
            let off = format!("{}=off", what.split('=').next().unwrap());
            if *unit != FailureUnit::FAILURE_UNIT_SYSTEM_MOTOR {
                parse_line(&off).unwrap_or_else(|why| panic!("{off}: {why}"));
            }
        }
    }
}
