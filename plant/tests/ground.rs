//! Ground: rest, landing, sliding, tumbling; no energy gained, nothing below the plane.

use messages::content::State;
use messages::parameters::Parameter;
use nalgebra::{Vector3, Vector4};
use plant::ground::{Contact, Ground};
use plant::integrator::{SUBSTEPS, Steps, integrate_with};
use plant::rigid_body::{Dynamics, RigidBody};
use plant::rotors::Spin;
use plant::{EnvelopeViolation, Initial, Plant, PlantSettings};
use proptest::prelude::*;

use crate::{PERIOD_S, airframe, command_of};

const IDLE: f64 = 30.0;

const GROUND: Ground = Ground {
    z_m: -0.25,
    leg_m: 0.05,
    friction: 0.6,
    crash_speed_m_s: 2.0,
    crash_tilt_rad: 0.785,
};
/// Height of the centre of mass on four feet.
const REST_Z_M: f64 = -0.2;

fn plant(initial: Initial) -> Plant {
    Plant::new(&PlantSettings {
        ground: Some(GROUND),
        initial,
        ..PlantSettings::default()
    })
}

/// Flies with all rotors at a speed, and shows every state.
fn fly(plant: &mut Plant, ticks: u64, speed_rad_s: f64, mut see: impl FnMut(&State, &Plant)) {
    for tick in 0..ticks {
        see(&plant.begin(tick), plant);
        plant.offer(&command_of(tick, [speed_rad_s; 4]), tick + 1);
        plant.finish();
    }
}

const fn at(position_w_m: [f64; 3]) -> Initial {
    Initial {
        position_w_m,
        velocity_w_m_s: [0.0; 3],
        attitude_rad: [0.0; 3],
        rate_b_rad_s: [0.0; 3],
    }
}

#[test]
fn at_rest_it_stays_where_it_stands_and_feels_its_weight() {
    for substeps in [1, 2, SUBSTEPS] {
        let mut plant = Plant::new(&PlantSettings {
            ground: Some(GROUND),
            initial: at([0.3, -0.2, REST_Z_M]),
            substeps,
            ..PlantSettings::default()
        });
        // It sinks with the square of the step.
        let most = 1e-6 * f64::from(SUBSTEPS / substeps).powi(2);
        fly(&mut plant, 5000, IDLE, |state, plant| {
            let stand = Vector3::new(0.3, -0.2, REST_Z_M);
            let off = Vector3::from(state.measured.position_w_m) - stand;
            assert!(off.norm() < most, "{substeps}: {state:?}");
            let tilt = Vector3::from(state.measured.attitude_rad).norm();
            assert!(tilt < most, "{substeps}: {state:?}");
            assert_eq!(plant.envelope(), Ok(()));
            // Tick 1 ends a tick at hover speed, in which the feet carried nothing.
            if state.truth.position_w_m[2] < REST_Z_M + 1e-9
                && plant.state().measured.rotor_speed_mean_rad_s[0] < 31.0
            {
                let felt = Vector3::from(plant.state().measured.specific_force_b_m_s2);
                assert!(
                    (felt - Vector3::z() * 9.8).norm() < 0.02,
                    "{substeps}: {felt}"
                );
            }
        });
    }
}

#[test]
fn a_gentle_descent_is_a_landing_and_a_fall_is_a_crash() {
    let landed = |velocity: f64, attitude_rad: [f64; 3]| {
        let mut plant = plant(Initial {
            velocity_w_m_s: [0.0, 0.0, velocity],
            attitude_rad,
            ..at([0.0, 0.0, REST_Z_M + 0.2])
        });
        fly(&mut plant, 1500, IDLE, |_, _| {});
        (plant.state().truth.position_w_m[2], plant.envelope())
    };
    // From 0.2 m it falls to 1.98 m/s at the most; the drag takes some of it.
    let (z_m, envelope) = landed(0.0, [0.0; 3]);
    assert_eq!(envelope, Ok(()));
    assert!((z_m - REST_Z_M).abs() < 1e-6, "{z_m}");
    let (z_m, envelope) = landed(-3.0, [0.0; 3]);
    let Err(EnvelopeViolation::Crash(crash)) = envelope else {
        panic!("{envelope:?}")
    };
    assert!((3.0..4.0).contains(&crash.speed_m_s), "{crash:?}");
    assert!(crash.tilt_rad < 0.01 && crash.tick < 100, "{crash:?}");
    assert!((z_m - REST_Z_M).abs() < 1e-6, "{z_m}");
    let (_, envelope) = landed(0.0, [1.0, 0.0, 0.0]);
    let Err(EnvelopeViolation::Crash(crash)) = envelope else {
        panic!("{envelope:?}")
    };
    assert!(crash.tilt_rad > 0.785, "{crash:?}");
    let said = crash.to_string();
    assert!(
        said.starts_with("the flight left its envelope: at tick "),
        "{said}"
    );
    assert!(said.contains("at most 2 m/s and 45 degrees"), "{said}");
}

