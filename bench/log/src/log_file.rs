//! One file of the flight log: messages in chunks, the scene, and what its reader needs to begin with it.
//!
//! There is one chunk per [`CHUNK_NS`]. Inside a chunk the messages are grouped by topic, because zstd compresses
//! similar data best. After a killed recorder the file is readable up to the last chunk.

use crate::async_writer::{AsyncWriter, Condition};
use crate::codec::{Logged, encode};
use crate::entry::{Counts, FORMATS, LogEntry, with_message};
use crate::facts::{Facts, LANDING, Record};
use crate::scene::Placed;
use crate::telemetry::{BESIDE, TelemetryTopic, place};
use crate::{TOPICS, scene, units};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};
use messages::grid::{NS_PER_S, Pace};
use messages::header::Message;
use messages::monitor::Monitor;
use messages::telemetry::LAW_ROLES;
use messages::topic::Topic;
use std::collections::{BTreeMap, VecDeque};

/// Longest time between two chunks [ns].
pub const CHUNK_NS: u64 = NS_PER_S / 2;
/// A chunk is compressed within this time [ns].
const COMPRESSION_NS: u64 = CHUNK_NS / 2;
/// Longest chunk before it is compressed [bytes]; in lockstep the clock would make longer ones.
const CHUNK_BYTES: usize = 1 << 20;
/// Level of zstd: up to 15 nothing gets smaller beyond 6, and at 3 a flight is a thirtieth larger. But compressing is a
/// burst beside the loops, whose 99th percentile it can be, and at 3 it takes half as long.
const LEVEL: i32 = 3;
/// The same in lockstep, where ticks come as fast as the recorder takes them: against level 1, a tenth more bytes in half
/// the time, which a replay reads in little more than half.
const LOCKSTEP_LEVEL: i32 = -3;

#[derive(Clone, Debug, Default)]
pub(crate) struct FileFate {
    pub bytes: u64,
    /// Messages in it, or on their way to a disk that has taken everything so far.
    pub written: Counts,
    pub dropped: Counts,
    pub refused: Option<String>,
    /// Why the file may lack something.
    pub gap: Option<String>,
    pub condition: Condition,
}

/// Messages of a channel, each with what belongs right behind it.
#[derive(Default)]
struct Part {
    /// Each with the end of its bytes.
    headers: Vec<(MessageHeader, usize)>,
    bytes: Vec<u8>,
}

impl Part {
    /// Adds a message, whose bytes `encode` appends; gives their number.
    fn add(&mut self, header: MessageHeader, encode: impl FnOnce(&mut Vec<u8>)) -> usize {
        let begin = self.bytes.len();
        encode(&mut self.bytes);
        self.headers.push((header, self.bytes.len()));
        self.bytes.len() - begin
    }
}

pub(crate) struct LogFile {
    writer: Writer<NoSeek<AsyncWriter>>,
    output: AsyncWriter,
    pace: Pace,
    pub(crate) newest_sample_ns: u64,
    channels: BTreeMap<&'static str, u16>,
    /// What the laws show, each with its channel, in the order of [`LAW_ROLES`].
    telemetry: [Option<(u16, TelemetryTopic)>; LAW_ROLES.len()],
    scene_every_ticks: u64,
    scene_sequence: [u32; scene::CHANNELS.len()],
    chunk: BTreeMap<u16, Part>,
    /// What is still to be written of the chunk before it.
    ending: VecDeque<Part>,
    /// When that chunk ended [ns], and how many channels it had.
    ending_since: (u64, usize),
    /// Empty parts for reuse: new memory costs as much as the messages.
    spare: Vec<Part>,
    /// Messages that had come when that one ended, without those that were dropped.
    ended: Counts,
    taken: Counts,
    /// Messages of these that were dropped, as the disk was too slow for them.
    dropped: Counts,
    /// Lengths at which the file is readable that have not reached the disk, with what is before them.
    chunks: VecDeque<(u64, Counts)>,
    settled: (u64, Counts),
    next_chunk_ns: u64,
    chunk_bytes: usize,
}

