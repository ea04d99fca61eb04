//! The theorem's functions and monitor: inequalities for every input and flight.

use control_api::Rig;
use controller::adaptation::{Adaptation, LastTick, Weight};
use controller::excitation::{Excitation, Shown};
use controller::gains::PRESET_NAMES;
use controller::laws::adaptive;
use controller::lyapunov::{EstimateStep, RateWeight, v_th, v_th_change};
use controller::{Gains, TheoremMonitor};
use messages::content::{Stamped, State};
use messages::monitor::{Cause, Monitor};
use messages::parameters::{Airframe, PARAMETERS, Parameter};
use messages::rate_dynamics::disturbance;
use messages::topic::Topic as _;
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use proptest::sample::select;

use crate::{inner_loop, setpoint, vector};

fn theta() -> impl Strategy<Value = Vector3<f64>> {
    (-1e-3..1e-3, 0.0..1.0, -2.0..2.0).prop_map(|(i_r, k_r, delta)| Vector3::new(i_r, k_r, delta))
}

fn step(adaptation: &Adaptation, x: &Matrix3<f64>) -> EstimateStep {
    EstimateStep::new(
        adaptation,
        x,
        Weight::new(x, &adaptation.gain()).expect("X is finite"),
    )
}

fn adaptation(preset: &str) -> Adaptation {
    Adaptation::new(&Rig::default(), &Gains::preset(preset).expect("a preset"))
}

proptest! {
    #[test]
    fn a_step_never_exceeds_what_it_owes_whatever_was_measured(
        preset in select(&PRESET_NAMES),
        theta in theta(),
        ticks in prop::collection::vec((-200.0..200.0, vector(1.0), vector(1.0), vector(0.5)), 40),
    ) {
        let adaptation = adaptation(preset);
        let mut learnt = adaptation.prior();
        let start = v_th(&(learnt.theta - theta), &adaptation.gamma);
        for (tick, (om_m, nu2_start, nu2_end, tau_m)) in ticks.into_iter().enumerate() {
            let [h_start, h_end] = [tick, tick + 1].map(|tick| disturbance(tick as f64 * adaptation.period_s));
            let last = LastTick { nu2_start, nu2_end, h_start, h_end, om_m, tau_m };
            let next = adaptation.step(&learnt, &last);
            let step = step(&adaptation, &next.x);
            let zb = step.left_of(&(next.y - next.x * learnt.theta));
            let mismatch = next.y - next.x * theta;
            let change = v_th_change(&(learnt.theta - theta), &(next.theta - theta), &adaptation.gamma);
            let owed = step.disturbance(&mismatch, &zb) - step.descent(&zb);
            let rounding = 1e-6 * (step.descent(&zb) + adaptation.step_s2 * mismatch.norm() * zb.norm()) + 1e-12 * start;
            prop_assert!(change <= owed + rounding, "{change:e} > {owed:e}");
            // The corollary: whatever the mismatch, V_th rises by (T/alpha)|eps|^2/4 at the most.
            let rise_max = adaptation.step_s2 * mismatch.norm_squared() / 4.0;
            prop_assert!(change <= rise_max * (1.0 + 1e-6) + rounding);
            learnt = next;
        }
    }

    #[test]
    fn without_delay_and_low_pass_v_falls_by_its_bound(
        alpha_1_s in 1.0..1e4,
        error in vector(1.0),
        e in vector(1.0),
        ticks in prop::collection::vec(prop::array::uniform3(vector(50.0)), 30),
    ) {
        let gains = Gains { alpha_1_s, regressor_filter_rad_s: 0.0, ..Gains::default() };
        let adaptation = Adaptation::new(&Rig::default(), &gains);
        let (s, a) = (adaptation.step_s2, (-alpha_1_s * Rig::default().period_s).exp());
        let gamma = Matrix3::from_diagonal(&adaptation.gamma);
        let steps: Vec<_> =
            ticks.iter().map(|columns| step(&adaptation, &Matrix3::from_columns(columns))).collect();
        // Nmax holds along the whole flight.
        let mut weight = RateWeight::new(&adaptation);
        steps.iter().for_each(|step| weight.take(step));
        let v = |e: &Vector3<f64>, error: &Vector3<f64>| {
            weight.sigma() / 2.0 * e.norm_squared() + v_th(error, &adaptation.gamma)
        };
        let (mut e, mut error) = (e, error.component_mul(&Vector3::new(1e-3, 0.5, 1.0)));
        for (columns, step) in ticks.iter().zip(&steps) {
            let x = Matrix3::from_columns(columns);
            let r = -x * error;
            let zb = step.left_of(&r);
            // (19) in (8) over a tick: e+ = a e - T X ~th.
            let (next_e, next_error) = (a * e + Rig::default().period_s * r, error + s * gamma * x.transpose() * zb);
            let bound = weight.v_change_bound(&e, &zb);
            let change = v(&next_e, &next_error) - v(&e, &error);
            prop_assert!(bound <= 0.0 && change <= bound + 1e-12 * v(&e, &error), "{change:e} > {bound:e}");
            (e, error) = (next_e, next_error);
        }
    }

    #[test]
    fn what_is_left_of_an_error_is_bounded_by_the_contractions(
        preset in select(&PRESET_NAMES),
        error in vector(1.0),
        ticks in prop::collection::vec(prop::array::uniform3(vector(50.0)), 30),
    ) {
        let adaptation = adaptation(preset);
        let mut excitation = Excitation::new(adaptation.period_s);
        let root = adaptation.gamma.map(f64::sqrt);
        let mut scaled = error;
        for columns in &ticks {
            let x = Matrix3::from_columns(columns);
            let step = step(&adaptation, &x);
            let ahead = scaled.component_mul(&root);
            let moved = adaptation.step_s2 * Matrix3::from_diagonal(&adaptation.gamma) * x.transpose();
            scaled = (ahead + moved * step.left_of(&(-x * ahead))).component_div(&root);
            excitation.take(&step.contraction());
            let bound = excitation.left() * error.norm();
            for i in 0..3 {
                prop_assert!(scaled[i].abs() <= bound[i] * (1.0 + 1e-9) + 1e-9);
            }
        }
    }
}

