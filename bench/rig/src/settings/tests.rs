//! Tests of settings from defaults, files and flags, and of the errors about them.

use std::io::Write as _;

use messages::limits::RotorLimits;
use messages::parameters::Airframe;

use crate::settings::*;

fn from_file(text: &str) -> Result<Settings, Failure> {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    Settings::resolve(Some(file.path()), &Vec::new())
}

#[test]
fn every_law_of_every_role_names_its_signals_as_it_should() {
    let all: Vec<_> = law_settings::SECTIONS
        .into_iter()
        .flat_map(|(_, role)| law_settings::known(role))
        .collect();
    assert!(all.len() > 7, "{all:?}");
    assert_eq!(
        all.into_iter()
            .flat_map(control_api::description::Description::flaws)
            .collect::<Vec<_>>(),
        [""; 0]
    );
}

#[test]
fn what_an_observer_knows_of_the_laws_is_what_the_flight_knows() {
    for (text, without) in [
        ("", None),
        ("[inner]\nadaptation = \"off\"\n", Some("adaptive")),
        (
            "[outer]\nlaw = \"estimating\"\n[inner]\nlaw = \"indi\"\n",
            Some("indi"),
        ),
    ] {
        let settings = from_file(text).unwrap();
        let flown = settings.flown_laws().unwrap();
        assert_eq!(flown.without_theorem, without, "{text}");
        assert_eq!(
            law_settings::shared(&airframe::pairs(&settings.shared_text().unwrap())).unwrap(),
            flown,
            "{text}"
        );
    }
    let other = [("inner.law".to_owned(), "mpc".to_owned())].into();
    let refused = law_settings::shared(&other).unwrap_err().to_string();
    assert!(
        refused.contains("there is no inner law of that name"),
        "{refused}"
    );
}

#[test]
fn a_command_names_the_laws_that_fly_only_when_they_are_asked_for() {
    let options = |text: &str| from_file(text).unwrap().law_options().unwrap();
    assert_eq!(options(""), "");
    assert_eq!(
        options("[outer]\nlaw = \"estimating\"\n[inner]\nlaw = \"indi\"\n"),
        "--outer estimating --inner indi"
    );
}

#[test]
fn the_default_is_the_laws_default() {
    let settings = Settings::resolve(None, &Vec::new()).unwrap();
    let laws = settings.laws().unwrap();
    assert_eq!(laws.map(|law| law.name), ["pd", "adaptive", "priority"]);
    for (law, section) in laws
        .iter()
        .zip([&settings.outer, &settings.inner, &settings.mixer])
    {
        assert_eq!(
            section.len(),
            law.settings.len() + 1,
            "{}: each of its settings, and its name",
            law.name
        );
    }
    assert_eq!(settings.rotor, RotorLimits::default());
    assert_eq!(settings.airframe().unwrap(), Airframe::nominal());
    let seed = settings.flight.seed;
    assert_eq!(
        settings.plant().unwrap(),
        plant::PlantSettings {
            seed,
            ..plant::PlantSettings::default()
        }
    );
    assert_eq!(settings.rig().unwrap().airframe, Airframe::nominal());
    assert_eq!(
        (settings.last_tick(), settings.wall_period_ns()),
        (30_000, 1_000_000)
    );
}

#[test]
fn the_printed_settings_are_read_back_as_they_are() {
    let overrides = vec![
        ("flight.preset", Value::from("paper")),
        ("rt.cpu", Value::from(0)),
    ];
    let settings = Settings::resolve(None, &overrides).unwrap();
    let text = settings.commented().unwrap();
    assert!(text.contains("# K_eta"), "comments stay");
    assert_eq!(from_file(&text).unwrap(), settings);
    let text = Settings::resolve(None, &Vec::new())
        .unwrap()
        .commented()
        .unwrap();
    assert!(
        text.starts_with(DEFAULT),
        "what is not said stays as it is written"
    );
    assert!(
        text.contains("[inner]\nlaw = \"adaptive\"\n")
            && text.contains("adaptation = \"on\" # whether"),
        "{text}"
    );
}

