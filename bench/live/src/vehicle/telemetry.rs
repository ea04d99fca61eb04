//! Telemetry of a flight: functions of the dashboard's model.

use std::time::Duration;

use mavlink::MessageData as _;
use mavlink::dialects::common::*;
use messages::blackboards::EndReason;
use messages::content::ROTORS;
use messages::parameters::Parameter;

use super::offboard::{Mode, lowest_m};
use crate::watch::dashboard_model::{Judged, WatchedFlight};
use messages::ned::{ORIGIN, geographic, turned, turned_angles, turned_quaternion};

/// A message of the flight in a mode, by the mode's number; none if there is nothing to report yet.
type Report = fn(&WatchedFlight, u32) -> Option<MavMessage>;

/// Messages by their numbers, and how often in a second each is sent unless the ground station asks for something else; 0
/// is only on request.
const MESSAGES: [(u32, u64, Report); 15] = [
    (HEARTBEAT_DATA::ID, 1, heartbeat),
    (SYS_STATUS_DATA::ID, 2, sys_status),
    (SYSTEM_TIME_DATA::ID, 1, system_time),
    (EXTENDED_SYS_STATE_DATA::ID, 2, extended_sys_state),
    (ATTITUDE_DATA::ID, 20, attitude),
    (ATTITUDE_QUATERNION_DATA::ID, 20, attitude_quaternion),
    (LOCAL_POSITION_NED_DATA::ID, 20, local_position),
    (POSITION_TARGET_LOCAL_NED_DATA::ID, 10, position_target),
    (GLOBAL_POSITION_INT_DATA::ID, 5, global_position),
    (HOME_POSITION_DATA::ID, 1, home_position),
    (GPS_GLOBAL_ORIGIN_DATA::ID, 1, global_origin),
    (VFR_HUD_DATA::ID, 5, vfr_hud),
    (SERVO_OUTPUT_RAW_DATA::ID, 5, servo_output),
    (AUTOPILOT_VERSION_DATA::ID, 0, autopilot_version),
    (CURRENT_MODE_DATA::ID, 0, current_mode),
];

/// Height above the ground up to which a vehicle has landed [m].
const LANDED_M: f64 = 0.01;

/// Messages that are sent by themselves, and the usual interval.
pub fn streams() -> impl Iterator<Item = (u32, Duration)> {
    let sent = MESSAGES.into_iter().filter(|(_, hz, _)| *hz > 0);
    sent.map(|(id, hz, _)| (id, Duration::from_micros(1_000_000 / hz)))
}

/// A message of the flight by its number; none if there is no such message, or nothing to report yet.
pub fn message(id: u32, flight: &WatchedFlight, mode: Mode) -> Option<MavMessage> {
    let custom_mode = match flight.follows_targets() {
        true => mode as u32,
        false => 0,
    };
    let (.., report) = MESSAGES.iter().find(|(known, ..)| *known == id)?;
    report(flight, custom_mode)
}

/// Flight time [ms].
fn time_ms(flight: &WatchedFlight) -> u32 {
    nearest_ms(flight.run.flight_time_s(flight.tick()))
}

const fn nearest_ms(time_s: f64) -> u32 {
    (time_s * 1e3).round() as u32
}

fn heartbeat(flight: &WatchedFlight, custom_mode: u32) -> Option<MavMessage> {
    let flies = flight.ending.is_none();
    let mut base_mode = MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED
        | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED
        | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED;
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, flies);
    base_mode.set(
        MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
        custom_mode != 0,
    );
    let system_status = match flight.ending {
        None => MavState::MAV_STATE_ACTIVE,
        Some(EndReason::Completed | EndReason::Interrupted) => MavState::MAV_STATE_STANDBY,
        Some(_) => MavState::MAV_STATE_CRITICAL,
    };
    Some(MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
        base_mode,
        system_status,
        mavlink_version: 3,
    }))
}

fn sys_status(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    use MavSysStatusSensor as Part;
    let present = Part::MAV_SYS_STATUS_SENSOR_3D_GYRO
        | Part::MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | Part::MAV_SYS_STATUS_SENSOR_GPS
        | Part::MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
        | Part::MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
        | Part::MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
        | Part::MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
        | Part::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | Part::MAV_SYS_STATUS_LOGGING
        | Part::MAV_SYS_STATUS_PREARM_CHECK;
    let (verdicts, not_fresh) = flight.verdicts();
    let mut health = present;
    let controls = Part::MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
        | Part::MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL;
    let is_bad = Judged::all(&verdicts).map(|it| it.is_good == Some(false));
    health.set(controls, !is_bad[0]);
    health.set(Part::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS, !is_bad[1]);
    health.set(Part::MAV_SYS_STATUS_LOGGING, flight.recorder_lives);
    let count = |ticks: u64| ticks.min(u16::MAX.into()) as u16;
    Some(MavMessage::SYS_STATUS(SYS_STATUS_DATA {
        onboard_control_sensors_present: present,
        onboard_control_sensors_enabled: present,
        onboard_control_sensors_health: health,
        // There is no battery.
        voltage_battery: u16::MAX,
        current_battery: -1,
        battery_remaining: -1,
        errors_count1: count(flight.run.deadlines_missed),
        errors_count2: count(flight.run.ticks_skipped),
        errors_count3: count(not_fresh.ticks),
        // The default of flags is their first one.
        onboard_control_sensors_present_extended: MavSysStatusSensorExtended::empty(),
        onboard_control_sensors_enabled_extended: MavSysStatusSensorExtended::empty(),
        onboard_control_sensors_health_extended: MavSysStatusSensorExtended::empty(),
        ..SYS_STATUS_DATA::default()
    }))
}

