//! Safety of the mixer stage: its output for a wrench of each age.

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::{GuardedMixer, Rig};
use messages::content::{Mode, NO_TICK, RotorSpeeds, Stamped, Wrench};
use mixer::RollPitchFirst;

fn mixer(period_s: f64) -> GuardedMixer {
    let rig = Rig {
        period_s,
        ..Rig::default()
    };
    let law = RollPitchFirst::new(&rig, &Settings::default()).unwrap();
    GuardedMixer::new(law.into(), &rig)
}

fn wrench(tick: u64) -> Stamped<Wrench> {
    let content = Wrench {
        thrust_n: 5.0,
        torque_b_nm: [0.02, -0.01, 0.005],
        ..Wrench::default()
    };
    Stamped { tick, content }
}

fn assert_idle(speeds: &RotorSpeeds) {
    assert_eq!((speeds.mode, speeds.saturated), (Mode::Idle as u64, 0));
    let at_least = speeds.speed_rad_s.iter().all(|w| (w - 30.0).abs() < 1e-12);
    assert!(at_least, "{speeds:?}");
    assert!((speeds.thrust_n - 4.0 * 3.13e-5 * 900.0).abs() < 1e-15);
    assert_eq!(speeds.torque_b_nm, [0.0; 3]);
}

#[test]
fn a_wrench_ages_from_held_over_fallback_to_idle() {
    let mut mixer = mixer(0.001);
    let fresh = mixer.tick(100, &wrench(100));
    for age in 1..=3 {
        let held = RotorSpeeds {
            mode: Mode::Held as u64,
            ..fresh
        };
        assert_eq!(mixer.tick(100 + age, &wrench(100)), held, "age {age}");
    }
    for age in 4..50 {
        let fallback = mixer.tick(100 + age, &wrench(100));
        assert_eq!(fallback.mode, Mode::Fallback as u64, "age {age}");
        assert!((fallback.thrust_n - 5.0).abs() < 1e-12);
        assert_eq!(fallback.torque_b_nm, [0.0; 3]);
    }
    for age in [50, 51, 1_000_000] {
        assert_idle(&mixer.tick(100 + age, &wrench(100)));
    }
    // A fresh wrench ends it.
    assert_eq!(mixer.tick(200, &wrench(200)), fresh);
}

#[test]
fn before_the_first_wrench_the_rotors_idle() {
    let nothing = Stamped::new(NO_TICK, Wrench::default());
    for tick in [0, 1, 49, 100] {
        assert_idle(&mixer(0.001).tick(tick, &nothing));
    }
}

#[test]
fn the_inner_loops_own_mode_changes_nothing_but_idle() {
    let mut mixer = mixer(0.001);
    let mut of_mode = |mode: Mode| {
        let mut wrench = wrench(7);
        wrench.content.mode = mode as u64;
        mixer.tick(7, &wrench)
    };
    assert_eq!(of_mode(Mode::Held), of_mode(Mode::Fresh));
    assert_eq!(of_mode(Mode::Fallback), of_mode(Mode::Fresh));
    assert_idle(&of_mode(Mode::Idle));
}

/// Ages in ticks at which a wrench is no longer held, and at which the rotors idle.
fn windows(period_s: f64) -> (u64, u64) {
    let mut mixer = mixer(period_s);
    let mut first = |mode: Mode| {
        (1..1000)
            .find(|age| mixer.tick(*age, &wrench(0)).mode == mode as u64)
            .unwrap()
    };
    (first(Mode::Fallback), first(Mode::Idle))
}

#[test]
fn a_wrench_is_held_for_three_ticks_or_3_ms_and_every_mode_has_its_turn_at_every_rate() {
    assert_eq!(windows(0.02), (2, 3), "50 Hz");
    assert_eq!(windows(0.005), (4, 10), "200 Hz");
    assert_eq!(windows(0.004), (4, 13), "250 Hz");
    assert_eq!(windows(0.001), (4, 50));
    assert_eq!(windows(0.000_25), (13, 200), "4 kHz: 3 ms are 12 ticks");
    assert_eq!(windows(0.000_125), (25, 400), "8 kHz");
}

#[test]
fn an_impossible_demand_is_flagged_and_what_is_achieved_is_told() {
    let mut wrench = wrench(3);
    wrench.content.torque_b_nm = [0.0, 0.0, 10.0];
    let speeds = mixer(0.001).tick(3, &wrench);
    assert_eq!(speeds.saturated, 1);
    assert!((speeds.thrust_n - 5.0).abs() < 1e-12);
    assert!(speeds.torque_b_nm[2] > 0.0 && speeds.torque_b_nm[2] < 0.2);
}
