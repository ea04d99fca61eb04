//! What both loops do with inputs that are late, missing, or back again.

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::{GuardedInner, GuardedOuter, Rig};
use controller::laws::Pd;
use controller::laws::adaptive::{estimate, rate_error};
use controller::{Gains, ScaledTrajectory, TheoremMonitor, Trajectory};
use messages::content::{Mode, Stamped, State, Truth, Wrench};
use messages::layout::Visit as _;
use messages::parameters::PARAMETERS;

use crate::{inner_loop, setpoint, state};

const HOLD_TICKS: u64 = 100;

fn outer_loop() -> GuardedOuter {
    let rig = Rig::default();
    let law = Pd::new(&rig, &Settings::default()).unwrap();
    let route = ScaledTrajectory::of(Trajectory::Lissajous).route(rig.period_s);
    GuardedOuter::new(law.into(), route, &rig)
}

/// At rest at some attitude.
fn still(tick: u64, attitude_rad: [f64; 3]) -> Stamped<State> {
    let mut state = state(tick);
    state.content.measured.attitude_rad = attitude_rad;
    state.content.measured.rate_b_rad_s = [0.0; 3];
    state
}

/// A loop that has flown the ticks 0 to `ticks` - 1 on fresh inputs.
fn flown(ticks: u64) -> GuardedInner {
    let mut inner = inner_loop();
    for tick in 0..ticks {
        inner.tick(tick, &state(tick), &setpoint(tick));
    }
    inner
}

fn hover_thrust_n() -> f64 {
    Rig::default().airframe.m() * Rig::default().airframe.g()
}

fn assert_output(wrench: &Wrench, mode: Mode, thrust_n: f64) {
    assert_eq!((wrench.mode, wrench.thrust_n), (mode as u64, thrust_n));
}

/// Held for 100 ms after tick 9, then hover.
fn assert_held_then_hover(wrench: &Wrench, tick: u64) {
    if tick <= 9 + HOLD_TICKS {
        assert_output(wrench, Mode::Held, 6.0);
    } else {
        assert_output(wrench, Mode::Fallback, hover_thrust_n());
    }
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
fn a_stale_set_point_is_held_like_a_repeated_one_and_then_the_airframe_is_levelled() {
    let (mut inner, mut repeated) = (flown(10), flown(10));
    for tick in 10..4010 {
        let wrench = inner.tick(tick, &state(tick), &setpoint(9));
        assert_held_then_hover(&wrench, tick);
        if tick <= 9 + HOLD_TICKS {
            let fresh = repeated.tick(tick, &state(tick), &setpoint(tick));
            assert_eq!(wrench.torque_b_nm, fresh.torque_b_nm);
        }
    }
    let wrench = inner.tick(4010, &still(4010, [0.0, 0.0, 0.4]), &setpoint(9));
    let e = rate_error(&wrench.telemetry);
    let is_level_at_the_last_yaw = e.iter().all(|e| e.abs() < 1e-3);
    assert!(is_level_at_the_last_yaw, "{e:?}");

    let mut inner = inner_loop();
    let mut wrench = Wrench::default();
    for tick in 0..3000 {
        wrench = inner.tick(tick, &still(tick, [0.0, 0.0, 0.3]), &Stamped::never());
        assert_output(&wrench, Mode::Fallback, hover_thrust_n());
    }
    let level_at_its_own_yaw = [0.0; 3];
    assert_eq!(rate_error(&wrench.telemetry), level_at_its_own_yaw);
}

#[test]
fn a_stale_state_gives_no_torque_and_teaches_nothing() {
    let mut inner = flown(10);
    let rehearsed = inner.rehearse(9, &state(8), &setpoint(9)).unwrap();
    let learnt = estimate(&rehearsed.telemetry);
    assert_ne!(learnt, [0.0; 3]);
    for tick in 10..400 {
        let wrench = inner.tick(tick, &state(9), &setpoint(tick));
        assert_held_then_hover(&wrench, tick);
        assert_eq!(wrench.torque_b_nm, [0.0; 3]);
        assert_eq!(estimate(&wrench.telemetry), learnt);
        assert!(rate_error(&wrench.telemetry).iter().all(|e| e.is_nan()));
    }
    let wrench = inner_loop().tick(0, &Stamped::never(), &setpoint(0));
    assert_output(&wrench, Mode::Fallback, hover_thrust_n());
}

#[test]
fn the_first_step_after_missed_states_is_not_learnt_from() {
    let mut inner = flown(10);
    let rehearsed = inner.rehearse(10, &Stamped::never(), &setpoint(10));
    let before = estimate(&rehearsed.unwrap().telemetry);
    inner.tick(10, &state(9), &setpoint(10));
    let back = inner.tick(11, &state(11), &setpoint(11));
    assert_eq!(estimate(&back.telemetry), before);
    assert_eq!(back.mode, Mode::Fresh as u64);
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
    let at_rest = still(5000, [0.1, -0.05, 0.3]);
    let mut blinded = flown(10);
    blinded.tick(10, &state(9), &setpoint(10));
    let [restarted, _] = [inner_loop(), blinded].map(|mut inner| {
        let wrench = inner.tick(5000, &at_rest, &setpoint(5000));
        assert_eq!(rate_error(&wrench.telemetry), [0.0; 3]);
        assert_eq!(wrench.mode, Mode::Fresh as u64);
        wrench
    });
    assert_eq!(estimate(&restarted.telemetry), [0.0; 3]);
}

#[test]
fn no_law_reads_the_truth() {
    let (mut with, mut without, mut outer) = (inner_loop(), inner_loop(), outer_loop());
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
        let wrench = without.tick(tick, &plain, &setpoint(tick));
        assert!(wrench.is_same(&with.tick(tick, &shown, &setpoint(tick))));
        // The monitor does.
        let plain = *of_plain.watch(tick, &plain, &setpoint(tick), &wrench);
        assert_ne!(
            &plain,
            of_shown.watch(tick, &shown, &setpoint(tick), &wrench)
        );
    }
}
