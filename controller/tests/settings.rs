//! Settings: what is refused and why, and that they survive being written out.

use controller::settings::loop_gain_limit;
use controller::{LoopSettings, Preset, SettingsError, Trajectory};
use proptest::prelude::*;

fn flight() -> LoopSettings {
    LoopSettings::new(Trajectory::Lissajous, Preset::Flight)
}

#[test]
fn every_preset_flies_every_trajectory() {
    for preset in Preset::ALL {
        assert_eq!(preset.name().parse(), Ok(preset));
        for trajectory in Trajectory::ALL {
            assert_eq!(LoopSettings::new(trajectory, preset).check(), Ok(()));
        }
    }
}

#[test]
fn each_value_out_of_range_is_refused_by_name() {
    type Change = fn(&mut LoopSettings, f64);
    let changes: [(&str, Change); 15] = [
        ("period_s", |s, x| s.period_s = x),
        ("gains.position_1_s2", |s, x| s.gains.position_1_s2 = x),
        ("gains.velocity_1_s", |s, x| s.gains.velocity_1_s = x),
        ("gains.alpha_1_s", |s, x| s.gains.alpha_1_s = x),
        ("gains.attitude_1_s[1]", |s, x| s.gains.attitude_1_s[1] = x),
        ("gains.command_filter_rad_s[2]", |s, x| {
            s.gains.command_filter_rad_s[2] = x;
        }),
        ("gains.adaptation[0]", |s, x| s.gains.adaptation[0] = x),
        ("gains.regressor_filter_rad_s", |s, x| {
            s.gains.regressor_filter_rad_s = x;
        }),
        ("gains.estimate_min[1]", |s, x| {
            s.gains.estimate_min[1] = if x < 0.0 { f64::NEG_INFINITY } else { x };
        }),
        ("gains.estimate_max[2]", |s, x| {
            s.gains.estimate_max[2] = if x < 0.0 { f64::NAN } else { x };
        }),
        ("limits.acceleration_z_min_g", |s, x| {
            s.limits.acceleration_z_min_g = x;
        }),
        ("limits.acceleration_z_max_g", |s, x| {
            s.limits.acceleration_z_max_g = x;
        }),
        ("limits.tilt_max_rad", |s, x| s.limits.tilt_max_rad = x),
        ("rotor.min_rad_s", |s, x| s.rotor.min_rad_s = x),
        ("rotor.max_rad_s", |s, x| s.rotor.max_rad_s = x),
    ];
    for (key, change) in changes {
        for value in [-1.0, f64::NAN, f64::INFINITY] {
            let mut settings = flight();
            change(&mut settings, value);
            let error = settings.check().unwrap_err().to_string();
            assert!(error.contains(key), "{key} = {value}: {error}");
        }
    }
}

#[test]
fn a_lower_bound_above_the_upper_one_is_refused_and_an_equal_one_fixes_the_estimate() {
    let mut settings = flight();
    settings.gains.estimate_min[1] = 1.1;
    assert!(matches!(settings.check(), Err(SettingsError::Crossed { .. })));
    settings.gains.estimate_min[1] = 1.0;
    assert_eq!(settings.check(), Ok(()));
}

#[test]
fn rotors_that_cannot_carry_the_airframe_are_refused() {
    let mut settings = flight();
    settings.rotor.max_rad_s = 200.0;
    let error = settings.check().unwrap_err();
    assert!(matches!(error, SettingsError::CannotHover { .. }), "{error}");
}

#[test]
fn a_predictor_of_another_depth_is_refused() {
    let mut settings = LoopSettings::new(Trajectory::Hover, Preset::Paper);
    for ticks in [2, u32::MAX] {
        settings.gains.predictor_ticks = ticks;
        assert_eq!(settings.check(), Err(SettingsError::PredictorDepth(ticks)));
    }
}