fn system_time(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let run = &flight.run;
    // In lockstep, the flight has no clock.
    let since_start_ns = flight.tick().saturating_mul(run.period_ns);
    Some(MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
        time_unix_usec: run.t0_wall_ns.saturating_add(since_start_ns) / 1000,
        time_boot_ms: time_ms(flight),
    }))
}

fn extended_sys_state(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let highest_m = lowest_m(flight) + LANDED_M;
    let stands = flight
        .state
        .is_some_and(|it| it.truth.position_w_m[2] <= highest_m);
    Some(MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
        vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED,
        landed_state: match flight.ending.is_some() || stands {
            true => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
            false => MavLandedState::MAV_LANDED_STATE_IN_AIR,
        },
    }))
}

/// A vector in MAVLink's frames.
fn ned(vector: [f64; 3]) -> [f32; 3] {
    turned(vector).map(|it| it as f32)
}

fn attitude(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let measured = flight.state.as_ref()?.measured;
    let [roll, pitch, yaw] = turned_angles(measured.attitude_rad).map(|it| it as f32);
    let [rollspeed, pitchspeed, yawspeed] = ned(measured.rate_b_rad_s);
    Some(MavMessage::ATTITUDE(ATTITUDE_DATA {
        time_boot_ms: time_ms(flight),
        roll,
        pitch,
        yaw,
        rollspeed,
        pitchspeed,
        yawspeed,
    }))
}

fn attitude_quaternion(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let measured = flight.state.as_ref()?.measured;
    let [q1, q2, q3, q4] = turned_quaternion(measured.attitude_quaternion).map(|it| it as f32);
    let [rollspeed, pitchspeed, yawspeed] = ned(measured.rate_b_rad_s);
    Some(MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
        time_boot_ms: time_ms(flight),
        q1,
        q2,
        q3,
        q4,
        rollspeed,
        pitchspeed,
        yawspeed,
        ..ATTITUDE_QUATERNION_DATA::default()
    }))
}

fn local_position(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let measured = flight.state.as_ref()?.measured;
    let [x, y, z] = ned(measured.position_w_m);
    let [vx, vy, vz] = ned(measured.velocity_w_m_s);
    Some(MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
        time_boot_ms: time_ms(flight),
        x,
        y,
        z,
        vx,
        vy,
        vz,
    }))
}

fn position_target(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let reference = flight.setpoint.as_ref()?.reference;
    let [x, y, z] = ned(reference.position_w_m);
    let [vx, vy, vz] = ned(reference.velocity_w_m_s);
    let [afx, afy, afz] = ned(reference.acceleration_w_m_s2);
    Some(MavMessage::POSITION_TARGET_LOCAL_NED(
        POSITION_TARGET_LOCAL_NED_DATA {
            time_boot_ms: time_ms(flight),
            x,
            y,
            z,
            vx,
            vy,
            vz,
            afx,
            afy,
            afz,
            yaw: turned_angles([0.0, 0.0, reference.yaw_rad])[2] as f32,
            yaw_rate: -reference.yaw_rate_rad_s as f32,
            type_mask: PositionTargetTypemask::empty(),
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        },
    ))
}

fn global_position(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let measured = flight.state.as_ref()?.measured;
    let [lat, lon, alt] = geographic(turned(measured.position_w_m));
    let [vx, vy, vz] = turned(measured.velocity_w_m_s).map(|it| (it * 100.0).round() as i16);
    Some(MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
        time_boot_ms: time_ms(flight),
        lat,
        lon,
        alt,
        relative_alt: (measured.position_w_m[2] * 1e3).round() as i32,
        vx,
        vy,
        vz,
        hdg: (heading_deg(measured.attitude_rad) * 100.0).round() as u16 % 36_000,
    }))
}

/// 0 to 360 degrees, clockwise from north.
fn heading_deg(attitude_rad: [f64; 3]) -> f64 {
    turned_angles(attitude_rad)[2]
        .to_degrees()
        .rem_euclid(360.0)
}

