//! The files that the recorder writes during a flight.
//!
//! One policy for all of them: a file that cannot be created refuses the flight. A file that can no longer be written
//! is incomplete, the report gives the first reason, and the flight and the other files go on.

use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use analysis::laws::FlownLaws;
use analysis::phrase::name_of;
use analysis::schema::{LogSection, Report};
use analysis::sections::log_section;
use analysis::series::SeriesSet;
use analysis::states::{Joined, StatesWriter};
use analysis::tracking::Tracking;
use errors::output::say;
use errors::{Failure, InFile as _};
use flight_log::entry::LogEntry;
use flight_log::facts::{Facts, Record};
use flight_log::writer::FlightLog;
use flight_log::{FILE, log_directory};
use ipc::clock::now_ns;
use messages::role::Channel;
use render::files::write_all;

use super::atomic_file::AtomicFileWriter;
use super::hlog::Hlog;
use crate::run_directory::{
    FACTS, LATENCIES, LATEST, SETTINGS, check_latest, is_ours, make_latest,
};
use config::{LogName, Settings, bytes_of, last_name};

/// Most bytes of a file from before take-off.
const BEFORE_BYTES: u64 = 16 << 20;

const REPORT: &str = "report.json";
const STATES: &str = "states.csv";

#[derive(Debug)]
pub struct Files {
    pub directory: PathBuf,
    /// Where a supervisor gets the final report, whatever the disk does.
    pub memory: Option<File>,
    /// Where to write the states a second time.
    pub states: Option<PathBuf>,
}

pub struct RunFiles<'a> {
    directory: &'a Path,
    memory: Option<&'a File>,
    latencies: Hlog<'a>,
    states: Vec<StatesWriter>,
    /// None if the settings switch them off; without those that broke. That of the flight, and with several channels each
    /// one's own.
    logs: VecDeque<(Option<Channel>, FlightLog)>,
    /// Number of the message that was released last.
    position: u64,
    log_name: String,
    /// report.json while the flight lasts.
    partial_report: AtomicFileWriter,
    is_latest: bool,
    /// Incomplete files, each with the first reason.
    pub incomplete: BTreeMap<String, String>,
    /// Content of the files from before take-off.
    before: Vec<(&'static str, Vec<u8>)>,
}

/// The log of the flight, or of a channel, in the directory of the flight.
fn log_file(channel: Option<Channel>) -> String {
    let of_channel = |channel| format!("{}/{FILE}", log_directory(channel));
    channel.map_or_else(|| FILE.into(), of_channel)
}

impl<'a> RunFiles<'a> {
    pub fn create(
        files: &'a Files,
        settings: &Settings,
        facts: &[(Option<Channel>, Facts)],
        latencies: Hlog<'a>,
        (tracking, laws): (Tracking, FlownLaws),
    ) -> Result<Self, Failure> {
        let directory = &files.directory;
        let every = settings.recorder.states_every_ticks;
        let states = std::iter::once(&directory.join(STATES))
            .chain(&files.states)
            .map(|path| StatesWriter::create(path, tracking, laws, every, true))
            .collect::<Result<_, _>>()?;
        let create = |(channel, facts): &(Option<Channel>, Facts)| {
            let file = directory.join(log_file(*channel));
            let directory = file.parent().unwrap_or(directory);
            fs::create_dir_all(directory).in_file("create", directory)?;
            let log = FlightLog::create(&file, facts);
            Ok((*channel, log?))
        };
        let logs = match settings.recorder.log {
            LogName::Off => VecDeque::new(),
            LogName::All | LogName::AroundMisses => {
                facts.iter().map(create).collect::<Result<_, Failure>>()?
            }
        };
        Ok(Self {
            directory,
            memory: files.memory.as_ref(),
            latencies,
            states,
            logs,
            position: 0,
            log_name: name_of(&settings.recorder.log),
            partial_report: AtomicFileWriter::new(directory.join(REPORT))?,
            is_latest: false,
            incomplete: BTreeMap::new(),
            before: [FACTS, SETTINGS]
                .into_iter()
                .filter_map(|name| {
                    Some((name, bytes_of(&directory.join(name), BEFORE_BYTES).ok()?))
                })
                .collect(),
        })
    }

    pub fn note(&mut self, file: impl Into<String>, written: Result<(), Failure>) {
        if let Err(failure) = written {
            self.incomplete
                .entry(file.into())
                .or_insert_with(|| failure.to_string());
        }
    }

    /// Writes a message to some of the logs: that of the flight, which is of no channel, or a channel's own.
    pub fn log(&mut self, entry: &LogEntry, is_wanted: impl Fn(Option<Channel>) -> bool) {
        for (channel, log) in &mut self.logs {
            if is_wanted(*channel) {
                log.take(entry, self.position);
            }
        }
    }

    /// Everything that is logged until the next call follows from the next message that was released.
    pub const fn next_position(&mut self) {
        self.position += 1;
    }

