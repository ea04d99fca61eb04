//! Reads a flight log from start to end and trusts only what its checksums cover.
//!
//! It reads chunk by chunk, so it can also read what a killed recorder or a full disk left behind. From a file that
//! names another one, which goes on, it goes on there.

mod assembly;
mod told;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{Channel, Metadata, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use model::role::Role;

use crate::entry::{Counts, LogEntry};
use crate::telemetry::TelemetryTopic;
use crate::{TOPICS, facts};
use assembly::Assembly;
use failure::{Failure, InFile as _, open_file};

pub use told::Kept;

/// A record longer than this is no log's [bytes].
const RECORD_LIMIT: usize = 1 << 28;

/// Length of what stands before a message: channel, sequence, and two times [bytes].
const MESSAGE_HEADER: usize = 2 + 4 + 8 + 8;

/// As much of a file is read at once, where that much is left [bytes]: some chunks. A chunk that is there as a whole is
/// decompressed to where it is read; one that comes in pieces takes a copy more. No more, whatever length a record says
/// that it has: memory follows what the file holds.
const READ_AHEAD: usize = 1 << 21;

/// What fails where a file cannot be read.
const READ: &str = "read the flight log";

/// How far a log goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// To its end, and every checksum holds.
    Complete,
    /// The end is missing: only what was read before is there.
    Truncated,
}

/// A flight log that is being read.
#[allow(missing_debug_implementations, reason = "the parser has none")]
pub struct LogReader {
    path: PathBuf,
    file: File,
    /// Which file of the log it is, once it has said so.
    part: Option<u64>,
    parser: LinearReader,
    assembly: Assembly,
    schemas: BTreeMap<u16, (String, Vec<u8>)>,
    facts: BTreeMap<String, facts::Record>,
    end: Option<End>,
    /// Messages that were read.
    read: Counts,
    has_data_end: bool,
    has_footer: bool,
}

