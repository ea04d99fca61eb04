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

use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, TcpStream};
use std::time::{Duration, Instant};

use ironbird_law::Measured;
use messages::content::ROTORS;
use messages::telemetry::AnswerOutcome;

use crate::sticks::Sticks;
use crate::{PACKET_BYTES, Port};

pub const PORT: Port = Port {
    name: "betaflight",
    variable: "IRONBIRD_BETAFLIGHT",
    executable: "betaflight_SITL",
    files: &["eeprom.bin"],
    state_udp: 9003,
    remote_udp: 9004,
    motors_udp: 9002,
    state,
    remote,
    motors,
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

/// Writes numbers one after another.
fn write<const N: usize>(bytes: &mut [u8], numbers: impl IntoIterator<Item = [u8; N]>) -> usize {
    let mut at = 0;
    for number in numbers {
        bytes[at..at + N].copy_from_slice(&number);
        at += N;
    }
    at
}

fn state(time_s: f64, measured: &Measured, packet: &mut [u8; PACKET_BYTES]) -> usize {
    let [p, q, r] = measured.rate_b_rad_s;
    let [fx, fy, fz] = measured.specific_force_b_m_s2;
    let [w, x, y, z] = measured.attitude_quaternion;
    let [px, py, pz] = measured.position_w_m;
    let [vx, vy, vz] = measured.velocity_w_m_s;
    let pressure_pa = PRESSURE_PA - PRESSURE_PA_PER_M * pz;
    let (east, north) = (px / DEGREE_M, py / DEGREE_M);
    let numbers = [
        time_s,
        p,
        -q,
        -r,
        -fx,
        -fy,
        -fz,
        w,
        x,
        -y,
        -z,
        vx,
        vy,
        vz,
        east,
        north,
        pz,
        pressure_pa,
    ];
    write(packet, numbers.map(f64::to_le_bytes))
}

fn remote(time_s: f64, sticks: &Sticks, packet: &mut [u8; PACKET_BYTES]) -> usize {
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
    let time = write(packet, [time_s.to_le_bytes()]);
    time + write(&mut packet[time..], channels.map(u16::to_le_bytes))
}

/// Rotors 1 to 4 are rear left, rear right, front right, front left.
fn motors(packet: &[u8]) -> Result<[f64; ROTORS], AnswerOutcome> {
    let (numbers, rest) = packet.as_chunks::<4>();
    if packet.len() != MOTOR_BYTES || !rest.is_empty() {
        return Err(AnswerOutcome::WrongSize);
    }
    let number = |place: usize| f64::from(f32::from_le_bytes(numbers[place]));
    let commands = [1, 3, 0, 2].map(number);
    match commands.iter().all(|command| command.is_finite()) {
        true => Ok(commands.map(|command| command.clamp(0.0, 1.0))),
        false => Err(AnswerOutcome::NotFinite),
    }
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

    #[test]
    fn a_state_has_the_signs_that_the_firmware_turns_back() {
        let measured = Measured {
            rate_b_rad_s: [1.0, 2.0, 3.0],
            specific_force_b_m_s2: [4.0, 5.0, 9.8],
            attitude_quaternion: [0.5, 0.6, 0.7, 0.8],
            position_w_m: [0.0, 0.0, 10.0],
            ..Measured::default()
        };
        let mut packet = [0; PACKET_BYTES];
        assert_eq!(state(7.5, &measured, &mut packet), 144);
        let (numbers, _) = packet[..144].as_chunks::<8>();
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
            let mut packet = [0; PACKET_BYTES];
            assert_eq!(remote(0.0, sticks, &mut packet), 40);
            let (channels, _) = packet[8..40].as_chunks::<2>();
            channels[..6]
                .iter()
                .map(|it| u16::from_le_bytes(*it))
                .collect::<Vec<_>>()
        };
        assert_eq!(channels(&sticks), [2000, 1250, 1525, 1550, 1800, 1800]);
        let low = channels(&Sticks::default());
        assert_eq!(low, [1500, 1500, 1000, 1500, 1000, 1800]);
    }

    #[test]
    fn motors_come_in_the_order_of_the_rotors() {
        let packet: Vec<u8> = [0.3_f32, 0.1, 0.4, 0.2]
            .iter()
            .flat_map(|it| it.to_le_bytes())
            .collect();
        // Front right 0.3, rear left 0.1, front left 0.4, rear right 0.2.
        let expected = [0.1_f32, 0.2, 0.3, 0.4].map(f64::from);
        assert_eq!(motors(&packet), Ok(expected));
        assert_eq!(motors(&packet[..12]), Err(AnswerOutcome::WrongSize));
        assert_eq!(motors(&[0; 20]), Err(AnswerOutcome::WrongSize));
        let mut broken = packet;
        broken[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(motors(&broken), Err(AnswerOutcome::NotFinite));
    }
}
