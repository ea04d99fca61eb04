//! Commands that reach the motors late.

use messages::content::{NO_TICK, State};
use messages::parameters::{Airframe, Parameter};
use plant::{Plant, PlantSettings, Swap};

use crate::timing::IDLE;
use crate::{fly, hover, plant, settings, speeds, verdict};

/// Rotor speeds over the tick before.
fn turned(state: &State) -> [f64; 4] {
    state.measured.rotor_speed_mean_rad_s
}

fn delayed(delay_s: f64, period_s: f64) -> Plant {
    Plant::new(&PlantSettings {
        period_s,
        ..settings(&[(Parameter::CommandDelay, delay_s)])
    })
}

#[test]
fn a_delay_of_commands_reaches_the_motors_and_no_verdict() {
    let mut plant = delayed(0.003, 0.001);
    for tick in 0..50 {
        let state = fly(&mut plant, tick);
        // The command of tick k is in force in k + 1, acts in k + 4, and is the mean of the tick before k + 5.
        let mean = tick.checked_sub(5).map_or(hover(), speeds);
        assert_eq!(turned(&state), mean, "tick {tick}");
        let (in_force, of) = match tick.checked_sub(1) {
            Some(last) => (speeds(last), last),
            None => (hover(), NO_TICK),
        };
        assert_eq!(verdict(&state), (in_force, of, 0, 0));
    }
    let mut idle = delayed(0.002, 0.001);
    let first = (0..30).find(|tick| turned(&idle.begin(*tick)) == IDLE);
    assert_eq!(first, Some(23), "in force in tick 20, acts in 22");
}

#[test]
fn a_delay_that_grows_repeats_commands_and_one_that_shrinks_skips_some() {
    let mut plant = plant();
    for (tick, delay_s) in [(20, 0.010), (40, 0.001)] {
        let swap = Swap::new(tick, &[(Parameter::CommandDelay, delay_s)]);
        plant.schedule(swap.unwrap()).unwrap();
    }
    for tick in 0..60 {
        let state = fly(&mut plant, tick);
        let delay = match tick {
            0..=20 => 0,
            21..=40 => 10,
            _ => 1,
        };
        if tick >= 2 {
            assert_eq!(turned(&state), speeds(tick - 2 - delay), "tick {tick}");
        }
    }
}

#[test]
fn a_delay_is_rounded_to_ticks_of_any_length() {
    for (period_s, delay_s, ticks) in [
        (1e-3, 0.0, 0),
        (1e-3, 0.0004, 0),
        (1e-3, 0.0006, 1),
        (1e-4, 0.010, 100),
        (0.02, 0.010, 1),
    ] {
        let mut plant = delayed(delay_s, period_s);
        let first = (0..200).find(|tick| turned(&fly(&mut plant, *tick)) == speeds(0));
        assert_eq!(first, Some(ticks + 2), "{delay_s} s at {period_s} s");
    }
    let mut airframe = Airframe::nominal();
    assert!(airframe.set(Parameter::CommandDelay, 0.011).is_err());
}
