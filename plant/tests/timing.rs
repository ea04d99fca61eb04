//! Timing of the plant stage: command hold, deadlines, skipped ticks, spin-down, the flight envelope.

use messages::content::{NO_TICK, State};
use messages::parameters::Parameter;
use plant::{EnvelopeViolation, Plant, PlantSettings, Swap};

use crate::{command, command_of, fly, fly_at, hover, miss, plant, speeds, verdict};

pub const IDLE: [f64; 4] = [30.0; 4];

#[test]
fn a_command_acts_from_the_tick_after_its_own() {
    let mut plant = plant();
    assert_eq!(verdict(&fly(&mut plant, 0)), (hover(), NO_TICK, 0, 0));
    for tick in 1..100 {
        let state = fly(&mut plant, tick);
        assert_eq!(verdict(&state), (speeds(tick - 1), tick - 1, 0, 0));
        let flown = tick.checked_sub(2).map_or(hover(), speeds);
        assert_eq!(state.measured.rotor_speed_mean_rad_s, flown);
        let squared = state.measured.rotor_speed_squared_mean_rad2_s2;
        assert_eq!(squared, flown.map(|w| w * w));
    }
    // Offered with its own tick, it still waits for the next.
    let mut plant = self::plant();
    plant.begin(0);
    plant.offer(&command(0), 0);
    plant.finish();
    assert_eq!(verdict(&plant.begin(1)), (speeds(0), 0, 0, 0));
}

#[test]
fn hover_holds_until_the_first_command_and_not_for_ever() {
    let mut plant = plant();
    for tick in 0..5 {
        let state = miss(&mut plant, tick);
        assert_eq!(verdict(&state), (hover(), NO_TICK, tick, tick));
    }
    plant.offer(&command(4), 5);
    assert_eq!(verdict(&plant.begin(5)), (speeds(4), 4, 4, 0));
    for (period_s, last) in [(0.001, 19), (0.002, 9)] {
        let mut plant = Plant::new(&PlantSettings {
            period_s,
            ..PlantSettings::default()
        });
        let commands = [last, last + 1].map(|tick| verdict(&plant.begin(tick)).0);
        assert_eq!(commands, [hover(), IDLE], "T = {period_s} s");
    }
}

#[test]
fn a_late_command_is_a_miss_and_acts_when_it_arrives() {
    let mut plant = plant();
    for tick in 0..10 {
        fly(&mut plant, tick);
    }
    // The command of tick 10 arrives a tick late, that of tick 12 in time behind it, that of 11 is overtaken.
    for (tick, offered, expected) in [
        (10, Some((10, 12)), (speeds(9), 9, 0, 0)),
        (11, None, (speeds(9), 9, 1, 1)),
        (12, Some((12, 13)), (speeds(10), 10, 2, 2)),
        (13, Some((11, 14)), (speeds(12), 12, 2, 0)),
        (14, None, (speeds(12), 12, 3, 1)),
    ] {
        assert_eq!(verdict(&plant.begin(tick)), expected, "tick {tick}");
        if let Some((of, effective)) = offered {
            plant.offer(&command(of), effective);
        }
        plant.finish();
    }
}

#[test]
fn of_two_commands_due_at_a_tick_the_newer_one_wins_in_either_order() {
    for pair in [[3, 4], [4, 3]] {
        let mut plant = plant();
        for tick in 0..5 {
            miss(&mut plant, tick);
        }
        for tick in pair {
            plant.offer(&command(tick), 5);
        }
        assert_eq!(verdict(&plant.begin(5)), (speeds(4), 4, 4, 0));
    }
}

#[test]
fn a_steady_delay_misses_every_deadline_but_flies() {
    // Commands of 64 ms may wait, at any rate.
    for (period_s, delay) in [(0.001, 3), (0.001, 63), (0.000_125, 500), (0.02, 63)] {
        let mut plant = Plant::new(&PlantSettings {
            period_s,
            ..PlantSettings::default()
        });
        for tick in 0..=3 * delay {
            let state = plant.begin(tick);
            let in_force = tick.checked_sub(delay).unwrap_or(NO_TICK);
            let (_, of, missed, run) = verdict(&state);
            assert_eq!(
                (of, missed, run),
                (in_force, tick, tick),
                "T = {period_s} s"
            );
            plant.offer(&command(tick), tick + delay);
            plant.finish();
        }
    }
}

