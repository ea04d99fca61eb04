//! The laws besides the paper's in closed loop: what each holds, what it is made for, and where it loses.
//!
//! Every bound is a figure of such a flight with a margin of one half. All flights are at 1 kHz with one tick of delay,
//! on the nominal airframe with its drags and its disturbance, which no law is told.

use crate::flight::{Inner, ScaledTrajectory, Track, course, fly, inner, outer, rig};
use control_api::description::{Settings, Value};
use control_api::law::{Desired, InnerLaw, Law, WrenchSetpoint};
use controller::Trajectory;
use controller::laws::{Estimating, Fixed, Geometric, Indi, Pid};
use messages::content::Measured;
use messages::content::Reference;
use messages::content::{NO_TICK, Stamped};
use messages::parameters::Parameter::{
    DisturbanceGain, GyroNoise, InertiaX, InertiaY, Mass, MotorTimeConstant, RotationalDrag,
    RotorEfficiency1, TranslationalDrag,
};
use messages::telemetry::Telemetry;

fn geometric() -> Inner {
    inner::<Geometric>(vec![])
}

fn indi() -> Inner {
    inner::<Indi>(vec![])
}

fn pid() -> Inner {
    inner::<Pid>(vec![])
}

fn fixed() -> Inner {
    inner::<Fixed>(vec![])
}

/// A flight under the estimating outer law with its defaults.
fn flown(course: &ScaledTrajectory, inner: Inner) -> Track {
    fly(course, outer::<Estimating>(vec![]), inner)
}

/// Each inner law within its bounds [mm], geometric, indi and pid, from 8 s on.
fn within(course: &ScaledTrajectory, bounds_mm: [f64; 3]) {
    for ((name, law), bound_mm) in [("geometric", geometric()), ("indi", indi()), ("pid", pid())]
        .into_iter()
        .zip(bounds_mm)
    {
        let worst_mm = 1e3 * flown(course, law).worst(8.0);
        println!("{name}: {worst_mm:.3} of {bound_mm} mm in {course:?}");
        assert!(
            worst_mm < bound_mm,
            "{name}: {worst_mm} mm, not {bound_mm} mm, in {course:?}"
        );
    }
}

#[test]
fn each_law_flies_each_trajectory() {
    within(&course(Trajectory::Hover), [2.1, 0.06, 0.9]);
    within(&course(Trajectory::Step), [2.1, 0.06, 0.9]);
    within(&course(Trajectory::Helix), [2.2, 0.3, 3.8]);
    within(&course(Trajectory::Lissajous), [2.7, 1.0, 12.0]);
    within(&course(Trajectory::Fast), [5.0, 7.6, 84.0]);
}

#[test]
fn each_law_bears_gyro_noise() {
    within(
        &course(Trajectory::Lissajous).with(0.0, GyroNoise, 0.01),
        [2.7, 1.2, 12.0],
    );
}

#[test]
fn each_law_bears_three_ticks_of_delay() {
    within(&course(Trajectory::Lissajous).delayed(3), [2.7, 1.1, 12.0]);
    within(&course(Trajectory::Fast).delayed(3), [5.7, 8.5, 84.0]);
}

#[test]
fn each_law_bears_slow_motors() {
    within(
        &course(Trajectory::Lissajous).with(0.0, MotorTimeConstant, 0.02),
        [3.9, 3.7, 12.0],
    );
    let worst = course(Trajectory::Lissajous)
        .with(0.0, MotorTimeConstant, 0.02)
        .with(0.0, GyroNoise, 0.01)
        .delayed(3);
    within(&worst, [4.4, 3.8, 12.0]);
}

#[test]
fn each_law_bears_skipped_ticks() {
    within(&course(Trajectory::Lissajous).skipping(7), [2.7, 1.3, 14.0]);
    within(&course(Trajectory::Lissajous).skipping(3), [2.7, 2.6, 17.0]);
}

/// Largest errors [mm] of `indi` and of the paper's law without adaptation.
fn against_fixed(course: &ScaledTrajectory, from_s: f64) -> [f64; 2] {
    let worst = [indi(), fixed()].map(|law| 1e3 * flown(course, law).worst(from_s));
    println!(
        "indi {:.3}, fixed {:.3} mm in {course:?}",
        worst[0], worst[1]
    );
    worst
}

