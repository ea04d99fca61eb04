//! Tests of settings from defaults, files and flags, and of the errors about them.

use std::io::Write as _;

use messages::limits::RotorLimits;
use messages::parameters::Airframe;
use messages::role::{Channel, Role};
use toml::Value;

use crate::*;

fn from_file(text: &str) -> Result<Settings, Failure> {
    with_flags(text, &[])
}

fn with_flags(text: &str, flags: &[(&'static str, Value)]) -> Result<Settings, Failure> {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    Settings::resolve(Some(file.path()), &flags.to_vec())
}

fn default() -> Settings {
    from_file("").unwrap()
}

#[test]
fn values_on_their_limits_are_allowed() {
    for text in [
        "[recorder]; max_steal_percent = 100; log_files = 2",
        "[rt]; lead_us = 500; cpu = 1023",
        "[rt]; channels = 2; priority = 4",
        "[rt]; channels = 3; priority = 7",
        "[flight]; duration_s = 0.001",
        "[flight]; faults = [\"state.drop=0.1@tick29000..tick30001\"]",
        "[flight]; faults = [\"state.drop=0.1@tick30000\"]",
    ] {
        let settings = from_file(&text.replace("; ", "\n"));
        assert!(settings.is_ok(), "{text}: {:?}", settings.err());
    }
}

/// `INSTA_UPDATE=always cargo test -p config` accepts a change.
#[test]
fn what_processes_take_from_the_settings_is_its_snapshot() {
    for (name, text) in [
        (
            "slow_motion",
            "[flight]\nslowdown = 4\ntrajectory = \"fast\"\n[rt]\nloop_cpus = 2\nlead_us = 900\n\
             [recorder]\nlog = \"around-misses\"\nlog_files = 3\nmax_steal_percent = 0\n",
        ),
        (
            "lockstep",
            "[flight]\npace = \"lockstep\"\nperiod_s = 0.002\nduration_s = 1.5\nairframe = \"x500\"\n\
             [rt]\nloop_cpus = 4\ncpu = 0\n[recorder]\ngate_theorem_strict = true\n",
        ),
        (
            "channels",
            "[rt]\nchannels = 3\nchannel_cpus = 2\n[channel.b.inner]\nlaw = \"pid\"\n[channel.b.outer]\nlaw = \"estimating\"\n\
             [channel.c.outer]\nlaw = \"estimating\"\n[simplex]\nenabled = true\n",
        ),
    ] {
        let settings = from_file(text).unwrap();
        let taken = (
            (
                settings.realtime().unwrap(),
                settings.wall_period_ns(),
                settings.last_tick(),
            ),
            (settings.log_plan(), settings.requested_gates()),
            (settings.arrangement(), settings.envelope()),
            settings.of_channel(Channel::B).law_options().unwrap(),
            settings.flown_laws().unwrap().without_theorem,
            settings.warnings().unwrap(),
        );
        insta::assert_debug_snapshot!(name, taken);
    }
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
fn the_default_is_the_laws_default() {
    let settings = default();
    let laws = settings.laws().unwrap();
    assert_eq!(
        laws.map(|law| law.name),
        ["pd", "adaptive", "roll_pitch_first"]
    );
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
    assert_eq!(from_file(&text).unwrap(), settings);
    let text = default().commented().unwrap();
    assert!(
        text.starts_with(DEFAULT),
        "what is not said stays as it is written"
    );
}

#[test]
fn printed_settings_need_no_airframe_file_also_where_it_is_built_as_the_papers_is() {
    let mut file = tempfile::Builder::new().suffix(".toml").tempfile().unwrap();
    let paper = include_str!("../airframes/paper.toml");
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
        (Some(40.0), 6)
    );
    let flag = [("flight.duration_s", Value::from(7.0))];
    let settings = with_flags("[flight]\nduration_s = 5\n", &flag).unwrap();
    assert_eq!(settings.flight.duration_s, 7.0);
}

#[test]
fn a_setting_by_its_key_goes_before_the_file_and_after_the_flags_that_have_it() {
    let flags = |texts: &[&str], more: &[(&'static str, Value)]| {
        let set = texts
            .iter()
            .map(|text| overrides::set("--set", text).unwrap());
        let all: Vec<_> = set.chain(more.iter().cloned()).collect();
        with_flags("[inner]\nalpha_1_s = 50\n", &all)
    };
    let set = [
        "inner.alpha_1_s=150",
        "flight.seed=3",
        "flight.trajectory=hover",
    ];
    let settings = flags(&set, &[("flight.seed", Value::from(4))]).unwrap();
    assert_eq!(settings.inner["alpha_1_s"].as_float(), Some(150.0));
    assert_eq!(
        (settings.flight.seed, &*settings.flight.trajectory),
        (4, "hover")
    );
    let gain = "inner.adaptation_gain=[2e-4, 6, 400]";
    let soft = flags(&[gain, "inner.preset=soft", "inner.alpha_1_s=1"], &[]).unwrap();
    assert_eq!(soft.inner["adaptation_gain"][1].as_float(), Some(6.0));
    // What is wrong in the file is not blamed on the flag.
    let seed = overrides::set("--set", "flight.seed=3").unwrap();
    let refused = with_flags("[inner]\nalpha_1_s = -1\n", &[seed]).unwrap_err();
    assert!(!refused.to_string().contains("--set"), "{refused}");
    for text in ["inner", "inner=1", ".a=1", "inner.=1"] {
        assert!(overrides::set("--set", text).is_err(), "{text}");
    }
}

#[test]
fn a_law_may_have_a_preset_and_settings_of_its_own() {
    let law = |text| overrides::law(Role::Inner, text).unwrap();
    assert_eq!(law("indi"), [("inner.law", Value::from("indi"))]);
    let text = "adaptive:soft,adaptation_gain=[2e-4, 6, 400],adaptation=off";
    let settings = with_flags("", &law(text)).unwrap();
    assert_eq!(settings.inner["alpha_1_s"].as_float(), Some(40.0));
    assert_eq!(settings.inner["adaptation_gain"][2].as_float(), Some(400.0));
    assert_eq!(settings.inner["adaptation"].as_str(), Some("off"));
    assert_eq!(overrides::variant(text), &text["adaptive".len()..]);
    let refused = with_flags("", &law("indi:alpha_1_s=1")).unwrap_err();
    let said = "--inner: unknown key `inner.alpha_1_s` of the law \"indi\"";
    assert!(refused.to_string().starts_with(said), "{refused}");
}

#[test]
fn settings_of_one_law_preset_or_airframe_are_not_mixed_with_another() {
    let printed = default().commented().unwrap();
    let table: Table = printed.parse().unwrap();
    for case in "outer.law | outer | estimating | its section [outer] is of the law `pd`
        inner.law | inner | fixed | its section [inner] is of the law `adaptive`
        flight.preset | preset | soft | its whole sections [outer], [inner] are of the preset `flight`
        flight.airframe | airframe | x500 | of the airframe `paper`"
        .lines()
    {
        let [key, name, other, what] = case.trim().split(" | ").collect::<Vec<_>>()[..] else {
            panic!("{case}")
        };
        let other_value = vec![(key, Value::from(other))];
        let by_flag = with_flags(&printed, &other_value).unwrap_err().text();
        let expected = format!("{what}, and would go before those of --{name} {other}");
        assert!(by_flag.contains(&expected), "{by_flag}");
        assert!(
            by_flag.contains(&format!("{other} --print-config")),
            "{by_flag}"
        );
        let beside = Settings::of(table.clone(), &other_value)
            .unwrap_err()
            .text();
        let expected = format!("{what}, and would go before those of {name}=\"{other}\"");
        assert!(beside.contains(&expected), "{beside}");
        assert!(beside.starts_with("error: settings: "), "{beside}");
        assert!(
            beside.contains("out of the settings, or fly without"),
            "{beside}"
        );
    }
    let whole = from_file(&printed).unwrap();
    for (key, same) in [
        ("outer.law", "pd"),
        ("inner.law", "adaptive"),
        ("flight.preset", "flight"),
    ] {
        let again = with_flags(&printed, &[(key, Value::from(same))]).unwrap();
        assert_eq!(again, whole, "{same}");
    }
    // Single keys are meant for any law and preset that has them.
    for (text, key, other) in [
        ("[inner]\nalpha_1_s = 50\n", "inner.law", "fixed"),
        (
            "[inner]\nlaw = \"fixed\"\nalpha_1_s = 50\n",
            "flight.preset",
            "soft",
        ),
    ] {
        let few = with_flags(text, &[(key, Value::from(other))]).unwrap();
        assert_eq!(few.inner["alpha_1_s"].as_float(), Some(50.0));
        assert_eq!(few.inner["law"].as_str(), Some("fixed"));
    }
}

#[test]
fn keys_set_beside_sections_have_the_type_of_the_default() {
    let beside = vec![
        ("flight.duration_s", Value::from(7)),
        ("inner.law", Value::from("adaptive")),
    ];
    let settings = Settings::of(Table::new(), &beside).unwrap();
    assert_eq!(settings.flight.duration_s, 7.0);
    let long = vec![("flight.duration_s", Value::from("long"))];
    let refused = Settings::of(Table::new(), &long).unwrap_err().to_string();
    let expected = "settings: flight.duration_s = \"long\": expected a number, as in 30.0";
    assert!(refused.contains(expected), "{refused}");
}

#[test]
fn every_mistake_names_key_value_and_what_is_allowed() {
    let lines = include_str!("refusals.txt").lines();
    for line in lines.filter(|line| !line.starts_with('#')) {
        let (text, said) = line.split_once(" -> ").unwrap();
        let settings = match text.strip_prefix("--set ") {
            Some(set) => with_flags("", &[overrides::set("--set", set).unwrap()]),
            None => from_file(&(text.replace("; ", "\n") + "\n")),
        };
        let failure = settings.unwrap_err();
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
    let text = default().shared_text().unwrap();
    assert!(text.contains("inner.alpha_1_s = 200.0\n"), "{text}");
    assert!(!text.contains("rt.") && !text.contains("recorder."));
}
