//! Physics of the plant: equilibrium, energy, integrator order, rotor means.

use messages::attitude::Attitude;
use messages::content::State;
use messages::parameters::{Airframe, Parameter};
use nalgebra::{Vector3, Vector4};
use plant::integrator::integrate;
use plant::rigid_body::{Effort, RigidBody};
use plant::rotors::{Spin, effort, hover};
use plant::{Initial, Plant, PlantSettings, Swap};
use proptest::prelude::*;

use crate::{PERIOD_S, airframe, fly_at, settings};

#[test]
fn hover_stays_put() {
    let mut plant = Plant::new(&settings(&[(Parameter::DisturbanceGain, 0.0)]));
    for tick in 0..5000 {
        let state = fly_at(&mut plant, tick, crate::hover());
        let parts = [
            state.measured.position_w_m,
            state.measured.velocity_w_m_s,
            state.measured.attitude_rad,
            state.truth.rate_b_rad_s,
        ];
        assert!(
            parts.iter().flatten().all(|x| x.abs() < 1e-12),
            "tick {tick}: {parts:?}"
        );
    }
}

#[test]
fn a_single_rotor_rolls_pitches_and_yaws_the_way_it_sits() {
    let airframe = Airframe::nominal();
    // Rear left, rear right, front right, front left: signs of roll, pitch and yaw by (7).
    for (rotor, signs) in [
        [1.0, 1.0, 1.0],
        [-1.0, 1.0, -1.0],
        [-1.0, -1.0, 1.0],
        [1.0, -1.0, -1.0],
    ]
    .iter()
    .enumerate()
    {
        let mut w = Vector4::zeros();
        w[rotor] = 200.0;
        let Effort { u, tau, om } = effort(&airframe, &w);
        assert!(u > 0.0);
        assert_eq!(tau.map(f64::signum), Vector3::from(*signs), "{rotor}");
        assert_eq!(om.signum(), signs[2], "{rotor}");
    }
}

#[test]
fn a_weak_rotor_loses_thrust_and_drag_torque_alike() {
    let weak = airframe(&[(Parameter::RotorEfficiency3, 0.5)]);
    let w = Vector4::new(0.0, 0.0, 200.0, 0.0);
    let (whole, half) = (effort(&Airframe::nominal(), &w), effort(&weak, &w));
    assert_eq!(
        (half.u, half.tau, half.om),
        (whole.u / 2.0, whole.tau / 2.0, whole.om)
    );
}

#[test]
fn the_integrator_is_of_order_4() {
    let airframe = airframe(&[(Parameter::MotorTimeConstant, 0.05)]);
    let spin = Spin::new(
        &airframe,
        Vector4::new(250.0, 150.0, 180.0, 230.0),
        hover(&airframe),
    );
    let start = RigidBody {
        v: Vector3::new(1.0, 0.5, -0.5),
        attitude: Attitude::of_euler(&Vector3::new(0.3, -0.2, 0.1)),
        nu2: Vector3::new(1.0, -2.0, 0.5),
        ..RigidBody::default()
    };
    // A tick of 0.1 s, from tick 7 on, so that the errors stand clear of rounding.
    let flown = |substeps| integrate(&start, &airframe, &spin, 7, 0.1, substeps);
    let exact = flown(4096);
    let error = |substeps| {
        let body = flown(substeps);
        let turned = Vector4::from(body.attitude.wxyz()) - Vector4::from(exact.attitude.wxyz());
        let parts = [
            body.eta1 - exact.eta1,
            body.v - exact.v,
            body.nu2 - exact.nu2,
        ]
        .map(|part| part.norm());
        [parts[0], parts[1], turned.norm(), parts[2]]
    };
    let errors = [8, 16, 32].map(error);
    for pair in errors.windows(2) {
        for (coarse, fine) in pair[0].iter().zip(pair[1]) {
            let order = (coarse / fine).log2();
            assert!((3.7..4.4).contains(&order), "order {order}: {errors:?}");
        }
    }
}

#[test]
fn an_airframe_that_is_swapped_before_the_flight_flies_as_one_built_so() {
    let changes = [
        (Parameter::TranslationalDrag, 0.5),
        (Parameter::RotationalDrag, 0.3),
        (Parameter::RotorInertia, 5e-5),
        (Parameter::InertiaX, 0.008),
        (Parameter::DisturbanceGain, 1.0),
        (Parameter::PositionDelay, 0.02),
        (Parameter::PositionRate, 100.0),
    ];
    let initial = Initial {
        rate_b_rad_s: [0.5, -0.2, 0.3],
        velocity_w_m_s: [1.0, 0.0, 2.0],
        ..Initial::default()
    };
    let mut built = Plant::new(&PlantSettings {
        initial,
        ..settings(&changes)
    });
    let mut swapped = Plant::new(&PlantSettings {
        initial,
        ..settings(&[])
    });
    swapped.schedule(Swap::new(0, &changes).unwrap()).unwrap();
    for tick in 0..200 {
        let expected = State {
            parameter_epoch: 1,
            ..built.begin(tick)
        };
        assert_eq!(swapped.begin(tick), expected, "tick {tick}");
        assert_eq!(
            swapped.state().measured,
            built.state().measured,
            "tick {tick}"
        );
    }
}