#[test]
fn alpha_is_bounded_by_962_at_1_khz_without_predictor() {
    let mut settings = flight();
    settings.gains.alpha_1_s = 962.0;
    assert_eq!(settings.check(), Ok(()));
    settings.gains.alpha_1_s = 963.0;
    let error = settings.check().unwrap_err().to_string();
    for part in [
        "gains.alpha_1_s = 963",
        "1 - exp(-alpha T) < 2 sin(pi/10) = 0.618034",
        "below 962.4",
        "gains.predictor_ticks = 1",
    ] {
        assert!(error.contains(part), "{part}: {error}");
    }
    settings.gains.predictor_ticks = 1;
    assert_eq!(settings.check(), Ok(()));
    settings.gains.alpha_1_s = 40_000.0;
    let error = settings.check().unwrap_err().to_string();
    assert!(!error.contains("predictor_ticks"), "{error}");
}

/// Size of e(k+1) = e(k) - c e(k-d) after many ticks.
fn error_after_many_ticks(c: f64, d: usize) -> f64 {
    let mut e = vec![1.0; d + 1];
    for k in d..d + 4000 {
        e.push(e[k] - c * e[k - d]);
    }
    e.iter().rev().take(20).fold(0.0, |max, e| e.abs().max(max))
}

#[test]
fn the_limit_of_the_loop_gain_is_where_the_delayed_loop_turns_unstable() {
    for d in 0..4_u8 {
        let limit = loop_gain_limit(u32::from(d));
        assert!(error_after_many_ticks(0.99 * limit, d.into()) < 1e-3, "{d}");
        assert!(error_after_many_ticks(1.01 * limit, d.into()) > 1e3, "{d}");
    }
    assert_eq!(loop_gain_limit(0), 2.0);
    assert!((loop_gain_limit(1) - 1.0).abs() < 1e-15);
    assert!((loop_gain_limit(2) - (5_f64.sqrt() - 1.0) / 2.0).abs() < 1e-15);
}

proptest! {
    #[test]
    fn what_flies_also_flies_with_a_smaller_alpha(
        period_s in 1e-4..2e-2, alpha in 0.1..2e4, share in 1e-3..1.0, predictor in 0..2_u32,
    ) {
        let mut settings = flight();
        settings.period_s = period_s;
        settings.gains.predictor_ticks = predictor;
        settings.gains.alpha_1_s = alpha;
        match settings.check() {
            Ok(()) => {
                settings.gains.alpha_1_s = alpha * share;
                prop_assert_eq!(settings.check(), Ok(()));
            }
            Err(SettingsError::RateLoopUnstable { alpha_max_1_s, period_max_s, .. }) => {
                settings.gains.alpha_1_s = 0.9 * alpha_max_1_s;
                prop_assert_eq!(settings.check(), Ok(()));
                settings.gains.alpha_1_s = alpha;
                settings.period_s = 0.9 * period_max_s;
                let refused = matches!(settings.check(), Err(SettingsError::RateLoopUnstable { .. }));
                prop_assert!(!refused);
            }
            Err(error) => prop_assert!(false, "{}", error),
        }
    }

    #[test]
    fn settings_survive_a_round_trip_exactly(
        alpha in 0.1..900.0, adaptation in prop::array::uniform3(1e-9..1e5), tilt in 0.01..1.5,
    ) {
        let mut settings = flight();
        settings.gains.alpha_1_s = alpha;
        settings.gains.adaptation = adaptation;
        settings.limits.tilt_max_rad = tilt;
        let text = toml::to_string(&settings).unwrap();
        prop_assert_eq!(toml::from_str::<LoopSettings>(&text).unwrap(), settings);
        let text = serde_json::to_string(&settings).unwrap();
        prop_assert_eq!(serde_json::from_str::<LoopSettings>(&text).unwrap(), settings);
    }
}

#[test]
fn an_unknown_key_is_refused() {
    let text = toml::to_string(&flight()).unwrap();
    let text = text.replace("alpha_1_s", "alpha");
    let error = toml::from_str::<LoopSettings>(&text).unwrap_err().to_string();
    assert!(error.contains("unknown field `alpha`"), "{error}");
}
