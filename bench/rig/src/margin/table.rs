//! The table of margins that flight reports use, stored by a fingerprint of everything that margins depend on.

use std::fs;
use std::path::{Path, PathBuf};

use flight_log::build::Build;
use messages::grid::Pace;
use report::json;
use report::margin::{LawMargins, Margins, SCHEMA};
use report::phrase::count;
use report::schema::MarginSection;
use report::schema::Report;

use crate::build;
use crate::settings::Settings;
use crate::settings::trajectory::sha256_of;
use errors::{Failure, InFile as _, read_text};

/// Directory of the tables, next to the flights.
pub const DIRECTORY: &str = "margins";

/// Shared settings without effect on margins, which choose their own faults and fly in simulated time.
const LEFT_OUT: [&str; 7] = [
    "flight.duration_s",
    "flight.pace",
    "flight.slowdown",
    "flight.seed",
    "flight.resume_estimates",
    "flight.faults",
    "flight.tracking_error_max_m",
];

/// Laws, gains, airframe, trajectory, sample time, envelope and version.
pub fn fingerprint(settings: &Settings) -> Result<String, Failure> {
    let matters = |line: &&str| {
        !LEFT_OUT
            .iter()
            .any(|key| line.split(" = ").next() == Some(key))
    };
    let shared = settings.shared_text()?;
    let lines: Vec<&str> = shared.lines().filter(matters).collect();
    let text = format!(
        "{SCHEMA} {}\n{}\n",
        env!("CARGO_PKG_VERSION"),
        lines.join("\n")
    );
    Ok(sha256_of(&text)[..16].to_owned())
}

fn path(out: &Path, fingerprint: &str) -> PathBuf {
    out.join(DIRECTORY).join(format!("{fingerprint}.json"))
}

/// Refuses a directory without write permission before any flight.
pub fn check(out: &Path) -> Result<(), Failure> {
    let directory = out.join(DIRECTORY);
    let made =
        fs::create_dir_all(&directory).and_then(|()| tempfile::tempfile_in(&directory).map(drop));
    made.map_err(|e| {
        Failure::usage(format!(
            "cannot write tables of margins into {}: {e}",
            directory.display()
        ))
        .help("name a directory that you can write, that of the flights: --out DIR")
    })
}

/// Writes one table per combination of laws, unless the same build has already written a larger one; reports each.
pub fn write(out: &Path, margins: &Margins) -> Result<Vec<String>, Failure> {
    let write = |law: &LawMargins| {
        let path = path(out, &law.fingerprint);
        if let Some(known) = read(out, &law.fingerprint).filter(|known| is_more(known, margins)) {
            return Ok(format!(
                "kept, for reports of flights: {}, which is of {} and outages up to {}",
                path.display(),
                count(known.phases_s.len() as u64, "phase"),
                count(known.longest_ticks, "tick")
            ));
        }
        let table = Margins {
            laws: vec![law.clone()],
            ..margins.clone()
        };
        let text = json::to_string(&table).in_file("write", &path)?;
        let draft = path.with_extension(format!("draft.{}", std::process::id()));
        fs::write(&draft, text + "\n").in_file("write", &draft)?;
        fs::rename(&draft, &path).in_file("write", &path)?;
        Ok(format!(
            "written, for reports of flights: {}",
            path.display()
        ))
    };
    margins.laws.iter().map(write).collect()
}

/// Whether a table of the same build has more phases or longer outages.
fn is_more(known: &Margins, than: &Margins) -> bool {
    let is_more =
        known.phases_s.len() > than.phases_s.len() || known.longest_ticks > than.longest_ticks;
    known.build == than.build && is_more
}

/// The margins for a flight that is about to begin; none in lockstep, which has no outages.
pub fn of_flight(
    pace: Pace,
    settings: &Settings,
    directory: &Path,
) -> Result<Option<MarginSection>, Failure> {
    match pace {
        Pace::Realtime(_) => Ok(Some(section(
            &fingerprint(settings)?,
            directory,
            &build::here(),
        ))),
        Pace::Lockstep => Ok(None),
    }
}

