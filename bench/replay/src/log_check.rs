//! Checks a log while it is read: undamaged, of this version and a single run, without a gap.

use std::path::{Path, PathBuf};

use messages::content::SwapRecord;
use messages::grid::Pace;
use messages::header::Message;
use messages::role::{Channel, Role};
use messages::settings_text::fingerprint;
use redundancy::Arrangement;

use config::law_settings::{LAW, SHA256};
use config::trajectory::is_file;
use config::{PointsFile, Settings};
use errors::Failure;
use faults::grammar::{Change, Fault};
use flight_log::build::{Build, executable};
use flight_log::entry::LogEntry;
use flight_log::facts::{CHANNEL, INJECTED, POINTS, RUN, SETTINGS};
use flight_log::fault_record::injected;
use flight_log::reader::{End, LogReader};
use sim::expected_messages::{ExpectedMessages, gap};
pub use sim::recorded_timing::first_of;
use sim::recorded_timing::{check_whole, recorded_settings};
use toml::Table;

/// Parameter changes that a replay keeps at the most.
const MOST_SWAPS: usize = 100_000;

#[derive(Clone, Debug)]
pub struct LogCheck {
    /// The log, or the first file of a channel's that is truncated.
    pub log: PathBuf,
    pub build: Build,
    pub settings: Settings,
    pub pace: Pace,
    pub swaps: Vec<Message<SwapRecord>>,
    pub end: End,
    pub last_tick: Option<u64>,
}

pub struct LogValidator {
    pub reader: LogReader,
    /// As the processes of the log's channel had them.
    pub settings: Settings,
    /// The channel whose own log it is; none of the log of a flight.
    pub channel: Option<Channel>,
    pub arrangement: Arrangement,
    pub expected: ExpectedMessages,
    swaps: Vec<Message<SwapRecord>>,
}

impl LogValidator {
    /// Checks the log's header and its first message.
    pub fn open(path: &Path, moved: &[(Role, PathBuf)]) -> Result<Self, Failure> {
        let mut reader = LogReader::open(path)?;
        first_of(&mut reader)?;
        reader.check_version()?;
        check_whole(&reader, path)?;
        let mut settings = settings_of(&reader)?;
        take_moved(&mut settings, moved)?;
        take_injected(&mut settings, &reader, path)?;
        let channel = reader.fact(RUN, CHANNEL).ok();
        let channel = Channel::ALL
            .into_iter()
            .find(|it| Some(it.name()) == channel);
        let arrangement = settings.arrangement();
        let settings = settings.of_channel(channel.unwrap_or(Channel::A));
        let expected = ExpectedMessages::new(&reader, &settings)?;
        Ok(Self {
            reader,
            settings,
            channel,
            arrangement,
            expected,
            swaps: Vec::new(),
        })
    }

    /// Reads to the end of the log and passes on each valid message, with the number of its chunk and its position.
    pub fn look_through(
        mut self,
        mut hand_on: impl FnMut(u64, u64, &LogEntry),
    ) -> Result<LogCheck, Failure> {
        let mut newest = None;
        // The first message was read when the log was opened.
        let mut is_there = true;
        while is_there {
            let entry = self.reader.newest();
            self.expected.check(entry)?;
            match entry {
                LogEntry::State(Message { envelope, content }) => {
                    newest = Some((envelope.tick, content.parameter_epoch));
                }
                LogEntry::Swap(_) if self.swaps.len() == MOST_SWAPS => {
                    let what = format!("it has more than {MOST_SWAPS} parameter changes");
                    return Err(self.reader.damaged(&what));
                }
                LogEntry::Swap(message) => self.swaps.push(*message),
                _ => {}
            }
            hand_on(self.reader.chunks, self.reader.position(), entry);
            is_there = self.reader.next_entry()?.is_some();
        }
        let (reader, swaps) = (self.reader, self.swaps);
        if reader.end() == End::Complete {
            self.expected.check_landing(&reader)?;
        }
        check_swaps(
            &swaps,
            newest.map_or(0, |(_, parameter_epoch)| parameter_epoch),
            reader.end(),
        )?;
        Ok(LogCheck {
            log: reader.path().to_owned(),
            build: reader.build(),
            settings: self.settings,
            pace: reader.pace()?,
            swaps,
            end: reader.end(),
            last_tick: newest.map(|(tick, _)| tick),
        })
    }
}

