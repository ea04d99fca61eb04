//! Reads a flight log from start to end and trusts only what its checksums cover.
//!
//! It reads chunk by chunk, so it can also read what a killed recorder or a full disk left behind. From a file that
//! names another one, which goes on, it goes on there.

use crate::build::Build;
use crate::chunk::{Chunk, RECORD_LIMIT};
use crate::codec::decode_into;
use crate::entry::{Counts, FORMATS, LogEntry, with_message};
use crate::telemetry::{BESIDE, TELEMETRY_TOPICS, TelemetryTopic, place};
use crate::{TOPICS, facts};
use errors::{Failure, InFile as _, open_file};
use mcap::McapError;
use mcap::records::{Channel, Metadata, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use messages::blackboards::LOCKSTEP;
use messages::grid::{Grid, Pace};
use messages::header::LAYOUT;
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Length of what stands before a message: channel, sequence, and two times [bytes].
const MESSAGE_HEADER: usize = 2 + 4 + 8 + 8;

/// As much of a file is read at once, where that much is left [bytes]: some chunks. No more, whatever length a record says
/// that it has: memory follows what the file holds.
const READ_AHEAD: usize = 1 << 21;

/// Longest schema or channel that is read [bytes]: a decoded schema takes up to 300 times as much memory.
const SHORT_BYTES: usize = 1 << 16;
/// Most bytes of all records of a file besides its messages: a trajectory has up to 16 MiB, and settings of many short
/// entries take 12 times as much memory.
const FACTS_BYTES: usize = 18 << 20;

const READ: &str = "read the flight log";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// To its end, and every checksum holds.
    Complete,
    /// The end is missing: only what was read before is there.
    Truncated,
}

pub struct LogReader {
    path: PathBuf,
    file: File,
    part: Option<u64>,
    parser: LinearReader,
    chunk: Chunk,
    assembly: Assembly,
    schemas: BTreeMap<u16, Vec<u8>>,
    facts: BTreeMap<String, facts::Record>,
    /// Bytes of schemas, channels and metadata in this file so far.
    facts_bytes: usize,
    /// True for the first file that is read.
    is_first: bool,
    end: Option<End>,
    read: Counts,
    /// Chunks that have been opened.
    pub chunks: u64,
    /// Position of the newest message in the recorder's order, of which the last bits are logged.
    position: u64,
    has_data_end: bool,
    has_footer: bool,
}

impl LogReader {
    pub fn open(path: &Path) -> Result<Self, Failure> {
        Ok(Self {
            path: path.to_owned(),
            file: open_file(path).in_file(READ, path)?,
            part: None,
            parser: parser(),
            chunk: Chunk::new().in_file(READ, path)?,
            assembly: Assembly::new(),
            schemas: BTreeMap::new(),
            facts: BTreeMap::new(),
            facts_bytes: 0,
            is_first: true,
            end: None,
            read: [0; TOPICS.len()],
            chunks: 0,
            position: 0,
            has_data_end: false,
            has_footer: false,
        })
    }

    /// The next message; none at the end, which [`Self::end`] then describes. A failure names the file, and says where
    /// it is damaged, or of which other version.
    pub fn next_entry(&mut self) -> Result<Option<&LogEntry>, Failure> {
        while self.end.is_none() {
            if self.step()? {
                let newest = &self.assembly.newest;
                self.read[newest.topic()] += 1;
                return Ok(Some(newest));
            }
        }
        Ok(None)
    }

    /// Position of the newest message in the order in which the recorder took the messages of all logs of the flight.
    /// Inside a chunk, they are grouped by topic.
    pub const fn position(&self) -> u64 {
        self.position
    }

    pub const fn newest(&self) -> &LogEntry {
        &self.assembly.newest
    }

