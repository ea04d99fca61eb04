//! Reads a flight log from start to end and trusts only what its checksums cover.
//!
//! It reads chunk by chunk, so it can also read what a killed recorder or a full disk left behind. From a file that
//! names another one, which goes on, it goes on there.

mod told;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{Metadata, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::monitor::Monitor;

use crate::TOPICS;
use crate::codec::decode_into;
use crate::entry::{Counts, LogEntry};
use crate::{facts, schema};
use failure::{Failure, InFile as _, open_file};

pub use told::Kept;

/// A record longer than this is no log's [bytes].
const RECORD_LIMIT: usize = 1 << 28;

/// Length of what stands before a message: channel, sequence, and two times [bytes].
const MESSAGE_HEADER: usize = 2 + 4 + 8 + 8;

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
    /// What is read by the messages' layouts: places in [`TOPICS`] by channel.
    channels: BTreeMap<u16, usize>,
    schemas: BTreeMap<u16, (String, Vec<u8>)>,
    facts: BTreeMap<String, facts::Record>,
    end: Option<End>,
    /// Messages that were read.
    read: Counts,
    /// The one that was read last.
    newest: LogEntry,
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
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            facts: BTreeMap::new(),
            end: None,
            read: [0; TOPICS.len()],
            newest: LogEntry::empty(0),
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
                self.read[self.newest.topic()] += 1;
                return Ok(Some(&self.newest));
            }
        }
        Ok(None)
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
            LinearReadEvent::ReadRequest(wanted) => {
                let read = self.file.read(self.parser.insert(wanted)).in_file(READ, &self.path)?;
                self.parser.notify_read(read);
                Ok(false)
            }
            LinearReadEvent::Record { opcode, data } => {
                // Most records are messages, of which the channel is all that is wanted.
                if opcode == op::MESSAGE
                    && let Some((header, data)) = data.split_at_checked(MESSAGE_HEADER)
                {
                    let channel = u16::from_le_bytes([header[0], header[1]]);
                    let Some(topic) = self.channels.get(&channel).copied() else { return Ok(false) };
                    if !read(topic, data, &mut self.newest) {
                        let what = format!("a message of topic `{}` does not follow its schema", TOPICS[topic]);
                        return Err(self.damaged(&what));
                    }
                    return Ok(true);
                }
                let record = mcap::parse_record(opcode, data).map(Record::into_owned);
                let record = record.map_err(|e| self.damaged(&e.to_string()))?;
                self.take(record).map(|()| false)
            }
        }
    }

    /// Name of the file after this one.
    fn next_name(&self) -> Option<String> {
        self.part.map(|part| crate::file_name(part + 1))
    }

    /// Ends with this file, or goes on with the one that it names.
    fn end_file(&mut self) -> Result<(), Failure> {
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
        (self.channels, self.schemas) = (BTreeMap::new(), BTreeMap::new());
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
            if let Some(before) = self.part.replace(part).filter(|before| *before + 1 != part) {
                return Err(self.damaged(&format!("it is file {part} of a log, and stands after file {before}")));
            }
        }
        Ok(())
    }

    fn take_channel(&mut self, channel: &mcap::records::Channel) -> Result<(), Failure> {
        let Some(place) = TOPICS.iter().position(|topic| *topic == channel.topic) else { return Ok(()) };
        let ours = match LogEntry::empty(place) {
            LogEntry::State(_) => schema::descriptor_set::<State>(),
            LogEntry::Setpoint(_) => schema::descriptor_set::<Setpoint>(),
            LogEntry::Wrench(_) => schema::descriptor_set::<Wrench>(),
            LogEntry::RotorSpeeds(_) => schema::descriptor_set::<RotorSpeeds>(),
            LogEntry::Swap(_) => schema::descriptor_set::<SwapRecord>(),
            LogEntry::Theorem(_) => schema::descriptor_set::<Monitor>(),
        };
        // Only what is laid out as here can be read.
        if self.schemas.get(&channel.schema_id).is_none_or(|(_, theirs)| *theirs != ours) {
            return Err(self.of_other_version(&format!("its topic `{}` has another schema", channel.topic)));
        }
        self.channels.insert(channel.id, place);
        Ok(())
    }
}

/// Reads a message of a topic into the place of another one; false where its bytes do not follow the layout.
fn read(topic: usize, data: &[u8], entry: &mut LogEntry) -> bool {
    // Messages of a topic stand together: most come into the place of one of their own.
    if entry.topic() != topic {
        *entry = LogEntry::empty(topic);
    }
    match entry {
        LogEntry::State(message) => decode_into(data, message),
        LogEntry::Setpoint(message) => decode_into(data, message),
        LogEntry::Wrench(message) => decode_into(data, message),
        LogEntry::RotorSpeeds(message) => decode_into(data, message),
        LogEntry::Swap(message) => decode_into(data, message),
        LogEntry::Theorem(message) => decode_into(data, message),
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
