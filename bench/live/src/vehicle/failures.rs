//! `MAV_CMD_INJECT_FAILURE` in the words of `ironbird inject`, by one table.

use mavlink::dialects::common::{FailureType, FailureUnit, MavResult};

/// Why a failure cannot be injected.
pub type Refused = (MavResult, String);

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
        (SERVO, OFF, "rotor_speeds.drop=1"),
        (SERVO, STUCK, "rotor_speeds.freeze"),
        (SERVO, GARBAGE, "rotor_speeds.speed_rad_s.noise=20"),
        (SERVO, WRONG, "rotor_speeds.speed_rad_s.bias=-20"),
        (SERVO, SLOW, "rotor_speeds.drop=4/5"),
        (SERVO, DELAYED, "rotor_speeds.delay=5"),
        (SERVO, INTERMITTENT, "rotor_speeds.drop=0.2"),
        (RC_SIGNAL, OFF, "setpoint.drop=1"),
        (RC_SIGNAL, STUCK, "setpoint.freeze"),
        (RC_SIGNAL, SLOW, "setpoint.drop=4/5"),
        (RC_SIGNAL, DELAYED, "setpoint.lag=20"),
        (RC_SIGNAL, INTERMITTENT, "setpoint.drop=0.2"),
    ]
};

const ROTORS: std::ops::RangeInclusive<u64> = 1..=4;

/// A failure to inject, or the end of those that were.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    pub unit: FailureUnit,
    pub kind: FailureType,
    /// Request to the plant, as `ironbird inject` takes it; none if nothing of the unit is to be ended.
    pub what: Option<String>,
}

