//! The paper's laws against the reference vectors.

use control_api::Rig;
use controller::adaptation::{Adaptation, LastTick, Learnt};
use controller::command_filter::{CommandFilter, Passage};
use controller::flatness::{Yaw, thrust_acceleration, tilt, tilt_rates};
use controller::laws::pd::thrust;
use controller::rate_law::{
    RatePoint, RateReference, predict, rate_reference, sampled_gain, torque,
};
use controller::{Gains, Trajectory};
use messages::parameters::Airframe;
use messages::rate_dynamics::{Inertia, disturbance};
use nalgebra::Vector3;
use serde_json::Value;

use crate::axes;
use crate::reference::{TOLERANCE, assert_close, assert_within, each_case, matrix, number, vector};

fn inertia() -> Inertia {
    Inertia::new(Airframe::nominal().i_m().into())
}

fn thrust_of(case: &Value) -> Vector3<f64> {
    let model = Airframe::nominal();
    let drag = model.k_t() / model.m();
    thrust_acceleration(&vector(&case["U"]), &vector(&case["vel"]), model.g(), drag)
}

#[test]
fn the_outer_loop() {
    each_case("att_des", |case| {
        let a = thrust_of(case);
        let (phi, theta) = tilt(&a, &Yaw::new(number(&case["psi_d"]), 0.0, 0.0));
        assert_close(a.as_slice(), &case["a"]);
        assert_close(&[phi], &case["phi_d"]);
        assert_close(&[theta], &case["theta_d"]);
    });
    each_case("flat_rates", |case| {
        let [psi, dpsi, ddpsi] = ["psi", "dpsi", "ddpsi"].map(|key| number(&case[key]));
        let [a, da, dda] = ["a", "jerk", "snap"].map(|key| vector(&case[key]));
        let rates = tilt_rates(&a, &da, &dda, &Yaw::new(psi, dpsi, ddpsi));
        let actual = [rates.dphi, rates.dtheta, rates.ddphi, rates.ddtheta];
        assert_close(&actual, &case["out_dphi_dth_ddphi_ddth"]);
    });
    each_case("thrust", |case| {
        let u = thrust(
            &thrust_of(case),
            &vector(&case["eul"]),
            &Airframe::nominal(),
        );
        assert_close(&[u], &case["u"]);
    });
}

#[test]
fn the_command_filter_and_its_rates() {
    each_case("rate_ref", |case| {
        let filter = CommandFilter {
            w_f: Vector3::zeros(),
            ec: vector(&case["ec"]),
            e1: vector(&case["dec"]),
        };
        let [eul, nu, ddec, k_eta] = ["eul", "nu", "ddec", "K_eta"].map(|key| vector(&case[key]));
        let reference = rate_reference(&eul, &nu, &filter, &ddec, &k_eta);
        assert_close(reference.nu2_d.as_slice(), &case["nu_d"]);
        assert_close(reference.dnu2_d.as_slice(), &case["dnu_d"]);
    });
    each_case("filter", |case| {
        let each = |key: &str| Vector3::repeat(number(&case[key]));
        let [w_f, ec, e1] = ["omega", "ec", "dec"].map(each);
        let passage = Passage::new(&w_f, number(&case["T"]));
        let next = CommandFilter { w_f, ec, e1 }.advance(&each("win"), &passage);
        assert_close(&[next.ec.x], &case["ec_next"]);
        assert_close(&[next.e1.x], &case["dec_next"]);
    });
}

fn point(case: &Value) -> RatePoint {
    RatePoint {
        nu2: vector(&case["nu"]),
        om: number(&case["Om"]),
        h: disturbance(number(&case["t"])),
    }
}

fn torque_of(case: &Value, gain: f64) -> Vector3<f64> {
    let reference = RateReference {
        nu2_d: vector(&case["nu_d"]),
        dnu2_d: vector(&case["dnu_d"]),
    };
    torque(
        &point(case),
        &reference,
        &vector(&case["theta"]),
        gain,
        &inertia(),
    )
}

#[test]
fn the_torque() {
    each_case("torque_ct", |case| {
        let tau = torque_of(case, number(&case["alpha"]));
        assert_close(tau.as_slice(), &case["tau"]);
    });
    each_case("torque_sampled", |case| {
        let gain = sampled_gain(number(&case["alpha"]), number(&case["T"]));
        assert_close(&[gain], &case["a_d"]);
        assert_close(torque_of(case, gain).as_slice(), &case["tau"]);
    });
    each_case("predict", |case| {
        let [eul, theta, tau] = ["eul", "theta", "tau"].map(|key| vector(&case[key]));
        let period_s = number(&case["T"]);
        let (eta2, nu2) = predict(&eul, &point(case), &theta, &tau, period_s, &inertia());
        assert_close(nu2.as_slice(), &case["nu_next"]);
        assert_close(eta2.as_slice(), &case["eul_next"]);
    });
}

#[test]
fn the_adaptation() {
    each_case("adapt_paper", |case| check_adaptation("paper", case, 1e-9));
    each_case("adapt_flight", |case| {
        check_adaptation("flight", case, TOLERANCE)
    });
}

fn check_adaptation(preset: &str, case: &Value, tolerance: f64) {
    let period_s = number(&case["T"]);
    let adaptation = Adaptation::new(&Rig::default(), &Gains::preset(preset).unwrap());
    assert_eq!(adaptation.gamma, vector::<3>(&case["Gamma"]));
    assert_eq!(adaptation.step_s2, period_s / number(&case["alpha"]));
    assert_eq!(adaptation.lo, vector::<3>(&case["lo"]));
    assert_eq!(adaptation.hi, vector::<3>(&case["hi"]));
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
        h_end: disturbance(t_start_s + period_s),
        om_m: number(&case["Om_mean"]),
        tau_m: vector(&case["tau_mean"]),
    };
    let after = adaptation.step(&before, &last);
    let r = after.y - after.x * before.theta;
    assert_close(after.x.transpose().as_slice(), &case["X_out"]);
    assert_close(after.y.as_slice(), &case["Y_out"]);
    assert_close(r.as_slice(), &case["residual"]);
    assert_within(after.theta.as_slice(), &case["theta_out"], tolerance);

    let unbounded = Adaptation {
        lo: Vector3::repeat(f64::NEG_INFINITY),
        hi: Vector3::repeat(f64::INFINITY),
        ..adaptation
    };
    let theta = unbounded.step(&before, &last).theta;
    assert_within(theta.as_slice(), &case["theta_unprojected"], tolerance);
}

#[test]
fn the_trajectories() {
    each_case("traj", |case| {
        let trajectory: Trajectory = case["name"].as_str().unwrap().parse().unwrap();
        let reference = trajectory.reference(number(&case["t"]));
        for (axis, actual) in axes(&reference).iter().enumerate() {
            let row = case["out_xyzpsi_by_derivative0to4"][axis]
                .as_array()
                .unwrap();
            assert_close(actual, &row[..actual.len()].into());
        }
    });
}
