//! Libraries as authors send them: read in full, refused by name, and called with what the interface says.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use control_api::description::{Settings, Value};
use control_api::law::{Fields, OuterInput, Rig};
use control_api::{SAVED_STATE_BYTES, SavedState};
use errors::Failure;
use messages::content::{Measured, Reference};
use messages::parameters::Parameter;
use messages::role::Role;
use messages::telemetry::Telemetry;
use plugin::{load, open};
use tempfile::TempDir;

const COMPILER: &str = "-std=c11 -O1 -Wall -Wextra -Werror -Wno-unused-variable -fPIC -shared";

fn library(directory: &TempDir, name: &str, defined: &[&str]) -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let library = directory.path().join(name);
    let mut compiler = Command::new("gcc");
    compiler.args(COMPILER.split(' ')).arg("-I");
    compiler.arg(here.join("../ironbird_law/include"));
    compiler.args(defined.iter().map(|it| format!("-D{it}")));
    compiler.arg("-o").arg(&library);
    compiler.arg(here.join("tests/described.c")).arg("-lm");
    assert!(compiler.status().unwrap().success(), "{defined:?}");
    library
}

/// Demands a usage error with these parts.
fn assert_refused<T>(result: Result<T, Failure>, parts: &[&str]) {
    let failure = result.map(drop).unwrap_err();
    let text = failure.text();
    assert_eq!(failure.code, errors::USAGE, "{text}");
    assert!(parts.iter().all(|part| text.contains(part)), "{text}");
}

#[test]
fn a_law_is_given_what_the_interface_says_and_its_answer_is_taken_as_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let library = open(Role::Outer, &library(&directory, "lib.so", &[])).unwrap();
    let mut rig = Rig {
        period_s: 0.002,
        ..Rig::default()
    };
    rig.airframe
        .set(Parameter::MotorTimeConstant, 0.03)
        .unwrap();
    rig.airframe.set(Parameter::RotorEfficiency4, 0.9).unwrap();
    let [gain, axes, mode] = *library.description.settings else {
        panic!("{:?}", library.description)
    };
    let settings = Settings::default()
        .with(&gain, Value::Number(7.0))
        .with(&axes, Value::Three([0.1, 0.2, 0.3]))
        .with(&mode, Value::Word("quick"));
    let mut made = library.outer(&rig, &settings).unwrap();
    let measured = Measured {
        position_w_m: [11.0, 12.0, 13.0],
        rotor_speed_command_rad_s: [0.0, 0.0, 0.0, 44.0],
        ..Measured::default()
    };
    let reference = Reference {
        position_w_m: [21.0, 0.0, 0.0],
        yaw_acceleration_rad_s2: 22.0,
        ..Reference::default()
    };
    let mut telemetry = Telemetry { value: [99.0; 32] };
    let input = |tick| OuterInput {
        tick,
        measured,
        reference,
        ..OuterInput::default()
    };
    let wanted = made.law.tick(&input(123), &mut telemetry);
    assert_eq!(
        (wanted.thrust_n, wanted.attitude_rad, wanted.limited),
        (44.0, [0.1, 0.2, 0.3], 1)
    );
    assert_eq!(wanted.attitude_rate_rad_s, rig.airframe.i_m());
    assert_eq!(wanted.attitude_acceleration_rad_s2, measured.position_w_m);
    let (max_rad_s, mass_kg) = (rig.rotor.max_rad_s, rig.airframe.m());
    let shown = [7.0, 0.03, max_rad_s, 0.002, 22.0, 123.0, 0.9, mass_kg];
    assert_eq!(telemetry.value[..8], shown);
    // What is not shown stays as it is.
    assert_eq!((telemetry.value[8], telemetry.value[31]), (99.0, 21.0));
    assert!(
        !library.is_rehearsed && !made.law.copy_into(&mut *made.twin),
        "it has no copy_into"
    );
    let mut state = SavedState::new();
    assert!(made.law.transfer(&mut Fields::Write(&mut state)));
    let mut other = library.outer(&rig, &settings).unwrap().law;
    assert!(!other.transfer(&mut Fields::Read(&state[1..])));
    assert!(other.transfer(&mut Fields::Read(&state)));
    other.tick(&input(4), &mut telemetry);
    assert_eq!(telemetry.value[30], 127.0, "the sum of its ticks");
    let mut full = SavedState::from([0; SAVED_STATE_BYTES]);
    assert!(!other.transfer(&mut Fields::Write(&mut full)));
}