fn home_position(_: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let [latitude, longitude, altitude] = geographic([0.0; 3]);
    Some(MavMessage::HOME_POSITION(HOME_POSITION_DATA {
        latitude,
        longitude,
        altitude,
        q: [f32::NAN; 4],
        approach_x: f32::NAN,
        approach_y: f32::NAN,
        approach_z: f32::NAN,
        ..HOME_POSITION_DATA::default()
    }))
}

fn global_origin(_: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let [latitude, longitude, altitude] = geographic([0.0; 3]);
    Some(MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
        latitude,
        longitude,
        altitude,
        ..GPS_GLOBAL_ORIGIN_DATA::default()
    }))
}

fn vfr_hud(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let state = flight.state.as_ref()?;
    let measured = state.measured;
    let [vx, vy, vz] = measured.velocity_w_m_s;
    let wind = [Parameter::WindX, Parameter::WindY, Parameter::WindZ];
    let [wx, wy, wz] = wind.map(|it| state.truth.parameter[it as usize]);
    let most = flight.settings.rotor.max_rad_s;
    let squares = measured.rotor_speed_squared_mean_rad2_s2;
    let share = squares.iter().sum::<f64>() / (ROTORS as f64 * most * most);
    Some(MavMessage::VFR_HUD(VFR_HUD_DATA {
        airspeed: (vx - wx).hypot(vy - wy).hypot(vz - wz) as f32,
        groundspeed: vx.hypot(vy) as f32,
        alt: (ORIGIN[2] + measured.position_w_m[2]) as f32,
        climb: vz as f32,
        heading: heading_deg(measured.attitude_rad).round() as i16 % 360,
        throttle: (100.0 * share).round() as u16,
    }))
}

/// Rotor commands as for servos, from 1000 us (slowest) to 2000 us (fastest).
fn servo_output(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let speeds = flight.rotor_speeds.as_ref()?.speed_rad_s;
    let (least, most) = (
        flight.settings.rotor.min_rad_s,
        flight.settings.rotor.max_rad_s,
    );
    let width_us = |speed: f64| (1000.0 + 1000.0 * (speed - least) / (most - least)).round() as u16;
    let [servo1_raw, servo2_raw, servo3_raw, servo4_raw] = speeds.map(width_us);
    Some(MavMessage::SERVO_OUTPUT_RAW(SERVO_OUTPUT_RAW_DATA {
        time_usec: time_ms(flight).wrapping_mul(1000),
        servo1_raw,
        servo2_raw,
        servo3_raw,
        servo4_raw,
        ..SERVO_OUTPUT_RAW_DATA::default()
    }))
}

fn autopilot_version(flight: &WatchedFlight, _: u32) -> Option<MavMessage> {
    let numbers = env!("CARGO_PKG_VERSION").split(['.', '-']).take(3);
    let numbers = numbers.map(|it| it.parse::<u32>().unwrap_or(0));
    let mut capabilities = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST;
    let steers = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED;
    capabilities.set(steers, flight.follows_targets());
    Some(MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
        capabilities,
        uid: flight.run.run_id,
        // Major, minor and patch, a byte each; then the type of the release, which has no number here.
        flight_sw_version: numbers.fold(0, |version, number| version << 8 | number) << 8,
        ..AUTOPILOT_VERSION_DATA::default()
    }))
}

fn current_mode(_: &WatchedFlight, custom_mode: u32) -> Option<MavMessage> {
    Some(MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
        custom_mode,
        ..CURRENT_MODE_DATA::default()
    }))
}

/// A mode by its number from 1 on; 0 is all of them. A flight that no ground station flies has one: its trajectory.
pub fn available_modes(flight: &WatchedFlight, index: u32) -> Vec<MavMessage> {
    let selectable = MavModeProperty::empty();
    let modes = match flight.follows_targets() {
        true => Mode::ALL
            .map(|it| (it as u32, it.name(), selectable))
            .to_vec(),
        false => {
            let name = flight.settings.flight.trajectory.as_str();
            vec![(
                0,
                name,
                MavModeProperty::MAV_MODE_PROPERTY_NOT_USER_SELECTABLE,
            )]
        }
    };
    let number_modes = modes.len() as u8;
    let message = |(mode_index, (custom_mode, name, properties)): (u8, (u32, &str, _))| {
        MavMessage::AVAILABLE_MODES(AVAILABLE_MODES_DATA {
            custom_mode,
            properties,
            number_modes,
            mode_index,
            standard_mode: MavStandardMode::MAV_STANDARD_MODE_NON_STANDARD,
            mode_name: name.into(),
        })
    };
    let numbered = (1..).zip(modes);
    let wanted = numbered.filter(|(number, _)| [0, u32::from(*number)].contains(&index));
    wanted.map(message).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_of_a_millisecond_has_its_own_time() {
        for tick in 0..100_000 {
            assert_eq!(nearest_ms(f64::from(tick) * 1e-3), tick);
        }
    }
}