#[test]
fn excitation_counts_what_each_column_shows_alone() {
    let mut excitation = Excitation::new(1.0);
    // Windows of ten steps: column 1 in both, column 2 as its copy, column 3 in the first alone.
    let both = Matrix3::new(0.1, 0.1, 0.0, 0.1, 0.1, 0.0, 0.0, 0.0, 0.2);
    let one = Matrix3::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for _ in 0..10 {
        excitation.take(&both);
    }
    let near = |shown: Shown, x: f64, y: f64, z: f64| {
        let error = shown.identifiability - Vector3::new(x, y, z);
        assert!(error.amax() < 1e-6, "{shown:?}");
    };
    // Copies tell nothing apart.
    assert!(excitation.shown().smallest < 1e-9);
    near(excitation.shown(), 0.0, 0.0, 2.0);
    for _ in 0..10 {
        excitation.take(&one);
    }
    near(excitation.shown(), 1.0, 0.0, 0.0);
    let after_both = (0..10).fold(Matrix3::identity(), |left, _| left - both * left);
    let left = 0.9_f64.powi(10) * after_both.row(0).norm();
    assert!((excitation.left().x - left).abs() < 1e-6);
}

fn state(tick: u64, parameter: [f64; PARAMETERS]) -> Stamped<State> {
    let mut state = crate::state(tick);
    state.content.truth.parameter = parameter;
    state
}

/// The ticks of an inner loop, each with the verdict of its monitor.
fn watched() -> impl FnMut(u64, &Stamped<State>) -> Monitor {
    let mut inner = inner_loop();
    let mut monitor = TheoremMonitor::new(&Rig::default(), &Gains::default());
    move |tick, state| {
        let wrench = inner.tick(tick, state, &setpoint(tick));
        *monitor.watch(tick, state, &setpoint(tick), &wrench)
    }
}

#[test]
fn a_truth_beyond_numbers_is_a_violation_and_never_an_infinite_wrench() {
    let mut watch = watched();
    let mut last = Monitor::default();
    for tick in 0..30 {
        let parameter = if tick == 20 {
            [1e300; PARAMETERS]
        } else {
            *Airframe::nominal().values()
        };
        last = watch(tick, &state(tick, parameter));
        assert!(last.finite(), "{last:?}");
    }
    assert!(last.violations[Cause::Unexplained as usize] > 0);
}

#[test]
fn estimates_that_move_against_their_samples_are_unexplained() {
    let (rig, gains) = (Rig::default(), Gains::default());
    let mut airframe = Airframe::nominal();
    airframe.set(Parameter::DisturbanceGain, 0.0).unwrap();
    // At rest, without a disturbance, nothing can be learnt. From 0, these lead away from the truth.
    for push in [
        Vector3::new(-1e-9, 0.0, 0.0),
        Vector3::new(0.0, -1e-6, 0.0),
        Vector3::new(0.0, 0.0, 1e-3),
    ] {
        let mut inner = inner_loop();
        let mut monitor = TheoremMonitor::new(&rig, &gains);
        let mut watch = |tick: u64, push: Vector3<f64>| {
            let mut state = state(tick, *airframe.values());
            state.content.measured.rate_b_rad_s = [0.0; 3];
            let mut wrench = inner.tick(tick, &state, &setpoint(tick));
            let estimate = Vector3::from(adaptive::estimate(&wrench.telemetry)) + push;
            wrench.telemetry.value[3..6].copy_from_slice(estimate.as_slice());
            *monitor.watch(tick, &state, &setpoint(tick), &wrench)
        };
        for tick in 0..10 {
            assert_eq!(watch(tick, Vector3::zeros()).violations[0], 0);
        }
        let violated = watch(10, push);
        assert_eq!(
            (violated.violations[0], violated.is_violation),
            (1, 1),
            "{push}"
        );
    }
}

#[test]
fn a_stale_state_is_counted_and_changes_nothing_else() {
    let mut watch = watched();
    let nominal = *Airframe::nominal().values();
    for tick in 0..10 {
        watch(tick, &state(tick, nominal));
    }
    let before = watch(10, &state(10, nominal));
    let stale = watch(11, &state(10, nominal));
    assert_ne!(stale.causes & Cause::StaleInput.bit(), 0);
    let expected = Monitor {
        ticks_stale: 1,
        causes: stale.causes,
        ..before
    };
    assert_eq!(stale, expected);
    // The tick after has no measured start: nothing is learnt from it, so nothing is checked.
    let after = watch(12, &state(12, nominal));
    assert_eq!(after.ticks_checked, before.ticks_checked);
    let next = watch(13, &state(13, nominal));
    assert_eq!(next.ticks_checked, before.ticks_checked + 1);
}
