//! Sensors: exact when nothing is set, noise by density whatever T, bias, drift, fixes with delay and rate.

use messages::parameters::Parameter;
use nalgebra::Vector3;
use plant::{Initial, Plant, PlantSettings, Swap};

use crate::fly_at;

fn settings(changes: &[(Parameter, f64)]) -> PlantSettings {
    PlantSettings {
        seed: 3,
        ..crate::settings(changes)
    }
}

/// Root mean square of what `of` gives over `ticks` ticks, per axis and all axes together.
fn spread(settings: &PlantSettings, ticks: u64, of: impl Fn(&Plant) -> Vector3<f64>) -> f64 {
    let mut plant = Plant::new(settings);
    let mut sum = 0.0;
    for tick in 0..ticks {
        plant.begin(tick);
        sum += of(&plant).norm_squared() / 3.0;
        plant.finish();
    }
    (sum / ticks as f64).sqrt()
}

fn rate_error(plant: &Plant) -> Vector3<f64> {
    Vector3::from(plant.state().measured.rate_b_rad_s)
        - Vector3::from(plant.state().truth.rate_b_rad_s)
}

#[test]
fn sensors_without_errors_show_the_truth_bit_by_bit() {
    let mut plant = Plant::new(&settings(&[]));
    for tick in 0..2000 {
        let truth = plant.begin(tick).truth;
        let shown = plant.state().measured;
        for (shown, truth) in [
            (shown.position_w_m, truth.position_w_m),
            (shown.velocity_w_m_s, truth.velocity_w_m_s),
            (shown.rate_b_rad_s, truth.rate_b_rad_s),
        ] {
            assert_eq!(shown.map(f64::to_bits), truth.map(f64::to_bits));
        }
        plant.finish();
    }
}

#[test]
fn noise_of_a_density_has_the_same_power_at_every_sample_time() {
    const DENSITY: f64 = 3e-4;
    for (period_s, ticks) in [(0.001, 20_000), (0.004, 20_000)] {
        let settings = PlantSettings {
            period_s,
            ..settings(&[(Parameter::GyroNoiseDensity, DENSITY)])
        };
        // Variance times T is the density squared; its standard error here is 0.6 %.
        let density = spread(&settings, ticks, rate_error) * f64::sqrt(period_s);
        let error = density / DENSITY - 1.0;
        assert!(error.abs() < 0.02, "T = {period_s}: {density}");
    }
    let mut noisy = Plant::new(&settings(&[(Parameter::AccelerometerNoise, 0.002)]));
    let mut quiet = Plant::new(&settings(&[]));
    let mut sum = 0.0;
    for tick in 0..20_000 {
        for plant in [&mut noisy, &mut quiet] {
            plant.finish();
            plant.begin(tick);
        }
        let felt = |plant: &Plant| Vector3::from(plant.state().measured.specific_force_b_m_s2);
        sum += (felt(&noisy) - felt(&quiet)).norm_squared() / 3.0;
    }
    let density = (sum / 20_000.0 * 0.001_f64).sqrt();
    assert!((density / 0.002 - 1.0).abs() < 0.02, "{density}");
}

#[test]
fn bias_is_constant_and_drift_walks_with_the_root_of_time() {
    let mut plant = Plant::new(&settings(&[
        (Parameter::GyroBias, 0.02),
        (Parameter::AccelerometerBias, -0.1),
    ]));
    plant.begin(0);
    assert!((rate_error(&plant) - Vector3::repeat(0.02)).norm() < 1e-15);
    let felt = Vector3::from(plant.state().measured.specific_force_b_m_s2);
    let error = felt - Vector3::new(-0.1, -0.1, 9.7);
    assert!(error.norm() < 1e-12, "{felt}");

    const DRIFT: f64 = 1e-3;
    let walked = |seed: u64, ticks: u64, last: u64| {
        let mut plant = Plant::new(&PlantSettings {
            seed,
            ..settings(&[(Parameter::GyroDrift, DRIFT)])
        });
        for tick in (0..=ticks).filter(|tick| tick % last == 0 || *tick == ticks) {
            plant.begin(tick);
        }
        rate_error(&plant)
    };
    // The walk of a skipped tick is walked all the same.
    assert_eq!(walked(1, 1000, 1), walked(1, 1000, 7));
    let power = |ticks| {
        (0..200)
            .map(|seed| walked(seed, ticks, 1).norm_squared() / 3.0)
            .sum::<f64>()
            / 200.0
    };
    for (ticks, time_s) in [(250, 0.25), (1000, 1.0)] {
        // 600 samples: the standard error of their variance is 5.8 %.
        let ratio = power(ticks) / (DRIFT * DRIFT * time_s);
        assert!((ratio - 1.0).abs() < 0.25, "{ticks} ticks: {ratio}");
    }
}