    /// The signals of a role's law, as the log names them; none of a law without signals, and before the first message.
    pub fn telemetry(&self, role: Role) -> Option<&TelemetryTopic> {
        self.assembly.telemetry[place(role)?].as_ref()
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How far the log goes; [`End::Truncated`] while it has not been read to its end.
    pub fn end(&self) -> End {
        self.end.unwrap_or(End::Truncated)
    }

    fn step(&mut self) -> Result<bool, Failure> {
        let record = match self.chunk.next() {
            Some(record) => record,
            None => match self.parser.next_event() {
                None => return self.end_file().map(|()| false),
                // The end of the file inside a record: of a log that was not finished.
                Some(Err(McapError::UnexpectedEof)) => {
                    self.end = Some(End::Truncated);
                    if self.facts.is_empty() {
                        return Err(self.damaged("it ends before its first record"));
                    }
                    return match self.next_name() {
                        Some(next) if self.path.with_file_name(&next).exists() => {
                            let what = format!("its end is missing, and the log goes on in {next}");
                            Err(self.damaged(&what))
                        }
                        _ => Ok(false),
                    };
                }
                Some(Err(e)) => Err(e),
                Some(Ok(LinearReadEvent::ReadRequest(_))) => {
                    let room = self.parser.insert(READ_AHEAD);
                    let read = self.file.read(room).in_file(READ, &self.path)?;
                    self.parser.notify_read(read);
                    return Ok(false);
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) if opcode == op::CHUNK => {
                    self.chunks += 1;
                    match self.chunk.open(data) {
                        Ok(()) => return Ok(false),
                        Err(e) => Err(e),
                    }
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => Ok((opcode, data)),
            },
        };
        let (opcode, data) = match record {
            Ok(record) => record,
            Err(e) => {
                self.end = Some(End::Truncated);
                return Err(self.damaged(&e.to_string()));
            }
        };
        // Most records are messages, of which the channel is all that is wanted.
        if opcode == op::MESSAGE
            && let Some((header, data)) = data.split_at_checked(MESSAGE_HEADER)
        {
            let channel = u16::from_le_bytes([header[0], header[1]]);
            let position = u32::from_le_bytes([header[2], header[3], header[4], header[5]]);
            let change = position.wrapping_sub(self.position as u32).cast_signed();
            self.position = self.position.wrapping_add_signed(change.into());
            let taken = self.assembly.take(channel, data);
            return taken.map_err(|what| self.damaged(&what));
        }
        let is_long = data.len() > SHORT_BYTES;
        let (kind, longest) = match opcode {
            // Settings may contain a trajectory. Those of the first file count.
            op::METADATA if is_long && !self.is_first => return Ok(false),
            op::METADATA => ("metadata", FACTS_BYTES),
            op::SCHEMA => ("schema", SHORT_BYTES),
            op::CHANNEL => ("channel", SHORT_BYTES),
            op::DATA_END | op::FOOTER => ("last", SHORT_BYTES),
            // Of no use here, and covered by the checksum of all messages.
            _ => return Ok(false),
        };
        self.facts_bytes += data.len();
        if data.len() > longest || self.facts_bytes > FACTS_BYTES {
            let (length, all) = (data.len(), self.facts_bytes);
            let what = format!(
                "a {kind} record of {length} bytes (allowed: {longest}) makes {all} bytes of facts (allowed: {FACTS_BYTES})"
            );
            return Err(self.damaged(&what));
        }
        let record = mcap::parse_record(opcode, data).map(Record::into_owned);
        let record = record.map_err(|e| self.damaged(&e.to_string()))?;
        self.take(record).map(|()| false)
    }

    fn next_name(&self) -> Option<String> {
        self.part?.checked_add(1).map(crate::file_name)
    }

    /// Ends with this file, or goes on with the one that it names.
    fn end_file(&mut self) -> Result<(), Failure> {
        let is_whole = self.assembly.check_whole();
        is_whole.map_err(|what| self.damaged(&what))?;
        if !(self.has_data_end && self.has_footer) {
            self.end = Some(End::Complete);
            return Err(self.damaged("its checksums are missing"));
        }
        let next = self.fact(facts::LANDING, facts::CONTINUED_IN);
        let Ok(next) = next.map(str::to_owned) else {
            self.end = Some(End::Complete);
            return Ok(());
        };
        self.end = Some(End::Truncated);
        // The landing of the whole log is that of its last file.
        self.facts.remove(facts::LANDING);
        if self.next_name().as_ref() != Some(&next) {
            let what = format!("it goes on in `{next}`, which is not the file after it");
            return Err(self.damaged(&what));
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
        (self.facts_bytes, self.is_first) = (0, false);
        let assembly = &mut self.assembly;
        assembly.channels.clear();
        assembly.beside.clear();
        assembly.telemetry_channels.clear();
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
                if self.is_first {
                    self.facts.entry(metadata.name).or_insert(metadata.metadata);
                }
            }
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, data.into_owned());
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
            let part = metadata.metadata.get("part");
            let part = part.and_then(|part| part.parse().ok());
            let part =
                part.ok_or_else(|| self.damaged("it does not say which file of its log it is"))?;
            let before = self.part.replace(part);
            if let Some(before) = before.filter(|before| before.checked_add(1) != Some(part)) {
                let what = format!("it is file {part} of a log, and stands after file {before}");
                return Err(self.damaged(&what));
            }
        }
        Ok(())
    }

