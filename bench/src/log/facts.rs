//! What a log says of its flight beside the messages: metadata records of names and texts.

use std::collections::BTreeMap;

use shared::boards;
use shared::clock::Pace;
use shared::envelope::LAYOUT;

use crate::failure::Failure;
use crate::record::host::Host;
use crate::record::report::RoleSection;
use crate::settings::Settings;

/// Version of the log: changed whenever a reader of the old one would misunderstand the new one.
pub const FORMAT: &str = "ironbird-log/1";
/// Name of the record that says which run it is, and how its clocks go.
pub const RUN: &str = "run";
/// Name of the record with the settings.
pub const SETTINGS: &str = "settings";
/// Name of the record with the machine.
pub const HOST: &str = "host";
/// Name of the record with what each process asked of the system, and was granted.
pub const REALTIME: &str = "realtime";
/// Name of the record that ends a log: how the flight ended.
pub const LANDING: &str = "landing";

/// Names and texts of a record.
pub type Record = BTreeMap<String, String>;

/// What a log says at its begin.
#[derive(Clone, Debug)]
pub struct Facts {
    /// What moves the ticks of the run on.
    pub pace: Pace,
    /// Sample time of the laws [ns].
    pub sample_time_ns: u64,
    records: Vec<(&'static str, Record)>,
}

impl Facts {
    /// The facts of a run.
    ///
    /// # Errors
    /// [`Failure`] where settings cannot be written, which checked ones rule out.
    pub fn new(
        run: &boards::Run,
        settings: &Settings,
        instance: &str,
        host: &Host,
        roles: &BTreeMap<String, RoleSection>,
    ) -> Result<Self, Failure> {
        let (pace, sample_time_ns) = (run.pace(), run.sample_time_ns);
        let wall_offset_ns = i128::from(run.t0_wall_ns) - i128::from(run.t0_ns);
        let run = record(&[
            ("format", FORMAT),
            ("version", env!("CARGO_PKG_VERSION")),
            ("layout", &format!("{LAYOUT:016x}")),
            ("instance", instance),
            ("run_id", &run.run_id.to_string()),
            ("settings", &format!("{:016x}", run.settings)),
            ("clock", "CLOCK_MONOTONIC of the machine, in ns; plus wall_offset_ns it is ns since 1970"),
            ("wall_offset_ns", &wall_offset_ns.to_string()),
            ("t0_ns", &run.t0_ns.to_string()),
            ("period_ns", &run.period_ns.to_string()),
            ("sample_time_ns", &run.sample_time_ns.to_string()),
            ("last_tick", &run.last_tick.to_string()),
        ]);
        let texts = record(&[("settings.toml", &settings.commented()?), ("shared", &settings.shared_text()?)]);
        let host = record(&[
            ("kernel", &host.kernel),
            ("preemption", &host.preemption),
            ("cpu", &host.cpu),
            ("cpus", &host.cpus.to_string()),
            ("hypervisor", &host.hypervisor.to_string()),
            ("clock_source", &host.clock_source),
            ("rt_runtime_us", &host.rt_runtime_us.to_string()),
        ]);
        let realtime = roles.iter().map(|(role, section)| (role.clone(), granted(section))).collect();
        Ok(Self {
            pace,
            sample_time_ns,
            records: vec![(RUN, run), (SETTINGS, texts), (HOST, host), (REALTIME, realtime)],
        })
    }

    /// The records by name.
    pub(super) fn records(&self) -> impl Iterator<Item = (&'static str, Record)> {
        self.records.iter().cloned()
    }
}

/// A record of texts.
#[must_use]
pub fn record(pairs: &[(&str, &str)]) -> Record {
    pairs.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
}

/// What a process asked of the system, a step a line.
fn granted(section: &RoleSection) -> String {
    let mut text = section.scheduling.clone();
    for step in &section.realtime {
        let asked = step.asked.map_or_else(String::new, |value| format!(" {value}"));
        let outcome = step.refused.as_ref().map_or_else(|| "granted".into(), |reason| format!("refused: {reason}"));
        text.push_str(&format!("\n{}{asked}: {outcome}", step.step));
    }
    text
}
