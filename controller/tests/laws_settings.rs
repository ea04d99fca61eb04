//! Settings of the laws besides the paper's: descriptions that hold together, and refusals that say what to do.

use control_api::description::{Description, SettingKind, Settings, Value};
use control_api::law::{Law, Rig};
use controller::laws::{Estimating, Geometric, Indi, Pid};
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter};
use messages::telemetry::TELEMETRY;

fn rig() -> Rig {
    Rig {
        period_s: 1e-3,
        airframe: Airframe::nominal(),
        rotor: RotorLimits::default(),
    }
}

fn refusal<L: Law>(rig: &Rig, values: &[(&'static str, Value)]) -> String {
    match L::new(rig, &Settings::new(values.to_vec())) {
        Ok(_) => panic!("{} takes {values:?}", L::DESCRIPTION.name),
        Err(refused) => refused.to_string(),
    }
}

/// Each part stands in the refusal: the name, the value, what is allowed, what to do.
fn says(refusal: &str, parts: &[&str]) {
    for part in parts {
        assert!(refusal.contains(part), "`{part}` is not in: {refusal}");
    }
}

fn holds_together(description: &Description) {
    let Description {
        name,
        settings,
        presets,
        telemetry,
        ..
    } = *description;
    let names: Vec<&str> = settings.iter().map(|setting| setting.name).collect();
    let in_range = |setting: &str, value: Value| {
        let found = settings
            .iter()
            .find(|known| known.name == setting)
            .unwrap_or_else(|| panic!("{name}: {setting}"));
        match (found.kind, value) {
            (SettingKind::Number { min, max, .. }, Value::Number(value)) => {
                (min..=max).contains(&value)
            }
            (SettingKind::Three { min, max, .. }, Value::Three(values)) => {
                values.iter().all(|value| (min..=max).contains(value))
            }
            _ => false,
        }
    };
    for setting in settings {
        assert_eq!(
            names.iter().filter(|name| **name == setting.name).count(),
            1,
            "{name}: {}",
            setting.name
        );
        let default = match setting.kind {
            SettingKind::Number { default, .. } => Value::Number(default),
            SettingKind::Three { default, .. } => Value::Three(default),
            SettingKind::Word(words) => Value::Word(words[0]),
        };
        assert!(
            in_range(setting.name, default),
            "{name}: {} = {default:?}",
            setting.name
        );
        assert!(!setting.meaning.is_empty(), "{name}: {}", setting.name);
    }
    for preset in presets {
        for (setting, value) in preset.values {
            assert!(
                in_range(setting, *value),
                "{name}: {setting} of preset {}",
                preset.name
            );
        }
    }
    assert!(telemetry.len() <= TELEMETRY, "{name}");
}

fn flies_with_defaults_and_presets<L: Law>() {
    let description = L::DESCRIPTION;
    holds_together(&description);
    assert!(
        L::new(&rig(), &Settings::default()).is_ok(),
        "{}",
        description.name
    );
    for preset in description.presets {
        assert!(
            L::new(&rig(), &Settings::new(preset.values.to_vec())).is_ok(),
            "{}",
            preset.name
        );
    }
}

#[test]
fn descriptions_hold_together_and_their_defaults_and_presets_are_taken() {
    flies_with_defaults_and_presets::<Estimating>();
    flies_with_defaults_and_presets::<Geometric>();
    flies_with_defaults_and_presets::<Indi>();
    flies_with_defaults_and_presets::<Pid>();
}

#[test]
fn a_rate_gain_that_a_late_command_makes_unstable_is_refused() {
    let values = [("rate_1_s", Value::Three([40.0, 620.0, 20.0]))];
    for refusal in [
        refusal::<Geometric>(&rig(), &values),
        refusal::<Indi>(&rig(), &values),
        refusal::<Pid>(&rig(), &values),
    ] {
        says(
            &refusal,
            &[
                "rate_1_s = 620 1/s (pitch)",
                "period_s of 0.001",
                "below 618.0 1/s",
                "lower rate_1_s",
            ],
        );
    }
    let slow = Rig {
        period_s: 0.02,
        ..rig()
    };
    says(
        &refusal::<Indi>(&slow, &[]),
        &[
            "rate_1_s = 40 1/s (roll)",
            "period_s of 0.02",
            "below 30.9 1/s",
        ],
    );
}

#[test]
fn an_attitude_loop_faster_than_its_rate_loop_is_refused() {
    let parts = [
        "= 50 (roll) is above rate_1_s = 40",
        "allowed is up to 40",
        "raise rate_1_s",
    ];
    let values = |name| [(name, Value::Three([50.0, 8.0, 3.0]))];
    says(
        &refusal::<Geometric>(&rig(), &values("attitude_rad_s")),
        &parts,
    );
    says(&refusal::<Indi>(&rig(), &values("attitude_1_s")), &parts);
    says(&refusal::<Pid>(&rig(), &values("attitude_1_s")), &parts);
}

#[test]
fn a_filter_that_the_sampling_does_not_carry_is_refused() {
    let values = [("filter_rad_s", Value::Number(1600.0))];
    let parts = [
        "filter_rad_s = 1600 rad/s",
        "period_s of 0.001",
        "1570.8 rad/s",
        "lower filter_rad_s",
    ];
    says(&refusal::<Indi>(&rig(), &values), &parts);
    says(&refusal::<Pid>(&rig(), &values), &parts);
}

#[test]
fn crossed_limits_of_the_acceleration_are_refused() {
    let values = [
        ("acceleration_z_min_g", Value::Number(1.0)),
        ("acceleration_z_max_g", Value::Number(1.0)),
    ];
    let parts = ["acceleration_z_min_g = 1 must be below acceleration_z_max_g = 1"];
    says(&refusal::<Estimating>(&rig(), &values), &parts);
    says(&refusal::<Geometric>(&rig(), &values), &parts);
}

#[test]
fn an_airframe_with_more_drag_than_can_be_estimated_is_refused() {
    let mut rig = rig();
    rig.airframe.set(Parameter::TranslationalDrag, 5.3).unwrap();
    let refusal = refusal::<Estimating>(&rig, &[]);
    says(
        &refusal,
        &[
            "translational_drag_kg_s / mass_kg = 10.192 1/s",
            "up to 10 1/s",
            "another outer law",
        ],
    );
}