/// The settings in a log, if they are those that its processes agreed on.
pub fn settings_of(reader: &LogReader) -> Result<Settings, Failure> {
    let mut settings = recorded_settings(reader)?;
    if is_file(&settings.flight.trajectory) {
        let tolerance = settings.trajectory.tolerance;
        let points = PointsFile::of(reader.fact(SETTINGS, POINTS)?.to_owned(), tolerance);
        let points = points.map_err(|e| reader.damaged(&format!("its {POINTS}: {e}")))?;
        settings
            .take_points(points)
            .map_err(|e| reader.damaged(&e.to_string()))?;
    }
    let shared = settings.shared_text()?;
    let (flown, agreed) = (
        reader.fact(SETTINGS, "shared")?,
        reader.fact(RUN, "settings")?,
    );
    // Settings that are newer than the flight have their defaults, and are not in what its processes shared.
    let defaults = Settings::resolve(None, &Vec::new())?.shared_text()?;
    let is_newer = |line: &&str| {
        let (key, _) = line.split_once('=').unwrap_or_default();
        defaults.lines().any(|it| it == *line) && !flown.lines().any(|it| it.starts_with(key))
    };
    if !shared.lines().filter(|it| !is_newer(it)).eq(flown.lines()) {
        let mut what = "its settings.toml is not what its processes shared".to_owned();
        let (there, here) = (reader.build(), executable());
        if there != here {
            what += &format!(", or {there}, which flew it, has other settings than {here}");
        }
        return Err(reader.damaged(&what));
    }
    let here = format!("{:016x}", fingerprint(flown));
    if here != agreed {
        return Err(reader.damaged(&format!(
            "its settings have the fingerprint {here}, its run {agreed}"
        )));
    }
    Ok(settings)
}

/// Adds message faults of the flight as if they had been planned. Process faults show in the ticks that the processes ran.
fn take_injected(settings: &mut Settings, reader: &LogReader, path: &Path) -> Result<(), Failure> {
    for text in injected(path)? {
        let fault: Fault = text
            .parse()
            .map_err(|e| reader.damaged(&format!("its record `{INJECTED}` has `{text}`: {e}")))?;
        let mut kinds = fault.changes.iter().flat_map(Change::kinds);
        if kinds.any(|(kind, _)| kind.port().is_some()) {
            settings.flight.faults.push(text);
        }
    }
    settings.planned().map(drop).map_err(|e| {
        reader.damaged(&format!(
            "the faults of its record `{INJECTED}` do not go together: {e}"
        ))
    })
}

/// Takes the new places of law libraries, each for the flown file with its SHA-256, and refuses other laws.
fn take_moved(settings: &mut Settings, moved: &[(Role, PathBuf)]) -> Result<(), Failure> {
    let usage = "a replay flies the same files: `ironbird replay --outer | --inner | --mixer FILE` says where they are now";
    for (role, file) in moved {
        let of_channels = settings
            .channel_laws()
            .map(|(_, role, section)| (role, section));
        let sections = settings.law_sections().into_iter().chain(of_channels);
        let word = |section: &Table, key| Some(section.get(key)?.as_str()?.to_owned());
        let flown: Vec<(String, Option<String>)> = sections
            .filter(|(it, _)| it == role)
            .filter_map(|(_, section)| Some((word(section, LAW)?, word(section, SHA256))))
            .collect();
        let is_file = |it: &&(String, _)| plugin::is_file(&it.0);
        let Some((first, _)) = flown.iter().find(is_file) else {
            return Err(Failure::usage(format!(
                "--{role} {}: the flight flew the {role} law `{}`, which is built in",
                file.display(),
                flown[0].0
            ))
            .help("a replay flies the laws of the flight: leave the flag out"));
        };
        let here = Some(plugin::open(*role, file)?.sha256.clone());
        let place = flown.iter().find(|(_, sha256)| *sha256 == here);
        let place = place.map_or(first, |(place, _)| place);
        settings.moved.insert(place.clone(), file.clone());
    }
    // Loaded now: what is not there is said before the log is read.
    let loaded = settings.laws().map(drop);
    loaded
        .and_then(|()| settings.named_channel_laws().map(drop))
        .map_err(|failure| failure.help(usage))
}

/// Every swap known to the last state must be in the log; a truncated log may end in between.
fn check_swaps(swaps: &[Message<SwapRecord>], known: u64, end: End) -> Result<(), Failure> {
    for (expected, swap) in (1..).zip(swaps) {
        let epoch = swap.content.parameter_epoch;
        if epoch != expected {
            return Err(gap(&format!(
                "parameter change {expected} is missing: after {} comes {epoch}",
                expected - 1
            )));
        }
    }
    if known > swaps.len() as u64 && end == End::Complete {
        return Err(gap(&format!(
            "its last state knows {known} parameter changes, and it holds {}",
            swaps.len()
        )));
    }
    Ok(())
}
