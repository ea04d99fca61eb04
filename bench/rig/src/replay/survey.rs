//! Checks a log before it is replayed: undamaged, of this version and one run, no gap.

use std::collections::BTreeMap;
use std::path::Path;

use model::envelope::{Envelope, LAYOUT, Message};
use model::grid::Pace;
use model::messages::{State, SwapRecord};
use model::settings_text::fingerprint;
use model::topic::Topic;

use crate::settings::trajectory::is_file;
use crate::settings::{PointsFile, Settings};
use failure::Failure;
use flight_log::TOPICS;
use flight_log::build::Build;
use flight_log::codec::Logged;
use flight_log::entry::LogEntry;
use flight_log::facts::{POINTS, RUN, SETTINGS};
use flight_log::reader::{End, Kept, LogReader};
use report::text::count;

/// A log that can be replayed.
#[derive(Clone, Debug)]
pub struct Survey {
    /// The executable that flew it.
    pub build: Build,
    /// Settings of the flight.
    pub settings: Settings,
    /// What moved its ticks on.
    pub pace: Pace,
    /// Its swaps, in order.
    pub swaps: Vec<Message<SwapRecord>>,
    /// How far the log goes.
    pub end: End,
    /// Tick of the newest state.
    pub last_tick: Option<u64>,
}

/// Looks through a log.
///
/// # Errors
/// [`Failure`] says what does not hold.
pub fn survey(path: &Path) -> Result<Survey, Failure> {
    let mut reader = LogReader::open(path)?;
    let Some(first) = reader.next_entry()?.copied() else {
        return Err(match reader.end() {
            End::Complete => Failure::failed(format!("{} holds no message: nothing was flown", path.display())),
            End::Truncated => Failure::failed(format!("{} is truncated before its first message", path.display()))
                .help("nothing can be replayed or exported from it; name another flight"),
        });
    };
    reader.check_version()?;
    check_whole(&reader, path)?;
    let settings = settings_of(&reader)?;
    let mut expected = ExpectedMessages::new(&reader)?;
    let mut swaps = Vec::new();
    let mut newest: Option<Message<State>> = None;
    let mut next = Some(&first);
    while let Some(entry) = next {
        match entry {
            LogEntry::State(message) => {
                expected.check(message)?;
                newest = Some(*message);
            }
            LogEntry::Setpoint(message) => expected.check(message)?,
            LogEntry::Wrench(message) => expected.check(message)?,
            LogEntry::RotorSpeeds(message) => expected.check(message)?,
            LogEntry::Swap(message) => {
                expected.check(message)?;
                swaps.push(*message);
            }
        }
        next = reader.next_entry()?;
    }
    if reader.end() == End::Complete {
        expected.check_landing(&reader)?;
    }
    check_swaps(&swaps, newest.as_ref(), reader.end())?;
    let last_tick = newest.map(|message| message.envelope.tick);
    let build = reader.build();
    Ok(Survey { build, settings, pace: reader.pace()?, swaps, end: reader.end(), last_tick })
}

/// Refuses excerpts, and logs of which files were removed: the state that they begin with is not known.
fn check_whole(reader: &LogReader, path: &Path) -> Result<(), Failure> {
    let Kept { around_ticks, files_before } = reader.kept()?;
    let what = match around_ticks {
        Some(ticks) => format!("it keeps excerpts, {} before and after each event", count(ticks, "tick")),
        None if files_before > 0 => format!("it is not the log's first file; missing before it: {files_before}"),
        None => return Ok(()),
    };
    Err(Failure::failed(format!("{} cannot be replayed: {what}", path.display())).help(
        "a state depends on everything before it, so that only a whole log can be flown again: `fly --log all`, with \
         `recorder.log_files = 0`; `ironbird export` gives what is there",
    ))
}

/// The settings in a log, if they are those that its processes agreed on.
fn settings_of(reader: &LogReader) -> Result<Settings, Failure> {
    let text = reader.fact(SETTINGS, "settings.toml")?;
    let mut settings: Settings = toml::from_str(text).map_err(|e| reader.damaged(&format!("its settings: {e}")))?;
    if is_file(&settings.flight.trajectory) {
        let points = PointsFile::of(reader.fact(SETTINGS, POINTS)?.to_owned());
        let points = points.map_err(|e| reader.damaged(&format!("its {POINTS}: {e}")))?;
        settings.take_points(points).map_err(|e| reader.damaged(&e.to_string()))?;
    }
    let shared = settings.shared_text()?;
    let (flown, agreed) = (reader.fact(SETTINGS, "shared")?, reader.fact(RUN, "settings")?);
    if shared != flown {
        return Err(reader.damaged("its settings.toml is not what its processes shared"));
    }
    let here = format!("{:016x}", fingerprint(&shared));
    if here != agreed {
        return Err(reader.damaged(&format!("its settings have the fingerprint {here}, its run {agreed}")));
    }
    Ok(settings)
}

