//! Complete settings are as in `snapshots/`: `INSTA_UPDATE=always cargo test -p config` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::collections::BTreeSet;
use std::fs;

use config::Settings;
use hashed::hashed;

#[test]
fn complete_settings_are_their_snapshots() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("settings.toml");
    let commented = |text: &str| {
        fs::write(&file, text).unwrap();
        let settings = Settings::resolve(Some(&file), &Vec::new()).unwrap();
        settings.commented().unwrap()
    };
    let default = commented("");
    for (name, text) in [
        ("default", ""),
        (
            "airframe",
            "flight.airframe = \"crazyflie\"\nplant.mass_kg = 0.03\n",
        ),
        (
            "laws",
            "flight.preset = \"soft\"\nouter.law = \"estimating\"\ninner.law = \"indi\"\n",
        ),
        (
            "faults",
            "flight.faults = [\"mass_kg=0.6~1s@2s\", \"state.drop=0.1@1s..2s\"]\ninner.law = \"adaptive\"\n",
        ),
    ] {
        let text = commented(text);
        // The sections, and what is not so by default.
        let usual: BTreeSet<&str> = default.lines().collect();
        let differs = |line: &&str| line.starts_with('[') || !usual.contains(line);
        let shown: Vec<&str> = text.lines().filter(differs).collect();
        insta::assert_snapshot!(name, hashed(name, &text, &shown.join("\n")));
    }
}
