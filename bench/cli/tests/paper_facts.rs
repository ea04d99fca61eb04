//! What docs/paper.md says of gains, delay, noise and lag, measured in flight.
//!
//! `cargo test --release -p ironbird --test rig paper_facts -- --nocapture` prints the figures that the page quotes.

use crate::reference_laws::Flight;
use controller::laws::adaptive;
use controller::rate_law::sampled_gain;
use controller::rate_loop::loop_gain_limit;
use controller::{Gains, Trajectory};
use messages::parameters::{Airframe, Parameter};
use std::fmt;

const PERIOD_S: f64 = 0.001;
/// Gyro noise of the noisy flights [rad/s].
const NOISE_RAD_S: f64 = 0.01;
/// Lag of the slow motors [s].
const LAG_S: f64 = 0.020;
/// Rise of V_th in a tick, as a share of V_th at the start, that comes from rounding and from the plant's finer steps.
const V_TH_RISE_MAX: f64 = 1e-12;

#[derive(Default)]
struct Measured {
    /// Share of the ticks whose demand the rotors could not meet.
    saturated: f64,
    /// Root of the mean squared rate error over the second half [rad/s].
    rate_error_rms_rad_s: f64,
    /// Largest distance from the reference [m].
    position_error_max_m: f64,
    /// Last estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    estimate: [f64; 3],
    /// V_th at the end, and its largest rise in a tick, as shares of V_th at the start.
    v_th_end: f64,
    v_th_rise_max: f64,
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (percent, e) = (100.0 * self.saturated, self.rate_error_rms_rad_s);
        let (position, rise) = (self.position_error_max_m, self.v_th_rise_max);
        write!(
            f,
            "saturated {percent:5.1} %, e {e:.1e} rad/s rms, position error {position:.4} m, V_th rise {rise:.1e}"
        )
    }
}

/// Flies 20 s by a preset, changed as a test says, and prints what was measured.
fn fly(
    trajectory: Trajectory,
    preset: &str,
    what: &str,
    change: impl FnOnce(&mut Flight),
) -> Measured {
    let mut flight = Flight::new(trajectory, preset, 20);
    change(&mut flight);
    let model = Airframe::nominal();
    let theta = [model.i_r(), model.k_r(), model.delta()];
    let v_th = |estimate: &[f64; 3]| -> f64 {
        let terms = (0..3).map(|i| (estimate[i] - theta[i]).powi(2) / flight.gains.adaptation[i]);
        terms.sum::<f64>() / 2.0
    };
    let v_th_start = v_th(&[0.0; 3]);
    let mut measured = Measured {
        v_th_end: 1.0,
        ..Measured::default()
    };
    let ticks = flight.last_tick as f64;
    flight.fly(
        |_, state| Some(state),
        |it| {
            measured.saturated += f64::from(u8::from(it.is_saturated)) / (ticks + 1.0);
            if it.tick > flight.last_tick / 2 {
                let error = adaptive::rate_error(&it.wrench.telemetry);
                measured.rate_error_rms_rad_s += error.iter().map(|e| e * e).sum::<f64>();
            }
            let position_error_m = it.sampled.position_error_m(&it.setpoint.content.reference);
            measured.position_error_max_m = measured.position_error_max_m.max(position_error_m);
            measured.estimate = adaptive::estimate(&it.wrench.telemetry);
            let v_th = v_th(&measured.estimate) / v_th_start;
            measured.v_th_rise_max = measured.v_th_rise_max.max(v_th - measured.v_th_end);
            measured.v_th_end = v_th;
        },
    );
    measured.rate_error_rms_rad_s = (measured.rate_error_rms_rad_s / (ticks / 2.0)).sqrt();
    println!("  {trajectory}, {preset}, {what}: {measured}");
    measured
}

#[test]
fn paper_saturates_half_the_time_under_gyro_noise_and_flight_never() {
    for trajectory in [Trajectory::Hover, Trajectory::Lissajous] {
        for seed in 1..=3 {
            let saturated = |preset| {
                let what = format!("gyro noise of 0.01 rad/s, seed {seed}");
                let measured = fly(trajectory, preset, &what, |flight| {
                    flight.start.push((Parameter::GyroNoise, NOISE_RAD_S));
                    flight.seed = seed;
                });
                measured.saturated
            };
            assert_eq!(saturated("flight"), 0.0);
            assert!((0.4..0.6).contains(&saturated("paper")));
        }
    }
}

#[test]
fn flight_tolerates_0_to_3_ticks_of_delay_and_v_th_never_rises() {
    let alpha_1_s = Gains::preset("flight").unwrap().alpha_1_s;
    let loop_gain = sampled_gain(alpha_1_s, PERIOD_S) * PERIOD_S;
    for delay_ticks in 0..=3_u32 {
        let margin = loop_gain_limit(delay_ticks) / loop_gain;
        assert!(margin > 2.4, "{delay_ticks} ticks: {margin}");
        for trajectory in [Trajectory::Lissajous, Trajectory::Fast] {
            let what = format!("{delay_ticks} ticks, gain margin {margin:.2}");
            let measured = fly(trajectory, "flight", &what, |flight| {
                flight.delay_ticks = delay_ticks.into();
            });
            assert_eq!(measured.saturated, 0.0);
            assert!(measured.rate_error_rms_rad_s < 1.5e-3, "{measured}");
            assert!(measured.position_error_max_m < 0.01, "{measured}");
            assert!(measured.v_th_rise_max < V_TH_RISE_MAX, "{measured}");
        }
    }
}

