//! The curve through points: passes through them, rests at its ends, does not jump; and the exact solution.

use controller::trajectory::{Point, Spline, SplineError};
use controller::{ScaledTrajectory, Trajectory};
use proptest::prelude::*;

use crate::axes;

/// Points whose intervals differ by a factor of up to 20.
fn any_points() -> impl Strategy<Value = Vec<Point>> {
    prop::collection::vec((0.05..1.0_f64, prop::array::uniform4(-5.0..5.0_f64)), 2..40).prop_map(
        |steps| {
            let mut t_s = -steps[0].0;
            let point = |(length_s, value)| {
                t_s += length_s;
                Point { t_s, value }
            };
            steps.into_iter().map(point).collect()
        },
    )
}

/// The largest size of each derivative in the interval before a time [s].
fn sizes(spline: &Spline, from_s: f64, to_s: f64) -> [f64; 5] {
    let mut sizes = [1e-9; 5];
    for i in 0..=20 {
        let axes = spline.axes(from_s + (to_s - from_s) * f64::from(i) / 20.0);
        for axis in axes {
            for (size, value) in sizes.iter_mut().zip(axis) {
                *size = f64::max(*size, value.abs());
            }
        }
    }
    sizes
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn it_passes_through_its_points_and_rests_at_both_ends(points in any_points()) {
        let spline = Spline::through(&points).unwrap();
        for point in &points {
            let axes = spline.axes(point.t_s);
            for (axis, value) in axes.iter().zip(point.value) {
                prop_assert_eq!(axis[0], value);
            }
        }
        for t_s in [points[0].t_s - 1.0, points[0].t_s, spline.end_s(), spline.end_s() + 1e6] {
            for axis in spline.axes(t_s) {
                prop_assert!(axis[1..].iter().all(|derivative| derivative.abs() < 1e-12), "{t_s}: {axis:?}");
            }
        }
    }

    #[test]
    fn no_derivative_up_to_snap_jumps_at_a_point(points in any_points()) {
        let spline = Spline::through(&points).unwrap();
        for pair in points.windows(2) {
            let (from_s, to_s) = (pair[0].t_s, pair[1].t_s);
            let size = sizes(&spline, from_s, to_s);
            let (before, after) = (spline.axes(to_s.next_down()), spline.axes(to_s));
            for axis in 0..4 {
                for order in 0..5 {
                    let jump = (before[axis][order] - after[axis][order]).abs();
                    // Rounding of the fifth derivative's worth of an interval.
                    let allowed = 1e-6 * size[order].max(size[4] * (to_s - from_s).powi(4 - order as i32));
                    prop_assert!(jump <= allowed, "order {order} at {to_s}: {jump} of {}", size[order]);
                }
            }
        }
    }

    #[test]
    fn a_stretched_course_is_larger_and_slower(
        index in 0..5_usize, t_s in 0.0..20.0_f64, size in 0.1..3.0_f64, period in 0.3..3.0_f64,
    ) {
        let course = ScaledTrajectory::of(Trajectory::ALL[index]);
        let (plain, stretched) = (axes(&course.reference(t_s)), axes(&course.stretched(size, period).reference(t_s * period)));
        for axis in 0..4 {
            for order in 0..plain[axis].len() {
                let factor = if axis < 3 { size } else { 1.0 } / period.powi(order as i32);
                let (is, wanted) = (stretched[axis][order], factor * plain[axis][order]);
                prop_assert!((is - wanted).abs() < 1e-9 * (1.0 + wanted.abs()), "{is} {wanted}");
            }
        }
    }
}

#[test]
fn it_is_the_exact_solution() {
    let cases: serde_json::Value = serde_json::from_str(include_str!("spline/exact.json")).unwrap();
    for case in cases.as_array().unwrap() {
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let points: Vec<Point> = case["points"]
            .as_array()
            .unwrap()
            .iter()
            .map(|point| Point {
                t_s: number(&point[0]),
                value: [0.0, number(&point[1]), 0.0, -number(&point[1])],
            })
            .collect();
        let spline = Spline::through(&points).unwrap();
        for sample in case["samples"].as_array().unwrap() {
            let axes = spline.axes(number(&sample[0]));
            for order in 0..5 {
                let exact = number(&sample[order + 1]);
                let close = |is: f64| {
                    (is - exact).abs() < 1e-9 * (100.0_f64.powi(order as i32) + exact.abs())
                };
                assert!(close(axes[1][order]), "{sample} {order}: {:?}", axes[1]);
                assert!(close(-axes[3][order]), "the axes are alike");
                assert_eq!(axes[0][order], 0.0);
            }
        }
    }
}

#[test]
fn what_is_no_curve_is_refused_by_its_point() {
    let point = |t_s: f64, x: f64| Point {
        t_s,
        value: [x, 0.0, 0.0, 0.0],
    };
    assert_eq!(Spline::through(&[]), Err(SplineError::TooFew));
    let single = Spline::through(&[point(0.0, 1.0)]);
    assert_eq!(single, Err(SplineError::TooFew));
    for (second, third) in [
        ((1.0, 0.0), (1.0, 1.0)),
        ((1.0, 0.0), (0.5, 1.0)),
        ((1.0, 0.0), (2.0, f64::NAN)),
    ] {
        let points = [
            point(0.0, 0.0),
            point(second.0, second.1),
            point(third.0, third.1),
        ];
        assert_eq!(Spline::through(&points), Err(SplineError::NotLater(2)));
    }
    let uneven = [
        point(0.0, 0.0),
        point(1e-200, 1.0),
        point(1.0, -1.0),
        point(2.0, 5.0),
    ];
    assert!(matches!(
        Spline::through(&uneven),
        Err(SplineError::Uneven(_))
    ));
}

