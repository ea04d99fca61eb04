//! Every law of this crate against the reference vectors: 50 cases each, to 1e-12.

use control_api::Rig;
use controller::adaptation::{Adaptation, Learnt};
use controller::command_filter::{CommandFilter, Passage};
use controller::flatness::{TiltRates, Yaw, tilt, tilt_rates};
use controller::laws::pd::{thrust, thrust_acceleration};
use controller::predictor::predict;
use controller::rate_law::{RatePoint, sampled_gain, torque};
use controller::rate_reference::{RateReference, rate_reference};
use controller::samples::LastTick;
use controller::{Gains, Trajectory};
use messages::content::Reference;
use messages::parameters::Airframe;
use messages::rate_dynamics::{Inertia, disturbance};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

const TOLERANCE: f64 = 1e-12;

/// Runs a check on each case of a group, and insists on 50 of them.
fn each_case(group: &str, check: impl Fn(&Value)) {
    let text = include_str!("../../shared/reference/vectors.json");
    let vectors: Value = serde_json::from_str(text).expect("the vectors are JSON");
    let cases = vectors[group].as_array().expect("a group is a list");
    cases.iter().for_each(check);
    assert_eq!(cases.len(), 50, "{group}");
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| number(&value[i]))
}

fn matrix(value: &Value) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| number(&value[i][j]))
}

fn assert_close(actual: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(actual.len(), expected.len());
    for (a, b) in actual.iter().zip(expected) {
        let error = (a - b).abs() / b.abs().max(1.0);
        assert!(error <= tolerance, "{a} for {b}: off by {error:e}");
    }
}

fn inertia() -> Inertia {
    Inertia::new(Airframe::nominal().i_m().into())
}

#[test]
fn att_des() {
    each_case("att_des", |case| {
        let model = Airframe::nominal();
        let a = thrust_acceleration(&vector(&case["U"]), &vector(&case["vel"]), &model);
        let (phi, theta) = tilt(&a, &Yaw::new(number(&case["psi_d"]), 0.0, 0.0));
        assert_close(a.as_slice(), vector(&case["a"]).as_slice(), TOLERANCE);
        let expected = [number(&case["phi_d"]), number(&case["theta_d"])];
        assert_close(&[phi, theta], &expected, TOLERANCE);
    });
}

#[test]
fn flat_rates() {
    each_case("flat_rates", |case| {
        let yaw = Yaw::new(
            number(&case["psi"]),
            number(&case["dpsi"]),
            number(&case["ddpsi"]),
        );
        let (a, da, dda) = (
            vector(&case["a"]),
            vector(&case["jerk"]),
            vector(&case["snap"]),
        );
        let TiltRates {
            dphi,
            dtheta,
            ddphi,
            ddtheta,
        } = tilt_rates(&a, &da, &dda, &yaw);
        let expected: [f64; 4] =
            std::array::from_fn(|i| number(&case["out_dphi_dth_ddphi_ddth"][i]));
        assert_close(&[dphi, dtheta, ddphi, ddtheta], &expected, TOLERANCE);
    });
}

#[test]
fn thrust_along_the_body() {
    each_case("thrust", |case| {
        let model = Airframe::nominal();
        let a = thrust_acceleration(&vector(&case["U"]), &vector(&case["vel"]), &model);
        let u = thrust(&a, &vector(&case["eul"]), &model);
        assert_close(&[u], &[number(&case["u"])], TOLERANCE);
    });
}

#[test]
fn rate_ref() {
    each_case("rate_ref", |case| {
        let filter = CommandFilter {
            w_f: Vector3::zeros(),
            ec: vector(&case["ec"]),
            e1: vector(&case["dec"]),
        };
        let reference = rate_reference(
            &vector(&case["eul"]),
            &vector(&case["nu"]),
            &filter,
            &vector(&case["ddec"]),
            &vector(&case["K_eta"]),
        );
        let (nu2_d, dnu2_d) = (vector(&case["nu_d"]), vector(&case["dnu_d"]));
        assert_close(reference.nu2_d.as_slice(), nu2_d.as_slice(), TOLERANCE);
        assert_close(reference.dnu2_d.as_slice(), dnu2_d.as_slice(), TOLERANCE);
    });
}

#[test]
fn filter() {
    each_case("filter", |case| {
        let each = |key: &str| Vector3::repeat(number(&case[key]));
        let filter = CommandFilter {
            w_f: each("omega"),
            ec: each("ec"),
            e1: each("dec"),
        };
        let next = filter.advance(&each("win"), &Passage::new(&filter.w_f, number(&case["T"])));
        assert_close(next.ec.as_slice(), each("ec_next").as_slice(), TOLERANCE);
        assert_close(next.e1.as_slice(), each("dec_next").as_slice(), TOLERANCE);
    });
}

fn torque_of(case: &Value, gain: f64) -> Vector3<f64> {
    let at = RatePoint {
        nu2: vector(&case["nu"]),
        om: number(&case["Om"]),
        h: disturbance(number(&case["t"])),
    };
    let reference = RateReference {
        nu2_d: vector(&case["nu_d"]),
        dnu2_d: vector(&case["dnu_d"]),
    };
    torque(&at, &reference, &vector(&case["theta"]), gain, &inertia())
}

