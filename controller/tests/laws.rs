//! What must hold for the laws at every input, not only in the reference cases.

use control_api::Rig;
use controller::adaptation::{Adaptation, LastTick, Learnt};
use controller::command_filter::{CommandFilter, Passage};
use controller::gains::PRESET_NAMES;
use controller::limits::AccelerationLimits;
use controller::{Gains, Limits, Trajectory};
use messages::content::Reference;
use messages::rate_dynamics::disturbance;
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use proptest::sample::select;

use crate::vector;

proptest! {
    #[test]
    fn the_command_filter_obeys_its_differential_equation(
        ec in vector(1.0), e1 in vector(5.0), win in vector(400.0),
    ) {
        let filter = CommandFilter { w_f: Vector3::new(20.0, 20.0, 3.0), ec, e1 };
        let dt = 1e-6;
        let next = filter.advance(&win, &Passage::new(&filter.w_f, dt));
        prop_assert!(((next.ec - ec) / dt - e1).amax() < 1e-2);
        prop_assert!(((next.e1 - e1) / dt - filter.acceleration(&win)).amax() < 1e-1);
    }

    #[test]
    fn a_limited_acceleration_is_inside_the_limits_and_keeps_its_direction(a in vector(60.0)) {
        let (g, tilt_max_rad) = (9.8, 35_f64.to_radians());
        let limits = Limits { acceleration_z_min_g: 0.2, acceleration_z_max_g: 2.0, tilt_max_rad };
        let bounds = AccelerationLimits::new(&limits, g);
        let (inside, limited) = bounds.limit(&a);
        prop_assert!((0.2 * g..=2.0 * g).contains(&inside.z));
        prop_assert!(inside.x.hypot(inside.y) <= inside.z * tilt_max_rad.tan() * (1.0 + 1e-12));
        prop_assert!((inside.x * a.y - inside.y * a.x).abs() < 1e-10);
        prop_assert_eq!(limited, inside != a);
        let (again, _) = bounds.limit(&inside);
        prop_assert!((again - inside).amax() < 1e-12);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn estimates_stay_in_bounds_whatever_is_measured(
        preset in select(&PRESET_NAMES),
        ticks in prop::collection::vec((-1e3..1e3, vector(50.0), vector(50.0), vector(5.0)), 50),
    ) {
        let adaptation = Adaptation::new(&Rig::default(), &Gains::preset(preset).expect("a preset"));
        let mut learnt = adaptation.prior();
        for (tick, (om_m, nu2_start, nu2_end, tau_m)) in ticks.into_iter().enumerate() {
            let [h_start, h_end] = [tick, tick + 1].map(|tick| disturbance(tick as f64 * adaptation.period_s));
            let last = LastTick { nu2_start, nu2_end, h_start, h_end, om_m, tau_m };
            learnt = adaptation.step(&learnt, &last);
            let is_bounded = |i: usize| (adaptation.lo[i]..=adaptation.hi[i]).contains(&learnt.theta[i]);
            prop_assert!((0..3).all(is_bounded), "{}", learnt.theta);
        }
    }
}

proptest! {
    /// Astolfi, Karagiannis and Ortega's estimates of (I_R, k_r, delta), by the implicit midpoint rule: an estimate is
    /// its integral part plus beta(nu, t), and the increment of beta over a tick is exact.
    #[test]
    fn the_adaptation_is_immersion_and_invariance_by_the_implicit_midpoint_rule(
        preset in select(&PRESET_NAMES),
        theta in vector(0.5),
        (start, end, tau_m) in (vector(2.0), vector(2.0), vector(0.3)),
        (om_m, tick) in (-200.0..200.0, 0..30_000_usize),
    ) {
        let gains = Gains { regressor_filter_rad_s: 0.0, ..Gains::preset(preset).expect("a preset") };
        let adaptation = Adaptation {
            lo: Vector3::repeat(f64::MIN),
            hi: Vector3::repeat(f64::MAX),
            ..Adaptation::new(&Rig::default(), &gains)
        };
        let (period_s, inertia) = (adaptation.period_s, &adaptation.inertia);
        let [h_start, h_end] = [tick, tick + 1].map(|tick| disturbance(tick as f64 * period_s));
        let last = LastTick { nu2_start: start, nu2_end: end, h_start, h_end, om_m, tau_m };
        let prior = Learnt { theta, ..adaptation.prior() };

        let g = adaptation.gamma / gains.alpha_1_s;
        let (mid, h) = ((start + end) / 2.0, (h_start + h_end) / 2.0);
        let phi = inertia.regressor(&mid, om_m, &h);
        let known = (inertia.coupling(&start) + inertia.coupling(&end)) / 2.0 + inertia.acceleration(&tau_m);
        // beta of k_r is -g2 sum nu_i^2/(2 I_i), that of delta g3 h^T nu less what time alone changes in it; that of I_R
        // has no potential, and its increment is that along the straight line.
        let energy = |nu: &Vector3<f64>| nu.dot(&inertia.acceleration(nu)) / 2.0;
        let d_beta = g.component_mul(&Vector3::new(
            phi.column(0).dot(&(end - start)),
            energy(&start) - energy(&end),
            h_end.dot(&end) - h_start.dot(&start) - mid.dot(&(h_end - h_start)),
        ));
        let g_phi = Matrix3::from_diagonal(&g) * phi.transpose();
        let left = Matrix3::identity() + period_s * g_phi * phi;
        let expected = left.lu().solve(&(theta + d_beta - period_s * g_phi * known)).expect("1 + a product G X^T X");
        let learnt = adaptation.step(&prior, &last).theta;
        let tolerance = if preset == "paper" { 1e-6 } else { 1e-9 };
        prop_assert!((learnt - expected).amax() < tolerance * expected.amax().max(1.0), "{learnt} {expected}");
    }
}

#[test]
fn every_ramped_trajectory_starts_at_rest_and_each_has_its_name() {
    for trajectory in Trajectory::ALL {
        assert_eq!(trajectory.name().parse(), Ok(trajectory));
        let moves = trajectory.reference(0.0) != Reference::default();
        assert_eq!(moves, trajectory == Trajectory::Step);
    }
    let error = "loop".parse::<Trajectory>().unwrap_err().to_string();
    let names = "unknown trajectory `loop`; known are hover, step, helix, lissajous, fast, mavlink";
    assert_eq!(error, names);
}