#[test]
fn a_course_as_it_is_has_the_bits_of_its_trajectory() {
    for trajectory in Trajectory::ALL {
        for i in 0..2000 {
            let t_s = f64::from(i) * 0.01;
            let scaled = ScaledTrajectory::of(trajectory).reference(t_s);
            assert_eq!(scaled, trajectory.reference(t_s));
        }
    }
}

/// A figure of eight of 20 s that begins and ends at rest, in points at a rate [Hz] rounded to a unit [m].
fn rounded(rate_hz: u32, unit_m: f64) -> Vec<Point> {
    let value = |t_s: f64| {
        let y = t_s / 20.0;
        // Once around, from rest to rest: the ramp of degree 9.
        let s =
            y.powi(5) * (126.0 - 420.0 * y + 540.0 * y * y - 315.0 * y.powi(3) + 70.0 * y.powi(4));
        let angle = 2.0 * std::f64::consts::PI * s;
        [angle.sin() * 2.0, (2.0 * angle).sin(), s, 0.0]
    };
    (0..=20 * rate_hz)
        .map(|i| {
            let t_s = f64::from(i) / f64::from(rate_hz);
            let value = value(t_s).map(|value| (value / unit_m).round() * unit_m);
            Point { t_s, value }
        })
        .collect()
}

#[test]
fn dense_and_rounded_points_make_no_snap() {
    let exact = Spline::through(&rounded(5, 1e-9)).unwrap();
    for (rate_hz, unit_m) in [
        (10, 1e-3),
        (20, 1e-3),
        (50, 1e-3),
        (100, 1e-2),
        (100, 1e-3),
        (100, 1e-6),
        (600, 1e-3),
    ] {
        let points = rounded(rate_hz, unit_m);
        let (spline, deviation) = Spline::near(&points, &[unit_m; 4]).unwrap();
        assert_eq!(deviation, None, "{rate_hz} Hz, {unit_m} m");
        for i in 0..=2000 {
            let t_s = f64::from(i) * 0.01;
            let (is, wanted) = (spline.axes(t_s), exact.axes(t_s));
            for axis in 0..3 {
                let off = |order: usize| (is[axis][order] - wanted[axis][order]).abs();
                let [position, snap] = [0, 4].map(off);
                assert!(
                    position < unit_m && snap < 1.0,
                    "{rate_hz} Hz, {unit_m} m, {t_s} s: {position} m, {snap} m/s^4"
                );
            }
        }
    }
}

#[test]
fn a_pause_is_a_rest_and_a_slow_flight_is_none() {
    let point = |(t_s, x, y, yaw): (f64, f64, f64, f64)| Point {
        t_s,
        value: [x, y, 1.0, yaw],
    };
    let points = [
        (0.0, 0.0, 0.0, 0.0),
        (2.0, 1.0, 0.0, 0.0),
        (4.0, 1.0, 0.0, 1.0),
        (6.0, 1.0, 1.0, 1.0),
        (8.0, 1.0, 1.0, 1.0),
        (8.5, 1.0, 1.0, 1.0),
        (10.0, 0.0, 0.0, 0.0),
    ];
    let (spline, _) = Spline::near(&points.map(point), &[0.01; 4]).unwrap();
    for (from, to, x, y) in [(200, 400, 1.0, 0.0), (600, 850, 1.0, 1.0)] {
        for i in from..=to {
            let axes = spline.axes(f64::from(i) * 0.01);
            let away = (axes[0][0] - x).abs().max((axes[1][0] - y).abs());
            assert!(away < 1e-9, "{axes:?}");
        }
    }
    // 0.3 mm/s, in whole millimetres: equal for seconds.
    let slow = |i: u32| {
        let t_s = f64::from(i) * 0.2;
        point((t_s, (0.3 * t_s).round() * 1e-3, 0.0, 0.0))
    };
    let slow: Vec<Point> = (0..200).map(slow).collect();
    let (spline, _) = Spline::near(&slow, &[1e-3; 4]).unwrap();
    for i in 0..3900 {
        let [_, velocity, .., snap] = spline.axes(f64::from(i) * 0.01)[0];
        assert!(
            velocity.abs() < 0.01 && snap.abs() < 60.0,
            "{velocity} {snap}"
        );
    }
}

#[test]
fn a_curve_that_leaves_its_points_is_reported_with_the_time() {
    // There and back at 1 m/s: it turns at 1 s, and neither begins nor ends at rest.
    let point = |i: u32| Point {
        t_s: f64::from(i) * 0.02,
        value: [(f64::from(i) * 0.02 - 1.0).abs(), 0.0, 0.0, 0.0],
    };
    let points: Vec<Point> = (0..=100).map(point).collect();
    let (spline, deviation) = Spline::near(&points, &[1e-3; 4]).unwrap();
    let deviation = deviation.unwrap();
    let away = (spline.axes(deviation.t_s)[0][0] - (deviation.t_s - 1.0).abs()).abs();
    assert_eq!(
        (deviation.axis, deviation.away, deviation.allowed),
        (0, away, 1e-3)
    );
    assert!(away > 1e-3, "{deviation:?}");
}