impl Failure {
    /// The failure of a command's parameters. `begun` has what has been injected into this flight and not been ended.
    pub fn of(
        [unit, kind, instance]: [f32; 3],
        begun: &[(FailureUnit, String)],
    ) -> Result<Self, Refused> {
        let denied = |what: String| (MavResult::MAV_RESULT_DENIED, what);
        let whole = |name: &str, value: f32| match value {
            _ if value.fract() == 0.0 && (0.0..=255.0).contains(&value) => Ok(value as u64),
            _ => Err(denied(format!(
                "{name} of the failure = {value}: write a whole number"
            ))),
        };
        let number = whole("unit", unit)?;
        let no_unit = || {
            (
                MavResult::MAV_RESULT_UNSUPPORTED,
                format!("unit {number} cannot fail here"),
            )
        };
        let known = FAILURES.iter().find(|(unit, ..)| *unit as u64 == number);
        let &(unit, ..) = known.ok_or_else(no_unit)?;
        let number = whole("type", kind)?;
        let instance = whole("instance", instance)?;
        let is_motor = unit == FailureUnit::FAILURE_UNIT_SYSTEM_MOTOR;
        let last = if is_motor { *ROTORS.end() } else { 1 };
        if instance > last {
            return Err(denied(format!(
                "instance {instance}: allowed are 0 (all) to {last}"
            )));
        }
        // 0 stands for all.
        let rotors = if instance == 0 {
            ROTORS
        } else {
            instance..=instance
        };
        let each = |what: &str| {
            let texts = rotors.clone().map(|n| what.replace("{n}", &n.to_string()));
            texts.collect::<Vec<_>>().join(",")
        };
        if number == FailureType::FAILURE_TYPE_OK as u64 {
            let ends = |what: &str| format!("{}=off", what.split('=').next().unwrap_or_default());
            let mut ends: Vec<String> = begun
                .iter()
                .filter(|(of, _)| *of == unit)
                .map(|(_, what)| ends(what))
                .collect();
            ends.dedup();
            let what = match is_motor {
                true => Some(each("rotor_efficiency_{n}=nominal")),
                false => Some(ends.join(",")).filter(|what| !what.is_empty()),
            };
            return Ok(Self {
                unit,
                kind: FailureType::FAILURE_TYPE_OK,
                what,
            });
        }
        let row = FAILURES
            .iter()
            .find(|(of, kind, _)| *of == unit && *kind as u64 == number);
        let no_kind = || {
            let name = format!("{unit:?}");
            let name = name.trim_start_matches("FAILURE_UNIT_").to_owned();
            (
                MavResult::MAV_RESULT_UNSUPPORTED,
                format!("failure type {number} of {name} does not exist here"),
            )
        };
        let &(_, kind, what) = row.ok_or_else(no_kind)?;
        let what = if is_motor {
            each(what)
        } else {
            what.to_owned()
        };
        Ok(Self {
            unit,
            kind,
            what: Some(what),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inject::parse_line;

    fn failure(unit: FailureUnit, kind: FailureType, instance: f32) -> Result<Failure, Refused> {
        Failure::of([unit as u32 as f32, kind as u32 as f32, instance], &[])
    }

    #[test]
    fn every_row_is_what_can_be_injected_and_nothing_is_there_twice() {
        for (place, (unit, kind, what)) in FAILURES.iter().enumerate() {
            let what = failure(*unit, *kind, 1.0)
                .unwrap()
                .what
                .unwrap_or_else(|| panic!("{what}"));
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

    #[test]
    fn instances_are_rotors_and_the_end_takes_back_what_was_injected() {
        use FailureType::*;
        use FailureUnit::*;
        let what = |failure: Result<Failure, Refused>| failure.unwrap().what;
        let motor = FAILURE_UNIT_SYSTEM_MOTOR;
        assert_eq!(
            what(failure(motor, FAILURE_TYPE_OFF, 3.0)).unwrap(),
            "rotor_efficiency_3=0"
        );
        assert_eq!(
            what(failure(motor, FAILURE_TYPE_OK, 0.0))
                .unwrap()
                .matches("=nominal")
                .count(),
            4
        );
        assert_eq!(
            what(failure(FAILURE_UNIT_SENSOR_GPS, FAILURE_TYPE_OK, 0.0)),
            None
        );
        let begun = [
            (FAILURE_UNIT_SENSOR_GPS, "outer.state.drop=0.2".to_owned()),
            (FAILURE_UNIT_SENSOR_GYRO, "inner.state.freeze".to_owned()),
            (FAILURE_UNIT_SENSOR_GPS, "outer.state.lag=20".to_owned()),
        ];
        let end = Failure::of([4.0, 0.0, 0.0], &begun).unwrap();
        assert_eq!(
            end.what.unwrap(),
            "outer.state.drop=off,outer.state.lag=off"
        );
    }

    #[test]
    fn what_is_no_failure_is_refused_with_the_reason() {
        use MavResult::*;
        for (parameters, result, words) in [
            (
                [7.0, 1.0, 0.0],
                MAV_RESULT_UNSUPPORTED,
                "unit 7 cannot fail here",
            ),
            (
                [4.0, 8.0, 0.0],
                MAV_RESULT_UNSUPPORTED,
                "failure type 8 of SENSOR_GPS does not exist here",
            ),
            (
                [101.0, 2.0, 1.0],
                MAV_RESULT_UNSUPPORTED,
                "failure type 2 of SYSTEM_MOTOR does not exist here",
            ),
            (
                [101.0, 1.0, 5.0],
                MAV_RESULT_DENIED,
                "instance 5: allowed are 0 (all) to 4",
            ),
            (
                [102.0, 1.0, 2.0],
                MAV_RESULT_DENIED,
                "instance 2: allowed are 0 (all) to 1",
            ),
            (
                [0.5, 1.0, 0.0],
                MAV_RESULT_DENIED,
                "unit of the failure = 0.5: write a whole number",
            ),
            (
                [4.0, f32::NAN, 0.0],
                MAV_RESULT_DENIED,
                "type of the failure = NaN: write a whole number",
            ),
            (
                [4.0, 1.0, -1.0],
                MAV_RESULT_DENIED,
                "instance of the failure = -1: write a whole number",
            ),
        ] {
            assert_eq!(
                Failure::of(parameters, &[]),
                Err((result, words.to_owned()))
            );
        }
    }
}
