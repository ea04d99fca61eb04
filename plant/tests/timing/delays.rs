//! Commands that reach the motors late.

use super::{IDLE, fly, hover, plant, settings, speeds, verdict};
use messages::content::{NO_TICK, State};
use messages::parameters::{Airframe, Parameter};
use plant::{Plant, PlantSettings, Swap};

/// Rotor speeds over the tick before.
fn turned(state: &State) -> [f64; 4] {
    state.measured.rotor_speed_mean_rad_s
}

#[test]
fn a_delay_of_commands_reaches_the_motors_and_no_verdict() {
    let mut airframe = Airframe::nominal();
    airframe.set(Parameter::CommandDelay, 0.003).unwrap();
    let mut plant = Plant::new(&PlantSettings {
        airframe,
        ..settings()
    });
    for tick in 0..50 {
        let state = fly(&mut plant, tick);
        // The command of tick k is in force in k + 1, acts in k + 4, and is the mean of the tick before k + 5.
        assert_eq!(
            turned(&state),
            if tick < 5 { hover() } else { speeds(tick - 5) },
            "tick {tick}"
        );
        let in_force = if tick == 0 {
            (hover(), NO_TICK, 0, 0)
        } else {
            (speeds(tick - 1), tick - 1, 0, 0)
        };
        assert_eq!(verdict(&state), in_force);
    }
}

#[test]
fn a_delay_that_grows_repeats_commands_and_one_that_shrinks_skips_some() {
    let mut plant = plant();
    plant
        .schedule(Swap::new(20, &[(Parameter::CommandDelay, 0.010)]).unwrap())
        .unwrap();
    plant
        .schedule(Swap::new(40, &[(Parameter::CommandDelay, 0.001)]).unwrap())
        .unwrap();
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
    let first_of = |period_s: f64, delay_s: f64| {
        let mut airframe = Airframe::nominal();
        airframe.set(Parameter::CommandDelay, delay_s).unwrap();
        let mut plant = Plant::new(&PlantSettings {
            airframe,
            period_s,
            ..settings()
        });
        (0..200)
            .find(|tick| turned(&fly(&mut plant, *tick)) == speeds(0))
            .map(|tick| tick - 2)
    };
    assert_eq!(first_of(1e-3, 0.0), Some(0));
    assert_eq!(first_of(1e-3, 0.0004), Some(0));
    assert_eq!(first_of(1e-3, 0.0006), Some(1));
    assert_eq!(first_of(1e-4, 0.010), Some(100));
    assert_eq!(first_of(0.02, 0.010), Some(1), "half a tick is one");
    assert!(
        Airframe::nominal()
            .set(Parameter::CommandDelay, 0.011)
            .is_err()
    );
}

#[test]
fn idle_comes_late_too() {
    let mut airframe = Airframe::nominal();
    airframe.set(Parameter::CommandDelay, 0.002).unwrap();
    let mut plant = Plant::new(&PlantSettings {
        airframe,
        ..settings()
    });
    let idle: Vec<u64> = (0..30)
        .filter(|tick| turned(&plant.begin(*tick)) == IDLE)
        .collect();
    assert_eq!(idle.first(), Some(&23), "in force in tick 20, acts in 22");
}