/// Mistakes of a law's table: a definition for described.c, and the words of the error.
#[rustfmt::skip]
const REFUSED: &[(&str, &str)] = &[
    ("VERSION=1", "built for version 1 of the interface, and this ironbird has version 4"),
    ("SIZES={8}", "its structs have other sizes than those of this ironbird: they are IronbirdSizes { law: 8,"),
    ("ROLE=7", "its role is 7: expected IRONBIRD_OUTER, IRONBIRD_INNER or IRONBIRD_MIXER"),
    ("ROLE=IRONBIRD_MIXER", "its function `tick_mixer` is NULL"),
    ("TICK=NULL", "its function `tick_outer` is NULL"),
    ("CREATE=NULL", "its function `create` is NULL"),
    ("LOAD=NULL", "one of its functions `save` and `load` is NULL: give both, or neither"),
    ("TABLE=NULL", "its function `ironbird_law` returned NULL"),
    ("TABLE=(const IronbirdLaw *)((const char *)&law+1)", "returned an odd address"),
    ("FUNCTION=my_law", "it exports no function `ironbird_law`"),
    ("MISSING", "it cannot be loaded: "),
    ("NAME=NULL", "its name is missing"),
    (r#"NAME="My law""#, "its name is `My law`: expected lower-case letters, digits and _, with a letter first"),
    (r#"NAME="nnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnn""#, "its name is longer than 40 bytes"),
    (r#"NAME="\xff\xfe""#, "its name is not UTF-8"),
    (r#"SUMMARY="one\ntwo""#, r#"its summary has the character '\n': expected one line of text"#),
    (r#"SUMMARY="""#, "its summary is missing"),
    ("SETTINGS=65", "its settings_count is 65: allowed are up to 64"),
    (r#"UNIT="\x1b""#, r#"its setting 0, `gain_1_s`: its unit has the character '\u{1b}'"#),
    (r#"GAIN={.name="g",.meaning="m"}"#, "its setting 0, `g`: its kind is 0: expected IRONBIRD_NUMBER"),
    (r#"GAIN={.name="g",.kind=1}"#, "its setting 0, `g`: its meaning is missing"),
    (r#"GAIN={.name="g",.meaning="m",.kind=1,.min=3,.max=2}"#, "`g`: min is 3 and max is 2: expected"),
    (r#"GAIN={.name="g",.meaning="m",.kind=1,.max=1.0/0.0}"#, "max is inf: expected finite numbers in order"),
    (r#"GAIN={.name="g",.meaning="m",.kind=1,.default_number={7},.max=2}"#, "its default is Number(7.0)"),
    (r#"GAIN={.name="g",.meaning="m",.kind=1,.default_number={0.0/0.0},.max=2}"#, "default is Number(NaN)"),
    (r#"GAIN={.name="axes",.meaning="m",.kind=1}"#, "it has the setting `axes` twice"),
    (r#"GAIN={.name="law",.meaning="m",.kind=1}"#, "it has the setting `law`, which is the rig's own"),
    (r#"WORDS="a","a""#, "its setting 2, `mode`: it has the word `a` twice"),
    (r#"WORDS="a b""#, "its setting 2, `mode`: its word is `a b`: expected letters, digits"),
    ("WORDS=NULL", "its setting 2, `mode`: its word is missing"),
    ("SOFT={{.number={10}},{.number={1,1,1}},{.word=1}}", "its preset 0, `soft`: its gain_1_s is Number(10.0)"),
    ("SOFT={{.number={0.0/0.0}},{.number={1,1,1}},{.word=1}}", "its preset 0, `soft`: its gain_1_s is Number(NaN)"),
    ("SOFT={{.number={1}},{.number={1,1,1}},{.word=2}}", r#"its preset 0, `soft`: its mode is Word("")"#),
    (r#"SIGNAL={"speed_m_s",NULL}"#, "it has the signal `speed_m_s` twice"),
    (r#"SIGNAL={"tick",NULL}"#, "it has the signal `tick`, which is the rig's own"),
    (r#"SIGNAL={"Speed",NULL}"#, "its signal 0, its name is `Speed`: expected"),
];

#[test]
fn what_is_wrong_with_a_table_is_named() {
    let directory = tempfile::tempdir().unwrap();
    for (i, (defined, words)) in REFUSED.iter().enumerate() {
        let file = library(&directory, &format!("{i}.so"), &[defined]);
        let failure = load(&file).unwrap_err();
        assert_eq!(failure.text().lines().count(), 2, "{defined}: {failure}");
        let start = format!("error: the law {}: ", file.display());
        assert_refused(Err::<(), _>(failure), &[&start, words]);
    }
}

#[test]
fn a_file_that_changes_is_not_flown_under_the_sum_of_what_it_was() {
    let directory = tempfile::tempdir().unwrap();
    let grows = library(&directory, "grows.so", &["GROWS"]);
    let changed = "grows.so: the file has changed while it was loaded";
    assert_refused(load(&grows), &[changed]);
    let file = library(&directory, "lib.so", &[]);
    load(&file).unwrap();
    library(&directory, "new.so", &["SUMMARY=\"says another thing\""]);
    fs::rename(directory.path().join("new.so"), &file).unwrap();
    let changed = "lib.so: the file has changed since it was loaded";
    assert_refused(load(&file), &[changed, "help: start again"]);
}

#[test]
fn a_file_that_every_user_may_write_is_not_run() {
    let directory = tempfile::tempdir().unwrap();
    let file = library(&directory, "lib.so", &[]);
    let set_mode = |mode| fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
    let path = file.display();
    for mode in [0o777, 0o602] {
        set_mode(mode);
        let what =
            format!("{path}: every user may write it, and it is code: its mode is {mode:04o}");
        assert_refused(load(&file), &[&what, &format!("help: chmod o-w {path}")]);
    }
    set_mode(0o775);
    // Many users have a group of their own, and files that it may write. Here is its flag, too.
    let what = "`described` is a law of the role outer, and not of inner";
    let help = format!("help: fly it with --outer {path}");
    assert_refused(open(Role::Inner, &file), &[what, &help]);
}
