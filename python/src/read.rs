//! `ironbird.read`: a recorded flight, without flying it again.

use std::path::{Path, PathBuf};

use analysis::faults::AppliedSwap;
use analysis::states::is_final_command;
use config::Settings;
use errors::Failure;
use flight_log::codec::Logged;
use flight_log::entry::LogEntry;
use flight_log::facts::{LANDING, SETTINGS};
use flight_log::reader::{End, LogReader};
use messages::header::Message;
use messages::output_hash::OutputHash;
use pyo3::prelude::*;
use recorder::run_directory::find_log;
use replay::log_check::{first_of, settings_of};

use crate::errors::log_error;
use crate::flight::{FlownLaw, Shown, Tables, facts};
use crate::timing::Timing;

/// Reads a flight: its directory, its flight.mcap, or `latest`.
#[pyfunction]
#[pyo3(signature = (run, out=None))]
pub(crate) fn read(py: Python<'_>, run: PathBuf, out: Option<PathBuf>) -> PyResult<Shown<'_>> {
    let path = find_log(&run, out.as_deref()).map_err(log_error)?;
    let read = py.detach(|| Read::from(&path)).map_err(log_error)?;
    let facts = facts(py, &read.settings, &read.text, &read.laws, &read.swaps)?;
    facts.set_item("end", read.end)?;
    facts.set_item("log", path)?;
    facts.set_item("fingerprint", read.outputs.to_string())?;
    read.tables.shown(py, read.timing.tables.into(), facts)
}

struct Read {
    settings: Settings,
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
            tables: Tables::of(&settings, &laws)?,
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
                let Message { envelope, content } = message;
                self.tables.push_reference(envelope.tick, content);
                self.stage(message);
            }
            LogEntry::Setpoint(message) => self.stage(message),
            LogEntry::Wrench(message) => self.stage(message),
            // The last message is the answer to no state.
            LogEntry::RotorSpeeds(message) if is_final_command(message) => {}
            LogEntry::RotorSpeeds(message) => self.stage(message),
            LogEntry::Swap(Message { envelope, content }) => {
                let period_s = self.settings.flight.period_s;
                self.swaps
                    .push(AppliedSwap::new(envelope.tick, period_s, content));
            }
            LogEntry::Theorem(Message { envelope, content }) => {
                self.tables.push(envelope.tick, content);
            }
            // Tables have one row a tick; `export` has these messages.
            LogEntry::Decisions(_) | LogEntry::Loss(_) => {}
        }
    }

    fn stage<C: Logged>(&mut self, message: &Message<C>) {
        let Message { envelope, content } = message;
        self.outputs.take(envelope.tick, content);
        self.timing.take(C::SENDER, envelope);
        self.tables.push(envelope.tick, content);
    }
}
