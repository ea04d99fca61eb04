//! What both loops do with inputs that are late, missing, or back again.

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::{GuardedInner, GuardedOuter, Rig};
use controller::laws::adaptive::{estimate, rate_error};
use controller::laws::{Adaptive, Fixed, Pd};
use controller::{Gains, ScaledTrajectory, TheoremMonitor, Trajectory};
use messages::content::Measured;
use messages::content::{Mode, NO_TICK, Setpoint, Stamped, State, Truth, Wrench};
use messages::parameters::PARAMETERS;

const HOLD_TICKS: u64 = 100;

fn outer_loop() -> GuardedOuter {
    let rig = Rig::default();
    let law = Pd::new(&rig, &Settings::default()).unwrap();
    GuardedOuter::new(
        law.into(),
        ScaledTrajectory::of(Trajectory::Lissajous).route(rig.period_s),
        &rig,
    )
}

fn inner_loop() -> GuardedInner {
    let rig = Rig::default();
    GuardedInner::new(Adaptive::with(&rig, &Gains::default()).into(), &rig)
}

fn dated<T>(tick: u64, content: T) -> Stamped<T> {
    Stamped { tick, content }
}

/// A slightly tilted airframe in hover, with a gyro that shows a different rate at every tick.
fn state(tick: u64) -> Stamped<State> {
    let w = Rig::default().airframe.hover_speed_rad_s();
    let rate = 0.01 * (tick as f64).sin();
    dated(
        tick,
        State {
            measured: Measured {
                attitude_rad: [0.1, -0.05, 0.3],
                rate_b_rad_s: [rate, -rate, 0.5 * rate],
                rotor_speed_mean_rad_s: [w; 4],
                rotor_speed_squared_mean_rad2_s2: [w * w; 4],
                rotor_speed_command_rad_s: [w; 4],
                ..Measured::default()
            },
            ..State::default()
        },
    )
}

fn setpoint(tick: u64) -> Stamped<Setpoint> {
    dated(
        tick,
        Setpoint {
            thrust_n: 6.0,
            attitude_rad: [0.2, 0.0, 0.4],
            attitude_rate_rad_s: [0.1, 0.0, 0.0],
            ..Setpoint::default()
        },
    )
}

fn never<T: Default>() -> Stamped<T> {
    dated(NO_TICK, T::default())
}

/// A loop that has flown the ticks 0 to `ticks` - 1 on fresh inputs.
fn flown(ticks: u64) -> GuardedInner {
    let mut inner = inner_loop();
    for tick in 0..ticks {
        inner.tick(tick, &state(tick), &setpoint(tick));
    }
    inner
}

fn mode(wrench: &Wrench) -> Mode {
    Mode::from_wire(wrench.mode).expect("a mode")
}

fn hover_thrust_n() -> f64 {
    Rig::default().airframe.m() * Rig::default().airframe.g()
}

#[test]
fn the_outer_loop_publishes_nothing_for_a_state_of_another_tick() {
    let mut outer = outer_loop();
    assert_eq!(outer.tick(7, &state(6)), None);
    assert_eq!(outer.tick(7, &state(8)), None);
    assert_eq!(outer.tick(7, &never()), None);
    assert!(outer.tick(7, &state(7)).is_some());
}

#[test]
fn the_outer_loop_feeds_nothing_forward_while_limited() {
    let mut outer = outer_loop();
    let near = outer.tick(3000, &state(3000)).unwrap();
    assert_eq!(near.limited, 0);
    assert_ne!(near.attitude_rate_rad_s[0], 0.0);
    let mut far = state(3000);
    far.content.measured.position_w_m = [20.0, 0.0, 0.0];
    let far = outer.tick(3000, &far).unwrap();
    assert_eq!(far.limited, 1);
    assert_eq!(far.attitude_rate_rad_s[..2], [0.0, 0.0]);
    assert_eq!(far.attitude_acceleration_rad_s2[..2], [0.0, 0.0]);
    assert_eq!(far.attitude_rate_rad_s[2], near.attitude_rate_rad_s[2]);
}