#[test]
fn skipped_ticks_are_flown_judged_and_counted() {
    let (mut skipping, mut steady) = (plant(), plant());
    for tick in 0..10 {
        fly(&mut skipping, tick);
        fly(&mut steady, tick);
    }
    // The process oversleeps ticks 10, 11 and 12; no stage can have computed their commands.
    let state = skipping.begin(13);
    for tick in 10..13 {
        miss(&mut steady, tick);
    }
    let expected = State {
        ticks_skipped: 3,
        ..steady.begin(13)
    };
    assert_eq!(state, expected);
    // The command of tick 9 was in time for tick 10.
    assert_eq!(verdict(&state), (speeds(9), 9, 3, 3));
    skipping.offer(&command(13), 14);
    skipping.finish();
    assert_eq!(verdict(&skipping.begin(14)), (speeds(13), 13, 3, 0));
}

#[test]
fn a_tick_begun_twice_or_not_finished_is_flown_once() {
    let (mut plain, mut untidy) = (plant(), plant());
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
    // The command of tick 9 is in force from tick 10 on, and for 20 ticks. Sent again, it is not newer.
    for tick in 10..40 {
        let state = plant.begin(tick);
        let in_force = if tick < 30 { speeds(9) } else { IDLE };
        assert_eq!(verdict(&state), (in_force, 9, tick - 10, tick - 10));
        plant.offer(&command(9), tick + 1);
        plant.finish();
    }
    fly(&mut plant, 40);
    assert_eq!(verdict(&plant.begin(41)), (speeds(40), 40, 30, 0));
}

#[test]
fn the_end_judges_the_last_command_and_lets_no_swap_of_the_next_tick_hold() {
    for skipped in [0, 2] {
        let mut plant = plant();
        for (tick, mass_kg) in [(8, 0.6), (10, 0.7)] {
            let swap = Swap::new(tick, &[(Parameter::Mass, mass_kg)]).unwrap();
            plant.schedule(swap).unwrap();
        }
        for tick in 0..10 - skipped {
            fly(&mut plant, tick);
        }
        let state = plant.end(9);
        // Ticks that were slept through are flown, judged, and swapped in like any others.
        let last = 9 - skipped;
        assert_eq!(verdict(&state), (speeds(last), last, skipped, skipped));
        let counts = (state.ticks_skipped, state.parameter_epoch);
        assert_eq!((counts, plant.airframe().m()), ((skipped, 1), 0.6));
        let applied: Vec<u64> = plant.applied().iter().map(|swap| swap.tick).collect();
        assert_eq!(applied, [8][..usize::from(skipped > 0)]);
        assert_eq!(plant.end(9), state, "it ends once");
    }
}

#[test]
fn a_flight_out_of_its_envelope_is_told() {
    let mut plant = Plant::new(&PlantSettings {
        tilt_max_rad: 80.0_f64.to_radians(),
        ..PlantSettings::default()
    });
    assert_eq!(plant.envelope(), Ok(()));
    let flip = [350.0, 350.0, 30.0, 30.0];
    let mut violations = (0..2000).filter_map(|tick| {
        fly_at(&mut plant, tick, flip);
        plant.envelope().err()
    });
    let tilted = violations.next().unwrap();
    let is_tilt = matches!(tilted, EnvelopeViolation::Tilt { tilt_rad, .. } if tilt_rad > 1.396);
    assert!(is_tilt, "{tilted}");
    plant.begin(2001);
    plant.offer(&command_of(2001, [f64::NAN; 4]), 2002);
    plant.begin(2003);
    let not_finite = EnvelopeViolation::NotFinite { tick: 2003 };
    assert_eq!(plant.envelope(), Err(not_finite));
}