/// The margins for a recorded flight, from the table next to it.
#[must_use]
fn section(fingerprint: &str, directory: &Path, build: &Build) -> MarginSection {
    let table = directory.parent().and_then(|out| read(out, fingerprint));
    table
        .and_then(|table| MarginSection::known(fingerprint, &table, build))
        .unwrap_or_else(|| {
            let settings = directory.join("settings.toml");
            MarginSection::unknown(
                fingerprint.into(),
                format!("ironbird margin --config {}", settings.display()),
            )
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
    let Report {
        margin: Some(margin),
        autopsy,
        run,
        ..
    } = report
    else {
        return;
    };
    let is_name = !margin.fingerprint.is_empty()
        && margin
            .fingerprint
            .bytes()
            .all(|byte| byte.is_ascii_hexdigit());
    // Reports from before outages were counted by stage have nothing to hold against a table.
    if margin.unknown.is_some() && is_name && autopsy.longest.is_some() {
        *margin = section(&margin.fingerprint, directory, &run.build).with(autopsy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::role::STAGES;
    use report::comparison::Laws;
    use report::margin::{Gate, OutageMargin};
    use report::schema::MACHINE;
    use toml::Value;

    fn margins(phases: usize, longest_ticks: u64, commit: &str) -> Margins {
        let outage = |of: &str| OutageMargin {
            of: of.into(),
            ticks: vec![30; phases],
            exceptions: Vec::new(),
        };
        let laws = Laws {
            outer: "pd".into(),
            inner: "pid".into(),
            mixer: "priority".into(),
        };
        let law = LawMargins {
            laws,
            fingerprint: "ab".into(),
            unfaulted_error_m: 0.0,
            unfaulted_saturated_percent: 0.0,
            recovered_below_m: 0.01,
            tracked_below_m: 0.1,
            saturated_max_percent: 10.0,
            outages: STAGES
                .into_iter()
                .map(|role| role.name())
                .chain([MACHINE])
                .map(outage)
                .collect(),
            lags: Vec::new(),
            delays: Vec::new(),
            losses: Vec::new(),
            patterns: Vec::new(),
            flights: 0,
        };
        Margins {
            schema: SCHEMA.into(),
            build: Build {
                commit: commit.into(),
                ..build::here()
            },
            trajectory: "hover".into(),
            airframe: "paper".into(),
            preset: "flight".into(),
            seed: 1,
            period_s: 1e-3,
            phases_s: vec![10.0; phases],
            span_s: 10.0,
            cycle_s: None,
            sparse: 8,
            longest_ticks,
            steady_s: 10.0,
            gate: Gate {
                recovered_below_m: None,
                tracked_below_m: 0.1,
                recovery_max_s: 5.0,
                limits: Vec::new(),
            },
            laws: vec![law],
        }
    }

    #[test]
    fn a_table_of_more_phases_is_kept_unless_another_build_made_it() {
        let out = tempfile::tempdir().unwrap();
        check(out.path()).unwrap();
        let write = |phases, longest, commit| {
            write(out.path(), &margins(phases, longest, commit))
                .unwrap()
                .join(" ")
        };
        let phases = || read(out.path(), "ab").map_or(0, |table| table.phases_s.len());
        assert!(write(1, 2000, "old").starts_with("written, for reports of flights: "));
        assert!(write(32, 2000, "old").ends_with("ab.json") && phases() == 32);
        let kept = write(1, 2000, "old");
        assert!(
            kept.ends_with("ab.json, which is of 32 phases and outages up to 2000 ticks"),
            "{kept}"
        );
        assert!(
            write(64, 60, "old").starts_with("kept") && phases() == 32,
            "shorter outages"
        );
        assert!(
            write(1, 60, "new").starts_with("written") && phases() == 1,
            "another build"
        );
    }

    #[test]
    fn a_flight_of_another_build_is_told_who_measured() {
        let out = tempfile::tempdir().unwrap();
        check(out.path()).unwrap();
        write(out.path(), &margins(32, 2000, "old")).unwrap();
        let run = out.path().join("run");
        let of = |commit: &str| {
            section(
                "ab",
                &run,
                &Build {
                    commit: commit.into(),
                    ..build::here()
                },
            )
        };
        assert!(of("old").unknown.is_none() && of("old").measured_by.is_none());
        assert!(
            of("new")
                .measured_by
                .is_some_and(|build| build.starts_with("old"))
        );
        assert!(section("cd", &run, &build::here()).unknown.is_some());
    }

    #[test]
    fn a_fingerprint_is_of_what_matters_and_of_nothing_else() {
        let of = |set: &[(&'static str, Value)]| {
            fingerprint(&Settings::resolve(None, &set.to_vec()).unwrap()).unwrap()
        };
        let plain = of(&[]);
        assert!(
            plain.len() == 16 && plain.bytes().all(|byte| byte.is_ascii_hexdigit()),
            "{plain}"
        );
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
