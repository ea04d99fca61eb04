//! Writes the flight log: chooses what is kept, and begins a new file when one is long enough.
//!
//! ```text
//!   messages --all, or the excerpt--> flight.mcap --long enough--> flight.1.mcap ... flight.N.mcap
//!                                     closed in the background      the newest few are kept, or all
//! ```
//!
//! Every file has its own index and facts, and says which one goes on. A full disk costs messages, which are counted,
//! but never the flight.

use crate::async_writer::{AsyncWriter, Disk, LEFT_FREE_BYTES, compare};
use crate::entry::{Counts, LogEntry};
use crate::event_log::EventLog;
use crate::facts::{CONTINUED_IN, Facts, INJECTED, Record};
pub use crate::log_file::CHUNK_NS;
use crate::log_file::{FileFate, LogFile};
use crate::reader::LogReader;
use crate::{TOPICS, file_name};
use errors::{Failure, InFile as _};
use mcap::McapError;
use std::collections::VecDeque;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::{fs, io};

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fate {
    /// Length of the files that are kept [bytes].
    pub file_bytes: u64,
    pub files: u64,
    /// In them, or on their way to a disk that has taken everything so far.
    pub written: Counts,
    /// Not in them. Messages that wait for a disk that has refused some are not, until it takes them.
    pub dropped: Counts,
    /// Not wanted: no event was near.
    pub left_out: Counts,
    /// In files that were removed, because newer ones are kept.
    pub removed: Counts,
    pub stretches: u64,
    pub refused: Option<String>,
    /// Why its files may lack something.
    pub gap: Option<String>,
}

pub struct FlightLog {
    first_path: PathBuf,
    facts: Facts,
    excerpt: Option<EventLog>,
    file: LogFile,
    part: u64,
    /// The file before it, until the disk has it.
    closing: Option<LogFile>,
    /// The files before that one that are kept.
    closed: VecDeque<FileFate>,
    removed: Counts,
    /// Not in the files that were removed either.
    dropped: Counts,
    refused: Option<String>,
    injected: Record,
    /// Whether the present file has that.
    has_injected: bool,
}

impl FlightLog {
    /// A log with its schemas and facts, before the first message.
    pub fn create(path: &Path, facts: &Facts) -> Result<Self, Failure> {
        let file = File::create(path).in_file("write", path)?;
        let output = AsyncWriter::new(file, LEFT_FREE_BYTES).in_file("write", path)?;
        Ok(Self {
            first_path: path.to_owned(),
            facts: facts.clone(),
            excerpt: facts.plan.around_ticks.map(EventLog::new),
            file: LogFile::begin(output, facts, 0, 0).in_file("write", path)?,
            part: 0,
            closing: None,
            closed: VecDeque::new(),
            removed: [0; TOPICS.len()],
            dropped: [0; TOPICS.len()],
            refused: None,
            injected: Record::new(),
            has_injected: true,
        })
    }

    /// Takes a message. Messages of several logs that were taken at the same position belong together.
    pub fn take(&mut self, entry: &LogEntry, position: u64) {
        let Self { excerpt, file, .. } = self;
        match excerpt {
            // An excerpt is not replayed.
            Some(excerpt) => excerpt.take(*entry, |entry| file.take(entry, position)),
            None => file.take(entry, position),
        }
    }

    /// Ends a chunk when it is time, and hands it to the disk; to be called often.
    pub fn keep(&mut self, now_ns: u64) -> Result<(), Failure> {
        let is_handed_over = self.file.keep(now_ns).map_err(broken)?;
        if let Some(closed) = self.closing.take_if(LogFile::is_on_disk) {
            self.closed.push_back(closed.fate());
        }
        // Between two chunks: nothing is half compressed. If this process is killed, the file has it.
        if is_handed_over {
            self.write_injected()?;
        }
        // While the disk has not taken the file before, no other one is begun.
        if is_handed_over
            && self.file.length() >= self.facts.plan.file_bytes
            && self.closing.is_none()
        {
            self.begin_next_file()?;
        }
        Ok(())
    }

    fn begin_next_file(&mut self) -> Result<(), Failure> {
        let next = self.part + 1;
        let files = self.facts.plan.files;
        let removed = files.and_then(|files| next.checked_sub(files));
        let path = |part| self.path(part);
        let disk = NextFile {
            path: path(next),
            removes: removed.map(path),
            file: OnceLock::new(),
        };
        let output = AsyncWriter::new(disk, LEFT_FREE_BYTES).in_file("write", &path(next))?;
        let file = LogFile::begin(output, &self.facts, next, self.file.newest_sample_ns)
            .map_err(broken)?;
        let mut landing = self.messages();
        landing.insert(CONTINUED_IN.into(), file_name(next));
        let mut before = std::mem::replace(&mut self.file, file);
        before.close(landing).map_err(broken)?;
        self.closing = Some(before);
        self.part = next;
        // The files before may be removed.
        self.has_injected = self.injected.is_empty();
        if removed.is_some() {
            let removed = self.closed.pop_front().unwrap_or_default();
            self.refused = self.refused.take().or(removed.refused);
            add(&mut self.removed, removed.written);
            add(&mut self.dropped, removed.dropped);
        }
        Ok(())
    }

