//! The common work of bench/peers: `open_loop work` writes it, `open_loop fly WORK.json STEPS` flies it with our plant.
//!
//! The work is one closed-loop flight of ours (Lissajous, gains `flight`, 10 s at 1 kHz) with drag, rotor inertia and
//! disturbance set to zero, which the peers cannot model: its rotor speeds, tick by tick, and what they push with.
//! Flown open loop it is a rigid body under piecewise constant thrust and torque. Both print JSON.

use std::error::Error;
use std::hint::black_box;
use std::time::Instant;

use control_api::description::Settings;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{INNER, OUTER};
use controller::{ScaledTrajectory, Trajectory};
use messages::parameters::{Airframe, Parameter};
use plant::integrator::{SUBSTEPS, integrate};
use plant::rigid_body::RigidBody;
use plant::rotors::{Spin, effort};
use serde_json::{Value, json};
use sim::simulator::Simulator;

const TICKS: u64 = 10_000;
/// Ticks that are flown first and not timed: they find caches cold.
const WARM: usize = 1000;
/// The reference's steps are a tenth of the plant's.
const REFERENCE_STEPS: u32 = 10 * SUBSTEPS;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let result = match args.as_slice() {
        ["work"] => work()?,
        ["fly", path, steps] => timed(
            &serde_json::from_slice(&std::fs::read(path)?)?,
            steps.parse()?,
        )?,
        _ => return Err("usage: open_loop work | open_loop fly WORK.json STEPS_PER_TICK".into()),
    };
    println!("{result}");
    Ok(())
}

/// The nominal airframe without what the peers cannot model.
fn airframe() -> Result<Airframe, Box<dyn Error>> {
    let mut airframe = Airframe::nominal();
    for parameter in [
        Parameter::TranslationalDrag,
        Parameter::RotationalDrag,
        Parameter::RotorInertia,
        Parameter::DisturbanceGain,
    ] {
        airframe.set(parameter, 0.0)?;
    }
    Ok(airframe)
}

fn work() -> Result<Value, Box<dyn Error>> {
    let airframe = airframe()?;
    let (rig, defaults) = (
        Rig {
            airframe,
            ..Rig::default()
        },
        Settings::default(),
    );
    let Rig {
        period_s, rotor, ..
    } = rig;
    let route = ScaledTrajectory::of(Trajectory::Lissajous).route(period_s);
    let mut flight = Simulator::new(
        &plant::PlantSettings {
            period_s,
            airframe,
            rotor,
            seed: 0,
            ..plant::PlantSettings::default()
        },
        GuardedOuter::new(OUTER[0].make(&rig, &defaults)?, route, &rig),
        GuardedInner::new(INNER[0].make(&rig, &defaults)?, &rig),
        GuardedMixer::new(mixer::LAWS[0].make(&rig, &defaults)?, &rig),
    );
    let commanded = |_| {
        flight.tick();
        flight.state().measured.rotor_speed_command_rad_s
    };
    let speeds: Vec<[f64; 4]> = (0..TICKS).map(commanded).collect();
    let commands: Vec<Value> = speeds
        .iter()
        .map(|speed| {
            let push = effort(&airframe, &(*speed).into());
            let torque: [f64; 3] = push.tau.into();
            json!({ "speed_rad_s": speed, "thrust_n": push.u, "torque_b_nm": torque })
        })
        .collect();
    let end = fly(&airframe, &speeds, period_s, REFERENCE_STEPS);
    Ok(json!({
        "period_s": period_s,
        "mass_kg": airframe.m(),
        "gravity_m_s2": airframe.g(),
        "inertia_kg_m2": airframe.i_m(),
        "arm_length_m": airframe.l(),
        "thrust_coefficient_n_s2": airframe.k(),
        "drag_factor_nm_s2": airframe.d(),
        "steps_per_tick": SUBSTEPS,
        "reference": { "steps_per_tick": REFERENCE_STEPS, "end": end_state(&end) },
        "commands": commands,
    }))
}

fn timed(work: &Value, steps: u32) -> Result<Value, Box<dyn Error>> {
    let airframe = airframe()?;
    let period_s = work["period_s"]
        .as_f64()
        .ok_or("period_s is not a number")?;
    let commands = work["commands"]
        .as_array()
        .ok_or("commands is not a list")?;
    let speeds: Vec<[f64; 4]> = commands
        .iter()
        .map(|command| serde_json::from_value(command["speed_rad_s"].clone()))
        .collect::<Result<_, _>>()?;
    black_box(fly(
        &airframe,
        &speeds[..speeds.len().min(WARM)],
        period_s,
        steps,
    ));
    let begin = Instant::now();
    let end = fly(&airframe, black_box(&speeds), period_s, steps);
    let wall_s = begin.elapsed().as_secs_f64();
    let mut result = end_state(&end);
    result["wall_s"] = json!(wall_s);
    Ok(result)
}

/// The body at the end, from rest in the origin, each set of rotor speeds held for a tick.
fn fly(airframe: &Airframe, speeds: &[[f64; 4]], period_s: f64, steps: u32) -> RigidBody {
    speeds
        .iter()
        .zip(0..)
        .fold(RigidBody::default(), |body, (speed, tick)| {
            let spin = Spin::new(airframe, (*speed).into(), (*speed).into());
            integrate(&body, airframe, &spin, tick, period_s, steps)
        })
}

fn end_state(body: &RigidBody) -> Value {
    let position: [f64; 3] = body.eta1.into();
    let [w, x, y, z] = body.attitude.wxyz();
    json!({ "position_w_m": position, "quaternion_wb_xyzw": [x, y, z, w] })
}
