//! Setpoints and commands of a ground station as targets of the plant, and the modes of a vehicle that it flies.

use std::f64::consts::TAU;

use ipc::TargetOrder;
use mavlink::dialects::common::*;
use messages::content::{FlightTarget, TargetKind};
use plant::guidance;

use super::failures::{Refused, denied};
use super::parameters::meant;
use crate::watch::dashboard_model::WatchedFlight;
use messages::ned::{ORIGIN, local, turned, turned_angles};

/// Comes to rest, and stays there.
pub const HOLD: TargetOrder = TargetOrder {
    target: FlightTarget {
        from_tick: 0,
        kind: TargetKind::Hold as u64,
        position_w_m: [0.0; 3],
        velocity_w_m_s: [0.0; 3],
        yaw_rad: 0.0,
    },
    has_yaw: 0,
    stays: 1,
};

/// Height of a take-off that names none, above the start [m].
const TAKEOFF_M: f64 = 2.5;

/// A mode that a ground station can choose. The numbers are PX4's, which MAVSDK uses for all but ArduPilot: the main mode is
/// in bits 16 to 23, the sub-mode above it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    Hold = 4 << 16 | 3 << 24,
    Offboard = 6 << 16,
}

impl Mode {
    pub const ALL: [Self; 2] = [Self::Hold, Self::Offboard];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Hold => "Hold",
            Self::Offboard => "Offboard",
        }
    }
}

/// The lowest target, where the vehicle stands on the ground [m].
pub fn lowest_m(flight: &WatchedFlight) -> f64 {
    flight.settings.flight.ground_z_m + flight.settings.ground.leg_m
}

/// Checks a target; a yaw that is no number keeps the one before.
fn order(
    target: FlightTarget,
    yaw_rad: f64,
    stays: bool,
    flight: &WatchedFlight,
) -> Result<TargetOrder, String> {
    let has_yaw = !yaw_rad.is_nan();
    let yaw_rad = if has_yaw { yaw_rad } else { 0.0 };
    // Turned zeros are negative.
    let target = FlightTarget {
        yaw_rad: yaw_rad + 0.0,
        position_w_m: target.position_w_m.map(|it| it + 0.0),
        velocity_w_m_s: target.velocity_w_m_s.map(|it| it + 0.0),
        ..target
    };
    guidance::check(&target).map_err(|e| e.to_string())?;
    let (height_m, lowest_m) = (target.position_w_m[2], lowest_m(flight));
    if target.kind == TargetKind::Position as u64 && height_m < lowest_m {
        return Err(format!(
            "height of the target: {height_m} m above the start: allowed are {lowest_m} m and more; the start is {} m above \
             sea level",
            ORIGIN[2]
        ));
    }
    Ok(TargetOrder {
        target,
        has_yaw: u64::from(has_yaw),
        stays: u64::from(stays),
    })
}

/// The target of a setpoint: a position, a velocity, or both, in the local frame, and a yaw if there is one.
pub fn of_setpoint(
    it: &SET_POSITION_TARGET_LOCAL_NED_DATA,
    flight: &WatchedFlight,
) -> Result<TargetOrder, String> {
    const POSITION: u16 = 0b111;
    const VELOCITY: u16 = POSITION << 3;
    const ACCELERATION: u16 = POSITION << 6;
    const YAW: u16 = 1 << 10;
    const YAW_RATE: u16 = 1 << 11;
    let ignored = it.type_mask.bits();
    if it.coordinate_frame != MavFrame::MAV_FRAME_LOCAL_NED {
        let frame = it.coordinate_frame;
        return Err(format!(
            "setpoint in {frame:?}: allowed is MAV_FRAME_LOCAL_NED"
        ));
    }
    let has = |all: u16| match ignored & all {
        0 => Some(true),
        some if some == all => Some(false),
        _ => None,
    };
    let (Some(has_position), Some(has_velocity)) = (has(POSITION), has(VELOCITY)) else {
        return Err("setpoint with a part of a vector: give or ignore all three axes".into());
    };
    let is_supported = has(ACCELERATION | YAW_RATE) == Some(false);
    if !is_supported || !(has_position || has_velocity) {
        return Err(format!(
            "setpoint with type_mask {ignored:#06x}: allowed are position, velocity and yaw; ignore all else"
        ));
    }
    let vector = |has: bool, vector: [f32; 3]| match has {
        true => turned(vector.map(meant)),
        false => [0.0; 3],
    };
    let kind = match has_position {
        true => TargetKind::Position,
        false => TargetKind::Velocity,
    };
    let target = FlightTarget {
        kind: kind as u64,
        position_w_m: vector(has_position, [it.x, it.y, it.z]),
        velocity_w_m_s: vector(has_velocity, [it.vx, it.vy, it.vz]),
        ..FlightTarget::default()
    };
    let has_yaw = has(YAW) == Some(true);
    if has_yaw && !it.yaw.is_finite() {
        return Err(format!("yaw of the setpoint: {} is no angle", it.yaw));
    }
    let yaw_rad = if has_yaw {
        yaw_of(meant(it.yaw))
    } else {
        f64::NAN
    };
    order(target, yaw_rad, false, flight)
}

/// The yaw of a heading [rad]; NaN of none.
fn yaw_of(heading_rad: f64) -> f64 {
    turned_angles([0.0, 0.0, heading_rad.rem_euclid(TAU)])[2]
}

