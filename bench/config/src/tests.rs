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
            (settings.arrangement(), settings.simplex_limits()),
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
        let shared = settings.shared_text().unwrap();
        let observed = Settings::of_shared(&shared).unwrap();
        assert_eq!(observed.flown_laws().unwrap(), flown, "{text}");
        assert_eq!(observed.shared_text().unwrap(), shared);
    }
    let other = Settings::of_shared("inner.law = \"mpc\"\n").unwrap();
    let refused = other.flown_laws().unwrap_err().to_string();
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
        text.starts_with(declarations::DEFAULT.as_str()),
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

/// A settings file, with `; ` between its lines, and a part of the error.
#[rustfmt::skip]
const REFUSED: &[(&str, &str)] = &[
    ("[inner]; [outer]; [inner]", "line 3, `[inner]`: this section or key is in the file twice: write it once"),
    ("[flihgt]", "unknown section [flihgt]; did you mean `flight`?"),
    ("[inner]; alpha = 3", r#"unknown key `inner.alpha` of the law "adaptive"; did you mean `alpha_1_s`?"#),
    (r#"[inner]; law = "fixed"; adaptation = "on""#, r#"unknown key `inner.adaptation` of the law "fixed""#),
    (r#"[inner]; alpha_1_s = "big""#, r#"inner.alpha_1_s = "big": expected a number, as in 200.0"#),
    ("[inner]; alpha_1_s = -1", "inner.alpha_1_s = -1.0 is out of range: allowed is a finite number above 0"),
    ("[inner]; adaptation_gain = [1, 2]", "expected a list of 3 numbers"),
    (r#"[flight]; faults = "x""#, r#"flight.faults = "x": expected a list of strings, as in ["rotational_drag_nm_s=0.315@8s"]"#),
    (r#"[inner]; adaptation = "maybe""#, r#"inner.adaptation = "maybe" is out of range: allowed is "on" or "off""#),
    ("[inner]; predictor_ticks = 0.5", "inner.predictor_ticks = 0.5: allowed are 0"),
    (r#"[inner]; law = "fixt""#, r#"inner.law = "fixt": there is no inner law of that name; did you mean `fixed`?"#),
    ("[mixer]; law = 3", r#"mixer.law = 3: expected a string, as in "roll_pitch_first""#),
    ("[outer]; tilt_max_rad = 2", "outer.tilt_max_rad = 2.0 is out of range: allowed is 0.001 to 1.5 rad"),
    ("[rotor]; max_rad_s = 200", "the airframe cannot hover"),
    ("[rotor]; max_rad_s = 30000", "the rotors give more than 10000 N in all"),
    ("flight = 3", "`flight` must be a section"),
    (r#"[flight]; trajectory = "loop""#, "unknown variant `loop`"),
    ("[flight]; duration_s = -1", "flight.duration_s = -1 is out of range"),
    ("[flight]; duration_s = nan", "flight.duration_s = NaN is out of range"),
    ("[plant]; mass_kg = 50", "plant.mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg"),
    (r#"[rt]; cpu = "fast""#, r#"rt.cpu = "fast""#),
    ("[rt]; cpu = -2", "rt.cpu = -2"),
    ("[plant]; substeps = 3", "plant.substeps = 3: allowed are 1, 2, 4"),
    ("[plant]; substeps = 2.0", "plant.substeps = 2.0: expected a whole number, as in 4"),
    ("[rt]; loop_cpus = 3", "rt.loop_cpus = 3: allowed are 1, 2, 4"),
    (r#"[flight]; faults = ["mas_kg=1@2s"]"#, "did you mean `mass_kg`"),
    (r#"[flight]; faults = ["mass_kg=1@2h"]"#, "is after the end of the flight: the last tick is 30000"),
    ("[flight]; tilt_max_rad = 4", "flight.tilt_max_rad = 4 is out of range: allowed are 0.1 to 3.14"),
    ("[initial]; attitude_rad = [0, 1.6, 0]", "initial.attitude_rad[1] = 1.6 is out of range: allowed are -1.57"),
    ("[initial]; rate_b_rad_s = [0, 0, nan]", "initial.rate_b_rad_s[2] = NaN is out of range"),
    (r#"[ground]; contact = "sea""#, "unknown variant `sea`, expected `off` or `plane`"),
    ("[ground]; crash_speed_m_s = inf", "ground.crash_speed_m_s = inf is out of range"),
    (r#"[ground]; contact = "plane"; [initial]; position_w_m = [0, 0, -0.3]"#, "initial.position_w_m[2] = -0.3 is 0.100 m too low: the airframe would begin in the ground at -0.25 m"),
    ("[recorder]; log_files = 1", "recorder.log_files = 1 is out of range: allowed are 0, for all, and 2 or more"),
    ("[recorder]; max_steal_percent = 100.5", "recorder.max_steal_percent = 100.5: allowed are 0 to 100, and a negative number"),
    ("[recorder]; max_loop_p999_us = inf", "recorder.max_loop_p999_us = inf: allowed are 0 and more"),
    ("[recorder]; gate_channels = true", "recorder.gate_channels = true: the flight has one channel"),
    (r#"[recorder]; gate_theorem_strict = true; [inner]; adaptation = "off""#, "recorder.gate_theorem_strict = true: the inner law `adaptive`"),
    ("[rt]; channels = 4", "rt.channels = 4 is out of range: allowed are 1 to 3"),
    ("[rt]; channels = 2; priority = 3", "rt.priority = 3: 2 channels need 3 priorities below it"),
    ("[rt]; channels = 3; priority = 6", "rt.priority = 6: 3 channels need 6 priorities below it"),
    ("[rt]; lead_us = -1", r#"rt.lead_us = -1: allowed are "auto""#),
    ("[rt]; cpu = 1024", r#"rt.cpu = 1024: allowed are a processor's number and "auto""#),
    (r#"[channel.b.inner]; law = "pid""#, "channel.b: the flight has 1 channel"),
    (r#"[channel.a.inner]; law = "pid""#, "unknown section [channel.a.inner]: channels b and c have"),
    ("[channel]; b = 3", "`channel.b` must be a section: [channel.b.inner]"),
    (r#"[channel.b.inner]; law = "pid"; alpha = 1; [rt]; channels = 2"#, r#"channel b: unknown key `inner.alpha` of the law "pid""#),
    (r#"[flight]; faults = ["state.drop=0.1@tick29000..tick30002"]"#, "ends at tick 30002, after the flight: that ends at tick 30000"),
    (r#"[flight]; faults = ["state.drop=0.1@tick30001"]"#, "a fault at tick 30001 is after the end of the flight"),
    ("[flight]; period_s = nan", "flight.period_s = NaN is out of range: allowed is 0.0001 to 0.02 s"),
    ("[flight]; seed = -1", "flight.seed = -1 is out of range: allowed are whole numbers from 0 to 9223372036854775807"),
    (r#"[flight]; airframe = "paper"; seed = 99999999999999999999999"#, "line 3, `seed = 99999999999999999999999`: a whole number beyond 9223372036854775807 cannot be read"),
    ("[model]; wingspan_m = 2", "unknown key `model.wingspan_m`"),
    ("[model]; gravity_m_s2 = 0", "model.gravity_m_s2 = 0: the laws hold a weight, and have none then; write a gravity above 0,"),
    ("[rt]; lead_us = 10.5", r#"rt.lead_us = 10.5: expected a whole number or a string, as in "auto""#),
    (r#"[flight]; pace = "lockstep"; [rt]; lead_us = 501"#, r#"rt.lead_us = 501: allowed are "auto" and whole microseconds from 0 (at the tick) to 500"#),
    (r#"[recorder]; gate_theorem = true; [inner]; adaptation = "off""#, "recorder.gate_theorem = true: the inner law `adaptive` has no theorem with its settings"),
    ("[recorder]; max_steal_percent = nan", "recorder.max_steal_percent = NaN: allowed are 0 to 100, and a negative number"),
    (r#"[recorder]; log = "some""#, "unknown variant `some`, expected one of `all`, `around-misses`, `off` in `recorder.log`"),
    ("[recorder]; log = 1", r#"recorder.log = 1: expected a string, as in "all""#),
    ("[recorder]; log_files = -2", "recorder.log_files = -2 is out of range: allowed are whole numbers from 0"),
];

/// Arguments of `--set`, and a part of the error.
#[rustfmt::skip]
const REFUSED_BESIDE: &[(&str, &str)] = &[
    ("inner.alpha=1", r#"--set: unknown key `inner.alpha` of the law "adaptive"; did you mean"#),
    ("iner.alpha_1_s=1", "--set: unknown section [iner]; did you mean `inner`?"),
    ("airframe.mass_kg=1", "--set: airframe.mass_kg cannot be set"),
    ("inner.alpha_1_s=fast", r#"--set: inner.alpha_1_s = "fast": expected a number"#),
    ("inner.alpha_1_s=-1", "is out of range: allowed is a finite number above 0 (--set)"),
    ("inner.preset=hard", "[possible values: flight, paper, soft, quick] (--set)"),
    ("flight.duration_s=0", "is out of range: allowed are 0.001 to 2592000 (--set)"),
];

#[test]
fn slow_motion_has_ticks_of_at_most_a_second_and_no_firmware() {
    let checked = |text: &str| from_file(text).unwrap().check_slow_motion();
    for (text, said) in [
        (
            "[flight]\nslowdown = 600\nperiod_s = 0.002\n",
            "a tick would take 1.2 s",
        ),
        (
            "[flight]\nslowdown = 2\n[inner]\nlaw = \"betaflight\"\n",
            "`betaflight` is one",
        ),
        (
            "[flight]\nslowdown = 2\n[channel.b.inner]\nlaw = \"betaflight\"\n[rt]\nchannels = 2\n",
            "`betaflight` is one",
        ),
    ] {
        assert!(
            checked(text).unwrap_err().to_string().contains(said),
            "{text}"
        );
    }
    for text in [
        "[flight]\nslowdown = 1000\n",
        "[flight]\nslowdown = 600\nperiod_s = 0.002\npace = \"lockstep\"\n",
    ] {
        checked(text).unwrap();
    }
}

#[test]
fn every_mistake_names_key_value_and_what_is_allowed() {
    let of_files = REFUSED.iter().map(|(text, said)| {
        let settings = from_file(&(text.replace("; ", "\n") + "\n"));
        (text, settings, said)
    });
    let of_flags = REFUSED_BESIDE.iter().map(|(set, said)| {
        let settings = with_flags("", &[overrides::set("--set", set).unwrap()]);
        (set, settings, said)
    });
    for (text, settings, said) in of_files.chain(of_flags) {
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

#[test]
fn a_recorded_flight_has_the_default_of_each_setting_that_is_newer() {
    let recorded = Table::try_from(default()).unwrap();
    for setting in declarations::settings() {
        let (section, key) = setting.path.split_once('.').unwrap();
        let mut older = recorded.clone();
        let removed = older[section].as_table_mut().unwrap().remove(key);
        assert!(removed.is_some(), "{}", setting.path);
        assert_eq!(Settings::recorded(&older.to_string()), Ok(default()));
    }
}

#[test]
fn the_plant_has_the_steps_of_its_settings() {
    for substeps in [1, 2, 4] {
        let settings = from_file(&format!("plant.substeps = {substeps}")).unwrap();
        assert_eq!(settings.plant().unwrap().substeps, substeps);
        let again = from_file(&settings.commented().unwrap()).unwrap();
        assert_eq!(again.plant, settings.plant);
    }
}

/// `IRONBIRD_WRITE_DOCS=1 cargo test -p config` writes the page.
#[test]
fn the_page_of_settings_is_what_their_declarations_say() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/settings.md");
    if std::env::var_os("IRONBIRD_WRITE_DOCS").is_some() {
        std::fs::write(path, declarations::page()).unwrap();
    }
    assert!(
        std::fs::read_to_string(path).unwrap() == declarations::page(),
        "IRONBIRD_WRITE_DOCS=1 cargo test -p config writes docs/settings.md"
    );
}

#[test]
fn every_word_of_a_setting_is_accepted_and_one_is_its_default() {
    let table: Table = declarations::DEFAULT.parse().unwrap();
    for setting in declarations::settings() {
        let (section, key) = setting.path.split_once('.').unwrap();
        let value = table[section][key].as_str();
        if let declarations::Allowed::OneOf(words) = setting.allowed {
            for (word, _) in words {
                let one = format!("[{section}]\n{key} = \"{word}\"\n");
                from_file(&one).unwrap_or_else(|e| panic!("{one}: {e}"));
            }
            assert!(words.iter().any(|(word, _)| value == Some(word)));
        }
    }
}