#[test]
fn the_rate_loop_turns_unstable_at_the_limit_of_the_settings_check() {
    for delay_ticks in 2..=4_u32 {
        let alpha_max_1_s = -(-loop_gain_limit(delay_ticks)).ln_1p() / PERIOD_S;
        let [below, above] = [0.9, 1.1].map(|share| {
            let alpha_1_s = share * alpha_max_1_s;
            let what = format!("{delay_ticks} ticks, alpha {alpha_1_s:.0}/s");
            fly(Trajectory::Lissajous, "flight", &what, |flight| {
                flight.delay_ticks = delay_ticks.into();
                flight.gains.alpha_1_s = alpha_1_s;
            })
        });
        assert!(
            below.saturated == 0.0 && below.rate_error_rms_rad_s < 1e-3,
            "{below}"
        );
        assert!(
            above.saturated > 0.5 && above.rate_error_rms_rad_s > 0.1,
            "{above}"
        );
    }
}

#[test]
fn the_papers_gains_need_a_predictor_of_the_chains_depth() {
    let fly = |delay_ticks, predictor_ticks, noise_rad_s| {
        let what = format!("delay {delay_ticks}, predictor {predictor_ticks}, noise {noise_rad_s}");
        fly(Trajectory::Lissajous, "paper", &what, |flight| {
            flight.delay_ticks = delay_ticks;
            flight.gains.predictor_ticks = f64::from(predictor_ticks);
            flight.start.push((Parameter::GyroNoise, noise_rad_s));
        })
    };
    // Where nothing is late, a predictor looks ahead too far.
    assert_eq!(fly(0, 0, 0.0).saturated, 0.0);
    let too_deep = fly(0, 1, 0.0);
    assert!(too_deep.saturated > 0.9 && too_deep.position_error_max_m > 0.5);
    // The chain's own delay: without noise both fly, but only the predictor has a margin left.
    assert_eq!(fly(1, 0, 0.0).saturated, 0.0);
    assert_eq!(fly(1, 1, 0.0).saturated, 0.0);
    assert!(fly(1, 0, 0.001).saturated > 0.01);
    assert_eq!(fly(1, 1, 0.001).saturated, 0.0);
    // One and two ticks late: a predictor of one tick is too shallow, and still better than none.
    for late in [2, 3] {
        let (none, one) = (fly(late, 0, 0.0), fly(late, 1, 0.0));
        assert!(none.saturated > 0.9, "{none}");
        assert!(one.rate_error_rms_rad_s < none.rate_error_rms_rad_s);
    }
}

/// Phase margin [degrees] of the rate loop with a motor lag [s]: an integrator, the lag, and the chain's delay of one
/// tick with half a tick for the hold.
fn phase_margin_deg(gain_1_s: f64, lag_s: f64) -> f64 {
    let crossover_rad_s =
        (((1.0 + (2.0 * lag_s * gain_1_s).powi(2)).sqrt() - 1.0) / 2.0).sqrt() / lag_s;
    90.0 - ((lag_s * crossover_rad_s).atan() + 1.5 * PERIOD_S * crossover_rad_s).to_degrees()
}

#[test]
fn slow_motors_with_noise_want_the_soft_gains() {
    let margins = ["flight", "soft"].map(|preset| {
        let alpha_1_s = Gains::preset(preset).unwrap().alpha_1_s;
        phase_margin_deg(sampled_gain(alpha_1_s, PERIOD_S), LAG_S)
    });
    println!("  phase margin in degrees with motors of 20 ms, flight and soft: {margins:.0?}");
    assert!(margins[0] < 25.0 && margins[1] > 50.0, "{margins:?}");
    for trajectory in [Trajectory::Hover, Trajectory::Lissajous, Trajectory::Fast] {
        let error_m = |preset, noise_rad_s| {
            let what = format!("motors of 20 ms, noise {noise_rad_s}");
            let measured = fly(trajectory, preset, &what, |flight| {
                flight.start.push((Parameter::MotorTimeConstant, LAG_S));
                flight.start.push((Parameter::GyroNoise, noise_rad_s));
            });
            measured.position_error_max_m
        };
        assert!(error_m("flight", 0.0) < 0.05 && error_m("soft", 0.0) < 0.05);
        assert!(error_m("paper", 0.0) > 1.0);
        assert!(error_m("soft", NOISE_RAD_S) < error_m("flight", NOISE_RAD_S) / 3.0);
    }
}

#[test]
fn estimates_converge_only_where_the_flight_excites_them() {
    let model = Airframe::nominal();
    for preset in ["flight", "paper"] {
        for trajectory in Trajectory::ALL {
            let measured = fly(trajectory, preset, "60 s", |flight| {
                flight.last_tick = 60_000
            });
            let ([i_r, k_r, delta], end) = (measured.estimate, measured.v_th_end);
            println!(
                "    I_R {i_r:.2e}, k_r {k_r:.5}, delta {delta:.5}, V_th at the end {end:.1e} of the start"
            );
            assert!(measured.v_th_rise_max < V_TH_RISE_MAX, "{measured}");
            let off = [i_r / model.i_r(), k_r / model.k_r(), delta / 0.2];
            let off = off.map(|share| (share - 1.0).abs());
            let is_right = match (preset, trajectory) {
                (_, Trajectory::Hover | Trajectory::Mavlink) => {
                    off[0] > 0.9 && off[1] > 0.9 && off[2] < 1e-3
                }
                (_, Trajectory::Step) => off[0] > 0.9,
                ("flight", _) => off.iter().all(|off| *off < 1e-3),
                _ => off[1] < 1e-3 && off[2] < 0.1,
            };
            assert!(is_right, "{trajectory}, {preset}: {off:?}");
        }
    }
}