    fn take_channel(&mut self, channel: &Channel) -> Result<(), Failure> {
        let schema = self.schemas.get(&channel.schema_id).map(Vec::as_slice);
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
            .with_emit_chunks(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(RECORD_LIMIT),
    )
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Ticks around missed deadlines that it keeps; none where it keeps every message.
    pub around_ticks: Option<u64>,
    /// Files that were before the first one that is there.
    pub files_before: u64,
}

impl LogReader {
    /// What the log says of its flight, as far as it has been read: all but the landing stands before the messages.
    pub fn fact(&self, record: &str, name: &str) -> Result<&str, Failure> {
        let text = self.facts.get(record).and_then(|record| record.get(name));
        text.map(String::as_str)
            .ok_or_else(|| self.damaged(&format!("its record `{record}` has no `{name}`")))
    }

    /// A number of the record that ends the log; none where it does not say.
    pub fn landed(&self, name: &str) -> Result<Option<u64>, Failure> {
        let Some(landing) = self.facts.get(facts::LANDING) else {
            return Err(self.damaged(
                "its record `landing` is missing: it has an end, but not the one that its recorder wrote",
            ));
        };
        let is_there = landing.contains_key(name);
        let number = is_there.then(|| self.number_of(facts::LANDING, name));
        number.transpose()
    }

    pub fn number(&self, name: &str) -> Result<u64, Failure> {
        self.number_of(facts::RUN, name)
    }

    fn number_of(&self, record: &str, name: &str) -> Result<u64, Failure> {
        let text = self.fact(record, name)?;
        let what = || format!("its record `{record}` has {name} = `{text}`, which is no number");
        text.parse().map_err(|_| self.damaged(&what()))
    }

    pub fn pace(&self) -> Result<Pace, Failure> {
        let (t0_ns, period_ns) = (self.number("t0_ns")?, self.number("period_ns")?);
        Ok(if period_ns == LOCKSTEP {
            Pace::Lockstep
        } else {
            Pace::Realtime(Grid { t0_ns, period_ns })
        })
    }

    pub fn kept(&self) -> Result<Kept, Failure> {
        let kept = self.fact(facts::KEPT, "kept")?;
        let around_ticks = self.number_of(facts::KEPT, "around_ticks")?;
        Ok(Kept {
            around_ticks: (kept == facts::AROUND_MISSES).then_some(around_ticks),
            files_before: self.number_of(facts::KEPT, "part")?,
        })
    }

    /// The executable that wrote it; what the log does not say is unknown.
    pub fn build(&self) -> Build {
        let known = |name: &str| self.fact(facts::RUN, name).unwrap_or("unknown").to_owned();
        Build {
            version: known("version"),
            commit: known("commit"),
            dirty: known("dirty") == "true",
            profile: known("profile"),
            rustc: known("rustc"),
            target: known("target"),
        }
    }

    pub fn damaged(&self, what: &str) -> Failure {
        Failure::failed(format!(
            "{} is damaged or no flight log: {what}",
            self.path.display()
        ))
        .help("only an undamaged log can be trusted; what stands before the damage can be exported")
    }

    /// Messages that a log with its beginning and its end lacks, by topic: those that it says it was to hold.
    pub fn missing(&self) -> Result<Vec<(&'static str, u64)>, Failure> {
        if self.end() != End::Complete || self.kept()?.files_before > 0 {
            return Ok(Vec::new());
        }
        let mut missing = Vec::new();
        for (topic, read) in TOPICS.into_iter().zip(self.read) {
            let held = self.landed(&format!("messages.{topic}"))?.unwrap_or(read);
            if held > read {
                missing.push((topic, held - read));
            }
        }
        Ok(missing)
    }