impl LogFile {
    /// A file with its schemas and facts, before its first message; `newest_sample_ns` is of the file before it.
    pub fn begin(
        output: AsyncWriter,
        facts: &Facts,
        part: u64,
        newest_sample_ns: u64,
    ) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .library(concat!("ironbird ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(match facts.pace {
                // zstd takes it as signed.
                Pace::Lockstep => LOCKSTEP_LEVEL.cast_unsigned(),
                Pace::Realtime(_) => LEVEL.cast_unsigned(),
            })
            // Chunks go to the output whole, compressed by this thread; they end when they are flushed.
            .compression_threads(0)
            .disable_seeking(true)
            .chunk_size(None);
        let mut writer = Writer::with_options(NoSeek::new(output.clone()), options)?;
        for (name, metadata) in facts.records(part) {
            let name = name.into();
            writer.write_metadata(&Metadata { name, metadata })?;
        }
        let shown = LAW_ROLES.map(|role| TelemetryTopic::new(role, facts.signals.of(role)));
        let mut channels = BTreeMap::new();
        let mut add = |topic, schema: &str, set: &[u8], metadata| {
            let schema = writer.add_schema(schema, "protobuf", set)?;
            writer.add_channel(schema, topic, "protobuf", &metadata)
        };
        for topic in FORMATS {
            let mut metadata = (topic.describe)();
            let shown = place(topic.sender).and_then(|place| shown[place].as_ref());
            metadata.extend(shown.map(|shown| (BESIDE.to_owned(), shown.topic().to_owned())));
            let why_not = facts.no_theorem.as_deref();
            let why_not = why_not.filter(|_| topic.name == Monitor::NAME);
            metadata.extend(why_not.map(units::not_applicable));
            let (schema, set) = ((topic.schema_name)(), (topic.descriptor_set)());
            channels.insert(topic.name, add(topic.name, &schema, &set, metadata)?);
        }
        let mut telemetry = [const { None }; LAW_ROLES.len()];
        for (telemetry, shown) in telemetry.iter_mut().zip(shown) {
            let Some(shown) = shown else { continue };
            let (schema, set) = (shown.schema_name(), shown.descriptor_set());
            let channel = add(shown.topic(), &schema, &set, shown.metadata())?;
            *telemetry = Some((channel, shown));
        }
        let set = scene::descriptor_set();
        for (topic, schema) in scene::CHANNELS {
            channels.insert(topic, add(topic, schema, &set, BTreeMap::new())?);
        }
        let mut file = Self {
            writer,
            output,
            pace: facts.pace,
            newest_sample_ns,
            channels,
            telemetry,
            scene_every_ticks: scene::every_ticks(facts.sample_time_ns),
            scene_sequence: [0; scene::CHANNELS.len()],
            chunk: BTreeMap::new(),
            ending: VecDeque::new(),
            ending_since: (0, 0),
            spare: Vec::new(),
            ended: [0; TOPICS.len()],
            taken: [0; TOPICS.len()],
            dropped: [0; TOPICS.len()],
            chunks: VecDeque::new(),
            settled: (0, [0; TOPICS.len()]),
            next_chunk_ns: 0,
            chunk_bytes: 0,
        };
        file.end_chunk()?;
        Ok(file)
    }

    /// Takes a message with its position in the recorder's order, and every few ticks puts airframe and reference into the
    /// scene.
    pub fn take(&mut self, entry: &LogEntry, position: u64) {
        self.taken[entry.topic()] += 1;
        with_message!(entry, message => self.write(message, position));
        match entry {
            LogEntry::State(message) => self.place(message, Placed::airframe),
            LogEntry::Setpoint(message) => self.place(message, Placed::reference),
            _ => {}
        }
    }

    fn write<C: Logged>(&mut self, message: &Message<C>, position: u64) {
        let envelope = &message.envelope;
        let log_time = self.log_time(message);
        // Where the sender is no stage there is no send time, and MCAP asks for the log time.
        let sent_ns = envelope.stamps_of(C::SENDER).send_ns;
        let header = MessageHeader {
            channel_id: self.channels[<C as Topic>::NAME],
            sequence: position as u32,
            log_time,
            publish_time: if sent_ns > 0 { sent_ns } else { log_time },
        };
        self.newest_sample_ns = self.newest_sample_ns.max(envelope.sample_ns);
        let part = part_of(&mut self.chunk, &mut self.spare, header.channel_id);
        self.chunk_bytes += part.add(header, |bytes| encode(message, bytes));
        let topic = place(C::SENDER).and_then(|place| self.telemetry[place].as_ref());
        if let (Some(telemetry), Some((channel_id, topic))) = (message.content.telemetry(), topic) {
            let mut header = header;
            header.channel_id = *channel_id;
            self.chunk_bytes += part.add(header, |bytes| {
                topic.encode(envelope.tick, telemetry, bytes);
            });
        }
    }

    /// When a message was sampled [ns]; where it goes back to no sample, the beginning of its tick, or in lockstep,
    /// where ticks have no place on the clock, the newest sample.
    fn log_time<C: Logged>(&self, message: &Message<C>) -> u64 {
        let Message { envelope, .. } = message;
        match self.pace {
            _ if envelope.sample_ns > 0 => envelope.sample_ns,
            Pace::Realtime(grid) => grid.begin_of(envelope.tick),
            Pace::Lockstep => self.newest_sample_ns,
        }
    }

    fn place<C: Logged>(&mut self, message: &Message<C>, placed: fn(u64, &C) -> Placed) {
        if !message.envelope.tick.is_multiple_of(self.scene_every_ticks) {
            return;
        }
        let placed = placed(self.log_time(message), &message.content);
        let publish_time = message.envelope.stamps_of(C::SENDER).send_ns;
        for (channel, bytes) in placed.messages() {
            let header = MessageHeader {
                channel_id: self.channels[scene::CHANNELS[channel].0],
                sequence: self.scene_sequence[channel],
                log_time: placed.at_ns,
                publish_time,
            };
            self.scene_sequence[channel] += 1;
            let part = part_of(&mut self.chunk, &mut self.spare, header.channel_id);
            self.chunk_bytes += part.add(header, |part| part.extend(bytes));
        }
    }

    /// Ends a chunk when it is time, and hands it to the disk; to be called often. Says whether all but the present
    /// chunk is handed over.
    ///
    /// By the clock, one channel per call: compressing a whole chunk takes several ticks and would disturb the loops. A
    /// recorder that is seldom called compresses as many as are due.
    pub fn keep(&mut self, now_ns: u64) -> Result<bool, McapError> {
        if self.ending.is_empty() {
            if now_ns < self.next_chunk_ns && self.chunk_bytes < CHUNK_BYTES {
                return Ok(false);
            }
            self.next_chunk_ns = now_ns + CHUNK_NS;
            self.begin_end();
            self.ending_since = (now_ns, self.ending.len());
        }
        let (since_ns, channels) = self.ending_since;
        let share = now_ns.saturating_sub(since_ns) as f64 / COMPRESSION_NS as f64;
        let due = (channels as f64 * share) as usize;
        let done = channels.saturating_sub(self.ending.len());
        self.compress(match self.pace {
            Pace::Lockstep => usize::MAX,
            Pace::Realtime(_) => due.saturating_sub(done).max(1),
        })?;
        let is_handed_over = self.ending.is_empty();
        if is_handed_over {
            self.hand_over()?;
        }
        Ok(is_handed_over)
    }

    /// Nothing more belongs to the present chunk. It is dropped where too much waits for the disk: the chunks after it
    /// need not be.
    fn begin_end(&mut self) {
        let chunk = std::mem::take(&mut self.chunk);
        self.chunk_bytes = 0;
        if self.pace == Pace::Lockstep {
            self.output.await_room();
        }
        if self.output.is_overfull() {
            self.dropped = less(self.taken, self.ended);
            self.output.note_dropped();
        } else {
            self.ending.extend(chunk.into_values());
        }
        self.ended = less(self.taken, self.dropped);
    }

    fn compress(&mut self, channels: usize) -> Result<(), McapError> {
        let channels = channels.min(self.ending.len());
        for mut part in self.ending.drain(..channels) {
            let mut begin = 0;
            for (header, end) in part.headers.drain(..) {
                let bytes = &part.bytes[begin..end];
                self.writer.write_to_known_channel(&header, bytes)?;
                begin = end;
            }
            part.bytes.clear();
            self.spare.push(part);
        }
        Ok(())
    }

    fn hand_over(&mut self) -> Result<(), McapError> {
        self.writer.flush()?;
        self.chunks.push_back((self.output.written(), self.ended));
        self.settle();
        Ok(())
    }

    /// Ends the present chunk, and what is left of the one before it.
    fn end_chunk(&mut self) -> Result<(), McapError> {
        self.begin_end();
        self.compress(usize::MAX)?;
        self.hand_over()
    }

    fn settle(&mut self) {
        let on_disk = self.output.settle();
        while let Some(chunk) = self.chunks.pop_front_if(|(length, _)| *length <= on_disk) {
            self.settled = chunk;
        }
    }

    /// Length of the file when everything that was handed over is there [bytes].
    pub fn length(&self) -> u64 {
        self.output.written()
    }

    pub fn fate(&self) -> FileFate {
        // A recorder that dies now leaves what has settled: what waits for a full disk is not promised.
        let refused = self.output.refused();
        let (bytes, written) = if refused.is_some() {
            self.settled
        } else {
            (self.output.written(), self.taken)
        };
        FileFate {
            bytes,
            written,
            dropped: less(self.taken, written),
            refused,
            gap: self.output.gap(),
            condition: self.output.condition(),
        }
    }

    /// Writes a fact that was not known at the beginning.
    pub fn add_metadata(&mut self, name: &str, metadata: Record) -> Result<(), McapError> {
        let name = name.into();
        // A record between two topics of a chunk would part it.
        self.compress(usize::MAX)?;
        self.writer.write_metadata(&Metadata { name, metadata })
    }

    /// Ends the file with its last facts and its index, and hands them to the disk without waiting.
    pub fn close(&mut self, last_facts: Record) -> Result<(), McapError> {
        self.end_chunk()?;
        self.add_metadata(LANDING, last_facts)?;
        self.writer.finish()?;
        self.chunks.push_back((self.output.written(), self.ended));
        self.output.end();
        Ok(())
    }

    /// Whether the disk has all of a file that was closed.
    pub fn is_on_disk(&mut self) -> bool {
        self.settle();
        self.chunks.is_empty() && self.output.is_at_rest()
    }

    /// Waits until the disk has all of a file that was closed, or takes nothing more.
    pub fn wait(&mut self) {
        self.output.finish();
        self.settle();
    }
}