#[test]
fn rotors_follow_a_step_of_the_command_with_their_time_constant() {
    let tau = 0.02;
    let mut plant = Plant::new(&settings(&[(Parameter::MotorTimeConstant, tau)]));
    let [start, ..] = crate::hover();
    for tick in 0..200 {
        let state = fly_at(&mut plant, tick, [300.0; 4]);
        // The first command acts from tick 1 on; the mean of [t_k-1, t_k) lies beside the speed half a tick earlier.
        let elapsed_s = (tick as f64 - 1.5) * PERIOD_S;
        if elapsed_s > 0.0 {
            let speed = 300.0 + (start - 300.0) * (-elapsed_s / tau).exp();
            let [mean, ..] = state.measured.rotor_speed_mean_rad_s;
            assert!((mean - speed).abs() < 0.02, "tick {tick}");
        }
    }
}

proptest! {
    #[test]
    fn rotor_means_are_the_integrals_of_the_motion(
        start in prop::array::uniform4(0.0..350.0_f64),
        command in prop::array::uniform4(0.0..350.0_f64),
        tau in prop_oneof![Just(0.0), 1e-4..1.0_f64],
    ) {
        let airframe = airframe(&[(Parameter::MotorTimeConstant, tau)]);
        let (start, command) = (Vector4::from(start), Vector4::from(command));
        let spin = Spin::new(&airframe, start, command);
        let means = spin.means(PERIOD_S);
        // Composite Simpson rule.
        let intervals = 2000;
        let (mut speed, mut squared) = (Vector4::zeros(), Vector4::zeros());
        for i in 0..=intervals {
            let weight = match i { 0 => 1.0, i if i == intervals => 1.0, i if i % 2 == 1 => 4.0, _ => 2.0 };
            let w = spin.speed(PERIOD_S * f64::from(i) / f64::from(intervals));
            speed += w * weight;
            squared += w.component_mul(&w) * weight;
        }
        speed /= 3.0 * f64::from(intervals);
        squared /= 3.0 * f64::from(intervals);
        prop_assert!((means.speed - speed).norm() < 1e-7, "{} {speed}", means.speed);
        prop_assert!((means.speed_squared - squared).norm() < 1e-4, "{} {squared}", means.speed_squared);
        let change = (spin.speed(PERIOD_S) - spin.speed(0.0)) / PERIOD_S;
        prop_assert!((means.acceleration - change).norm() < 1e-6 * change.norm().max(1e3), "{} {change}", means.acceleration);
        if tau == 0.0 {
            prop_assert_eq!(spin.speed(0.0), command);
            prop_assert_eq!(means.speed_squared, command.component_mul(&command));
        } else {
            prop_assert_eq!(spin.speed(0.0), command + (start - command));
        }
    }

    #[test]
    fn slow_motors_barely_move_and_fast_ones_are_there(
        start in 30.0..350.0_f64,
        command in 30.0..350.0_f64,
    ) {
        let means = |tau: f64| {
            let airframe = airframe(&[(Parameter::MotorTimeConstant, tau)]);
            Spin::new(&airframe, Vector4::repeat(start), Vector4::repeat(command)).means(PERIOD_S)
        };
        prop_assert!((means(1.0).speed.x - start).abs() <= 0.0006 * (start - command).abs());
        prop_assert!((means(1e-300).speed.x - command).abs() < 1e-9);
        prop_assert!((means(1e-300).speed_squared.x - command * command).abs() < 1e-6);
    }
}

#[test]
fn rotors_that_change_their_speed_turn_the_body_the_other_way() {
    use Parameter::{DisturbanceGain, DragFactor, MotorTimeConstant, RotationalDrag, RotorInertia};
    let yawing = |i_r: f64| {
        let airframe = airframe(&[
            (DisturbanceGain, 0.0),
            (DragFactor, 0.0),
            (RotationalDrag, 0.0),
            (MotorTimeConstant, 0.02),
            (RotorInertia, i_r),
        ]);
        let (from, to) = (hover(&airframe), Vector4::new(250.0, 150.0, 250.0, 150.0));
        let spin = Spin::new(&airframe, from, to);
        let body = integrate(&RigidBody::default(), &airframe, &spin, 0, 0.01, 40);
        let w = spin.speed(0.01);
        let of_rotors = i_r * (w.x - w.y + w.z - w.w);
        (body.nu2.z, body.nu2.z * airframe.i_m()[2] + of_rotors)
    };
    let (rate, momentum) = yawing(-3.36e-5);
    assert!(rate > 0.1 && momentum.abs() < 1e-12, "{rate} {momentum}");
    // The paper's sign is none of a rotor, and has no reaction.
    assert_eq!(yawing(3.36e-5).0, 0.0);
}
