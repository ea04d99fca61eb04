//! What both loops do with inputs that are late, missing, or back again.

use controller::{InnerLoop, LoopSettings, OuterLoop, Preset, TheoremMonitor, Trajectory};
use law::{InnerLaw as _, OuterLaw as _};
use model::messages::{Dated, Mode, NO_TICK, Setpoint, State, Truth, Wrench};
use model::parameters::PARAMETERS;

const HOLD_TICKS: u64 = 100;

fn settings() -> LoopSettings {
    LoopSettings::new(Trajectory::Lissajous, Preset::Flight)
}

fn dated<T>(tick: u64, content: T) -> Dated<T> {
    Dated { tick, content }
}

/// A slightly tilted airframe in hover, with a gyro that shows a different rate at every tick.
fn state(tick: u64) -> Dated<State> {
    let settings = settings();
    let w = settings.model.hover_speed_rad_s();
    let rate = 0.01 * (tick as f64).sin();
    dated(
        tick,
        State {
            attitude_rad: [0.1, -0.05, 0.3],
            rate_b_rad_s: [rate, -rate, 0.5 * rate],
            rotor_speed_mean_rad_s: [w; 4],
            rotor_speed_squared_mean_rad2_s2: [w * w; 4],
            rotor_speed_command_rad_s: [w; 4],
            ..State::default()
        },
    )
}

