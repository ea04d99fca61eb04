//! Prints the table of docs/plant.md: what fewer Runge-Kutta steps per tick cost in accuracy and gain in speed.
//!
//! Flies each flight with each number of steps, and compares it with one of 40 steps per tick.

use std::time::{Duration, Instant};

use config::Settings;
use errors::Failure;
use nalgebra::Vector3;
use sim::simulator::Simulator;
use toml::Table;

const FLIGHT_S: f64 = 30.0;
const REFERENCE_STEPS: u32 = 40;
/// Flights of which the fastest counts.
const FLIGHTS: usize = 9;

fn main() -> Result<(), Failure> {
    println!(
        "| trajectory, motor lag | rate [Hz] | steps | position [m] | attitude [rad] | time of a tick [us] |"
    );
    println!("|---|---|---|---|---|---|");
    let flights = [("lissajous", 0.0), ("fast", 0.02)];
    let rates = [1000.0, 500.0, 250.0];
    for (flight, rate_hz) in flights
        .into_iter()
        .flat_map(|it| rates.map(|rate| (it, rate)))
    {
        let (reference, _) = fly(flight, rate_hz, REFERENCE_STEPS)?;
        for steps in [1, 2, 4] {
            let (flown, mut fastest) = fly(flight, rate_hz, steps)?;
            for _ in 1..FLIGHTS {
                fastest = fastest.min(fly(flight, rate_hz, steps)?.1);
            }
            let largest = |part: usize| {
                let pairs = flown.iter().zip(&reference);
                let off = pairs.map(|(it, other)| (it[part] - other[part]).norm());
                off.fold(0.0, f64::max)
            };
            let (position_m, attitude_rad) = (largest(0), largest(1));
            let tick_us = fastest.as_secs_f64() / flown.len() as f64 * 1e6;
            let (trajectory, lag_s) = flight;
            println!(
                "| {trajectory}, {lag_s} s | {rate_hz} | {steps} | {position_m:.1e} | {attitude_rad:.1e} | {tick_us:.2} |"
            );
        }
    }
    Ok(())
}

/// Position [m] and attitude [rad] at a tick.
type Sample = [Vector3<f64>; 2];

/// A flight along a trajectory with a motor lag [s], and how long it took.
fn fly(
    (trajectory, lag_s): (&str, f64),
    rate_hz: f64,
    substeps: u32,
) -> Result<(Vec<Sample>, Duration), Failure> {
    let given = format!(
        "flight = {{ trajectory = \"{trajectory}\", duration_s = {FLIGHT_S:?}, period_s = {:?} }}\n\
         plant.motor_time_constant_s = {lag_s:?}\n",
        1.0 / rate_hz
    );
    let given: Table = given.parse().map_err(|e| Failure::failed(format!("{e}")))?;
    let mut settings = Settings::of(given, &Vec::new())?;
    // Beyond what users may set.
    settings.plant.substeps = substeps;
    let mut rig = Simulator::of(&settings)?;
    let mut samples = Vec::with_capacity(settings.last_tick() as usize + 1);
    let begin = Instant::now();
    while rig.next_tick() <= settings.last_tick() {
        rig.tick();
        let state = rig.state();
        samples.push([
            state.truth.position_w_m.into(),
            state.measured.attitude_rad.into(),
        ]);
    }
    Ok((samples, begin.elapsed()))
}