#[test]
fn a_stale_set_point_is_held_for_100_ms_and_then_the_airframe_is_levelled() {
    let mut inner = flown(10);
    for tick in 10..10 + 4000 {
        let wrench = inner.tick(tick, &state(tick), &setpoint(9));
        if tick <= 9 + HOLD_TICKS {
            assert_eq!(mode(&wrench), Mode::Held, "{tick}");
            assert_eq!(wrench.thrust_n, 6.0);
        } else {
            assert_eq!(mode(&wrench), Mode::Fallback, "{tick}");
            assert_eq!(wrench.thrust_n, hover_thrust_n());
        }
    }
    let level = state(5000);
    let mut level = level.content;
    level.measured.attitude_rad = [0.0, 0.0, 0.4];
    level.measured.rate_b_rad_s = [0.0; 3];
    let wrench = inner.tick(4010, &dated(4010, level), &setpoint(9));
    for e in rate_error(&wrench.telemetry) {
        assert!(e.abs() < 1e-3, "the order is level at the last yaw: {e}");
    }
}

#[test]
fn a_held_set_point_gives_what_a_repeated_one_gives() {
    let (mut held, mut repeated) = (flown(10), flown(10));
    for tick in 10..=9 + HOLD_TICKS {
        let a = held.tick(tick, &state(tick), &setpoint(9));
        let b = repeated.tick(tick, &state(tick), &setpoint(tick));
        assert_eq!(a.torque_b_nm, b.torque_b_nm);
    }
}

#[test]
fn without_any_set_point_the_airframe_is_levelled_at_its_own_yaw() {
    let mut inner = inner_loop();
    let mut wrench = Wrench::default();
    for tick in 0..3000 {
        let mut state = state(tick);
        state.content.measured.attitude_rad = [0.0, 0.0, 0.3];
        state.content.measured.rate_b_rad_s = [0.0; 3];
        wrench = inner.tick(tick, &state, &never());
        assert_eq!(mode(&wrench), Mode::Fallback);
        assert_eq!(wrench.thrust_n, hover_thrust_n());
    }
    assert_eq!(rate_error(&wrench.telemetry), [0.0; 3]);
}

#[test]
fn a_stale_state_gives_no_torque_and_teaches_nothing() {
    let mut inner = flown(10);
    let learnt = estimate(
        &inner
            .rehearse(9, &state(8), &setpoint(9))
            .unwrap()
            .telemetry,
    );
    assert_ne!(learnt, [0.0; 3]);
    for tick in 10..400 {
        let wrench = inner.tick(tick, &state(9), &setpoint(tick));
        let (expected, thrust_n) = if tick <= 9 + HOLD_TICKS {
            (Mode::Held, 6.0)
        } else {
            (Mode::Fallback, hover_thrust_n())
        };
        assert_eq!(mode(&wrench), expected, "{tick}");
        assert_eq!(wrench.thrust_n, thrust_n, "{tick}");
        assert_eq!(wrench.torque_b_nm, [0.0; 3]);
        assert_eq!(estimate(&wrench.telemetry), learnt);
        assert!(
            rate_error(&wrench.telemetry).iter().all(|e| e.is_nan()),
            "nobody measured it"
        );
    }
}

#[test]
fn states_that_are_always_one_tick_late_do_not_pass_for_a_short_outage() {
    let mut inner = flown(10);
    for tick in 10..300 {
        let wrench = inner.tick(tick, &state(tick - 1), &setpoint(tick));
        let held = tick <= 9 + HOLD_TICKS;
        assert_eq!(
            mode(&wrench),
            if held { Mode::Held } else { Mode::Fallback }
        );
    }
}

#[test]
fn without_any_state_the_loop_asks_for_hover_thrust() {
    let mut inner = inner_loop();
    let wrench = inner.tick(0, &never(), &setpoint(0));
    assert_eq!(mode(&wrench), Mode::Fallback);
    assert_eq!(wrench.thrust_n, hover_thrust_n());
    assert_eq!(wrench.torque_b_nm, [0.0; 3]);
}

#[test]
fn a_loop_takes_over_the_estimates_of_another_where_they_are_within_their_bounds() {
    let learnt = flown(50).estimates().unwrap();
    let prior = inner_loop().estimates().unwrap();
    assert_ne!(learnt, prior);
    let mut inner = inner_loop();
    assert!(inner.resume(learnt));
    let first = inner.tick(50, &state(50), &setpoint(50));
    assert_eq!(
        estimate(&first.telemetry),
        learnt,
        "nothing is learnt from the first state"
    );
    let bounds = Gains::default();
    for i in 0..3 {
        for wrong in [
            f64::NAN,
            f64::INFINITY,
            bounds.estimate_min[i] - 1e-9,
            bounds.estimate_max[i] + 1e-9,
        ] {
            let (mut inner, mut estimates) = (inner_loop(), learnt);
            estimates[i] = wrong;
            assert!(!inner.resume(estimates), "{estimates:?}");
            assert_eq!(inner.estimates(), Some(prior), "it begins with its priors");
        }
    }
    let rig = Rig::default();
    let mut fixed = GuardedInner::new(Fixed::new(&rig, &Settings::default()).unwrap().into(), &rig);
    assert_eq!(
        (fixed.estimates(), fixed.resume(learnt)),
        (None, false),
        "a law that learns nothing takes nothing over"
    );
}