/// Every swap that a state knows must be there; a truncated log may end between them.
fn check_swaps(swaps: &[Message<SwapRecord>], newest: Option<&Message<State>>, end: End) -> Result<(), Failure> {
    for (expected, swap) in (1..).zip(swaps) {
        let epoch = swap.content.parameter_epoch;
        if epoch != expected {
            return Err(gap(&format!("swap {expected} is missing: after {} comes {epoch}", expected - 1)));
        }
    }
    let known = newest.map_or(0, |message| message.content.parameter_epoch);
    if known > swaps.len() as u64 && end == End::Complete {
        return Err(gap(&format!("its last state knows {known} swaps, and it holds {}", swaps.len())));
    }
    Ok(())
}

/// A failure of a log that lacks something.
pub(super) fn gap(what: &str) -> Failure {
    Failure::failed(format!("the log has a gap: {what}"))
        .help("a flight can be replayed from a whole record alone; report.txt says what the recorder lost, and why")
}

/// What the messages of a log have in common, and which ones come next.
struct ExpectedMessages {
    run_id: u64,
    settings: u64,
    /// Messages by topic.
    messages: BTreeMap<&'static str, u64>,
    /// Epoch and sequence of the newest message, by topic.
    newest: BTreeMap<&'static str, Envelope>,
}

impl ExpectedMessages {
    fn new(reader: &LogReader) -> Result<Self, Failure> {
        let text = reader.fact(RUN, "settings")?;
        let settings = u64::from_str_radix(text, 16).map_err(|_| {
            reader.damaged(&format!("its record `{RUN}` has settings = `{text}`, which is no fingerprint"))
        })?;
        Ok(Self { run_id: reader.number("run_id")?, settings, messages: BTreeMap::new(), newest: BTreeMap::new() })
    }

    /// Whether the log holds what its recorder wrote, and every state that the plant published.
    fn check_landing(&self, reader: &LogReader) -> Result<(), Failure> {
        for topic in TOPICS {
            let holds = self.messages.get(topic).copied().unwrap_or(0);
            let written = reader.landed(&format!("messages.{topic}"))?;
            if written.is_none_or(|written| written != holds) {
                let written = written.map_or_else(|| "does not say how many".into(), |n| format!("wrote {n}"));
                return Err(gap(&format!("it holds {holds} messages of topic `{topic}`, and its recorder {written}")));
            }
        }
        let states = self.messages.get(State::NAME).copied().unwrap_or(0);
        match reader.landed("ticks_run")? {
            // A plant that dies may have published a state that it has not counted yet.
            Some(published) if states < published => Err(gap(&format!(
                "the plant published {published} states, and it holds {states}: the last {} are missing",
                published - states
            ))),
            _ => Ok(()),
        }
    }

    fn check<C: Logged>(&mut self, message: &Message<C>) -> Result<(), Failure> {
        let (topic, envelope) = (<C as Topic>::NAME, &message.envelope);
        let Envelope { layout, run_id, settings, epoch, seq, tick, .. } = *envelope;
        if layout != LAYOUT || run_id != self.run_id || settings != self.settings {
            return Err(Failure::failed(format!(
                "the log mixes runs: message {seq} of topic `{topic}` (tick {tick}) has run {run_id} and settings \
                 {settings:016x}, the log has run {} and settings {:016x}",
                self.run_id, self.settings
            )));
        }
        *self.messages.entry(topic).or_default() += 1;
        let last = self.newest.insert(topic, *envelope);
        let same_sender = last.filter(|last| last.epoch == epoch);
        let owed = same_sender.map_or(0, |last| last.seq + 1);
        if seq != owed {
            let missing = seq.wrapping_sub(owed);
            return Err(gap(&format!("topic `{topic}` lacks {} before tick {tick}", count(missing, "message"))));
        }
        let rises = last.is_none_or(|last| last.tick + u64::from(!C::MANY_PER_TICK) <= tick && last.epoch <= epoch);
        if !rises {
            return Err(gap(&format!("topic `{topic}` goes back to tick {tick}")));
        }
        Ok(())
    }
}