#[test]
fn printed_settings_need_no_airframe_file_also_where_it_is_built_as_the_papers_is() {
    let mut file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
    let paper = include_str!("../../airframes/paper.toml");
    write!(file, "{paper}\n[model]\nmass_kg = 0.6\n").unwrap();
    let name = file.path().to_str().unwrap().to_owned();
    let settings = Settings::resolve(None, &vec![("flight.airframe", Value::from(name))]).unwrap();
    assert_eq!(
        (settings.model["mass_kg"], settings.airframe().unwrap()),
        (0.6, Airframe::nominal())
    );
    drop(file);
    assert_eq!(from_file(&settings.commented().unwrap()).unwrap(), settings);
}

#[test]
fn flags_go_before_the_file_and_the_file_before_the_preset() {
    let settings = from_file("[flight]\npreset = \"soft\"\n[inner]\nalpha_1_s = 50\n").unwrap();
    let soft = from_file("[flight]\npreset = \"soft\"\n").unwrap();
    assert_eq!(soft.inner["alpha_1_s"].as_float(), Some(40.0));
    let mut expected = soft.inner;
    expected.insert("alpha_1_s".into(), Value::from(50.0));
    assert_eq!(settings.inner, expected);
    let fixed = from_file("[flight]\npreset = \"soft\"\n[inner]\nlaw = \"fixed\"\n").unwrap();
    assert_eq!(
        (fixed.inner["alpha_1_s"].as_float(), fixed.inner.len()),
        (Some(40.0), 5)
    );
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(b"[flight]\nduration_s = 5\n").unwrap();
    let overrides = vec![("flight.duration_s", Value::from(7.0))];
    assert_eq!(
        Settings::resolve(Some(file.path()), &overrides)
            .unwrap()
            .flight
            .duration_s,
        7.0
    );
}

#[test]
fn settings_of_one_law_or_preset_are_not_mixed_with_another() {
    let over = |text: &str, key: &'static str, flag: &str| {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        Settings::resolve(Some(file.path()), &vec![(key, Value::from(flag))])
    };
    let printed = Settings::resolve(None, &Vec::new())
        .unwrap()
        .commented()
        .unwrap();
    for (key, flag, told) in [
        (
            "outer.law",
            "estimating",
            "its section [outer] is of the law `pd`, and would go before those of --outer est",
        ),
        (
            "inner.law",
            "fixed",
            "its section [inner] is of the law `adaptive`, and would go before those of --inner fix",
        ),
        (
            "flight.preset",
            "soft",
            "its whole sections [outer], [inner] are of the preset `flight`, and would go before those of --preset",
        ),
    ] {
        let refused = over(&printed, key, flag).unwrap_err();
        assert!(refused.to_string().contains(told), "{refused}");
        assert!(
            refused.told().contains(&format!("{flag} --print-config")),
            "{}",
            refused.told()
        );
    }
    let whole = from_file(&printed).unwrap();
    for (key, same) in [
        ("outer.law", "pd"),
        ("inner.law", "adaptive"),
        ("flight.preset", "flight"),
    ] {
        assert_eq!(over(&printed, key, same).unwrap(), whole, "{same}");
    }
    // What somebody wrote is meant, for any law and preset that has it.
    let few = over("[inner]\nalpha_1_s = 50\n", "inner.law", "fixed").unwrap();
    assert_eq!(few.inner["alpha_1_s"].as_float(), Some(50.0));
    let few = over(
        "[inner]\nlaw = \"fixed\"\nalpha_1_s = 50\n",
        "flight.preset",
        "soft",
    )
    .unwrap();
    assert_eq!(
        (
            few.inner["alpha_1_s"].as_float(),
            few.flight.preset.as_str()
        ),
        (Some(50.0), "soft")
    );
}