#[test]
fn the_first_step_after_missed_states_is_not_learnt_from() {
    let mut inner = flown(10);
    let before = estimate(
        &inner
            .rehearse(10, &never(), &setpoint(10))
            .unwrap()
            .telemetry,
    );
    inner.tick(10, &state(9), &setpoint(10));
    let back = inner.tick(11, &state(11), &setpoint(11));
    assert_eq!(estimate(&back.telemetry), before);
    assert_eq!(mode(&back), Mode::Fresh);
    let after = inner.tick(12, &state(12), &setpoint(12));
    assert_ne!(estimate(&after.telemetry), before);
}

#[test]
fn the_command_filter_keeps_time_through_missed_states_and_missed_ticks() {
    let (mut whole, mut blind, mut late) = (flown(10), flown(10), flown(10));
    for tick in 10..30 {
        whole.tick(tick, &state(tick), &setpoint(tick));
        blind.tick(tick, &state(9), &setpoint(tick));
    }
    let [whole, blind, late] = [&mut whole, &mut blind, &mut late]
        .map(|inner| rate_error(&inner.tick(30, &state(30), &setpoint(30)).telemetry));
    assert_eq!(whole, blind);
    for (a, b) in whole.iter().zip(late) {
        assert!((a - b).abs() < 1e-13, "{a} {b}");
    }
}

#[test]
fn a_loop_starts_at_rest_from_the_measured_attitude_at_any_tick() {
    let at_rest = |tick| {
        let mut state = state(tick);
        state.content.measured.rate_b_rad_s = [0.0; 3];
        state
    };
    let mut restarted = inner_loop();
    let mut blinded = flown(10);
    blinded.tick(10, &state(9), &setpoint(10));
    for inner in [&mut restarted, &mut blinded] {
        let wrench = inner.tick(5000, &at_rest(5000), &setpoint(5000));
        assert_eq!(rate_error(&wrench.telemetry), [0.0; 3]);
        assert_eq!(mode(&wrench), Mode::Fresh);
    }
    let restarted = inner_loop().tick(5000, &at_rest(5000), &setpoint(5000));
    assert_eq!(estimate(&restarted.telemetry), [0.0; 3]);
}

/// What the law says, bit by bit.
fn bits(wrench: &Wrench) -> Vec<u64> {
    let Wrench {
        thrust_n,
        torque_b_nm,
        mode,
        telemetry,
    } = *wrench;
    let numbers = [[thrust_n].as_slice(), &torque_b_nm, &telemetry.value].concat();
    numbers
        .into_iter()
        .map(f64::to_bits)
        .chain([mode])
        .collect()
}

#[test]
fn no_law_reads_the_truth() {
    let (mut told, mut untold, mut outer) = (inner_loop(), inner_loop(), outer_loop());
    let monitor = || TheoremMonitor::new(&Rig::default(), &Gains::default());
    let (mut of_plain, mut of_shown) = (monitor(), monitor());
    for tick in 0..50 {
        let plain = state(tick);
        let mut shown = plain;
        shown.content.truth = Truth {
            position_w_m: [1.0, 2.0, 3.0],
            velocity_w_m_s: [1.0, 2.0, 3.0],
            rate_b_rad_s: [1.0, 2.0, 3.0],
            touches_ground: 1,
            parameter: [1.0; PARAMETERS],
        };
        assert_eq!(outer.tick(tick, &plain), outer.tick(tick, &shown));
        let wrench = untold.tick(tick, &plain, &setpoint(tick));
        assert_eq!(
            bits(&wrench),
            bits(&told.tick(tick, &shown, &setpoint(tick)))
        );
        // The monitor does.
        assert_ne!(
            of_plain.watch(tick, &plain, &wrench),
            of_shown.watch(tick, &shown, &wrench)
        );
    }
}