impl LogReader {
    /// Opens a log and reads what it says of its flight.
    ///
    /// # Errors
    /// [`Failure`] names the file, and says what is wrong with it.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        Ok(Self {
            path: path.to_owned(),
            file: open_file(path).in_file(READ, path)?,
            part: None,
            parser: parser(),
            assembly: Assembly::new(),
            schemas: BTreeMap::new(),
            facts: BTreeMap::new(),
            end: None,
            read: [0; TOPICS.len()],
            has_data_end: false,
            has_footer: false,
        })
    }

    /// The next message; none at the end, which [`Self::end`] then describes.
    ///
    /// # Errors
    /// [`Failure`] names the file, and says where it is damaged, or of which other version.
    pub fn next_entry(&mut self) -> Result<Option<&LogEntry>, Failure> {
        while self.end.is_none() {
            if self.step()? {
                let newest = self.assembly.newest();
                self.read[newest.topic()] += 1;
                return Ok(Some(newest));
            }
        }
        Ok(None)
    }

    /// The message that was read last.
    #[must_use]
    pub const fn newest(&self) -> &LogEntry {
        self.assembly.newest()
    }

    /// What the law of a role shows, as the log names it; none of a law without signals, and before the first message.
    #[must_use]
    pub fn telemetry(&self, role: Role) -> Option<&TelemetryTopic> {
        self.assembly.telemetry(role)
    }

    /// The file that was read last.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How far the log goes; [`End::Truncated`] while it has not been read to its end.
    #[must_use]
    pub fn end(&self) -> End {
        self.end.unwrap_or(End::Truncated)
    }

    /// Takes what comes next; true where it is a message.
    fn step(&mut self) -> Result<bool, Failure> {
        let event = match self.parser.next_event() {
            None => return self.end_file().map(|()| false),
            // The end of the file inside a record: of a log that was not finished.
            Some(Err(McapError::UnexpectedEof)) => {
                self.end = Some(End::Truncated);
                if self.facts.is_empty() {
                    return Err(self.damaged("it ends before its first record"));
                }
                if let Some(next) = self.next_name().filter(|next| self.path.with_file_name(next).exists()) {
                    return Err(self.damaged(&format!("its end is missing, and the log goes on in {next}")));
                }
                return Ok(false);
            }
            Some(Err(e)) => {
                self.end = Some(End::Truncated);
                return Err(self.damaged(&e.to_string()));
            }
            Some(Ok(event)) => event,
        };
        match event {
            LinearReadEvent::ReadRequest(_) => {
                let room = self.parser.insert(READ_AHEAD);
                let read = self.file.read(room).in_file(READ, &self.path)?;
                self.parser.notify_read(read);
                Ok(false)
            }
            LinearReadEvent::Record { opcode, data } => {
                // Most records are messages, of which the channel is all that is wanted.
                if opcode == op::MESSAGE
                    && let Some((header, data)) = data.split_at_checked(MESSAGE_HEADER)
                {
                    let channel = u16::from_le_bytes([header[0], header[1]]);
                    return self.assembly.take(channel, data).map_err(|what| self.damaged(&what));
                }
                let record = mcap::parse_record(opcode, data).map(Record::into_owned);
                let record = record.map_err(|e| self.damaged(&e.to_string()))?;
                self.take(record).map(|()| false)
            }
        }
    }

    /// Name of the file after this one.
    fn next_name(&self) -> Option<String> {
        self.part.and_then(|part| part.checked_add(1)).map(crate::file_name)
    }

    /// Ends with this file, or goes on with the one that it names.
    fn end_file(&mut self) -> Result<(), Failure> {
        self.assembly.check_whole().map_err(|what| self.damaged(&what))?;
        if !(self.has_data_end && self.has_footer) {
            self.end = Some(End::Complete);
            return Err(self.damaged("its checksums are missing"));
        }
        let continued = self.facts.get(facts::LANDING).and_then(|landing| landing.get(facts::CONTINUED_IN)).cloned();
        let Some(next) = continued else {
            self.end = Some(End::Complete);
            return Ok(());
        };
        self.end = Some(End::Truncated);
        // The landing of the whole log is that of its last file.
        self.facts.remove(facts::LANDING);
        if self.next_name().as_ref() != Some(&next) {
            return Err(self.damaged(&format!("it goes on in `{next}`, which is not the file after it")));
        }
        let path = self.path.with_file_name(next);
        let file = open_file(&path).in_file(READ, &path).map_err(|failure| {
            failure.help(format!(
                "{} goes on in it: the files of a log belong together; what stands before can be exported",
                self.path.display()
            ))
        })?;
        self.end = None;
        (self.path, self.file, self.parser) = (path, file, parser());
        self.schemas.clear();
        self.assembly.begin_file();
        (self.has_data_end, self.has_footer) = (false, false);
        Ok(())
    }

    fn take(&mut self, record: Record<'static>) -> Result<(), Failure> {
        match record {
            Record::Metadata(metadata) if metadata.name == facts::LANDING => {
                self.facts.insert(metadata.name, metadata.metadata);
            }
            // Every file of a log says the same, but for its number: that of the first is kept.
            Record::Metadata(metadata) => {
                self.check_follows(&metadata)?;
                self.facts.entry(metadata.name).or_insert(metadata.metadata);
            }
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, (header.name, data.into_owned()));
            }
            Record::Channel(channel) => self.take_channel(&channel)?,
            Record::DataEnd(end) => {
                self.has_data_end = true;
                if end.data_section_crc == 0 {
                    return Err(self.damaged("its messages have no checksum"));
                }
            }
            Record::Footer(footer) => {
                self.has_footer = true;
                if footer.summary_crc == 0 {
                    return Err(self.damaged("its index has no checksum"));
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Refuses a file that is not the next one of the same flight, where there was one before it.
    fn check_follows(&mut self, metadata: &Metadata) -> Result<(), Failure> {
        let first = self.facts.get(&metadata.name);
        if metadata.name == facts::RUN && first.is_some_and(|first| *first != metadata.metadata) {
            return Err(self.damaged("it is of another flight than the file before it"));
        }
        if metadata.name == facts::KEPT {
            // Logs from before there were several files do not say.
            let part = metadata.metadata.get("part").and_then(|part| part.parse().ok()).unwrap_or(0);
            if let Some(before) = self.part.replace(part).filter(|before| before.checked_add(1) != Some(part)) {
                return Err(self.damaged(&format!("it is file {part} of a log, and stands after file {before}")));
            }
        }
        Ok(())
    }

    fn take_channel(&mut self, channel: &Channel) -> Result<(), Failure> {
        let schema = self.schemas.get(&channel.schema_id).map(|(_, schema)| schema.as_slice());
        if self.assembly.take_channel(channel, schema) {
            return Ok(());
        }
        // Only what is laid out as here can be read.
        self.check_version()?;
        let (topic, version) = (&channel.topic, env!("CARGO_PKG_VERSION"));
        Err(self.damaged(&format!(
            "the schema of its topic `{topic}` is not that of ironbird {version}, which its record `run` names"
        )))
    }
}

fn parser() -> LinearReader {
    LinearReader::new_with_options(
        LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(RECORD_LIMIT),
    )
}