fn part_of<'a>(
    chunk: &'a mut BTreeMap<u16, Part>,
    spare: &mut Vec<Part>,
    channel: u16,
) -> &'a mut Part {
    let new = || spare.pop().unwrap_or_default();
    chunk.entry(channel).or_insert_with(new)
}

/// The messages of some that are not of others.
fn less(all: Counts, others: Counts) -> Counts {
    std::array::from_fn(|topic| all[topic] - others[topic])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::async_writer::Disk;
    use crate::facts::LogPlan;
    use messages::content::{State, SwapRecord, Wrench};
    use messages::grid::Grid;
    use messages::telemetry::Signals;
    use std::fs::File;
    use std::io;
    use std::os::unix::fs::FileExt as _;
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;

    fn facts(plan: LogPlan) -> Facts {
        let run = [("version", env!("CARGO_PKG_VERSION"))];
        Facts {
            pace: Pace::Lockstep,
            sample_time_ns: 1_000_000,
            plan,
            signals: Signals::default(),
            no_theorem: None,
            records: vec![(crate::facts::RUN, crate::facts::record(&run))],
        }
    }

    fn file(disk: impl Disk) -> LogFile {
        let output = AsyncWriter::new(disk, 1).unwrap();
        LogFile::begin(output, &facts(LogPlan::WHOLE), 0, 0).unwrap()
    }

    /// States from `tick` on that make a chunk, and do not get smaller by being compressed.
    fn noise(tick: u64) -> Vec<Message<State>> {
        let mut bytes = Vec::new();
        encode(&Message::<State>::default(), &mut bytes);
        let count = CHUNK_BYTES.div_ceil(bytes.len()) as u64;
        let mut word = tick;
        let state = |tick| {
            let mut state = Message::of_tick(tick, State::default());
            let measured = &mut state.content.measured;
            let velocity_w_m_s = &mut measured.velocity_w_m_s;
            for value in measured.position_w_m.iter_mut().chain(velocity_w_m_s) {
                word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                *value = f64::from_bits(word >> 2);
            }
            state
        };
        (tick..tick + count).map(state).collect()
    }

    /// A disk that stands still until it is let go.
    struct Stuck(File, Arc<AtomicBool>);

    impl Disk for Stuck {
        fn file(&self) -> io::Result<&File> {
            Ok(&self.0)
        }

        fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
            while !self.1.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(1));
            }
            self.0.write_all_at(bytes, place)
        }
    }

    /// A file of a flight in real time, with a tick of three topics.
    fn realtime_file(path: &Path) -> LogFile {
        let output = AsyncWriter::new(File::create(path).unwrap(), 1).unwrap();
        let facts = Facts {
            pace: Pace::Realtime(Grid {
                t0_ns: 0,
                period_ns: 1_000_000,
            }),
            ..facts(LogPlan::WHOLE)
        };
        let mut file = LogFile::begin(output, &facts, 0, 0).unwrap();
        file.take(&LogEntry::State(Message::of_tick(1, State::default())), 1);
        file.take(&LogEntry::Wrench(Message::of_tick(1, Wrench::default())), 2);
        let swap = Message::of_tick(1, SwapRecord::default());
        file.take(&LogEntry::Swap(swap), 3);
        file
    }

    #[test]
    fn a_fact_that_comes_while_a_chunk_is_written_does_not_part_it() {
        let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
        let mut file = realtime_file(&path);
        assert!(!file.keep(CHUNK_NS).unwrap());
        file.add_metadata("fact", Record::new()).unwrap();
        file.close(Record::new()).unwrap();
        file.wait();
        let mut reader = crate::reader::LogReader::open(&path).unwrap();
        let mut chunks = Vec::new();
        while reader.next_entry().unwrap().is_some() {
            chunks.push(reader.chunks);
        }
        assert_eq!(chunks.len(), 3);
        chunks.dedup();
        assert_eq!(chunks.len(), 1);
    }

    #[test]
    fn a_chunk_is_written_in_parts_and_at_once_if_the_recorder_was_away() {
        let calls = |every_ns: u64| {
            let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
            let mut file = realtime_file(&path);
            let mut calls = 1..;
            calls.find(|call| file.keep(CHUNK_NS + call * every_ns).unwrap())
        };
        assert_eq!(calls(1_000_000), Some(3));
        assert_eq!(calls(CHUNK_NS), Some(2));
    }

    #[test]
    fn a_file_goes_on_after_what_a_slow_disk_had_no_room_for_and_is_whole() {
        let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
        let goes_on = Arc::new(AtomicBool::new(false));
        let disk = Stuck(File::create(&path).unwrap(), Arc::clone(&goes_on));
        let mut file = file(disk);
        let mut tick = 0;
        let mut chunk = |file: &mut LogFile, before_its_end: &dyn Fn()| {
            let (begin, states) = (tick, noise(tick));
            tick += states.len() as u64;
            for state in states {
                file.take(&LogEntry::State(state), 0);
            }
            before_its_end();
            assert!(file.keep(tick).unwrap());
            begin..tick
        };
        let mut kept = Vec::new();
        while !file.output.is_overfull() {
            kept.extend(chunk(&mut file, &|| ()));
        }
        let dropped = chunk(&mut file, &|| ());
        // In lockstep, it waits for a disk that goes on after a while.
        kept.extend(chunk(&mut file, &|| {
            let goes_on = Arc::clone(&goes_on);
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(50));
                goes_on.store(true, Ordering::Relaxed);
            });
        }));
        file.close(BTreeMap::new()).unwrap();
        file.wait();
        let fate = file.fate();
        let expected = (kept.len() as u64, dropped.count() as u64);
        assert_eq!((fate.written[0], fate.dropped[0]), expected);
        assert!(fate.refused.unwrap().contains("the disk is too slow"));
        assert_eq!(fate.bytes, path.metadata().unwrap().len());
        let mut reader = crate::reader::LogReader::open(&path).unwrap();
        let mut read = Vec::new();
        while let Some(entry) = reader.next_entry().unwrap() {
            read.push(entry.envelope().tick);
        }
        assert_eq!((read, reader.end()), (kept, crate::reader::End::Complete));
        // The index says the same.
        let bytes = std::fs::read(&path).unwrap();
        let statistics = mcap::Summary::read(&bytes).unwrap().unwrap().stats.unwrap();
        let channel = file.channels[<State as Topic>::NAME];
        assert_eq!(statistics.channel_message_counts[&channel], fate.written[0]);
    }
}
