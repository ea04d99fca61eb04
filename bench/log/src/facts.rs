//! Facts about a flight, stored in its log as metadata records of names and texts.

use std::collections::BTreeMap;

use model::grid::Pace;

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
    /// The records by name.
    pub records: Vec<(&'static str, Record)>,
}

impl Facts {
    /// The records by name.
    pub(crate) fn records(&self) -> impl Iterator<Item = (&'static str, Record)> {
        self.records.iter().cloned()
    }
}

/// A record of texts.
#[must_use]
pub fn record(pairs: &[(&str, &str)]) -> Record {
    pairs.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
}
