//! Settings of the laws: what is refused and why. Ranges are in the descriptions, and the rig checks them.

use control_api::Rig;
use control_api::description::{Preset, Settings, Signal, TICK, Value};
use control_api::law::Law as _;
use controller::Gains;
use controller::gains::PRESET_NAMES;
use controller::laws::{INNER, OUTER, Pd, pd};
use controller::rate_loop::{check, loop_gain_limit};
use messages::telemetry::TELEMETRY;
use proptest::prelude::*;

#[test]
fn every_law_flies_with_its_defaults_and_with_each_of_its_presets() {
    let rig = Rig::default();
    let settings = |presets: &[Preset]| {
        let presets = presets
            .iter()
            .map(|preset| Settings::new(preset.values.to_vec()));
        presets.chain([Settings::default()]).collect::<Vec<_>>()
    };
    for entry in OUTER {
        let mut settings = settings(entry.description.presets).into_iter();
        assert!(settings.all(|settings| entry.make(&rig, &settings).is_ok()));
    }
    for entry in INNER {
        let mut settings = settings(entry.description.presets).into_iter();
        assert!(settings.all(|settings| entry.make(&rig, &settings).is_ok()));
    }
    for preset in PRESET_NAMES {
        assert_eq!(check(&rig, &Gains::preset(preset).unwrap()), Ok(()));
    }
    assert_eq!(
        (Gains::preset("race"), Gains::preset("flight")),
        (None, Some(Gains::default()))
    );
}

/// The names of signals are columns, fields and plots of whatever shows a flight: in snake_case, with the unit.
fn assert_named(Signal { name, unit }: &Signal) {
    let is_lower = |word: &str| {
        let mut characters = word.chars();
        !word.is_empty() && characters.all(|c| c.is_ascii_lowercase() || c.is_ascii_digit())
    };
    let is_named = name.starts_with(|c: char| c.is_ascii_lowercase());
    let is_snake = is_named && name.split('_').all(is_lower);
    assert!(is_snake && *name != TICK, "{name}");
    let letters = unit.replace("N m", "nm").replace('N', "n").replace('^', "");
    let ending = letters.replace([' ', '/'], "_");
    assert!(name.ends_with(&ending), "{name} [{unit}]");
}

#[test]
fn descriptions_hold_what_they_promise() {
    let laws = OUTER
        .iter()
        .map(|entry| entry.description)
        .chain(INNER.iter().map(|entry| entry.description))
        .chain(mixer::LAWS.iter().map(|entry| entry.description));
    for law in laws {
        assert!(law.telemetry.len() <= TELEMETRY, "{}", law.name);
        for (i, signal) in law.telemetry.iter().enumerate() {
            assert_named(signal);
            let is_it = |earlier: &Signal| earlier.name == signal.name;
            assert!(!law.telemetry[..i].iter().any(is_it), "{signal:?}");
        }
        for setting in law.settings {
            let name = setting.name;
            assert!(setting.allows(&setting.default()), "{}.{name}", law.name);
            assert!(!setting.meaning.is_empty(), "{}.{name}", law.name);
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                assert!(!setting.allows(&Value::Number(value)), "{name} = {value}");
                assert!(
                    !setting.allows(&Value::Three([1.0, value, 1.0])),
                    "{name} = {value}"
                );
            }
            assert!(!setting.allows(&Value::Word("maybe")), "{name}");
            let named = law.settings.iter().filter(|other| other.name == name);
            assert_eq!(named.count(), 1, "{}.{name}", law.name);
        }
        for (name, value) in law.presets.iter().flat_map(|preset| preset.values) {
            let setting = law
                .settings
                .iter()
                .find(|setting| setting.name == *name)
                .unwrap();
            assert!(setting.allows(value), "{}.{name}", law.name);
        }
    }
}

#[test]
fn a_lower_bound_above_the_upper_one_is_refused_and_an_equal_one_fixes_the_estimate() {
    let mut gains = Gains::default();
    gains.estimate_min[1] = 1.1;
    let error = check(&Rig::default(), &gains).unwrap_err().to_string();
    let crossed = "inner.estimate_min[1] = 1.1 must not be above inner.estimate_max[1] = 1";
    assert_eq!(error, crossed);
    gains.estimate_min[1] = 1.0;
    assert_eq!(check(&Rig::default(), &gains), Ok(()));
    let crossed = vec![(pd::ACCELERATION_Z_MIN_G.name, Value::Number(3.0))];
    let error = Pd::new(&Rig::default(), &Settings::new(crossed)).unwrap_err();
    let expected =
        "outer.acceleration_z_min_g = 3 must not be above outer.acceleration_z_max_g = 2";
    assert_eq!(error.to_string(), expected);
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
    fn what_flies_also_flies_with_a_smaller_alpha_and_a_smaller_period(
        period_s in 1e-4..2e-2, alpha in 0.1..2e4, share in 1e-3..1.0, predictor in 0..2_u8,
    ) {
        let gains = |alpha_1_s| Gains { alpha_1_s, predictor_ticks: predictor.into(), ..Gains::default() };
        let rig = Rig { period_s, ..Rig::default() };
        // What the message says must be enough is: alpha T below a limit that depends on the delay alone.
        let delay_ticks = 2 - u32::from(predictor);
        let alpha_t_max = -(-loop_gain_limit(delay_ticks)).ln_1p();
        match check(&rig, &gains(alpha)) {
            Ok(()) => prop_assert_eq!(check(&rig, &gains(alpha * share)), Ok(())),
            Err(_) => {
                prop_assert_eq!(check(&rig, &gains(0.9 * alpha_t_max / period_s)), Ok(()));
                let shorter = Rig { period_s: 0.9 * alpha_t_max / alpha, ..rig };
                prop_assert_eq!(check(&shorter, &gains(alpha)), Ok(()));
            }
        }
    }
}
