//! Facts about a flight, stored in its log as metadata records of names and texts.

use std::collections::BTreeMap;

use messages::grid::Pace;
use messages::telemetry::Signals;

/// Version of the log: changed whenever a reader of the old one would misunderstand the new one. Logs of version 1 lack the
/// decisions of the processes: they can be exported, and not replayed.
pub const FORMAT: &str = "ironbird-log/2";
/// Name of the record that says which run it is, and how its clocks go.
pub const RUN: &str = "run";
/// What [`RUN`] calls the channel whose messages the log has; the log of a flight does not say.
pub const CHANNEL: &str = "channel";
pub const SETTINGS: &str = "settings";
/// What [`SETTINGS`] calls the points of the trajectory, where it has some: the file as it was read.
pub const POINTS: &str = "trajectory.csv";
/// Name of the record with the laws: of each role its name, its version, and its file with its SHA-256 where it has one.
pub const LAWS: &str = "laws";
/// Name of the record with the faults of messages, by number, with their ticks; there is none without faults.
pub const FAULTS: &str = "faults";
/// Name of the record with the faults that were injected in flight, by number, in the words that plan the same. Each
/// time there were more it is written again, with all of them; the last one counts. There is none without such faults.
pub const INJECTED: &str = "faults_injected";
pub const HOST: &str = "host";
pub const REALTIME: &str = "realtime";
/// Name of the record with what the log keeps, and which of its files this is.
pub const KEPT: &str = "log";
/// Name of the record that ends a file of the log: how the flight ended, or which file goes on.
pub const LANDING: &str = "landing";
/// What [`LANDING`] calls the file that goes on.
pub const CONTINUED_IN: &str = "continued_in";

pub type Record = BTreeMap<String, String>;

#[derive(Clone, Debug)]
pub struct Facts {
    pub pace: Pace,
    pub sample_time_ns: u64,
    pub plan: LogPlan,
    pub signals: Signals,
    /// Why topic `theorem` stays empty, where it does.
    pub no_theorem: Option<String>,
    pub records: Vec<(&'static str, Record)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogPlan {
    /// Ticks that are kept before and after an event; none where every message is kept.
    pub around_ticks: Option<u64>,
    /// Length at which a file ends and the next one begins [bytes].
    pub file_bytes: u64,
    /// The newest files that are kept; none where all of them are.
    pub files: Option<u64>,
}

impl LogPlan {
    pub const WHOLE: Self = Self {
        around_ticks: None,
        file_bytes: u64::MAX,
        files: None,
    };

    pub const fn kept(&self) -> &'static str {
        match self.around_ticks {
            Some(_) => AROUND_MISSES,
            None => ALL,
        }
    }
}

pub const ALL: &str = "all";
pub const AROUND_MISSES: &str = "around-misses";
pub const OFF: &str = "off";

impl Facts {
    pub(crate) fn records(&self, part: u64) -> impl Iterator<Item = (&'static str, Record)> {
        let around_ticks = self.plan.around_ticks.unwrap_or(0).to_string();
        let kept = record(&[
            ("kept", self.plan.kept()),
            ("around_ticks", &around_ticks),
            ("part", &part.to_string()),
        ]);
        self.records.iter().cloned().chain([(KEPT, kept)])
    }
}

pub fn record(pairs: &[(&str, &str)]) -> Record {
    let owned = |(name, text): &(&str, &str)| ((*name).to_owned(), (*text).to_owned());
    pairs.iter().map(owned).collect()
}
