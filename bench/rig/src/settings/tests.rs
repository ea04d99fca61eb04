//! Tests of settings from defaults, files and flags, and of the errors about them.

use std::io::Write as _;

use model::parameters::Airframe;

use crate::settings::*;

fn from_file(text: &str) -> Result<Settings, Failure> {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    Settings::resolve(Some(file.path()), &Vec::new())
}

#[test]
fn the_default_is_the_laws_default() {
    let settings = Settings::resolve(None, &Vec::new()).unwrap();
    assert_eq!(settings.gains, Gains::default());
    assert_eq!(settings.limits, Limits::default());
    assert_eq!(settings.rotor, RotorLimits::default());
    assert_eq!(settings.airframe().unwrap(), Airframe::nominal());
    let seed = settings.flight.seed;
    assert_eq!(settings.plant().unwrap(), plant::PlantSettings { seed, ..plant::PlantSettings::default() });
    assert_eq!(settings.controller().unwrap().model, Airframe::nominal());
    assert_eq!((settings.last_tick(), settings.wall_period_ns()), (30_000, 1_000_000));
}

#[test]
fn the_printed_settings_are_read_back_as_they_are() {
    let overrides = vec![("flight.preset", Value::from("paper")), ("rt.cpu", Value::from(0))];
    let settings = Settings::resolve(None, &overrides).unwrap();
    let text = settings.commented().unwrap();
    assert!(text.contains("# K_eta"), "comments stay");
    assert_eq!(from_file(&text).unwrap(), settings);
    assert_eq!(Settings::resolve(None, &Vec::new()).unwrap().commented().unwrap(), DEFAULT);
}

#[test]
fn printed_settings_need_no_airframe_file_also_where_it_is_built_as_the_papers_is() {
    let mut file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
    let paper = include_str!("../../airframes/paper.toml");
    write!(file, "{paper}\n[model]\nmass_kg = 0.6\n").unwrap();
    let name = file.path().to_str().unwrap().to_owned();
    let settings = Settings::resolve(None, &vec![("flight.airframe", Value::from(name))]).unwrap();
    assert_eq!((settings.model["mass_kg"], settings.airframe().unwrap()), (0.6, Airframe::nominal()));
    drop(file);
    assert_eq!(from_file(&settings.commented().unwrap()).unwrap(), settings);
}

#[test]
fn flags_go_before_the_file_and_the_file_before_the_preset() {
    let settings = from_file("[flight]\npreset = \"soft\"\n[gains]\nalpha_1_s = 50\n").unwrap();
    assert_eq!(settings.gains, Gains { alpha_1_s: 50.0, ..Gains::preset(Preset::Soft) });
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(b"[flight]\nduration_s = 5\n").unwrap();
    let overrides = vec![("flight.duration_s", Value::from(7.0))];
    assert_eq!(Settings::resolve(Some(file.path()), &overrides).unwrap().flight.duration_s, 7.0);
}

#[test]
fn every_mistake_names_key_value_and_what_is_allowed() {
    for (text, said) in [
        ("[flihgt]\n", "unknown section [flihgt]; did you mean `flight`?"),
        ("[gains]\nalpha = 3\n", "unknown key `gains.alpha`; did you mean `alpha_1_s`?"),
        ("[gains]\nalpha_1_s = \"big\"\n", "gains.alpha_1_s = \"big\": expected a number, as in 200.0"),
        ("[gains]\nadaptation = [1, 2]\n", "expected a list of 3 numbers"),
        ("flight = 3\n", "`flight` must be a section"),
        ("[flight]\ntrajectory = \"loop\"\n", "unknown variant `loop`"),
        ("[flight]\npreset = \"race\"\n", "unknown preset `race`"),
        ("[flight]\nduration_s = -1\n", "flight.duration_s = -1 is out of range"),
        ("[flight]\nduration_s = nan\n", "flight.duration_s = NaN is out of range"),
        ("[plant]\nmass_kg = 50\n", "plant.mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg"),
        ("[gains]\nalpha_1_s = 2000\n", "gains.alpha_1_s = 2000 cannot fly"),
        ("[rt]\ncpu = \"fast\"\n", "rt.cpu = \"fast\""),
        ("[rt]\ncpu = -2\n", "rt.cpu = -2"),
        ("[flight]\nfaults = [\"mas_kg=1@2s\"]\n", "did you mean `mass_kg`"),
        ("[flight]\nfaults = [\"mass_kg=1@2h\"]\n", "never strikes: the flight ends at tick 30000"),
        ("[flight]\ntilt_max_rad = 4\n", "flight.tilt_max_rad = 4 is out of range: allowed are 0.1 to 3.14"),
        ("[initial]\nattitude_rad = [0, 1.6, 0]\n", "initial.attitude_rad[1] = 1.6 is out of range: allowed are -1.57"),
        ("[initial]\nrate_b_rad_s = [0, 0, nan]\n", "initial.rate_b_rad_s[2] = NaN is out of range"),
        ("[ground]\ncontact = \"sea\"\n", "unknown variant `sea`, expected `off` or `plane`"),
        ("[ground]\nleg_m = 0\n", "ground.leg_m = 0 is out of range: allowed are 0.001 to 2"),
        ("[ground]\nfriction = -1\n", "ground.friction = -1 is out of range"),
        ("[ground]\ncrash_speed_m_s = inf\n", "ground.crash_speed_m_s = inf is out of range"),
        ("[ground]\ncrash_tilt_rad = 4\n", "ground.crash_tilt_rad = 4 is out of range"),
        (
            "[ground]\ncontact = \"plane\"\n[initial]\nposition_w_m = [0, 0, -0.3]\n",
            "initial.position_w_m[2] = -0.3 is 0.100 m too low: the airframe would begin in the ground at -0.25 m",
        ),
        ("[flight\n", "TOML parse error at line 1"),
    ] {
        let failure = from_file(text).unwrap_err();
        assert!(failure.to_string().contains(said), "{text}: {failure}");
        assert_eq!(failure.code, failure::USAGE, "{text}");
    }
    let missing = Settings::resolve(Some(Path::new("/nowhere.toml")), &Vec::new()).unwrap_err();
    assert_eq!(missing.code, failure::USAGE);
    assert!(missing.to_string().contains("/nowhere.toml"));
}

#[test]
fn a_flight_may_begin_on_the_ground_in_any_attitude() {
    let on_feet = "[ground]\ncontact = \"plane\"\n[initial]\nposition_w_m = [0, 0, -0.2]\n";
    let plant = from_file(on_feet).unwrap().plant().unwrap();
    assert_eq!(plant.ground.map(|ground| (ground.z_m, ground.leg_m)), Some((-0.25, 0.05)));
    let inverted = "[initial]\nattitude_rad = [3.1, 0, -2]\nposition_w_m = [0, 0, 3]\n";
    let plant = from_file(inverted).unwrap().plant().unwrap();
    assert_eq!((plant.initial.attitude_rad, plant.ground), ([3.1, 0.0, -2.0], None));
}

#[test]
fn the_shared_text_has_no_settings_that_may_differ() {
    let text = Settings::resolve(None, &Vec::new()).unwrap().shared_text().unwrap();
    assert!(text.contains("gains.alpha_1_s = 200.0\n"), "{text}");
    assert!(!text.contains("rt.") && !text.contains("recorder."));
}
