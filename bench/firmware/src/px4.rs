//! PX4's simulated vehicle, over TCP, in messages of MAVLink's common dialect.
//!
//! Source: PX4, `src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp` for messages, port and order;
//! `ROMFS/px4fmu_common/init.d-posix/airframes/10016_none_iris` for the motors;
//! `src/modules/sensors/data_validator/DataValidator.hpp` for values that repeat.
//!
//! | message | from, to | content |
//! |---|---|---|
//! | HIL_SENSOR, id 0 | to PX4, which connects to TCP port 4560 | time, which becomes PX4's clock; rate, specific force and magnetic field (FRD), pressure |
//! | HIL_GPS | to PX4, ten times in a second | place, velocity (NED) |
//! | HIL_ACTUATOR_CONTROLS | from PX4 | time of the state that it answers, controls from 0 to 1, whether it has armed |
//!
//! PX4 sends a heartbeat when it has connected, and no controls before states have come; so the first states are sent
//! without waiting for answers. Motors 1 to 4 are front right, rear left, front left, rear right. PX4 takes a sensor that
//! repeats a value a hundred times for a broken one, so each reading alternates by a few of its steps.

use std::io::{self, ErrorKind, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsFd as _, BorrowedFd};
use std::time::Duration;

use control_api::description::{Description, number, settings};
use mavlink::dialects::common::{
    GpsFixType, HIL_ACTUATOR_CONTROLS_DATA, HIL_GPS_DATA, HIL_SENSOR_DATA,
    HilSensorUpdatedFlags as Updated, MavMessage, MavModeFlag,
};
use mavlink::error::MessageReadError;
use mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkReader};
use messages::ned::{ORIGIN, geographic, turned};
use messages::role::Role;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::bridge::{ANSWER_LIMIT, LOCKSTEP_ARMING_LIMIT_S, LOCKSTEP_SIGNALS, PRIORITY};
use crate::udp::local;
use crate::{Link, Message, Port, Sample};

settings! {
    TCP_PORT = "port", "", number(4560.0, 1024.0, 65_533.0), "TCP port that the firmware connects to";
}

pub const PORT: Port = Port {
    description: Description {
        name: "px4-hil",
        role: Role::Inner,
        version: "1",
        summary: "PX4, as a program of its own that flies its own mode, from position to motors",
        source: "PX4, src/modules/simulation/simulator_mavlink, over TCP; `ironbird docs firmware`",
        settings: &[TCP_PORT, ANSWER_LIMIT, LOCKSTEP_ARMING_LIMIT_S, PRIORITY],
        presets: &[],
        suited: None,
        telemetry: LOCKSTEP_SIGNALS,
    },
    variable: "IRONBIRD_PX4",
    cached: None,
    is_lockstep: true,
    answers_each: false,
    ports: 1,
    open: |tcp| Ok(Box::new(Hil::open(tcp)?)),
    why_not_armed: || None,
};

const GPS_EVERY: Duration = Duration::from_millis(100);
/// Magnetic field at [`messages::ned::ORIGIN`] by the World Magnetic Model, NED [G]; PX4 compares it with its own table.
const FIELD_G: [f64; 3] = [0.216, 0.012, 0.433];
const PRESSURE_HPA: f64 = 1013.25;
const PRESSURE_HPA_PER_M: f64 = 0.12;
/// By how much readings alternate: specific force [m/s^2], rate [rad/s], field [G], pressure [hPa].
const STEPS: [f64; 4] = [0.02, 0.004, 0.001, 0.01];

struct Hil {
    /// Stays open after a firmware has connected, so that no other flight can wait at its port.
    listener: TcpListener,
    /// The firmware that has connected.
    reader: Option<MavlinkReader<TcpStream>>,
    sequence: u8,
    gps_at: Duration,
}

impl Hil {
    fn open(tcp: u16) -> io::Result<Self> {
        let listener = TcpListener::bind(local(tcp))?;
        listener.set_nonblocking(true)?;
        Ok(Self::new(listener, None))
    }

    const fn new(listener: TcpListener, reader: Option<MavlinkReader<TcpStream>>) -> Self {
        Self {
            listener,
            reader,
            sequence: 0,
            gps_at: Duration::ZERO,
        }
    }
}