    /// Refuses a log that another version wrote, or one with other layouts.
    pub fn check_version(&self) -> Result<(), Failure> {
        for (name, ours) in [
            ("format", facts::FORMAT.to_owned()),
            ("version", env!("CARGO_PKG_VERSION").into()),
            ("layout", format!("{LAYOUT:016x}")),
        ] {
            let theirs = self.fact(facts::RUN, name)?;
            if theirs != ours {
                let (path, build) = (self.path.display(), self.build());
                return Err(Failure::failed(format!(
                    "{path} was written by another version of ironbird, {build}: {name} `{theirs}`, here `{ours}`"
                ))
                .help("use that version; the schemas in the log let any MCAP reader read it (`ironbird docs recording`)"));
            }
        }
        Ok(())
    }
}

/// The channels of a file, and the message that is being put together.
struct Assembly {
    /// The topics that are read by the messages' layouts, by channel: place in [`TOPICS`].
    channels: BTreeMap<u16, usize>,
    /// Topics whose messages have what their law shows right behind them, by place in [`TOPICS`].
    beside: BTreeMap<usize, String>,
    /// What the laws show: places in [`LAW_ROLES`] by channel.
    telemetry_channels: BTreeMap<u16, usize>,
    telemetry: [Option<TelemetryTopic>; LAW_ROLES.len()],
    newest: LogEntry,
    waits: bool,
}

impl Assembly {
    fn new() -> Self {
        Self {
            channels: BTreeMap::new(),
            beside: BTreeMap::new(),
            telemetry_channels: BTreeMap::new(),
            telemetry: [const { None }; LAW_ROLES.len()],
            newest: (FORMATS[0].empty)(),
            waits: false,
        }
    }

    /// Takes a channel; false if its schema is not the one that is read here.
    fn take_channel(&mut self, channel: &Channel, schema: Option<&[u8]>) -> bool {
        let name = channel.topic.as_str();
        if let Some(place) = TELEMETRY_TOPICS.iter().position(|topic| *topic == name) {
            let role = LAW_ROLES[place];
            self.telemetry_channels.insert(channel.id, place);
            self.telemetry[place] =
                schema.and_then(|it| TelemetryTopic::described(role, it, &channel.metadata));
            return self.telemetry[place].is_some();
        }
        let Some(place) = TOPICS.iter().position(|topic| *topic == name) else {
            return true;
        };
        let format = &FORMATS[place];
        self.channels.insert(channel.id, place);
        let beside = channel.metadata.get(BESIDE);
        self.beside
            .extend(beside.map(|topic| (place, topic.clone())));
        // Only what is laid out as here can be read.
        schema == Some(&(format.descriptor_set)())
    }

    /// Takes the bytes of a channel; true where a message is whole now.
    fn take(&mut self, channel: u16, data: &[u8]) -> Result<bool, String> {
        if let Some(place) = self.telemetry_channels.get(&channel) {
            return self.take_telemetry(*place, data).map(|()| true);
        }
        let Some(topic) = self.channels.get(&channel).copied() else {
            return Ok(false);
        };
        self.check_whole()?;
        if !read(topic, data, &mut self.newest) {
            return Err(format!(
                "a message of topic `{}` does not follow its schema",
                TOPICS[topic]
            ));
        }
        self.waits = self.beside.contains_key(&topic);
        Ok(!self.waits)
    }

    fn take_telemetry(&mut self, place: usize, data: &[u8]) -> Result<(), String> {
        let topic = TELEMETRY_TOPICS[place];
        let beside = self.beside.get(&self.newest.topic());
        let is_beside = beside.is_some_and(|beside| beside == topic);
        if !std::mem::replace(&mut self.waits, false) || !is_beside {
            return Err(format!(
                "a message of topic `{topic}` does not stand behind that of its stage"
            ));
        }
        let tick = self.newest.envelope().tick;
        let shown = self.telemetry[place].as_ref();
        let shown = shown.zip(self.newest.telemetry_mut());
        if !shown.is_some_and(|(shown, telemetry)| shown.decode_into(data, tick, telemetry)) {
            return Err(format!(
                "a message of topic `{topic}` does not follow its schema, or is of another tick"
            ));
        }
        Ok(())
    }