    pub fn fate(&self) -> Fate {
        let excerpt = self.excerpt.as_ref();
        let mut fate = Fate {
            removed: self.removed,
            dropped: self.dropped,
            left_out: excerpt.map_or([0; TOPICS.len()], |it| it.left_out),
            stretches: excerpt.map_or(0, |it| it.stretches),
            refused: self.refused.clone(),
            ..Fate::default()
        };
        for file in self.files() {
            fate.refused = fate.refused.or(file.refused);
            fate.gap = fate.gap.or(file.gap);
            fate.files += 1;
            fate.file_bytes += file.bytes;
            add(&mut fate.written, file.written);
            add(&mut fate.dropped, file.dropped);
        }
        fate
    }

    /// Messages that the log has held so far, by topic, as its reader counts them.
    fn messages(&self) -> Record {
        let fate = self.fate();
        let mut all = fate.written;
        add(&mut all, fate.dropped);
        add(&mut all, fate.removed);
        let counts = TOPICS.iter().zip(all);
        counts
            .map(|(topic, count)| (format!("messages.{topic}"), count.to_string()))
            .collect()
    }

    /// Takes what was injected into the flight so far; the file has it with its next chunk.
    pub fn tell_injected(&mut self, injected: Record) {
        self.has_injected = injected.is_empty();
        self.injected = injected;
    }

    fn write_injected(&mut self) -> Result<(), Failure> {
        if self.has_injected {
            return Ok(());
        }
        self.has_injected = true;
        let injected = self.injected.clone();
        self.file.add_metadata(INJECTED, injected).map_err(broken)
    }

    /// Ends the log with its last facts and its index; says what became of the messages.
    pub fn finish(mut self, mut last_facts: Record) -> Result<Fate, Failure> {
        self.write_injected()?;
        let Self { excerpt, file, .. } = &mut self;
        if let Some(excerpt) = excerpt {
            excerpt.finish(|entry| file.take(entry, 0));
        }
        last_facts.extend(self.messages());
        self.file.close(last_facts).map_err(broken)?;
        let files = self.closing.iter_mut().chain([&mut self.file]);
        files.for_each(LogFile::wait);
        let mut fate = self.fate();
        let checked = self.check_files().map_err(|failure| failure.to_string());
        fate.gap = fate.gap.or(checked.err());
        Ok(fate)
    }

    /// State of the files that are kept, in order.
    fn files(&self) -> impl Iterator<Item = FileFate> {
        let open = self.closing.iter().chain([&self.file]);
        self.closed.iter().cloned().chain(open.map(LogFile::fate))
    }

    /// Checks that all files are as they were left. If one may have been written into, the log is read.
    fn check_files(&self) -> Result<(), Failure> {
        let first = self.part + 1 - self.files().count() as u64;
        let mut is_doubtful = false;
        for (part, file) in (first..).zip(self.files()) {
            let (path, condition) = (self.path(part), file.condition);
            // A file that could not be created was not left.
            if let Some(left) = condition.left {
                let there = fs::symlink_metadata(&path).in_file("find", &path)?;
                is_doubtful |= compare(&left, &there).in_file("trust", &path)?;
            }
            is_doubtful |= condition.is_doubtful;
        }
        let path = self.path(first);
        let mut log = is_doubtful.then(|| LogReader::open(&path)).transpose()?;
        while let Some(log) = &mut log
            && log.next_entry()?.is_some()
        {}
        Ok(())
    }

    fn path(&self, part: u64) -> PathBuf {
        self.first_path.with_file_name(file_name(part))
    }
}

/// A file that the thread at the disk makes when its first bytes come, and that takes the place of an older one.
struct NextFile {
    path: PathBuf,
    removes: Option<PathBuf>,
    file: OnceLock<File>,
}

impl Disk for NextFile {
    fn file(&self) -> io::Result<&File> {
        if let Some(file) = self.file.get() {
            return Ok(file);
        }
        let file = File::create(&self.path)?;
        if let Some(oldest) = &self.removes {
            // One that resists costs room, and no message.
            let _ = fs::remove_file(oldest);
        }
        Ok(self.file.get_or_init(|| file))
    }
}

fn add(sum: &mut Counts, counts: Counts) {
    sum.iter_mut()
        .zip(counts)
        .for_each(|(sum, count)| *sum += count);
}

fn broken(error: McapError) -> Failure {
    Failure::failed(format!("cannot write the flight log: {error}"))
}
