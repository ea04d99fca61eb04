//! Timing of the plant stage: latch, deadlines, skipped ticks, spin-down; swaps; delays of commands.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod delays;
mod swaps;

use messages::content::{NO_TICK, RotorSpeeds, Stamped, State};
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter};
use plant::{EnvelopeViolation, Plant, PlantSettings, Swap};

const IDLE: [f64; 4] = [30.0; 4];

fn plant() -> Plant {
    Plant::new(&settings())
}

fn settings() -> PlantSettings {
    PlantSettings {
        period_s: 0.001,
        airframe: Airframe::nominal(),
        rotor: RotorLimits::default(),
        seed: 42,
        ..PlantSettings::default()
    }
}

fn hover() -> [f64; 4] {
    [Airframe::nominal().hover_speed_rad_s(); 4]
}

/// Speeds that tell the tick of their command.
fn speeds(tick: u64) -> [f64; 4] {
    [200.0 + tick as f64 * 0.01; 4]
}

fn command(tick: u64) -> Stamped<RotorSpeeds> {
    Stamped {
        tick,
        content: RotorSpeeds {
            speed_rad_s: speeds(tick),
            ..RotorSpeeds::default()
        },
    }
}

/// One tick with its command in time.
fn fly(plant: &mut Plant, tick: u64) -> State {
    let state = plant.begin(tick);
    plant.offer(&command(tick), tick + 1);
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

#[test]
fn a_command_acts_from_the_tick_after_its_own() {
    let mut plant = plant();
    assert_eq!(verdict(&fly(&mut plant, 0)), (hover(), NO_TICK, 0, 0));
    for tick in 1..100 {
        let state = fly(&mut plant, tick);
        assert_eq!(verdict(&state), (speeds(tick - 1), tick - 1, 0, 0));
        let flown = if tick == 1 { hover() } else { speeds(tick - 2) };
        assert_eq!(state.measured.rotor_speed_mean_rad_s, flown);
        assert_eq!(
            state.measured.rotor_speed_squared_mean_rad2_s2,
            flown.map(|w| w * w)
        );
    }
}

#[test]
fn a_command_offered_with_its_own_tick_still_waits_for_the_next() {
    let mut plant = plant();
    plant.begin(0);
    plant.offer(&command(0), 0);
    plant.finish();
    assert_eq!(verdict(&plant.begin(1)), (speeds(0), 0, 0, 0));
}

#[test]
fn hover_holds_until_the_first_command() {
    let mut plant = plant();
    for tick in 0..5 {
        assert_eq!(verdict(&plant.begin(tick)), (hover(), NO_TICK, tick, tick));
        plant.finish();
    }
    plant.offer(&command(4), 5);
    assert_eq!(verdict(&plant.begin(5)), (speeds(4), 4, 4, 0));
}

#[test]
fn a_late_command_is_a_miss_and_acts_when_it_arrives() {
    let mut plant = plant();
    for tick in 0..10 {
        fly(&mut plant, tick);
    }
    // The command of tick 10 arrives a tick late, that of tick 11 in time behind it.
    plant.begin(10);
    plant.offer(&command(10), 12);
    plant.finish();
    assert_eq!(verdict(&plant.begin(11)), (speeds(9), 9, 1, 1));
    plant.finish();
    assert_eq!(verdict(&plant.begin(12)), (speeds(10), 10, 2, 2));
    plant.offer(&command(12), 13);
    plant.finish();
    assert_eq!(verdict(&plant.begin(13)), (speeds(12), 12, 2, 0));
    // Late, and overtaken by its successor: never in force.
    plant.offer(&command(11), 14);
    plant.finish();
    assert_eq!(verdict(&plant.begin(14)), (speeds(12), 12, 3, 1));
}

#[test]
fn of_two_commands_due_at_a_tick_the_newer_one_wins_in_either_order() {
    for pair in [[3, 4], [4, 3]] {
        let mut plant = plant();
        for tick in 0..5 {
            plant.begin(tick);
            plant.finish();
        }
        for tick in pair {
            plant.offer(&command(tick), 5);
        }
        assert_eq!(verdict(&plant.begin(5)), (speeds(4), 4, 4, 0));
    }
}

#[test]
fn a_steady_delay_of_three_ticks_misses_every_deadline_but_flies() {
    let mut plant = plant();
    for tick in 0..100 {
        let state = plant.begin(tick);
        if tick >= 3 {
            assert_eq!(verdict(&state), (speeds(tick - 3), tick - 3, tick, tick));
        }
        plant.offer(&command(tick), tick + 3);
        plant.finish();
    }
}

#[test]
fn a_delay_beyond_the_room_for_waiting_commands_lets_some_through() {
    let mut plant = plant();
    let mut in_force = Vec::new();
    for tick in 0..100 {
        let state = plant.begin(tick);
        in_force.push(state.command_tick);
        plant.offer(&command(tick), tick + 10);
        plant.finish();
    }
    in_force.dedup();
    assert!(in_force.len() > 20, "{in_force:?}");
}

#[test]
fn commands_of_64_ms_may_wait_at_any_rate() {
    for (period_s, delay) in [(0.001, 63), (0.000_125, 500), (0.02, 63)] {
        let mut plant = Plant::new(&PlantSettings {
            period_s,
            ..settings()
        });
        for tick in 0..=3 * delay {
            let state = plant.begin(tick);
            let in_force = tick.checked_sub(delay).unwrap_or(NO_TICK);
            assert_eq!(
                state.command_tick, in_force,
                "tick {tick}, T = {period_s} s: as late as its delay, and no more"
            );
            plant.offer(&command(tick), tick + delay);
            plant.finish();
        }
    }
}

#[test]
fn skipped_ticks_are_flown_judged_and_counted() {
    let mut skipping = plant();
    let mut steady = plant();
    for tick in 0..10 {
        fly(&mut skipping, tick);
        fly(&mut steady, tick);
    }
    // The shell oversleeps ticks 10, 11 and 12; nobody can have computed their commands.
    let state = skipping.begin(13);
    for tick in 10..13 {
        steady.begin(tick);
        steady.finish();
    }
    let expected = steady.begin(13);
    assert_eq!(
        state,
        State {
            ticks_skipped: 3,
            ..expected
        }
    );
    // The command of tick 9 was in time for tick 10.
    assert_eq!(verdict(&state), (speeds(9), 9, 3, 3));
    skipping.offer(&command(13), 14);
    skipping.finish();
    assert_eq!(verdict(&skipping.begin(14)), (speeds(13), 13, 3, 0));
}

#[test]
fn a_tick_begun_twice_or_not_finished_is_flown_once() {
    let mut plain = plant();
    let mut untidy = plant();
    for tick in 0..10 {
        let expected = fly(&mut plain, tick);
        untidy.begin(tick);
        assert_eq!(untidy.begin(tick), expected);
        untidy.offer(&command(tick), tick + 1);
        if tick % 2 == 0 {
            untidy.finish();
            untidy.finish();
        }
    }
    // Ten is next; three lies behind.
    plain.begin(10);
    untidy.begin(10);
    let expected = plain.begin(10);
    assert_eq!(untidy.begin(3), expected);
    assert_eq!(expected.ticks_skipped, 0);
}

#[test]
fn without_commands_for_20_ms_the_rotors_idle_until_a_newer_one() {
    let mut plant = plant();
    for tick in 0..=9 {
        fly(&mut plant, tick);
    }
    // The command of tick 9 is in force from tick 10 on, and for 20 ticks.
    for tick in 10..40 {
        let state = plant.begin(tick);
        let in_force = if tick < 30 { speeds(9) } else { IDLE };
        assert_eq!(
            verdict(&state),
            (in_force, 9, tick - 10, tick - 10),
            "tick {tick}"
        );
        // Sent again, it is not newer.
        plant.offer(&command(9), tick + 1);
        plant.finish();
    }
    plant.begin(40);
    plant.offer(&command(40), 41);
    plant.finish();
    assert_eq!(verdict(&plant.begin(41)), (speeds(40), 40, 30, 0));
}

#[test]
fn hover_does_not_hold_for_ever_either() {
    let mut plant = plant();
    assert_eq!(plant.begin(19).measured.rotor_speed_command_rad_s, hover());
    assert_eq!(plant.begin(20).measured.rotor_speed_command_rad_s, IDLE);
}

#[test]
fn the_timeout_counts_ticks_of_any_length() {
    let mut plant = Plant::new(&PlantSettings {
        period_s: 0.002,
        ..settings()
    });
    assert_eq!(plant.begin(9).measured.rotor_speed_command_rad_s, hover());
    assert_eq!(plant.begin(10).measured.rotor_speed_command_rad_s, IDLE);
}

#[test]
fn the_end_judges_the_last_command_and_lets_no_swap_of_the_next_tick_hold() {
    for skipped in [0, 2] {
        let mut plant = plant();
        for (tick, mass_kg) in [(8, 0.6), (10, 0.7)] {
            plant
                .schedule(Swap::new(tick, &[(Parameter::Mass, mass_kg)]).unwrap())
                .unwrap();
        }
        for tick in 0..10 - skipped {
            fly(&mut plant, tick);
        }
        let state = plant.end(9);
        // Ticks that were slept through are flown, judged, and swapped in like any others.
        assert_eq!(
            verdict(&state),
            (speeds(9 - skipped), 9 - skipped, skipped, skipped)
        );
        assert_eq!(
            (
                state.ticks_skipped,
                state.parameter_epoch,
                plant.airframe().m()
            ),
            (skipped, 1, 0.6)
        );
        assert_eq!(
            plant.applied().iter().map(|swap| swap.tick).sum::<u64>(),
            if skipped == 0 { 0 } else { 8 }
        );
        assert_eq!(plant.end(9), state, "it ends once");
    }
}

#[test]
fn gyro_noise_is_in_the_measurement_and_not_in_the_truth() {
    let swap = || Swap::new(10, &[(Parameter::GyroNoise, 0.01)]).unwrap();
    let (mut noisy, mut quiet, mut other) = (
        plant(),
        plant(),
        Plant::new(&PlantSettings {
            seed: 43,
            ..settings()
        }),
    );
    noisy.schedule(swap()).unwrap();
    other.schedule(swap()).unwrap();
    for tick in 0..20 {
        let (n, q, o) = (
            fly(&mut noisy, tick),
            fly(&mut quiet, tick),
            fly(&mut other, tick),
        );
        assert_eq!(q.measured.rate_b_rad_s, q.truth.rate_b_rad_s);
        assert_eq!(n.truth.rate_b_rad_s, q.truth.rate_b_rad_s);
        assert_eq!(n.measured.rate_b_rad_s == n.truth.rate_b_rad_s, tick < 10);
        assert_eq!(
            n.measured.rate_b_rad_s == o.measured.rate_b_rad_s,
            tick < 10
        );
    }
}

#[test]
fn a_flight_out_of_its_envelope_is_told() {
    let tilt_max_rad = 80.0_f64.to_radians();
    let mut plant = Plant::new(&PlantSettings {
        tilt_max_rad,
        ..settings()
    });
    assert_eq!(plant.envelope(), Ok(()));
    let flip = RotorSpeeds {
        speed_rad_s: [350.0, 350.0, 30.0, 30.0],
        ..RotorSpeeds::default()
    };
    let departure = (0..2000)
        .find_map(|tick| {
            plant.begin(tick);
            plant.offer(
                &Stamped {
                    tick,
                    content: flip,
                },
                tick + 1,
            );
            plant.finish();
            plant.envelope().err()
        })
        .unwrap();
    assert!(
        matches!(departure, EnvelopeViolation::Tilt { tilt_rad, .. } if tilt_rad > 1.396),
        "{departure}"
    );
    let wrong = RotorSpeeds {
        speed_rad_s: [f64::NAN; 4],
        ..RotorSpeeds::default()
    };
    plant.begin(2001);
    plant.offer(
        &Stamped {
            tick: 2001,
            content: wrong,
        },
        2002,
    );
    plant.begin(2003);
    assert_eq!(
        plant.envelope(),
        Err(EnvelopeViolation::NotFinite { tick: 2003 })
    );
}
