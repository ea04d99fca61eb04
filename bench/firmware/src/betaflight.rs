//! Betaflight's simulator target, over UDP.
//!
//! Source: Betaflight 4.6.0, `src/platform/SIMULATOR/sitl.c` and `target/SITL/target.h`, for layouts, ports and signs.
//! All numbers are little-endian.
//!
//! | packet | to port | content |
//! |---|---|---|
//! | state | 9003 | 18 doubles: time [s], rate [rad/s], acceleration [m/s^2], quaternion w x y z, velocity, position, pressure [Pa] |
//! | remote control | 9004 | time [s] as a double, 16 channels [us] as u16: roll, pitch, throttle, yaw, AUX1 (armed), AUX2 (ANGLE) |
//! | motors | 9002 | 4 floats from 0 to 1, of Betaflight's motors 2, 3, 4, 1: front right, rear left, front left, rear right |
//!
//! The firmware negates the acceleration and the second and third rate, and its attitude from a quaternion has the pitch
//! of a frame with x forward, y right, z down. So this port sends the negative specific force, the rate (p, -q, -r) and
//! the quaternion (w, x, -y, -z). Each state is answered with one motor packet, which does not say whose answer it is.

use std::io::{self, Read as _, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::time::{Duration, Instant};

use control_api::description::Description;
use messages::ned::{turned, turned_quaternion};
use messages::role::Role;
use messages::telemetry::AnswerOutcome;

use crate::bridge::{self, SIGNALS};
use crate::udp::Udp;
use crate::{Message, Port, Sample};

pub const PORT: Port = Port {
    description: Description {
        name: "betaflight",
        role: Role::Inner,
        version: "1",
        summary: "Betaflight, as a program of its own: attitude and rate loop in ANGLE mode, and its mixer",
        source: "Betaflight 4.6.0, simulator target, over UDP; `ironbird docs firmware`",
        settings: bridge::SETTINGS,
        presets: &[],
        suited: None,
        telemetry: SIGNALS,
    },
    variable: "IRONBIRD_BETAFLIGHT",
    cached: Some(("betaflight_SITL", &["eeprom.bin"])),
    is_lockstep: false,
    answers_each: true,
    ports: 3,
    open: |udp| {
        Ok(Box::new(Udp::open(
            udp,
            motors,
            &[(2, remote), (1, state)],
        )?))
    },
    why_not_armed,
};

/// TCP port of the command line.
const COMMAND_LINE_TCP: u16 = 5761;
/// Throttle below this is 0: Betaflight's `min_check` [us].
const THROTTLE_MIN_US: f64 = 1050.0;
/// Metres of a degree of latitude.
const DEGREE_M: f64 = 111_320.0;
const PRESSURE_PA: f64 = 101_325.0;
const PRESSURE_PA_PER_M: f64 = 12.0;
/// Bytes of the packet of motor commands.
const MOTOR_BYTES: usize = 16;
/// Motor commands are this far below idle only if the firmware has disarmed.
const STOPPED: f64 = 1e-3;

fn state(sample: &Sample, packet: &mut dyn Write) -> io::Result<()> {
    let measured = sample.measured;
    let [x, y, height_m] = measured.position_w_m;
    let pressure_pa = PRESSURE_PA - PRESSURE_PA_PER_M * height_m;
    let mut numbers = [sample.stamp.as_secs_f64()]
        .into_iter()
        .chain(turned(measured.rate_b_rad_s))
        .chain(measured.specific_force_b_m_s2.map(|it| -it))
        .chain(turned_quaternion(measured.attitude_quaternion))
        .chain(measured.velocity_w_m_s)
        .chain([x / DEGREE_M, y / DEGREE_M, height_m, pressure_pa]);
    numbers.try_for_each(|it| packet.write_all(&it.to_le_bytes()))
}

fn remote(sample: &Sample, packet: &mut dyn Write) -> io::Result<()> {
    let sticks = sample.sticks;
    let centred = |stick: f64| (1500.0 + 500.0 * stick).round() as u16;
    let switch = |is_on: bool| if is_on { 1800 } else { 1000 };
    let throttle_us = match sticks.throttle {
        0.0 => 1000.0,
        share => THROTTLE_MIN_US + (2000.0 - THROTTLE_MIN_US) * share,
    };
    let mut channels = [1000_u16; 16];
    channels[..6].copy_from_slice(&[
        centred(sticks.roll),
        centred(sticks.pitch),
        throttle_us.round() as u16,
        centred(sticks.yaw),
        switch(sticks.armed),
        switch(true),
    ]);
    packet.write_all(&sample.stamp.as_secs_f64().to_le_bytes())?;
    let mut channels = channels.iter();
    channels.try_for_each(|it| packet.write_all(&it.to_le_bytes()))
}

/// Rotors 1 to 4 are rear left, rear right, front right, front left.
fn motors(packet: &[u8]) -> Message {
    let (numbers, _) = packet.as_chunks::<4>();
    if packet.len() != MOTOR_BYTES {
        return Message::Broken(AnswerOutcome::WrongSize);
    }
    let number = |place: usize| f64::from(f32::from_le_bytes(numbers[place]));
    let commands = [1, 3, 0, 2].map(number);
    // Armed motors idle.
    let is_armed = commands.iter().any(|command| *command > STOPPED);
    Message::motors(commands, is_armed, None)
}

/// The line of `status` that lists what keeps it from arming.
fn why_not_armed() -> Option<String> {
    let mut line = TcpStream::connect((Ipv4Addr::LOCALHOST, COMMAND_LINE_TCP)).ok()?;
    line.set_read_timeout(Some(Duration::from_millis(100)))
        .ok()?;
    let mut said = Vec::new();
    for (command, wait) in [("#", 1500), ("status\n", 1500)] {
        line.write_all(command.as_bytes()).ok()?;
        let until = Instant::now() + Duration::from_millis(wait);
        while Instant::now() < until {
            let mut some = [0; 1024];
            if let Ok(bytes) = line.read(&mut some) {
                said.extend_from_slice(&some[..bytes]);
            }
        }
    }
    let said = String::from_utf8_lossy(&said).into_owned();
    let flags = said.lines().find(|line| line.contains("Arming disable"))?;
    Some(flags.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    use ironbird_law::Measured;

    use crate::sticks::Sticks;
    use crate::udp::WritePacket;

    fn packet(write: WritePacket, measured: &Measured, sticks: &Sticks) -> Vec<u8> {
        let mut packet = Vec::new();
        let sample = Sample {
            stamp: Duration::from_millis(7500),
            measured,
            sticks,
        };
        write(&sample, &mut packet).unwrap();
        packet
    }

    #[test]
    fn a_state_has_the_signs_that_the_firmware_turns_back() {
        let measured = Measured {
            rate_b_rad_s: [1.0, 2.0, 3.0],
            specific_force_b_m_s2: [4.0, 5.0, 9.8],
            attitude_quaternion: [0.5, 0.6, 0.7, 0.8],
            position_w_m: [0.0, 0.0, 10.0],
            ..Measured::default()
        };
        let packet = packet(state, &measured, &Sticks::default());
        assert_eq!(packet.len(), 144);
        let (numbers, _) = packet.as_chunks::<8>();
        let numbers: Vec<f64> = numbers.iter().map(|it| f64::from_le_bytes(*it)).collect();
        let expected = [7.5, 1.0, -2.0, -3.0, -4.0, -5.0, -9.8, 0.5, 0.6, -0.7, -0.8];
        assert_eq!(numbers[..11], expected);
        assert_eq!(numbers[16..], [10.0, 101_205.0]);
    }

    #[test]
    fn sticks_are_channels() {
        let sticks = Sticks {
            roll: 1.0,
            pitch: -0.5,
            yaw: 0.1,
            throttle: 0.5,
            armed: true,
        };
        let channels = |sticks: &Sticks| {
            let packet = packet(remote, &Measured::default(), sticks);
            assert_eq!(packet.len(), 40);
            let (channels, _) = packet[8..].as_chunks::<2>();
            let channels = channels[..6].iter().map(|it| u16::from_le_bytes(*it));
            channels.collect::<Vec<_>>()
        };
        assert_eq!(channels(&sticks), [2000, 1250, 1525, 1550, 1800, 1800]);
        let low = channels(&Sticks::default());
        assert_eq!(low, [1500, 1500, 1000, 1500, 1000, 1800]);
    }
}
