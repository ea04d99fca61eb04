//! A law in Rust that is built outside of the workspace: one line exports it, and no panic leaves it.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

use control_api::SavedState;
use control_api::description::{Setting, Settings, Value};
use control_api::law::{Fields, InnerInput, Rig};
use messages::role::Role;
use messages::telemetry::Telemetry;
use plugin::{Library, open};

/// Tells this test, run by itself, to fly the library to its end.
const BREAKS: &str = "IRONBIRD_TEST_BREAKS";

/// Builds the crate that authors copy, and the law with it.
fn build(directory: &Path) -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let rustc = |kind: &str, name: &str, source: &str, needs: &[&str]| {
        let arguments =
            format!("--edition 2024 --crate-type {kind} --crate-name {name} -D warnings");
        let mut rustc = Command::new(env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()));
        rustc
            .args(arguments.split(' '))
            .arg("--out-dir")
            .arg(directory);
        rustc
            .arg("-L")
            .arg(directory)
            .args(needs)
            .arg(here.join(source));
        assert!(rustc.status().unwrap().success(), "{rustc:?}");
    };
    let needs = ["--extern", "ironbird_law"];
    rustc("rlib", "ironbird_law", "../ironbird_law/src/lib.rs", &[]);
    rustc("cdylib", "spring", "tests/in_rust/law.rs", &needs);
    directory.join("libspring.so")
}

fn tick(made: &mut dyn control_api::law::InnerLaw) -> ([f64; 3], f64) {
    let mut input = InnerInput {
        tick: 7,
        ..InnerInput::default()
    };
    input.measured.attitude_rad = [0.1, -0.2, 0.3];
    let mut telemetry = Telemetry::default();
    let demand = made.tick(&input, &mut telemetry);
    (demand.torque_b_nm, telemetry.value[0])
}

fn ends(library: &Library, how: &'static str) -> Settings {
    let ends: &Setting = &library.description.settings[2];
    Settings::default().with(ends, Value::Word(how))
}

#[test]
fn a_law_in_rust_is_one_line_away_from_the_rig() {
    let rig = Rig::default();
    if let Some(library) = env::var_os(BREAKS) {
        let library = open(Role::Inner, Path::new(&library)).unwrap();
        let mut made = library.inner(&rig, &ends(library, "tick")).unwrap();
        tick(&mut *made.law);
        unreachable!("its tick panics, and that ends the process");
    }
    let directory = tempfile::tempdir().unwrap();
    let file = build(directory.path());
    let library = open(Role::Inner, &file).unwrap();
    let description = library.description;
    assert_eq!(
        (description.name, description.version, description.source),
        ("spring", "3", "Hooke, 1678")
    );
    assert!(library.not_real_time && library.is_rehearsed);
    let given = description.settings.iter().map(Setting::default);
    assert!(given.eq([
        Value::Number(0.5),
        Value::Three([1.0, 2.0, 3.0]),
        Value::Word("never")
    ]));
    let stiff = description.preset("stiff").unwrap();
    assert_eq!(stiff.number(&description.settings[0]), 8.0);
    assert_eq!(stiff.word(&description.settings[2]), "tick");

    let mut made = library.inner(&rig, &Settings::default()).unwrap();
    let torque = [0.1, -0.2 * 2.0, 0.3 * 3.0].map(|it: f64| -0.5 * it);
    let (first, ticks) = tick(&mut *made.law);
    assert!(first.iter().zip(torque).all(|(a, b)| (a - b).abs() < 1e-15));
    assert_eq!(ticks, 1.0);
    for _ in 0..3 {
        assert!(made.law.copy_into(&mut *made.twin));
        // A warm-up run begins where the law is.
        assert_eq!(tick(&mut *made.twin).1, 2.0);
    }
    assert_eq!(tick(&mut *made.law).1, 2.0, "and changes nothing");
    let mut state = SavedState::new();
    assert!(made.law.transfer(&mut Fields::Write(&mut state)));
    let mut other = library.inner(&rig, &Settings::default()).unwrap().law;
    assert!(!other.transfer(&mut Fields::Read(&state[1..])));
    assert!(other.transfer(&mut Fields::Read(&state)));
    assert_eq!(tick(&mut *other).1, 3.0);

    for (how, expected) in [
        (
            "refused",
            "ends = refused with a period of 0.001 s; choose another",
        ),
        ("new", "it panicked: no spring at 0.001 s"),
    ] {
        let refused = library.inner(&rig, &ends(library, how)).map(drop);
        let text = refused.unwrap_err().0;
        assert!(
            text.ends_with(&format!("refuses its settings: {expected}")),
            "{text}"
        );
    }

    let broken = Command::new(env::current_exe().unwrap())
        .arg("--nocapture")
        .env(BREAKS, &file)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&broken.stderr);
    assert_eq!(broken.status.code(), None, "{said}");
    assert!(said.contains("the spring broke in tick 7"), "{said}");
    let named = format!(
        "error: inner law `spring` ({}) failed in tick 7: SIGABRT: it aborted\n",
        library.file.display()
    );
    assert!(said.contains(&named), "{said}");
}
