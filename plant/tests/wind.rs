//! Wind: drag in moving air, and the turbulence against the formulas of MIL-F-8785C.

use messages::parameters::Parameter::{DisturbanceGain, Turbulence as W20, WindX, WindY, WindZ};
use nalgebra::Vector3;
use plant::turbulence::{INTENSITY, LENGTH_M, Turbulence};
use plant::{Plant, PlantSettings, Swap};

use crate::{airframe, fly_at, miss, settings};

#[test]
fn air_takes_a_level_airframe_along() {
    let mut plant = Plant::new(&settings(&[
        (DisturbanceGain, 0.0),
        (WindX, 5.0),
        (WindY, -3.0),
        (WindZ, 1.0),
    ]));
    let wind = Vector3::new(5.0, -3.0, 1.0);
    for tick in 0..3000 {
        let state = fly_at(&mut plant, tick, crate::hover());
        let expected = wind * (1.0 - (-0.95 / 0.52 * tick as f64 * 1e-3).exp());
        let error = Vector3::from(state.truth.velocity_w_m_s) - expected;
        assert!(error.amax() < 1e-9, "tick {tick}: {error}");
        // Drag and thrust are what an accelerometer feels.
        let drag = (wind - Vector3::from(state.truth.velocity_w_m_s)) * (0.95 / 0.52);
        let felt = Vector3::from(state.measured.specific_force_b_m_s2);
        assert!((felt - drag - Vector3::z() * 9.8).amax() < 1e-9, "{felt}");
    }
}

#[test]
fn intensities_and_lengths_are_those_at_10_ft() {
    let by_height = 0.177 + 0.000_823 * 10.0_f64;
    let sigma = 0.1 / by_height.powf(0.4);
    let length_m = 10.0 / by_height.powf(1.2) * 0.3048;
    for (value, formula) in INTENSITY.iter().zip([sigma, sigma, 0.1]) {
        assert!((value - formula).abs() < 1e-15, "{value} {formula}");
    }
    for (value, formula) in LENGTH_M.iter().zip([length_m, length_m, 3.048]) {
        assert!((value - formula).abs() < 1e-13, "{value} {formula}");
    }
}

/// Products of independent gusts over their variances: N of them have a mean with a standard error of at most
/// sqrt(2/N), here 2.2 %; five of them bound it. As the autocorrelation is that of the formula, so is the spectrum.
#[test]
fn variance_and_autocorrelation_of_gusts_are_those_of_the_formula() {
    const FLIGHTS: u64 = 4_000;
    const W20_M_S: f64 = 8.0;
    let airframe = airframe(&[(W20, W20_M_S)]);
    // 50 Hz and 1 kHz; lags up to L_w/V, and L_u/V at 50 Hz.
    for (period_s, lags) in [(0.02, [0, 5, 19, 144]), (0.001, [0, 5, 50, 381])] {
        let mut products = [[0.0; 3]; 4];
        for seed in 0..FLIGHTS {
            let mut turbulence = Turbulence::new(period_s, seed);
            let first = turbulence.gust(&airframe, 0).unwrap();
            let mut gust = first;
            for tick in 0..=lags[3] {
                if tick > 0 {
                    gust = turbulence.gust(&airframe, tick).unwrap();
                }
                for (lag, product) in lags.iter().zip(&mut products) {
                    if tick == *lag {
                        for axis in 0..3 {
                            product[axis] += first[axis] * gust[axis];
                        }
                    }
                }
            }
        }
        let five_errors = 5.0 * (2.0 / FLIGHTS as f64).sqrt();
        for (lag, product) in lags.iter().zip(products) {
            for axis in 0..3 {
                let sigma = INTENSITY[axis] * W20_M_S;
                let mean = product[axis] / FLIGHTS as f64 / (sigma * sigma);
                let units = *lag as f64 * period_s * W20_M_S / LENGTH_M[axis];
                let transverse = if axis == 0 { 1.0 } else { 1.0 - units / 2.0 };
                let expected = (-units).exp() * transverse;
                assert!(
                    (mean - expected).abs() < five_errors,
                    "axis {axis}, lag {lag} of {period_s} s: {mean}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn gusts_are_those_of_the_seed_and_of_the_tick() {
    let turbulent = |seed| {
        let mut plant = Plant::new(&PlantSettings {
            seed,
            ..settings(&[(W20, 5.0)])
        });
        let swap = Swap::new(100, &[(W20, 0.0)]).unwrap();
        plant.schedule(swap).unwrap();
        plant
    };
    let [mut one, mut same, mut other, mut skipping] = [7, 7, 8, 7].map(turbulent);
    let mut last = one.state();
    for tick in 0..200 {
        last = miss(&mut one, tick);
        assert_eq!(last, miss(&mut same, tick));
        assert!(tick == 0 || last.truth != miss(&mut other, tick).truth);
    }
    // Ticks that are slept through have their gusts, too.
    skipping.begin(50);
    assert_eq!(skipping.begin(199).truth, last.truth);
}