    fn check_whole(&self) -> Result<(), String> {
        let topic = self.newest.topic();
        match self.beside.get(&topic) {
            Some(beside) if self.waits => {
                let tick = self.newest.envelope().tick;
                Err(format!(
                    "the message of topic `{}` of tick {tick} lacks that of topic `{beside}`",
                    TOPICS[topic]
                ))
            }
            _ => Ok(()),
        }
    }
}

/// Reads a message of a topic into the place of another one; false where its bytes do not follow the layout.
fn read(topic: usize, data: &[u8], entry: &mut LogEntry) -> bool {
    // Messages of a topic stand together: most come into the place of one of their own.
    if entry.topic() != topic {
        *entry = (FORMATS[topic].empty)();
    }
    with_message!(entry, message => decode_into(data, message))
}

#[cfg(test)]
mod tests {
    use messages::content::Wrench;
    use messages::header::Message;
    use messages::telemetry::Signal;

    use super::*;
    use crate::codec::encode;
    use crate::schema;

    const WRENCH: u16 = 1;
    const SHOWN: u16 = 2;

    fn topic() -> TelemetryTopic {
        let (name, unit) = ("gain", "");
        TelemetryTopic::new(Role::Inner, &[Signal { name, unit }]).unwrap()
    }

    fn channel(id: u16, topic: &str, metadata: BTreeMap<String, String>) -> Channel {
        Channel {
            id,
            schema_id: id,
            topic: topic.into(),
            message_encoding: "protobuf".into(),
            metadata,
        }
    }

    fn file() -> Assembly {
        let mut assembly = Assembly::new();
        let beside = BTreeMap::from([(BESIDE.to_owned(), "inner_telemetry".to_owned())]);
        assert!(assembly.take_channel(
            &channel(WRENCH, "wrench", beside),
            Some(&schema::descriptor_set::<Wrench>())
        ));
        let shown = channel(SHOWN, "inner_telemetry", topic().metadata());
        assert!(assembly.take_channel(&shown, Some(&topic().descriptor_set())));
        assembly
    }

    fn wrench(tick: u64) -> Message<Wrench> {
        let mut message = Message::of_tick(tick, Wrench::default());
        message.content.telemetry.value[0] = tick as f64 + 0.5;
        message
    }

    fn bytes(tick: u64) -> [Vec<u8>; 2] {
        let (mut bytes, mut shown) = (Vec::new(), Vec::new());
        encode(&wrench(tick), &mut bytes);
        topic().encode(tick, &wrench(tick).content.telemetry, &mut shown);
        [bytes, shown]
    }

    #[test]
    fn telemetry_belongs_to_the_message_before_it_and_no_other() {
        let (mut file, [seventh, shown], [eighth, next]) = (file(), bytes(7), bytes(8));
        let misplaced = Err(
            "a message of topic `inner_telemetry` does not stand behind that of its stage".into(),
        );
        let lacks = "the message of topic `wrench` of tick 7 lacks that of topic `inner_telemetry`";
        let other = "a message of topic `inner_telemetry` does not follow its schema, or is of another tick";
        assert_eq!(file.take(SHOWN, &shown), misplaced);
        assert_eq!(file.take(WRENCH, &seventh), Ok(false));
        // At the end of the file, and before another message.
        assert_eq!(file.check_whole(), Err(lacks.into()));
        assert_eq!(file.take(WRENCH, &eighth), Err(lacks.into()));
        assert_eq!(file.take(SHOWN, &shown), Ok(true));
        assert_eq!(file.newest, LogEntry::Wrench(wrench(7)));
        assert_eq!(file.take(SHOWN, &shown), misplaced, "a second one");
        assert_eq!(file.take(WRENCH, &eighth), Ok(false));
        assert_eq!(file.take(SHOWN, &next), Ok(true));
        assert_eq!(file.newest, LogEntry::Wrench(wrench(8)));
        assert_eq!(file.check_whole(), Ok(()));
        file.take(WRENCH, &eighth).unwrap();
        assert_eq!(file.take(SHOWN, &shown), Err(other.into()));
        let shown = channel(SHOWN, "inner_telemetry", BTreeMap::new());
        for schema in [None, Some(&schema::descriptor_set::<Wrench>()[..])] {
            assert!(!Assembly::new().take_channel(&shown, schema));
        }
    }
}
