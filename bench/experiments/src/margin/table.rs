//! The table of margins that flight reports use, stored by a fingerprint of everything that margins depend on.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use analysis::json;
use analysis::margin::{Margins, SCHEMA, SURVIVES};
use analysis::phrase::count;
use analysis::schema::{MarginSection, Report};
use flight_log::build::Build;
use messages::grid::Pace;

use config::Settings;
use config::trajectory::sha256_of;
use errors::{Failure, InFile as _, read_text, write_whole};
use flight_log::build;

/// Directory of the tables, next to the flights.
pub const DIRECTORY: &str = "margins";

/// Shared settings without effect on margins, which choose their own faults and fly in simulated time.
const LEFT_OUT: [&str; 5] = [
    "flight.duration_s",
    "flight.pace",
    "flight.slowdown",
    "flight.seed",
    "flight.faults",
];

/// Laws, gains, airframe, trajectory, sample time, envelope and version.
pub fn fingerprint(settings: &Settings) -> Result<String, Failure> {
    let matters = |line: &&str| !line.split(" = ").take(1).any(|key| LEFT_OUT.contains(&key));
    let shared = settings.shared_text()?;
    let lines: Vec<&str> = shared.lines().filter(matters).collect();
    let version = env!("CARGO_PKG_VERSION");
    let text = format!("{SCHEMA} {version}\n{}\n", lines.join("\n"));
    Ok(sha256_of(&text)[..16].to_owned())
}

fn path(out: &Path, fingerprint: &str) -> PathBuf {
    out.join(DIRECTORY).join(format!("{fingerprint}.json"))
}

/// Refuses a directory without write permission before any flight.
pub fn check(out: &Path) -> Result<(), Failure> {
    let directory = out.join(DIRECTORY);
    let created = fs::create_dir_all(&directory);
    let created = created.and_then(|()| tempfile::tempfile_in(&directory).map(drop));
    created.map_err(|e| {
        let directory = directory.display();
        let what = format!("cannot write tables of margins into {directory}: {e}");
        let help = "name a directory that you can write, that of the flights: --out DIR";
        Failure::usage(what).help(help)
    })
}

/// Writes one table per qualified combination of laws, unless the same build has already written a larger one; returns a
/// line for each.
pub fn write(out: &Path, margins: &Margins) -> Result<Vec<String>, Failure> {
    let mut lines = Vec::new();
    // A table of the same build with more phases or longer outages is kept.
    let is_larger = |known: &Margins| {
        let has_more_phases = known.phases_s.len() > margins.phases_s.len();
        let has_longer = known.longest_ticks > margins.longest_ticks;
        known.build == margins.build && (has_more_phases || has_longer)
    };
    for law in margins.laws.iter().filter(|law| law.qualified[SURVIVES]) {
        let path = path(out, &law.fingerprint);
        let place = path.display();
        let known = read(out, &law.fingerprint);
        if let Some(known) = known.filter(is_larger) {
            let phases = count(known.phases_s.len() as u64, "phase");
            let longest = count(known.longest_ticks, "tick");
            lines.push(format!(
                "kept, for reports of flights: {place}, which is of {phases} and outages up to {longest}\n"
            ));
            continue;
        }
        let table = Margins {
            laws: vec![law.clone()],
            ..margins.clone()
        };
        let text = json::to_string(&table).in_file("write", &path)?;
        let written = write_whole(&path, |file| writeln!(file, "{text}"));
        written.in_file("write", &path)?;
        lines.push(format!("written, for reports of flights: {place}\n"));
    }
    Ok(lines)
}

/// The margins for a flight that is about to begin; none in lockstep, which has no outages, and of what cannot be
/// simulated: channels with different laws, and targets from a ground station.
pub fn of_flight(
    pace: Pace,
    settings: &Settings,
    directory: &Path,
) -> Result<Option<MarginSection>, Failure> {
    let cannot_be_measured = settings.has_several_laws() || settings.course()?.follows_targets();
    if pace == Pace::Lockstep || cannot_be_measured {
        return Ok(None);
    }
    let section = section(&fingerprint(settings)?, directory, &build::executable());
    Ok(Some(section))
}

/// The margins for a recorded flight, from the table next to it.
fn section(fingerprint: &str, directory: &Path, build: &Build) -> MarginSection {
    let table = directory.parent().and_then(|out| read(out, fingerprint));
    let known = table.and_then(|table| MarginSection::known(fingerprint, &table, build));
    known.unwrap_or_else(|| {
        let settings = directory.join("settings.toml");
        let command = format!("ironbird margin --config {}", settings.display());
        MarginSection::unknown(fingerprint.into(), command)
    })
}

/// A table; none if it is missing or unreadable.
fn read(out: &Path, fingerprint: &str) -> Option<Margins> {
    let text = read_text("read", &path(out, fingerprint)).ok()?;
    let table: Margins = serde_json::from_str(&text).ok()?;
    (table.schema == SCHEMA).then_some(table)
}

/// Looks for margins that were measured after a flight.
pub fn look_again(report: &mut Report, directory: &Path) {
    let Some(margin) = &mut report.margin else {
        return;
    };
    let (fingerprint, autopsy) = (&margin.fingerprint, &report.autopsy);
    let is_name = !fingerprint.is_empty() && fingerprint.bytes().all(|it| it.is_ascii_hexdigit());
    if margin.unknown.is_some() && is_name {
        *margin = section(fingerprint, directory, &report.run.build).with(autopsy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::Value;

    #[test]
    fn a_fingerprint_depends_on_what_matters_and_on_nothing_else() {
        let of = |set: &[(&'static str, Value)]| {
            fingerprint(&Settings::resolve(None, &set.to_vec()).unwrap()).unwrap()
        };
        let plain = of(&[]);
        assert_eq!(plain.len(), 16);
        for (key, value, matters) in [
            ("flight.duration_s", Value::from(60.0), false),
            ("flight.seed", Value::from(7), false),
            ("flight.pace", Value::from("lockstep"), false),
            ("flight.slowdown", Value::from(4), false),
            ("flight.faults", Value::from(vec!["mass_kg=0.6@8s"]), false),
            ("recorder.out", Value::from("elsewhere"), false),
            ("rt.priority", Value::from(50), false),
            ("flight.period_s", Value::from(0.002), true),
            ("flight.trajectory", Value::from("hover"), true),
            ("flight.position_error_max_m", Value::from(5.0), true),
            ("flight.tracking_error_max_m", Value::from(0.2), true),
            ("inner.law", Value::from("indi"), true),
            ("inner.alpha_1_s", Value::from(150.0), true),
            ("plant.mass_kg", Value::from(0.53), true),
            ("trajectory.period", Value::from(2.0), true),
        ] {
            assert_eq!(of(&[(key, value)]) != plain, matters, "{key}");
        }
    }
}