fn setpoint(tick: u64) -> Dated<Setpoint> {
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

fn never<T: Default>() -> Dated<T> {
    dated(NO_TICK, T::default())
}

/// A loop that has flown the ticks 0 to `ticks` - 1 on fresh inputs.
fn flown(ticks: u64) -> InnerLoop {
    let mut inner = InnerLoop::new(&settings());
    for tick in 0..ticks {
        inner.tick(tick, &state(tick), &setpoint(tick));
    }
    inner
}

fn mode(wrench: &Wrench) -> Mode {
    Mode::from_wire(wrench.mode).expect("a mode")
}

fn hover_thrust_n() -> f64 {
    settings().model.m() * settings().model.g()
}

#[test]
fn the_outer_loop_publishes_nothing_for_a_state_of_another_tick() {
    let mut outer = OuterLoop::new(&settings());
    assert_eq!(outer.tick(7, &state(6)), None);
    assert_eq!(outer.tick(7, &state(8)), None);
    assert_eq!(outer.tick(7, &never()), None);
    assert!(outer.tick(7, &state(7)).is_some());
}

#[test]
fn the_outer_loop_feeds_nothing_forward_while_limited() {
    let mut outer = OuterLoop::new(&settings());
    let near = outer.tick(3000, &state(3000)).unwrap();
    assert_eq!(near.limited, 0);
    assert_ne!(near.attitude_rate_rad_s[0], 0.0);
    let mut far = state(3000);
    far.content.position_w_m = [20.0, 0.0, 0.0];
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
    level.attitude_rad = [0.0, 0.0, 0.4];
    level.rate_b_rad_s = [0.0; 3];
    let wrench = inner.tick(4010, &dated(4010, level), &setpoint(9));
    for e in wrench.rate_error_b_rad_s {
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
    let mut inner = InnerLoop::new(&settings());
    let mut wrench = Wrench::default();
    for tick in 0..3000 {
        let mut state = state(tick);
        state.content.attitude_rad = [0.0, 0.0, 0.3];
        state.content.rate_b_rad_s = [0.0; 3];
        wrench = inner.tick(tick, &state, &never());
        assert_eq!(mode(&wrench), Mode::Fallback);
        assert_eq!(wrench.thrust_n, hover_thrust_n());
    }
    assert_eq!(wrench.rate_error_b_rad_s, [0.0; 3]);
}

#[test]
fn a_stale_state_gives_no_torque_and_teaches_nothing() {
    let mut inner = flown(10);
    let learnt = inner.clone().tick(9, &state(8), &setpoint(9)).estimate;
    assert_ne!(learnt, [0.0; 3]);
    for tick in 10..400 {
        let wrench = inner.tick(tick, &state(9), &setpoint(tick));
        let (expected, thrust_n) =
            if tick <= 9 + HOLD_TICKS { (Mode::Held, 6.0) } else { (Mode::Fallback, hover_thrust_n()) };
        assert_eq!(mode(&wrench), expected, "{tick}");
        assert_eq!(wrench.thrust_n, thrust_n, "{tick}");
        assert_eq!(wrench.torque_b_nm, [0.0; 3]);
        assert_eq!(wrench.estimate, learnt);
    }
}

#[test]
fn states_that_are_always_one_tick_late_do_not_pass_for_a_short_outage() {
    let mut inner = flown(10);
    for tick in 10..300 {
        let wrench = inner.tick(tick, &state(tick - 1), &setpoint(tick));
        let held = tick <= 9 + HOLD_TICKS;
        assert_eq!(mode(&wrench), if held { Mode::Held } else { Mode::Fallback });
    }
}

#[test]
fn without_any_state_the_loop_asks_for_hover_thrust() {
    let mut inner = InnerLoop::new(&settings());
    let wrench = inner.tick(0, &never(), &setpoint(0));
    assert_eq!(mode(&wrench), Mode::Fallback);
    assert_eq!(wrench.thrust_n, hover_thrust_n());
    assert_eq!(wrench.torque_b_nm, [0.0; 3]);
}

#[test]
fn the_first_step_after_missed_states_is_not_learnt_from() {
    let mut inner = flown(10);
    let before = inner.clone().tick(10, &never(), &setpoint(10)).estimate;
    inner.tick(10, &state(9), &setpoint(10));
    let back = inner.tick(11, &state(11), &setpoint(11));
    assert_eq!(back.estimate, before);
    assert_eq!(mode(&back), Mode::Fresh);
    let after = inner.tick(12, &state(12), &setpoint(12));
    assert_ne!(after.estimate, before);
}

#[test]
fn the_command_filter_keeps_time_through_missed_states_and_missed_ticks() {
    let (mut whole, mut blind, mut late) = (flown(10), flown(10), flown(10));
    for tick in 10..30 {
        whole.tick(tick, &state(tick), &setpoint(tick));
        blind.tick(tick, &state(9), &setpoint(tick));
    }
    let [whole, blind, late] =
        [&mut whole, &mut blind, &mut late].map(|inner| inner.tick(30, &state(30), &setpoint(30)).rate_error_b_rad_s);
    assert_eq!(whole, blind);
    for (a, b) in whole.iter().zip(late) {
        assert!((a - b).abs() < 1e-13, "{a} {b}");
    }
}

#[test]
fn a_loop_starts_at_rest_from_the_measured_attitude_at_any_tick() {
    let at_rest = |tick| {
        let mut state = state(tick);
        state.content.rate_b_rad_s = [0.0; 3];
        state
    };
    let mut restarted = InnerLoop::new(&settings());
    let mut blinded = flown(10);
    blinded.tick(10, &state(9), &setpoint(10));
    for inner in [&mut restarted, &mut blinded] {
        let wrench = inner.tick(5000, &at_rest(5000), &setpoint(5000));
        assert_eq!(wrench.rate_error_b_rad_s, [0.0; 3]);
        assert_eq!(mode(&wrench), Mode::Fresh);
    }
    let restarted = InnerLoop::new(&settings()).tick(5000, &at_rest(5000), &setpoint(5000));
    assert_eq!(restarted.estimate, [0.0; 3]);
}

/// What the law says, bit by bit.
fn bits(wrench: &Wrench) -> Vec<u64> {
    let Wrench { thrust_n, torque_b_nm, estimate, rate_error_b_rad_s, mode } = *wrench;
    let numbers = [[thrust_n].as_slice(), &torque_b_nm, &estimate, &rate_error_b_rad_s].concat();
    numbers.into_iter().map(f64::to_bits).chain([mode]).collect()
}

#[test]
fn no_law_reads_the_truth() {
    let settings = settings();
    let mut told = InnerLoop::new(&settings);
    let mut untold = InnerLoop::new(&settings);
    let mut outer = OuterLoop::new(&settings);
    let (mut of_plain, mut of_shown) = (TheoremMonitor::new(&settings), TheoremMonitor::new(&settings));
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
        assert_eq!(bits(&wrench), bits(&told.tick(tick, &shown, &setpoint(tick))));
        // The monitor does.
        assert_ne!(of_plain.watch(tick, &plain, &wrench), of_shown.watch(tick, &shown, &wrench));
    }
}
