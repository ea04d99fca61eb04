//! ArduPilot's simulated vehicle with the JSON interface, over UDP.
//!
//! Source: ArduPilot, `libraries/SITL/SIM_JSON.cpp` and `SIM_JSON.h` for packets, ports and order, with
//! `examples/JSON/readme.md`; `libraries/AP_Motors/AP_MotorsMatrix.cpp` for the motors.
//!
//! | packet | from, to | content |
//! |---|---|---|
//! | motors | to port 9002 | little-endian: u16 18458, u16 frame rate, u32 frame count, 16 u16 [us]; or 29569 and 32 u16 |
//! | state | to where the motors came from | a line of JSON between two line ends: timestamp [s], rate and specific force (FRD), position, velocity and quaternion (NED) |
//!
//! ArduPilot sends motors, waits for a state, takes its clock from the timestamp and counts the frame. Without a state it
//! sends the same frame again, once in a second. Motors 1 to 4 of a quadrotor are front right, rear left, front left, rear
//! right in the frame types X and H. The rotors spin as in H: 1 and 2 clockwise.

use std::io::{self, Write};

use control_api::description::Description;
use messages::ned::{turned, turned_quaternion};
use messages::role::Role;
use messages::telemetry::AnswerOutcome;

use crate::bridge::{ANSWER_LIMIT, LOCKSTEP_ARMING_LIMIT_S, LOCKSTEP_SIGNALS, PRIORITY, UDP_PORT};
use crate::udp::Udp;
use crate::{Message, Port, Sample};

pub const PORT: Port = Port {
    description: Description {
        name: "ardupilot-json",
        role: Role::Inner,
        version: "1",
        summary: "ArduPilot Copter, as a program of its own that flies its own mode, from position to motors",
        source: "ArduPilot, libraries/SITL/SIM_JSON.cpp, over UDP; `ironbird docs firmware`",
        settings: &[UDP_PORT, ANSWER_LIMIT, LOCKSTEP_ARMING_LIMIT_S, PRIORITY],
        presets: &[],
        suited: None,
        telemetry: LOCKSTEP_SIGNALS,
    },
    variable: "IRONBIRD_ARDUPILOT",
    cached: None,
    is_lockstep: true,
    answers_each: true,
    ports: 1,
    open: |udp| Ok(Box::new(Udp::open(udp, motors, &[(0, state)])?)),
    why_not_armed: || None,
};

/// Writes the line of a state.
fn state(sample: &Sample, packet: &mut dyn Write) -> io::Result<()> {
    let measured = sample.measured;
    let [p, q, r] = turned(measured.rate_b_rad_s);
    let [fx, fy, fz] = turned(measured.specific_force_b_m_s2);
    let [north, east, down] = turned(measured.position_w_m);
    let [vn, ve, vd] = turned(measured.velocity_w_m_s);
    let [w, x, y, z] = turned_quaternion(measured.attitude_quaternion);
    writeln!(
        packet,
        "\n{{\"timestamp\":{:.6},\"imu\":{{\"gyro\":[{p:.9},{q:.9},{r:.9}],\"accel_body\":[{fx:.9},{fy:.9},{fz:.9}]}},\
         \"position\":[{north:.9},{east:.9},{down:.9}],\"velocity\":[{vn:.9},{ve:.9},{vd:.9}],\
         \"quaternion\":[{w:.9},{x:.9},{y:.9},{z:.9}]}}",
        sample.stamp.as_secs_f64()
    )
}

/// Rotors 1 to 4 are rear left, rear right, front right, front left.
fn motors(packet: &[u8]) -> Message {
    let (numbers, _) = packet.as_chunks::<2>();
    let number = |place: usize| u16::from_le_bytes(numbers[place]);
    if !matches!(packet.len(), 40 | 72) || !matches!(number(0), 18_458 | 29_569) {
        return Message::Broken(AnswerOutcome::WrongSize);
    }
    let frame = u64::from(number(2)) | u64::from(number(3)) << 16;
    // A motor that is off has 1000 us; one that is armed idles above it.
    let commands = [1, 3, 0, 2].map(|motor| (f64::from(number(4 + motor)) - 1000.0) / 1000.0);
    let is_armed = commands.iter().any(|command| *command > 0.0);
    Message::motors(commands, is_armed, Some(frame))
}