#[test]
fn indi_beats_a_fixed_model_on_each_disturbance_it_is_made_for() {
    for trajectory in [Trajectory::Hover, Trajectory::Lissajous] {
        let course = course(trajectory);
        let faults = [
            (
                "disturbance",
                course.clone().with(0.0, DisturbanceGain, 2.0),
            ),
            (
                "inertia",
                course
                    .clone()
                    .with(0.0, InertiaX, 0.0138)
                    .with(0.0, InertiaY, 0.0138),
            ),
            ("rotor", course.clone().with(2.0, RotorEfficiency1, 0.7)),
            ("drag", course.clone().with(0.0, RotationalDrag, 0.525)),
        ];
        for (name, course) in faults {
            let [indi, fixed] = against_fixed(&course, 8.0);
            assert!(indi < fixed / 3.0, "{name}: {indi} mm, fixed {fixed} mm");
        }
    }
}

#[test]
fn indi_asks_less_of_the_rotors_under_gyro_noise() {
    let noisy = course(Trajectory::Hover).with(0.0, GyroNoise, 0.01);
    let [indi, fixed] = [indi(), fixed()].map(|law| flown(&noisy, law).agitation());
    println!("agitation: indi {indi:.2}, fixed {fixed:.2} rad/s");
    assert!(indi < fixed / 6.0, "{indi} rad/s, fixed {fixed} rad/s");
}

#[test]
fn estimating_holds_its_height_when_the_mass_grows() {
    let heavier = course(Trajectory::Lissajous).with(8.0, Mass, 1.3 * 0.52);
    for (name, law) in [("indi", indi()), ("pid", pid()), ("fixed", fixed())] {
        let track = flown(&heavier, law);
        let (at_once, later) = (1e3 * track.worst(8.0), 1e3 * track.worst(13.0));
        let [scale, mass_kg, drag] = track.telemetry[19_999]
            .value
            .first_chunk()
            .copied()
            .unwrap_or_default();
        println!(
            "{name}: {at_once:.1} mm, from 13 s {later:.2} mm; {scale:.4}, {mass_kg:.4} kg, {drag:.3} 1/s"
        );
        assert!(later < 10.0, "{name}: {later} mm");
        assert!(at_once < 260.0, "{name}: {at_once} mm");
        assert!(
            (mass_kg - 0.676).abs() < 0.01 && (scale * mass_kg - 0.52).abs() < 1e-12,
            "{name}: {mass_kg} kg"
        );
    }
    let still = outer::<Estimating>(vec![
        ("thrust_scale_gain_s3_m2", Value::Number(0.0)),
        ("drag_gain_s_m2", Value::Number(0.0)),
    ]);
    let sag = fly(&heavier, still, indi()).worst(13.0);
    println!("without estimates: {sag:.3} m");
    assert!(sag > 0.5, "{sag} m");
    // Lee's law knows the mass, and has no integrator.
    let sag = flown(&heavier, geometric()).worst(13.0);
    println!("geometric: {sag:.3} m");
    assert!(sag > 0.5, "{sag} m");
}

#[test]
fn estimating_learns_the_drag_of_a_vehicle_that_moves() {
    let faster = course(Trajectory::Fast).with(0.0, TranslationalDrag, 0.4);
    let track = flown(&faster, indi());
    let drag = track.telemetry[19_999].value[2];
    println!(
        "drag {drag:.4} 1/s for {:.4}, error {:.2} mm",
        0.4 / 0.52,
        1e3 * track.worst(8.0)
    );
    assert!((drag - 0.4 / 0.52).abs() < 0.02, "{drag} 1/s");
}

/// A law that was never shown the vehicle, then one that is not shown it any more.
fn coasts<L: Law + InnerLaw>(overrides_thrust: bool) {
    let mut law = L::new(&rig(), &Settings::default()).expect("the defaults go together");
    let mut ask = |tick, measured_tick| {
        let measured = Stamped {
            tick: measured_tick,
            content: Measured {
                rate_b_rad_s: [1.0; 3],
                ..Measured::default()
            },
        };
        let wanted = Stamped {
            tick,
            content: Desired {
                thrust_n: 4.0,
                ..Desired::default()
            },
        };
        law.tick(
            tick,
            &measured,
            &wanted,
            &Reference::default(),
            &mut Telemetry::default(),
        )
    };
    let weight_n = rig().airframe.m() * rig().airframe.g();
    assert_eq!(
        ask(0, NO_TICK),
        WrenchSetpoint {
            thrust_n: weight_n,
            ..WrenchSetpoint::default()
        }
    );
    let shown = ask(1, 1);
    assert!(shown.torque_b_nm.iter().all(|tau| *tau < 0.0), "{shown:?}");
    assert!(overrides_thrust || shown.thrust_n == 4.0, "{shown:?}");
    assert_eq!(
        ask(2, 1),
        WrenchSetpoint {
            thrust_n: shown.thrust_n,
            ..WrenchSetpoint::default()
        }
    );
}

#[test]
fn without_a_measurement_of_the_tick_no_law_asks_for_a_torque() {
    coasts::<Geometric>(true);
    coasts::<Indi>(false);
    coasts::<Pid>(false);
}