    pub fn log_injected(&mut self, injected: &Record) {
        for (_, log) in &mut self.logs {
            log.tell_injected(injected.clone());
        }
    }

    /// Hands full chunks of the next log to the disk; to be called often. More than one at once would disturb the loops.
    pub fn flush_log(&mut self) {
        let Some((channel, mut log)) = self.logs.pop_front() else {
            return;
        };
        match log.keep(now_ns()) {
            Ok(()) => self.logs.push_back((channel, log)),
            Err(failure) => self.note(log_file(channel), Err(failure)),
        }
    }

    pub fn write_state(&mut self, joined: &Joined) {
        self.each_states(|states| states.write(joined));
    }

    pub fn flush_states(&mut self) {
        self.each_states(StatesWriter::flush);
    }

    pub fn finish_states(&mut self) {
        self.each_states(StatesWriter::finish);
    }

    /// Acts on each file of states, also after one that failed.
    fn each_states(&mut self, act: impl Fn(&mut StatesWriter) -> Result<(), Failure>) {
        let mut failed = Vec::new();
        for (place, states) in self.states.iter_mut().enumerate() {
            if let Err(failure) = act(states) {
                let file = match place {
                    0 => STATES.to_owned(),
                    _ => states.path().display().to_string(),
                };
                failed.push((file, failure));
            }
        }
        failed
            .into_iter()
            .for_each(|(file, failure)| self.note(file, Err(failure)));
    }

    pub fn write_latencies(&mut self, series: &mut SeriesSet) {
        let written = self.latencies.close_interval(series);
        self.note(LATENCIES, written);
    }

    pub fn finish_latencies(&mut self, series: &mut SeriesSet) {
        let written = self
            .latencies
            .close_interval(series)
            .and_then(|()| self.latencies.finish());
        self.note(LATENCIES, written);
    }

    /// Writes report.json during the flight, and makes `latest` point to the flight once that file exists.
    pub fn write_partial_report(&mut self, report: &Report) {
        let text = analysis::json::to_string(report).in_file("write", Path::new(REPORT));
        let put = text.and_then(|text| self.partial_report.put(text + "\n"));
        self.note(REPORT, put);
        if !self.is_latest && self.directory.join(REPORT).exists() {
            self.is_latest = true;
            let pointed = make_latest(self.directory);
            self.note(LATEST, pointed);
        }
    }

    /// To be called before the final report is built: its own file is no longer incomplete.
    pub fn prepare_final_report(&mut self) {
        self.incomplete.remove(REPORT);
        if !self.is_latest {
            self.note(LATEST, check_latest(self.directory));
        }
    }

    /// Ends the log, then writes the final report.
    pub fn finish(mut self, report: &mut Report, ending: Record) {
        // The log is the last file that needs much room; the report says whether it is complete.
        for (channel, log) in std::mem::take(&mut self.logs) {
            match log.finish(ending.clone()) {
                Ok(fate) => {
                    if channel.is_none() {
                        analysis::gates::take_log(report, &self.log_name, &fate);
                    }
                    // Messages that the log of a flight lacks are counted.
                    let is_counted = channel.is_none() && report.unlogged() > 0;
                    let why = fate.gap.filter(|_| !is_counted).map(Failure::failed);
                    self.note(log_file(channel), why.map_or(Ok(()), Err));
                }
                Err(failure) => self.note(log_file(channel), Err(failure)),
            }
        }
        for (name, before) in std::mem::take(&mut self.before) {
            let change = match bytes_of(&self.directory.join(name), BEFORE_BYTES) {
                Ok(now) if now == before => continue,
                Ok(_) => "another program changed it".into(),
                Err(e) => e.to_string(),
            };
            self.note(name, Err(Failure::failed(change)));
        }
        report.recorder.unwritten = self.incomplete.clone();
        if self.incomplete.keys().any(|file| is_ours(last_name(file))) {
            analysis::gates::mark_incomplete(report);
        }
        // A disk that blocks keeps the report no longer than its files.
        self.hand_over(report);
        self.partial_report.close();
        write_all(report, self.directory);
        self.hand_over(report);
        let is_free = !self.is_latest && !self.incomplete.contains_key(LATEST);
        if is_free && let Err(failure) = make_latest(self.directory) {
            say(&format!("warning: {failure}\n"));
        }
    }

    fn hand_over(&self, report: &Report) {
        let (Some(memory), Ok(text)) = (self.memory, report.text()) else {
            return;
        };
        // If this fails, the supervisor reads the file.
        let cleared = memory.set_len(0);
        let _ = cleared.and_then(|()| memory.write_all_at(text.as_bytes(), 0));
    }

    pub fn log_section(&self) -> LogSection {
        let flown = self.logs.iter().find(|(channel, _)| channel.is_none());
        let fate = flown.map(|(_, log)| log.fate()).unwrap_or_default();
        log_section(&self.log_name, &fate)
    }
}
