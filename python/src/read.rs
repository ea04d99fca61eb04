//! `ironbird.read`: a recorded flight, without flying it again.

use std::path::{Path, PathBuf};

use errors::Failure;
use flight_log::entry::LogEntry;
use flight_log::facts::{LANDING, SETTINGS};
use flight_log::reader::{End, LogReader};
use ironbird::replay::log_check::{first_of, settings_of};
use ironbird::run_directory::find_log;
use ironbird::settings::Settings;
use messages::header::Message;
use messages::output_hash::OutputHash;
use messages::topic::Topic;
use pyo3::prelude::*;
use report::flight_statistics::is_last_word;
use report::swaps::AppliedSwap;

use crate::errors::log_error;
use crate::flight::{FlownLaw, Shown, Tables, facts};
use crate::timing::Timing;

/// Reads a flight: its directory, its flight.mcap, or `latest`.
#[pyfunction]
#[pyo3(signature = (run, out=None))]
pub(crate) fn read(py: Python<'_>, run: PathBuf, out: Option<PathBuf>) -> PyResult<Shown<'_>> {
    let read = py
        .detach(|| Read::from(&find_log(&run, out.as_deref())?))
        .map_err(log_error)?;
    let facts = facts(py, &read.settings, &read.text, &read.laws, &read.swaps)?;
    facts.set_item("end", read.end)?;
    facts.set_item("fingerprint", read.outputs.to_string())?;
    read.tables.shown(py, read.timing.into_tables(), facts)
}

/// What a log holds.
struct Read {
    settings: Settings,
    /// The settings as the log has them.
    text: String,
    laws: [FlownLaw; 3],
    tables: Tables,
    timing: Timing,
    swaps: Vec<AppliedSwap>,
    outputs: OutputHash,
    end: String,
}

impl Read {
    fn from(path: &Path) -> Result<Self, Failure> {
        let mut reader = LogReader::open(path)?;
        let first = first_of(&mut reader)?;
        reader.check_version()?;
        let settings = settings_of(&reader)?;
        let laws = FlownLaw::recorded(&settings);
        let mut read = Self {
            tables: Tables::of(&laws),
            timing: Timing::of(reader.pace()?),
            swaps: Vec::new(),
            outputs: OutputHash::default(),
            end: String::new(),
            text: reader.fact(SETTINGS, "settings.toml")?.to_owned(),
            settings,
            laws,
        };
        read.take(&first);
        while let Some(entry) = reader.next_entry()? {
            read.take(entry);
        }
        read.end = match reader.end() {
            End::Complete => reader.fact(LANDING, "ending")?.to_owned(),
            End::Truncated => "not known: the end of the log is missing".to_owned(),
        };
        Ok(read)
    }

    fn take(&mut self, entry: &LogEntry) {
        match entry {
            LogEntry::State(message) => {
                self.hash(message);
                self.timing.state(&message.envelope);
                self.tables
                    .state
                    .push(message.envelope.tick, &message.content);
            }
            LogEntry::Setpoint(message) => {
                self.hash(message);
                self.timing.setpoint(&message.envelope);
                self.tables
                    .setpoint
                    .push(message.envelope.tick, &message.content);
            }
            LogEntry::Wrench(message) => {
                self.hash(message);
                self.timing.wrench(&message.envelope);
                self.tables
                    .wrench
                    .push(message.envelope.tick, &message.content);
            }
            // The last word is the answer to no state.
            LogEntry::RotorSpeeds(message) if is_last_word(message) => {}
            LogEntry::RotorSpeeds(message) => {
                self.hash(message);
                self.timing.rotor_speeds(&message.envelope);
                self.tables
                    .rotor_speeds
                    .push(message.envelope.tick, &message.content);
            }
            LogEntry::Swap(message) => {
                let swap = AppliedSwap::new(
                    message.envelope.tick,
                    self.settings.flight.period_s,
                    &message.content,
                );
                self.swaps.push(swap);
            }
            LogEntry::Theorem(message) => self
                .tables
                .theorem
                .push(message.envelope.tick, &message.content),
        }
    }

    fn hash<C: Topic>(&mut self, message: &Message<C>) {
        self.outputs.take(message.envelope.tick, &message.content);
    }
}