#[test]
fn what_is_said_beside_sections_is_not_mixed_with_them() {
    let printed: Table = Settings::resolve(None, &Vec::new())
        .unwrap()
        .commented()
        .unwrap()
        .parse()
        .unwrap();
    for (key, other, told) in [
        (
            "inner.law",
            "fixed",
            "its section [inner] is of the law `adaptive`, and would go before those of inner=\"fixed\"",
        ),
        (
            "flight.airframe",
            "x500",
            "of the airframe `paper`, and would go before those of airframe=\"x500\"",
        ),
        (
            "flight.preset",
            "soft",
            "of the preset `flight`, and would go before those of preset=\"soft\"",
        ),
    ] {
        let refused = Settings::of(printed.clone(), &vec![(key, Value::from(other))]).unwrap_err();
        assert!(
            refused.to_string().starts_with("settings: ") && refused.to_string().contains(told),
            "{refused}"
        );
        assert!(
            refused
                .told()
                .contains("out of the settings, or fly without"),
            "{}",
            refused.told()
        );
    }
    let beside = vec![
        ("flight.duration_s", Value::from(7)),
        ("inner.law", Value::from("adaptive")),
    ];
    assert_eq!(
        Settings::of(printed.clone(), &beside)
            .unwrap()
            .flight
            .duration_s,
        7.0
    );
    let refused =
        Settings::of(printed, &vec![("flight.duration_s", Value::from("long"))]).unwrap_err();
    assert!(
        refused
            .to_string()
            .contains("settings: flight.duration_s = \"long\": expected a number, as in 30.0")
    );
}

