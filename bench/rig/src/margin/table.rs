//! The table that `margin` leaves for the reports of flights, by the fingerprint of what margins depend on.

use std::fs;
use std::path::{Path, PathBuf};

use model::grid::Pace;
use report::json;
use report::margin::line::Section;
use report::margin::{LawMargins, Margins, SCHEMA};
use report::schema::Report;

use crate::settings::Settings;
use crate::settings::trajectory::sha256_of;
use failure::{Failure, InFile as _, read_text};

/// Directory of tables, beside those of the flights.
pub const DIRECTORY: &str = "margins";

/// Shared settings that no margin depends on: it begins faults where it likes, and in simulated time.
const LEFT_OUT: [&str; 7] = [
    "flight.duration_s",
    "flight.pace",
    "flight.slowdown",
    "flight.seed",
    "flight.resume_estimates",
    "flight.faults",
    "flight.tracking_error_max_m",
];

/// Names what margins depend on: laws, gains, airframe, trajectory, sample time, envelope, and the version.
///
/// # Errors
/// As [`Settings::shared_text`].
pub fn fingerprint(settings: &Settings) -> Result<String, Failure> {
    let matters = |line: &&str| !LEFT_OUT.iter().any(|key| line.split(" = ").next() == Some(key));
    let shared = settings.shared_text()?;
    let lines: Vec<&str> = shared.lines().filter(matters).collect();
    let text = format!("{SCHEMA} {}\n{}\n", env!("CARGO_PKG_VERSION"), lines.join("\n"));
    Ok(sha256_of(&text)[..16].to_owned())
}

fn path(out: &Path, fingerprint: &str) -> PathBuf {
    out.join(DIRECTORY).join(format!("{fingerprint}.json"))
}

/// Refuses a directory that tables cannot be written into, before hours are flown.
///
/// # Errors
/// Usage names it.
pub fn check(out: &Path) -> Result<(), Failure> {
    let directory = out.join(DIRECTORY);
    let made = fs::create_dir_all(&directory).and_then(|()| tempfile::tempfile_in(&directory).map(drop));
    made.map_err(|e| {
        Failure::usage(format!("cannot write tables of margins into {}: {e}", directory.display()))
            .help("name a directory that you can write, that of the flights: --out DIR")
    })
}

/// Leaves a table for each combination of laws; gives their paths.
///
/// # Errors
/// [`Failure`] names the file that cannot be written.
pub fn write(out: &Path, margins: &Margins) -> Result<Vec<PathBuf>, Failure> {
    let write = |law: &LawMargins| {
        let path = path(out, &law.fingerprint);
        let table = Margins { laws: vec![law.clone()], ..margins.clone() };
        let text = json::to_string(&table).in_file("write", &path)?;
        let draft = path.with_extension(format!("draft.{}", std::process::id()));
        fs::write(&draft, text + "\n").in_file("write", &draft)?;
        fs::rename(&draft, &path).in_file("write", &path)?;
        Ok(path)
    };
    margins.laws.iter().map(write).collect()
}

/// What the loop of a flight bears that is about to begin; none in lockstep, where there are no outages.
///
/// # Errors
/// As [`fingerprint`].
pub fn of_flight(pace: Pace, settings: &Settings, directory: &Path) -> Result<Option<Section>, Failure> {
    match pace {
        Pace::Realtime(_) => Ok(Some(section(&fingerprint(settings)?, directory))),
        Pace::Lockstep => Ok(None),
    }
}

/// What a flight in a directory bears, as far as a table beside it says.
#[must_use]
pub fn section(fingerprint: &str, directory: &Path) -> Section {
    let table = directory.parent().and_then(|out| known(out, fingerprint));
    table.unwrap_or_else(|| {
        let settings = directory.join("settings.toml");
        Section::unknown(fingerprint.into(), format!("ironbird margin --config {}", settings.display()))
    })
}

/// What a table says; nothing where there is none, or none that can be read.
fn known(out: &Path, fingerprint: &str) -> Option<Section> {
    let text = read_text("read", &path(out, fingerprint)).ok()?;
    let table: Margins = serde_json::from_str(&text).ok()?;
    (table.schema == SCHEMA).then(|| Section::known(fingerprint, &table)).flatten()
}

/// Looks once more for margins that were not known when a flight ended.
pub fn look_again(report: &mut Report, directory: &Path) {
    let Report { margin: Some(margin), autopsy, .. } = report else { return };
    let is_name = !margin.fingerprint.is_empty() && margin.fingerprint.bytes().all(|byte| byte.is_ascii_hexdigit());
    if margin.unknown.is_some() && is_name {
        *margin = section(&margin.fingerprint, directory).with(autopsy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::Value;

    #[test]
    fn a_fingerprint_is_of_what_matters_and_of_nothing_else() {
        let of = |set: &[(&'static str, Value)]| fingerprint(&Settings::resolve(None, &set.to_vec()).unwrap()).unwrap();
        let plain = of(&[]);
        assert!(plain.len() == 16 && plain.bytes().all(|byte| byte.is_ascii_hexdigit()), "{plain}");
        for same in [
            ("flight.duration_s", Value::from(60.0)),
            ("flight.seed", Value::from(7)),
            ("flight.pace", Value::from("lockstep")),
            ("flight.slowdown", Value::from(4)),
            ("flight.faults", Value::from(vec!["mass_kg=0.6@8s"])),
            ("recorder.out", Value::from("elsewhere")),
            ("rt.priority", Value::from(50)),
        ] {
            assert_eq!(of(std::slice::from_ref(&same)), plain, "{}", same.0);
        }
        for other in [
            ("flight.period_s", Value::from(0.002)),
            ("flight.trajectory", Value::from("hover")),
            ("flight.position_error_max_m", Value::from(5.0)),
            ("inner.law", Value::from("indi")),
            ("inner.alpha_1_s", Value::from(150.0)),
            ("plant.mass_kg", Value::from(0.53)),
            ("trajectory.period", Value::from(2.0)),
        ] {
            assert_ne!(of(std::slice::from_ref(&other)), plain, "{}", other.0);
        }
    }
}