#[test]
fn torque_ct() {
    each_case("torque_ct", |case| {
        let tau = torque_of(case, number(&case["alpha"]));
        assert_close(tau.as_slice(), vector(&case["tau"]).as_slice(), TOLERANCE);
    });
}

#[test]
fn torque_sampled() {
    each_case("torque_sampled", |case| {
        let gain = sampled_gain(number(&case["alpha"]), number(&case["T"]));
        assert_close(&[gain], &[number(&case["a_d"])], TOLERANCE);
        let tau = torque_of(case, gain);
        assert_close(tau.as_slice(), vector(&case["tau"]).as_slice(), TOLERANCE);
    });
}

#[test]
fn adapt_paper() {
    each_case("adapt_paper", |case| {
        check_adaptation("paper", case, 1e-9);
    });
}

#[test]
fn adapt_flight() {
    each_case("adapt_flight", |case| {
        check_adaptation("flight", case, TOLERANCE);
    });
}

fn check_adaptation(preset: &str, case: &Value, tolerance: f64) {
    let adaptation = Adaptation::new(&Rig::default(), &Gains::preset(preset).expect("a preset"));
    assert_eq!(adaptation.gamma, vector(&case["Gamma"]));
    assert_eq!(
        adaptation.step_s2,
        number(&case["T"]) / number(&case["alpha"])
    );
    assert_eq!(adaptation.lo, vector(&case["lo"]));
    assert_eq!(adaptation.hi, vector(&case["hi"]));
    let before = Learnt {
        theta: vector(&case["theta"]),
        x: matrix(&case["X"]),
        y: vector(&case["Y"]),
    };
    let t_start_s = number(&case["t_prev"]);
    let last = LastTick {
        nu2_start: vector(&case["nu_prev"]),
        nu2_end: vector(&case["nu_now"]),
        h_start: disturbance(t_start_s),
        h_end: disturbance(t_start_s + number(&case["T"])),
        om_m: number(&case["Om_mean"]),
        tau_m: vector(&case["tau_mean"]),
    };
    let after = adaptation.step(&before, &last);
    let r = after.y - after.x * before.theta;
    assert_close(
        after.x.as_slice(),
        matrix(&case["X_out"]).as_slice(),
        TOLERANCE,
    );
    assert_close(
        after.y.as_slice(),
        vector(&case["Y_out"]).as_slice(),
        TOLERANCE,
    );
    assert_close(
        r.as_slice(),
        vector(&case["residual"]).as_slice(),
        TOLERANCE,
    );
    let expected = vector(&case["theta_out"]);
    assert_close(after.theta.as_slice(), expected.as_slice(), tolerance);

    let unbounded = Adaptation {
        lo: Vector3::repeat(f64::NEG_INFINITY),
        hi: Vector3::repeat(f64::INFINITY),
        ..adaptation
    };
    let theta = unbounded.step(&before, &last).theta;
    let expected = vector(&case["theta_unprojected"]);
    assert_close(theta.as_slice(), expected.as_slice(), tolerance);
}

/// The orders of x, y, z and psi that a reference has.
fn axes(reference: &Reference) -> [Vec<f64>; 4] {
    let Reference {
        position_w_m,
        velocity_w_m_s,
        acceleration_w_m_s2,
        jerk_w_m_s3,
        snap_w_m_s4,
        ..
    } = *reference;
    let along = |i: usize| {
        [
            position_w_m,
            velocity_w_m_s,
            acceleration_w_m_s2,
            jerk_w_m_s3,
            snap_w_m_s4,
        ]
        .map(|order| order[i])
        .to_vec()
    };
    let yaw = vec![
        reference.yaw_rad,
        reference.yaw_rate_rad_s,
        reference.yaw_acceleration_rad_s2,
    ];
    [along(0), along(1), along(2), yaw]
}

#[test]
fn traj() {
    each_case("traj", |case| {
        let trajectory: Trajectory = case["name"].as_str().unwrap().parse().unwrap();
        let reference = trajectory.reference(number(&case["t"]));
        for (axis, actual) in axes(&reference).iter().enumerate() {
            let row = &case["out_xyzpsi_by_derivative0to4"][axis];
            let row: Vec<f64> = (0..actual.len()).map(|i| number(&row[i])).collect();
            assert_close(actual, &row, TOLERANCE);
        }
    });
}

#[test]
fn prediction() {
    each_case("predict", |case| {
        let now = RatePoint {
            nu2: vector(&case["nu"]),
            om: number(&case["Om"]),
            h: disturbance(number(&case["t"])),
        };
        let (eta2, nu2) = predict(
            &vector(&case["eul"]),
            &now,
            &vector(&case["theta"]),
            &vector(&case["tau"]),
            number(&case["T"]),
            &inertia(),
        );
        assert_close(
            nu2.as_slice(),
            vector(&case["nu_next"]).as_slice(),
            TOLERANCE,
        );
        assert_close(
            eta2.as_slice(),
            vector(&case["eul_next"]).as_slice(),
            TOLERANCE,
        );
    });
}