#[test]
fn every_mistake_names_key_value_and_what_is_allowed() {
    for (text, said) in [
        (
            "[flihgt]\n",
            "unknown section [flihgt]; did you mean `flight`?",
        ),
        (
            "[inner]\nalpha = 3\n",
            "unknown key `inner.alpha` of the law \"adaptive\"; did you mean `alpha_1_s`?",
        ),
        (
            "[inner]\nlaw = \"fixed\"\nadaptation = \"on\"\n",
            "unknown key `inner.adaptation` of the law \"fixed\"",
        ),
        (
            "[inner]\nalpha_1_s = \"big\"\n",
            "inner.alpha_1_s = \"big\": expected a number, as in 200.0",
        ),
        (
            "[inner]\nalpha_1_s = -1\n",
            "inner.alpha_1_s = -1.0 is out of range: allowed is a finite number above 0",
        ),
        (
            "[inner]\nadaptation_gain = [1, 2]\n",
            "expected a list of 3 numbers",
        ),
        (
            "[flight]\nfaults = \"x\"\n",
            "flight.faults = \"x\": expected a list of strings, as in [\"mass_kg=0.6@8s\"]",
        ),
        (
            "[inner]\nadaptation = \"maybe\"\n",
            "inner.adaptation = \"maybe\" is out of range: allowed is \"on\" or \"off\"",
        ),
        (
            "[inner]\npredictor_ticks = 0.5\n",
            "inner.predictor_ticks = 0.5: allowed are 0",
        ),
        (
            "[inner]\nlaw = \"fixt\"\n",
            "inner.law = \"fixt\": there is no inner law of that name; there are fixed, pid, indi, adaptive, geometric",
        ),
        (
            "[mixer]\nlaw = 3\n",
            "mixer.law = 3: expected a string, as in \"priority\"",
        ),
        (
            "[outer]\ntilt_max_rad = 2\n",
            "outer.tilt_max_rad = 2.0 is out of range: allowed is 0.001 to 1.5 rad",
        ),
        (
            "[gains]\nalpha_1_s = 3\nadaptation = [1, 2, 3]\n",
            "`gains.alpha_1_s` is `inner.alpha_1_s`",
        ),
        (
            "[gains]\nadaptation = [1, 2, 3]\n",
            "`gains.adaptation` is `inner.adaptation_gain`",
        ),
        (
            "[gains]\nvelocity_1_s = 1\n",
            "`gains.velocity_1_s` is `outer.velocity_1_s`",
        ),
        (
            "[limits]\ntilt_max_rad = 1\n",
            "`limits.tilt_max_rad` is `outer.tilt_max_rad`",
        ),
        (
            "[gains]\n",
            "there is no section [gains] any more, its keys are the laws' own: [outer] and [inner]",
        ),
        ("[rotor]\nmax_rad_s = 200\n", "the airframe cannot hover"),
        ("flight = 3\n", "`flight` must be a section"),
        (
            "[flight]\ntrajectory = \"loop\"\n",
            "unknown variant `loop`",
        ),
        ("[flight]\npreset = \"race\"\n", "unknown preset `race`"),
        (
            "[flight]\nduration_s = -1\n",
            "flight.duration_s = -1 is out of range",
        ),
        (
            "[flight]\nduration_s = nan\n",
            "flight.duration_s = NaN is out of range",
        ),
        (
            "[plant]\nmass_kg = 50\n",
            "plant.mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg",
        ),
        (
            "[inner]\nalpha_1_s = 2000\n",
            "inner.alpha_1_s = 2000 cannot fly",
        ),
        ("[rt]\ncpu = \"fast\"\n", "rt.cpu = \"fast\""),
        ("[rt]\ncpu = -2\n", "rt.cpu = -2"),
        (
            "[flight]\nfaults = [\"mas_kg=1@2s\"]\n",
            "did you mean `mass_kg`",
        ),
        (
            "[flight]\nfaults = [\"mass_kg=1@2h\"]\n",
            "never strikes: the flight ends at tick 30000",
        ),
        (
            "[flight]\ntilt_max_rad = 4\n",
            "flight.tilt_max_rad = 4 is out of range: allowed are 0.1 to 3.14",
        ),
        (
            "[initial]\nattitude_rad = [0, 1.6, 0]\n",
            "initial.attitude_rad[1] = 1.6 is out of range: allowed are -1.57",
        ),
        (
            "[initial]\nrate_b_rad_s = [0, 0, nan]\n",
            "initial.rate_b_rad_s[2] = NaN is out of range",
        ),
        (
            "[ground]\ncontact = \"sea\"\n",
            "unknown variant `sea`, expected `off` or `plane`",
        ),
        (
            "[ground]\nleg_m = 0\n",
            "ground.leg_m = 0 is out of range: allowed are 0.001 to 2",
        ),
        (
            "[ground]\nfriction = -1\n",
            "ground.friction = -1 is out of range",
        ),
        (
            "[ground]\ncrash_speed_m_s = inf\n",
            "ground.crash_speed_m_s = inf is out of range",
        ),
        (
            "[ground]\ncrash_tilt_rad = 4\n",
            "ground.crash_tilt_rad = 4 is out of range",
        ),
        (
            "[ground]\ncontact = \"plane\"\n[initial]\nposition_w_m = [0, 0, -0.3]\n",
            "initial.position_w_m[2] = -0.3 is 0.100 m too low: the airframe would begin in the ground at -0.25 m",
        ),
        ("[flight\n", "TOML parse error at line 1"),
    ] {
        let failure = from_file(text).unwrap_err();
        assert!(failure.to_string().contains(said), "{text}: {failure}");
        assert_eq!(failure.code, errors::USAGE, "{text}");
    }
    let missing = Settings::resolve(Some(Path::new("/nowhere.toml")), &Vec::new()).unwrap_err();
    assert_eq!(missing.code, errors::USAGE);
    assert!(missing.to_string().contains("/nowhere.toml"));
}

#[test]
fn a_flight_may_begin_on_the_ground_in_any_attitude() {
    let on_feet = "[ground]\ncontact = \"plane\"\n[initial]\nposition_w_m = [0, 0, -0.2]\n";
    let plant = from_file(on_feet).unwrap().plant().unwrap();
    assert_eq!(
        plant.ground.map(|ground| (ground.z_m, ground.leg_m)),
        Some((-0.25, 0.05))
    );
    let inverted = "[initial]\nattitude_rad = [3.1, 0, -2]\nposition_w_m = [0, 0, 3]\n";
    let plant = from_file(inverted).unwrap().plant().unwrap();
    assert_eq!(
        (plant.initial.attitude_rad, plant.ground),
        ([3.1, 0.0, -2.0], None)
    );
}

#[test]
fn the_shared_text_has_no_settings_that_may_differ() {
    let text = Settings::resolve(None, &Vec::new())
        .unwrap()
        .shared_text()
        .unwrap();
    assert!(text.contains("inner.alpha_1_s = 200.0\n"), "{text}");
    assert!(!text.contains("rt.") && !text.contains("recorder."));
}
