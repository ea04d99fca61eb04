//! Whether a log has every message of its flight.

use analysis::phrase::count;
use config::Settings;
use errors::Failure;
use flight_log::TOPICS;
use flight_log::entry::{Counts, LogEntry};
use flight_log::facts::{CHANNEL, RUN};
use flight_log::reader::LogReader;
use messages::header::{LAYOUT, Message};
use messages::role::Channel;

pub fn gap(what: &str) -> Failure {
    Failure::failed(format!("the log has a gap: {what}"))
        .help("a flight can be repeated from a whole record alone; report.txt says what the recorder lost, and why, and which \
               processes died: a message of a process that died may have reached a loop, and not the recorder")
}

/// Common facts of all messages, and the next expected ones.
pub struct ExpectedMessages {
    pub run_id: u64,
    settings: u64,
    messages: Counts,
    /// Whether the messages of a topic are of changing channels, and not all of any.
    has_many_senders: bool,
    newest: [Option<Sent>; TOPICS.len()],
}

#[derive(Clone, Copy)]
struct Sent {
    epoch: u64,
    seq: u64,
    tick: u64,
}

impl ExpectedMessages {
    /// Those of a log with these settings.
    pub fn new(reader: &LogReader, settings: &Settings) -> Result<Self, Failure> {
        let text = reader.fact(RUN, "settings")?;
        let no_fingerprint =
            format!("its record `{RUN}` has settings = `{text}`, which is no fingerprint");
        Ok(Self {
            run_id: reader.number("run_id")?,
            settings: u64::from_str_radix(text, 16).map_err(|_| reader.damaged(&no_fingerprint))?,
            messages: [0; TOPICS.len()],
            has_many_senders: settings.rt.channels > 1 && reader.fact(RUN, CHANNEL).is_err(),
            newest: [None; TOPICS.len()],
        })
    }

    /// Checks that the log holds every message that the recorder wrote and every state that the plant published.
    pub fn check_landing(&self, reader: &LogReader) -> Result<(), Failure> {
        for (topic, holds) in TOPICS.into_iter().zip(self.messages) {
            let written = reader.landed(&format!("messages.{topic}"))?;
            if written != Some(holds) {
                let written = written
                    .map_or_else(|| "does not say how many".into(), |n| format!("wrote {n}"));
                return Err(gap(&format!(
                    "it holds {} of topic `{topic}`, and its recorder {written}",
                    count(holds, "message")
                )));
            }
        }
        let [states, ..] = self.messages;
        match reader.landed("ticks_run")? {
            // A plant that dies may have published a state that it has not counted yet.
            Some(published) if states < published => Err(gap(&format!(
                "the plant published {}, and it lacks the last {}",
                count(published, "state"),
                published - states
            ))),
            _ => Ok(()),
        }
    }

    pub fn check(&mut self, entry: &LogEntry) -> Result<(), Failure> {
        let (place, topic) = (entry.topic(), TOPICS[entry.topic()]);
        let many_per_tick = matches!(entry, LogEntry::Swap(_) | LogEntry::Decisions(_));
        let envelope = entry.envelope();
        let (run_id, settings) = (envelope.run_id, envelope.settings);
        let (epoch, seq, tick) = (envelope.epoch, envelope.seq, envelope.tick);
        if envelope.layout != LAYOUT || run_id != self.run_id || settings != self.settings {
            return Err(Failure::failed(format!(
                "the log mixes runs: message {seq} of topic `{topic}` (tick {tick}) has run {run_id} and settings \
                 {settings:016x}, the log has run {} and settings {:016x}",
                self.run_id, self.settings
            )));
        }
        self.messages[place] += 1;
        if let LogEntry::Loss(Message { content, .. }) = entry {
            let topic = usize::try_from(content.topic).ok();
            let topic = topic.and_then(|it| TOPICS.get(it)).unwrap_or(&"?");
            let channel = Channel::from_wire(content.channel).map_or("?", Channel::name);
            return Err(gap(&format!(
                "the recorder lost {} of topic `{topic}` of channel {channel} before tick {}",
                count(content.messages, "message"),
                content.before_tick
            )));
        }
        let last = self.newest[place].replace(Sent { epoch, seq, tick });
        let same_sender = last.filter(|last| last.epoch == epoch);
        let owed = same_sender.map_or(0, |last| last.seq.saturating_add(1));
        let is_of_stage = matches!(
            entry,
            LogEntry::Setpoint(_) | LogEntry::Wrench(_) | LogEntry::RotorSpeeds(_)
        );
        let is_of_channels = self.has_many_senders && is_of_stage;
        if seq != owed && !is_of_channels {
            let missing = count(seq.wrapping_sub(owed), "message");
            return Err(gap(&format!(
                "topic `{topic}` lacks {missing} before tick {tick}"
            )));
        }
        let rises = |last: Sent| last.tick < tick || many_per_tick && last.tick == tick;
        let is_older = |last: Sent| last.epoch > epoch && !is_of_channels;
        if last.is_some_and(|last| !rises(last) || is_older(last)) {
            return Err(gap(&format!("topic `{topic}` goes back to tick {tick}")));
        }
        Ok(())
    }
}