#[test]
fn it_slides_to_a_stop_as_friction_says() {
    let mut plant = plant(Initial {
        velocity_w_m_s: [1.0, 0.0, 0.0],
        ..at([0.0, 0.0, REST_Z_M])
    });
    let mut stopped = None;
    let mut farthest: f64 = 0.0;
    fly(&mut plant, 1000, IDLE, |state, _| {
        farthest = farthest.max(state.measured.position_w_m[0]);
        if stopped.is_none() && state.measured.velocity_w_m_s[0] < 1e-9 {
            stopped = Some(state.measured.position_w_m[0]);
        }
        // It is not thrown back.
        assert!(state.measured.velocity_w_m_s[0] > -1e-6, "{state:?}");
    });
    // v^2 / (2 mu g) = 0.085 m without drag, which shortens it a little; tick 0 is flown at hover speed, without load.
    let stopped = stopped.unwrap();
    assert!((0.07..0.087).contains(&stopped), "{stopped}");
    assert!(farthest - stopped < 1e-6);
}

#[test]
fn without_friction_it_slides_on() {
    let ground = Ground {
        friction: 0.0,
        ..GROUND
    };
    let airframe = airframe(&[(Parameter::TranslationalDrag, 0.0)]);
    let initial = Initial {
        velocity_w_m_s: [1.0, 0.5, 0.0],
        ..at([0.0, 0.0, REST_Z_M])
    };
    let settings = PlantSettings {
        ground: Some(ground),
        airframe,
        initial,
        ..PlantSettings::default()
    };
    let mut plant = Plant::new(&settings);
    fly(&mut plant, 1000, IDLE, |_, _| {});
    let [x, y, _] = plant.state().truth.velocity_w_m_s;
    assert!((x - 1.0).abs() < 1e-6 && (y - 0.5).abs() < 1e-6, "{x} {y}");
}

#[test]
fn it_takes_off_from_the_ground() {
    let mut plant = plant(at([0.0, 0.0, REST_Z_M]));
    fly(&mut plant, 1000, 230.0, |_, _| {});
    assert!(plant.state().truth.position_w_m[2] > REST_Z_M + 0.5);
    assert_eq!(plant.envelope(), Ok(()));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn however_it_tumbles_it_gains_no_energy_and_stays_above(
        attitude in prop::array::uniform3(-3.1..3.1_f64),
        v in prop::array::uniform3(-5.0..5.0_f64),
        nu2 in prop::array::uniform3(-20.0..20.0_f64),
        friction in 0.0..1.5_f64,
        inertia_z in 0.002..0.05_f64,
    ) {
        let airframe = airframe(&[
            (Parameter::DisturbanceGain, 0.0),
            (Parameter::TranslationalDrag, 0.0),
            (Parameter::RotationalDrag, 0.0),
            (Parameter::InertiaZ, inertia_z),
        ]);
        let i_m = Vector3::from(airframe.i_m());
        let energy = |body: &RigidBody| {
            airframe.m() * (body.v.norm_squared() / 2.0 + airframe.g() * body.eta1.z)
                + body.nu2.component_mul(&i_m).dot(&body.nu2) / 2.0
        };
        let ground = Ground { friction, ..GROUND };
        let mut body = RigidBody {
            eta1: Vector3::new(0.0, 0.0, 0.1),
            v: v.into(),
            attitude: messages::attitude::Attitude::of_euler(&attitude.into()),
            nu2: nu2.into(),
        };
        let (dynamics, spin) = (Dynamics::new(&airframe), Spin::new(&airframe, Vector4::zeros(), Vector4::zeros()));
        let steps = Steps::new(PERIOD_S, SUBSTEPS);
        let start = energy(&body);
        let mut least = start;
        for tick in 0..4000 {
            let mut contact = Contact::default();
            let step_s = PERIOD_S / f64::from(SUBSTEPS);
            let keep_above = |start: &RigidBody, body: &mut RigidBody| {
                ground.keep_above(&airframe, start, body, step_s, &mut contact);
            };
            body = integrate_with(&body, &dynamics, &spin, tick, &steps, keep_above);
            let now = energy(&body);
            prop_assert!(now < least + 1e-9, "tick {tick}: {now} J after {least} J");
            least = least.min(now);
            prop_assert!(ground.clearance_m(&airframe, &body) > -1e-6, "tick {tick}");
            prop_assert!(body.is_finite());
        }
        prop_assert!(least < start);
    }
}
