//! Tests of the airframe simulation.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod attitude;
mod delays;
mod ground;
mod physics;
#[path = "../../shared/reference/vectors.rs"]
mod reference;
mod reference_vectors;
mod sensors;
mod swaps;
mod timing;
mod wind;

use messages::content::{RotorSpeeds, Stamped, State};
use messages::parameters::{Airframe, Parameter};
use plant::{Plant, PlantSettings};

const PERIOD_S: f64 = 0.001;

/// The nominal airframe with some values that differ.
fn airframe(changes: &[(Parameter, f64)]) -> Airframe {
    let mut airframe = Airframe::nominal();
    for &(parameter, value) in changes {
        airframe.set(parameter, value).unwrap();
    }
    airframe
}

fn settings(changes: &[(Parameter, f64)]) -> PlantSettings {
    PlantSettings {
        airframe: airframe(changes),
        ..PlantSettings::default()
    }
}

fn plant() -> Plant {
    Plant::new(&PlantSettings::default())
}

fn hover() -> [f64; 4] {
    [Airframe::nominal().hover_speed_rad_s(); 4]
}

/// Speeds that tell the tick of their command.
fn speeds(tick: u64) -> [f64; 4] {
    [200.0 + tick as f64 * 0.01; 4]
}

fn command_of(tick: u64, speed_rad_s: [f64; 4]) -> Stamped<RotorSpeeds> {
    let content = RotorSpeeds {
        speed_rad_s,
        ..RotorSpeeds::default()
    };
    Stamped::new(tick, content)
}

fn command(tick: u64) -> Stamped<RotorSpeeds> {
    command_of(tick, speeds(tick))
}

/// One tick with a command in time.
fn fly_at(plant: &mut Plant, tick: u64, speed_rad_s: [f64; 4]) -> State {
    let state = plant.begin(tick);
    plant.offer(&command_of(tick, speed_rad_s), tick + 1);
    plant.finish();
    state
}

fn fly(plant: &mut Plant, tick: u64) -> State {
    fly_at(plant, tick, speeds(tick))
}

/// One tick without a command.
fn miss(plant: &mut Plant, tick: u64) -> State {
    let state = plant.begin(tick);
    plant.finish();
    state
}

/// Command in force, its tick, misses so far and the run.
fn verdict(state: &State) -> ([f64; 4], u64, u64, u64) {
    (
        state.measured.rotor_speed_command_rad_s,
        state.command_tick,
        state.deadlines_missed,
        state.deadline_miss_run,
    )
}