#[test]
fn a_fix_arrives_late_and_is_shown_until_the_next() {
    let fixes = [
        (Parameter::PositionDelay, 0.1),
        (Parameter::PositionRate, 50.0),
    ];
    let falling = Initial {
        velocity_w_m_s: [1.0, 0.0, 2.0],
        ..Initial::default()
    };
    let mut plant = Plant::new(&PlantSettings {
        initial: falling,
        ..settings(&fixes)
    });
    let mut truth = Vec::new();
    for tick in 0..400_usize {
        let state = plant.begin(tick as u64);
        truth.push((state.truth.position_w_m, state.truth.velocity_w_m_s));
        let taken = tick.saturating_sub(100) / 20 * 20;
        let shown = (state.measured.position_w_m, state.measured.velocity_w_m_s);
        assert_eq!(shown, truth[taken], "tick {tick}");
        plant.finish();
    }
}

#[test]
fn fixes_err_as_much_as_they_may_and_a_skipped_tick_shifts_nothing() {
    let noisy = settings(&[
        (Parameter::PositionNoise, 0.5),
        (Parameter::VelocityNoise, 0.05),
    ]);
    let position = |plant: &Plant| {
        Vector3::from(plant.state().measured.position_w_m)
            - Vector3::from(plant.state().truth.position_w_m)
    };
    let velocity = |plant: &Plant| {
        Vector3::from(plant.state().measured.velocity_w_m_s)
            - Vector3::from(plant.state().truth.velocity_w_m_s)
    };
    assert!((spread(&noisy, 20_000, position) / 0.5 - 1.0).abs() < 0.02);
    assert!((spread(&noisy, 20_000, velocity) / 0.05 - 1.0).abs() < 0.02);
    let late = settings(&[
        (Parameter::PositionNoise, 0.5),
        (Parameter::PositionDelay, 0.02),
    ]);
    let (mut every, mut seldom) = (Plant::new(&late), Plant::new(&late));
    for tick in 0..300 {
        let shown = every.begin(tick);
        if tick % 13 == 0 {
            let seldom = seldom.begin(tick).measured;
            assert_eq!(seldom.position_w_m, shown.measured.position_w_m);
        }
    }
}

#[test]
fn in_free_fall_it_feels_nothing_and_a_thrust_along_its_own_z() {
    let still = [
        (Parameter::TranslationalDrag, 0.0),
        (Parameter::DisturbanceGain, 0.0),
    ];
    let tilted = Initial {
        attitude_rad: [0.5, -0.3, 2.0],
        ..Initial::default()
    };
    let mut plant = Plant::new(&PlantSettings {
        initial: tilted,
        ..settings(&still)
    });
    plant.begin(0);
    let felt = Vector3::from(plant.state().measured.specific_force_b_m_s2);
    // Hover thrust, whatever the attitude.
    assert!((felt - Vector3::z() * 9.8).norm() < 1e-12, "{felt}");
    for tick in 0..3 {
        fly_at(&mut plant, tick, [0.0; 4]);
    }
    plant.begin(3);
    assert_eq!(plant.state().measured.specific_force_b_m_s2, [0.0; 3]);
}

#[test]
fn gyro_noise_is_in_the_measurement_and_not_in_the_truth() {
    let plant = |seed| {
        Plant::new(&PlantSettings {
            seed,
            ..settings(&[])
        })
    };
    let [mut noisy, mut quiet, mut other] = [42, 42, 43].map(plant);
    for plant in [&mut noisy, &mut other] {
        let swap = Swap::new(10, &[(Parameter::GyroNoise, 0.01)]).unwrap();
        plant.schedule(swap).unwrap();
    }
    for tick in 0..20 {
        let [n, q, o] = [&mut noisy, &mut quiet, &mut other].map(|plant| crate::fly(plant, tick));
        assert_eq!(q.measured.rate_b_rad_s, q.truth.rate_b_rad_s);
        assert_eq!(n.truth.rate_b_rad_s, q.truth.rate_b_rad_s);
        for same in [n.truth.rate_b_rad_s, o.measured.rate_b_rad_s] {
            assert_eq!(n.measured.rate_b_rad_s == same, tick < 10);
        }
    }
}