impl Link for Hil {
    fn send(&mut self, sample: &Sample) -> io::Result<()> {
        let reader = self.reader.as_mut().ok_or(ErrorKind::NotConnected)?;
        let up = self.sequence.is_multiple_of(2);
        let mut send = |message: MavMessage| {
            let header = MavHeader {
                sequence: self.sequence,
                ..MavHeader::default()
            };
            self.sequence = self.sequence.wrapping_add(1);
            let mut frame = MAVLinkV2MessageRaw::new();
            frame.serialize_message(header, &message);
            reader.get_mut().write_all(frame.raw_bytes())
        };
        if sample.stamp >= self.gps_at {
            self.gps_at = sample.stamp + GPS_EVERY;
            send(MavMessage::HIL_GPS(gps(sample)))?;
        }
        send(MavMessage::HIL_SENSOR(sensors(sample, up)))
    }

    fn receive(&mut self) -> io::Result<Message> {
        let Some(reader) = &mut self.reader else {
            let (stream, _) = self.listener.accept()?;
            stream.set_nonblocking(true)?;
            stream.set_nodelay(true)?;
            self.reader = Some(MavlinkReader::new(stream));
            return Ok(Message::Other);
        };
        match reader.read_any_message::<MavMessage>() {
            Ok((_, MavMessage::HIL_ACTUATOR_CONTROLS(controls))) => Ok(motors(&controls)),
            // Messages of another dialect, too.
            Ok(_) | Err(MessageReadError::Parse(_)) => Ok(Message::Other),
            Err(MessageReadError::Io(e)) => Err(e),
        }
    }

    fn descriptor(&self) -> BorrowedFd<'_> {
        match &self.reader {
            None => self.listener.as_fd(),
            Some(reader) => reader.get_ref().as_fd(),
        }
    }

    fn try_clone(&self) -> io::Result<Box<dyn Link>> {
        let stream = self.reader.as_ref().map(|it| it.get_ref().try_clone());
        let reader = stream.transpose()?.map(MavlinkReader::new);
        Ok(Box::new(Self::new(self.listener.try_clone()?, reader)))
    }
}

fn micros(stamp: Duration) -> u64 {
    stamp.as_micros() as u64
}

/// `up` is whether the readings are above the values that they alternate about.
fn sensors(sample: &Sample, up: bool) -> HIL_SENSOR_DATA {
    let measured = sample.measured;
    let [force, rate, field, pressure] =
        STEPS.map(|step| if up { step / 2.0 } else { -step / 2.0 });
    let readings = |vector: [f64; 3], step: f64| turned(vector).map(|it| (it + step) as f32);
    let [xacc, yacc, zacc] = readings(measured.specific_force_b_m_s2, force);
    let [xgyro, ygyro, zgyro] = readings(measured.rate_b_rad_s, rate);
    let [w, x, y, z] = measured.attitude_quaternion;
    let attitude = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    let field_b = attitude.inverse() * Vector3::from(turned(FIELD_G));
    let [xmag, ymag, zmag] = readings(field_b.into(), field);
    let height_m = measured.position_w_m[2];
    let pressure_hpa = PRESSURE_HPA - PRESSURE_HPA_PER_M * (ORIGIN[2] + height_m);
    HIL_SENSOR_DATA {
        time_usec: micros(sample.stamp),
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        xmag,
        ymag,
        zmag,
        abs_pressure: (pressure_hpa + pressure) as f32,
        pressure_alt: (ORIGIN[2] + height_m) as f32,
        temperature: 20.0,
        fields_updated: Updated::all()
            - Updated::HIL_SENSOR_UPDATED_DIFF_PRESSURE
            - Updated::HIL_SENSOR_UPDATED_RESET,
        ..HIL_SENSOR_DATA::default()
    }
}

fn gps(sample: &Sample) -> HIL_GPS_DATA {
    let [lat, lon, alt] = geographic(turned(sample.measured.position_w_m));
    let [vn, ve, vd] = turned(sample.measured.velocity_w_m_s).map(|it| (it * 100.0).round());
    HIL_GPS_DATA {
        time_usec: micros(sample.stamp),
        lat,
        lon,
        alt,
        // One metre.
        eph: 100,
        epv: 100,
        vel: (vn * vn + ve * ve).sqrt() as u16,
        vn: vn as i16,
        ve: ve as i16,
        vd: vd as i16,
        // Unknown.
        cog: u16::MAX,
        fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX as u8,
        satellites_visible: 12,
        ..HIL_GPS_DATA::default()
    }
}

/// Rotors 1 to 4 are rear left, rear right, front right, front left.
fn motors(controls: &HIL_ACTUATOR_CONTROLS_DATA) -> Message {
    let commands = [1, 3, 0, 2].map(|motor| f64::from(controls.controls[motor]));
    let is_armed = controls
        .mode
        .contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
    Message::motors(commands, is_armed, Some(controls.time_usec))
}