/// A command, in whichever of the two messages it came.
#[derive(Clone, Copy, Debug)]
pub struct Command {
    pub name: MavCmd,
    /// The first four.
    pub parameters: [f32; 4],
    /// None in a frame that is not global.
    place: Option<Place>,
}

/// The place that a command is about; what it leaves out is none.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    latitude_longitude_deg: Option<[f64; 2]>,
    /// Above the start [m].
    height_m: Option<f64>,
}

impl Command {
    pub fn long(it: &COMMAND_LONG_DATA) -> Self {
        // The altitude of a take-off is above the start: clients send it so to all autopilots but PX4.
        let begin_m = match it.command {
            MavCmd::MAV_CMD_NAV_TAKEOFF => 0.0,
            _ => ORIGIN[2],
        };
        Self {
            name: it.command,
            parameters: [it.param1, it.param2, it.param3, it.param4],
            place: Some(Place::new(
                [it.param5, it.param6].map(meant),
                it.param7,
                begin_m,
            )),
        }
    }

    #[expect(deprecated, reason = "sent by older clients")]
    pub fn int(it: &COMMAND_INT_DATA) -> Self {
        let begin_m = match it.frame {
            MavFrame::MAV_FRAME_GLOBAL | MavFrame::MAV_FRAME_GLOBAL_INT => Some(ORIGIN[2]),
            MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT
            | MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT => Some(0.0),
            _ => None,
        };
        let degrees = [it.x, it.y].map(|it| match it {
            i32::MAX => f64::NAN,
            it => f64::from(it) * 1e-7,
        });
        Self {
            name: it.command,
            parameters: [it.param1, it.param2, it.param3, it.param4],
            place: begin_m.map(|begin_m| Place::new(degrees, it.z, begin_m)),
        }
    }

    /// The mode that MAV_CMD_DO_SET_MODE selects.
    pub fn mode(&self) -> Option<Mode> {
        let [_, main, sub, _] = self.parameters.map(|it| it as u32);
        let number = |mode: &Mode| *mode as u32;
        let mut modes = Mode::ALL.into_iter();
        let is_mode = self.name == MavCmd::MAV_CMD_DO_SET_MODE;
        modes.find(|it| is_mode && [number(it) >> 16 & 0xff, number(it) >> 24] == [main, sub])
    }
}

impl Place {
    fn new(degrees: [f64; 2], altitude_m: f32, begin_m: f64) -> Self {
        let is_given = degrees.iter().all(|it| !it.is_nan()) && degrees != [0.0; 2];
        Self {
            latitude_longitude_deg: is_given.then_some(degrees),
            height_m: (!altitude_m.is_nan()).then(|| meant(altitude_m) - begin_m),
        }
    }
}

/// The target of a command.
pub fn of_command(command: &Command, flight: &WatchedFlight) -> Result<TargetOrder, Refused> {
    let (name, [first, .., heading]) = (command.name, command.parameters);
    let heading_rad = match name {
        // In degrees, by MAVLink's description of these two.
        MavCmd::MAV_CMD_NAV_TAKEOFF | MavCmd::MAV_CMD_NAV_LAND => meant(heading).to_radians(),
        _ => meant(heading),
    };
    let height_m = match name {
        MavCmd::MAV_CMD_DO_SET_MODE if command.mode() == Some(Mode::Hold) => return Ok(HOLD),
        MavCmd::MAV_CMD_DO_SET_MODE => {
            let modes = Mode::ALL.map(Mode::name).join(" and ");
            return Err(denied(format!("modes of this vehicle: {modes}")));
        }
        MavCmd::MAV_CMD_DO_PAUSE_CONTINUE if first == 0.0 => return Ok(HOLD),
        MavCmd::MAV_CMD_NAV_TAKEOFF => Some(TAKEOFF_M),
        MavCmd::MAV_CMD_NAV_LAND => Some(lowest_m(flight)),
        MavCmd::MAV_CMD_DO_REPOSITION if first > 0.0 => {
            let why = format!("speed {first} m/s of the reposition: allowed is -1");
            return Err(denied(why));
        }
        MavCmd::MAV_CMD_DO_REPOSITION => None,
        MavCmd::MAV_CMD_DO_PAUSE_CONTINUE => {
            return Err(denied("a flight that holds continues with its next target"));
        }
        _ => return Err(denied(format!("{name:?} is not flown here"))),
    };
    let no_place = || {
        denied(
            "the frame of the command is not global: use MAV_FRAME_GLOBAL or MAV_FRAME_GLOBAL_RELATIVE_ALT",
        )
    };
    let place = command.place.ok_or_else(no_place)?;
    let lands = name == MavCmd::MAV_CMD_NAV_LAND;
    let mut position_w_m = flight.state.unwrap_or_default().reference.position_w_m;
    if let Some(degrees) = place.latitude_longitude_deg {
        [position_w_m[0], position_w_m[1], _] = turned(local(degrees));
    }
    let height_m = place.height_m.filter(|_| !lands).or(height_m);
    position_w_m[2] = height_m.unwrap_or(position_w_m[2]);
    let target = FlightTarget {
        kind: TargetKind::Position as u64,
        position_w_m,
        ..FlightTarget::default()
    };
    order(target, yaw_of(heading_rad), true, flight).map_err(denied)
}
