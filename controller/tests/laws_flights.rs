//! The laws besides the paper's in closed loop: what each holds, what it is made for, and where it loses.
//!
//! Every bound is a figure of such a flight with a margin of one half. All flights are at 1 kHz with one tick of delay,
//! on the nominal airframe with its drags and its disturbance, which no law knows.

use crate::flight::{Inner, ScaledTrajectory, Track, course, fly, inner, outer};
use control_api::description::{Settings, Value};
use control_api::law::{InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use controller::Trajectory;
use controller::laws::{
    Adaptive, AdaptiveResidual, Estimating, Fixed, Geometric, Indi, L1, Mrac, Pd, Pid, Sliding,
};
use messages::attitude::Attitude;
use messages::content::Measured;
use messages::parameters::Parameter::{
    DisturbanceGain, GyroNoise, InertiaX, InertiaY, Mass, MotorTimeConstant, RotationalDrag,
    RotorEfficiency1, TranslationalDrag, WindX,
};
use messages::telemetry::Telemetry;
use nalgebra::Vector3;
use plant::Initial;

fn geometric() -> Inner {
    inner::<Geometric>(vec![])
}

fn indi() -> Inner {
    inner::<Indi>(vec![])
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
    for ((name, law), bound_mm) in [
        ("geometric", geometric()),
        ("indi", indi()),
        ("pid", inner::<Pid>(vec![])),
    ]
    .into_iter()
    .zip(bounds_mm)
    {
        let worst_mm = 1e3 * flown(course, law).worst(8.0);
        assert!(
            worst_mm < bound_mm,
            "{name}: {worst_mm} mm, not {bound_mm} mm, in {course:?}"
        );
    }
}

#[test]
fn each_law_flies_each_trajectory() {
    for (trajectory, bounds_mm) in [
        (Trajectory::Hover, [2.1, 0.06, 0.9]),
        (Trajectory::Step, [2.1, 0.06, 0.9]),
        (Trajectory::Helix, [2.2, 0.3, 3.8]),
        (Trajectory::Lissajous, [2.7, 1.0, 12.0]),
        (Trajectory::Fast, [5.0, 7.6, 84.0]),
    ] {
        within(&course(trajectory), bounds_mm);
    }
}

#[test]
fn each_law_tolerates_noise_delay_slow_motors_and_skipped_ticks() {
    let course = || course(Trajectory::Lissajous);
    let slow = || course().with(0.0, MotorTimeConstant, 0.02);
    let fast = crate::flight::course(Trajectory::Fast);
    for (course, bounds_mm) in [
        (course().with(0.0, GyroNoise, 0.01), [2.7, 1.2, 12.0]),
        (course().delayed(3), [2.7, 1.1, 12.0]),
        (fast.delayed(3), [5.7, 8.5, 84.0]),
        (slow(), [3.9, 3.7, 12.0]),
        (
            slow().with(0.0, GyroNoise, 0.01).delayed(3),
            [4.4, 3.8, 12.0],
        ),
        (course().skipping(7), [2.7, 1.3, 14.0]),
        (course().skipping(3), [2.7, 2.6, 17.0]),
    ] {
        within(&course, bounds_mm);
    }
}

#[test]
fn indi_beats_a_fixed_model_on_each_disturbance_it_is_made_for() {
    for trajectory in [Trajectory::Hover, Trajectory::Lissajous] {
        let course = || course(trajectory);
        let heavy = course().with(0.0, InertiaX, 0.0138);
        for course in [
            course().with(0.0, DisturbanceGain, 2.0),
            heavy.with(0.0, InertiaY, 0.0138),
            course().with(2.0, RotorEfficiency1, 0.7),
            course().with(0.0, RotationalDrag, 0.525),
        ] {
            let [indi, fixed] = [indi(), fixed()].map(|law| flown(&course, law).worst(8.0));
            assert!(
                indi < fixed / 3.0,
                "{indi} m, fixed {fixed} m in {course:?}"
            );
        }
    }
}

/// Worst error [mm] of `adaptive_residual`, `l1`, `mrac` and `sliding`, with some settings of them all.
fn unmodelled(
    course: &ScaledTrajectory,
    from_s: f64,
    settings: &[(&'static str, Value)],
) -> [f64; 4] {
    [
        inner::<AdaptiveResidual>(settings.to_vec()),
        inner::<L1>(settings.to_vec()),
        inner::<Mrac>(settings.to_vec()),
        inner::<Sliding>(settings.to_vec()),
    ]
    .map(|law| 1e3 * flown(course, law).worst(from_s))
}

#[test]
fn laws_that_cancel_what_no_model_names_fly_on_with_a_weak_rotor_delay_and_slow_motors() {
    let course = || course(Trajectory::Lissajous);
    for (course, from_s, bounds_mm) in [
        (course(), 8.0, [0.4, 0.5, 0.7, 0.4]),
        (
            course().with(0.0, RotationalDrag, 0.315),
            8.0,
            [0.5, 0.7, 1.4, 0.5],
        ),
        // The outer law must find the thrust that is left.
        (course().with(8.0, RotorEfficiency1, 0.8), 13.0, [9.6; 4]),
        (course().delayed(3), 8.0, [0.7, 0.7, 0.8, 0.7]),
        (course().delayed(8), 8.0, [1.5; 4]),
        (course().with(0.0, MotorTimeConstant, 0.02), 8.0, [3.6; 4]),
        (course().skipping(7), 8.0, [0.5, 0.6, 1.8, 0.5]),
    ] {
        let errors_mm = unmodelled(&course, from_s, &[]);
        let within = errors_mm
            .iter()
            .zip(bounds_mm)
            .all(|(error, bound)| *error < bound);
        assert!(
            within,
            "{errors_mm:?} mm, not {bounds_mm:?} mm, in {course:?}"
        );
    }
}

#[test]
fn where_yaw_saturates_the_thrust_still_points_as_wanted_with_the_rotation_as_attitude_error() {
    let course = course(Trajectory::Lissajous).with(0.0, RotationalDrag, 0.7);
    let quaternion = [("attitude", Value::Word("quaternion"))];
    let adaptive =
        |settings: &[_]| 1e3 * flown(&course, inner::<Adaptive>(settings.to_vec())).worst(13.0);
    let (euler_mm, rotation_mm) = (adaptive(&[]), adaptive(&quaternion));
    assert!(
        euler_mm > 20.0 && rotation_mm < 0.7,
        "{euler_mm} mm, {rotation_mm} mm"
    );
    let errors_mm = unmodelled(&course, 13.0, &quaternion);
    assert!(
        errors_mm.iter().all(|error| *error < 2.8),
        "{errors_mm:?} mm"
    );
}

#[test]
fn indi_asks_less_of_the_rotors_under_gyro_noise() {
    let noisy = course(Trajectory::Hover).with(0.0, GyroNoise, 0.01);
    let [indi, fixed] = [indi(), fixed()].map(|law| flown(&noisy, law).agitation());
    assert!(indi < fixed / 6.0, "{indi} rad/s, fixed {fixed} rad/s");
}

#[test]
fn estimating_holds_its_height_when_the_mass_grows() {
    let heavier = course(Trajectory::Lissajous).with(8.0, Mass, 1.3 * 0.52);
    for (name, law) in [
        ("indi", indi()),
        ("pid", inner::<Pid>(vec![])),
        ("fixed", fixed()),
    ] {
        let track = flown(&heavier, law);
        let (at_once, later) = (1e3 * track.worst(8.0), 1e3 * track.worst(13.0));
        let [scale, mass_kg, ..] = track.telemetry[19_999].value;
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
    assert!(sag > 0.5, "{sag} m");
    // Lee's law knows the mass, and has no integrator.
    let sag = flown(&heavier, geometric()).worst(13.0);
    assert!(sag > 0.5, "{sag} m");
}

#[test]
fn in_steady_wind_a_hover_leans_until_thrust_balances_the_drag() {
    let wind_m_s = 2.0;
    let mut course = course(Trajectory::Hover).with(2.0, WindX, wind_m_s);
    course.seconds = 40.0;
    let track = flown(&course, inner::<AdaptiveResidual>(vec![]));
    let [roll, pitch, _] = track.measured[39_999].attitude_rad;
    let airframe = Rig::default().airframe;
    let balance = (airframe.k_t() * wind_m_s / (airframe.m() * airframe.g())).atan();
    assert!((pitch + balance).abs() < 1e-3, "{pitch}, not -{balance}");
    assert!(roll.abs() < 1e-3, "{roll}");
}

#[test]
fn estimating_learns_the_drag_of_a_vehicle_that_moves() {
    let faster = course(Trajectory::Fast).with(0.0, TranslationalDrag, 0.4);
    let track = flown(&faster, indi());
    let drag = track.telemetry[19_999].value[2];
    assert!((drag - 0.4 / 0.52).abs() < 0.02, "{drag} 1/s");
}

/// A law that was never shown the vehicle, then one that is not shown it any more.
fn coasts<L: Law + InnerLaw>(overrides_thrust: bool) {
    let mut law = L::new(&Rig::default(), &Settings::default()).expect("the defaults go together");
    let mut ask = |tick, measured_age| {
        let mut input = InnerInput {
            tick,
            measured_age,
            ..InnerInput::default()
        };
        input.measured.rate_b_rad_s = [1.0; 3];
        input.wanted.thrust_n = 4.0;
        law.tick(&input, &mut Telemetry::default())
    };
    let no_torque = |thrust_n| WrenchSetpoint {
        thrust_n,
        ..WrenchSetpoint::default()
    };
    let weight_n = Rig::default().airframe.m() * Rig::default().airframe.g();
    assert_eq!(ask(0, u64::MAX), no_torque(weight_n));
    let shown = ask(1, 0);
    assert!(shown.torque_b_nm.iter().all(|tau| *tau < 0.0), "{shown:?}");
    assert!(overrides_thrust || shown.thrust_n == 4.0, "{shown:?}");
    assert_eq!(ask(2, 1), no_torque(shown.thrust_n));
}

#[test]
fn without_a_measurement_of_the_tick_no_law_asks_for_a_torque() {
    coasts::<Geometric>(true);
    coasts::<Indi>(false);
    coasts::<Pid>(false);
}

#[test]
fn geometric_recovers_from_any_side_and_tumbling() {
    for (attitude_degrees, rate_b_rad_s) in [
        ([170.0, 0.0, 0.0], [0.0; 3]),
        ([0.0, 89.0, 0.0], [0.0; 3]),
        ([0.0, 170.0, 120.0], [0.0; 3]),
        ([179.0, 0.0, -30.0], [0.0; 3]),
        ([95.0, -80.0, 170.0], [3.0, -4.0, 2.0]),
        ([-170.0, 20.0, 60.0], [-8.0, 8.0, 3.0]),
    ] {
        let mut course = course(Trajectory::Mavlink).with(0.0, DisturbanceGain, 0.0);
        course.seconds = 10.0;
        course.initial = Initial {
            attitude_rad: attitude_degrees.map(f64::to_radians),
            rate_b_rad_s,
            ..Initial::default()
        };
        let track = fly(&course, outer::<Pd>(vec![]), geometric());
        let left_m = track.worst(9.999);
        assert!(left_m < 1e-3, "{attitude_degrees:?}: {left_m} m");
        let is_tilted = |measured: &Measured| {
            let attitude = Attitude::of_wxyz(measured.attitude_quaternion);
            attitude.to_world(&Vector3::z()).z < 10_f64.to_radians().cos()
        };
        let last_tilted = track.measured.iter().rposition(is_tilted);
        let heights_m = track.measured.iter().map(|it| it.position_w_m[2]);
        let lowest_m = heights_m.fold(0.0, f64::min);
        let is_quick = last_tilted < Some(2000) && lowest_m > -3.0;
        assert!(
            is_quick || attitude_degrees[0] != 170.0,
            "{last_tilted:?}, {lowest_m} m"
        );
    }
}
