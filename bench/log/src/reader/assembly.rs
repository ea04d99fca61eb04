//! Puts the messages of a file together: what a law shows stands right behind the message that it came in.

use std::collections::BTreeMap;

use mcap::records::Channel;
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::monitor::Monitor;
use model::role::Role;
use model::telemetry::LAW_ROLES;

use crate::codec::decode_into;
use crate::entry::LogEntry;
use crate::telemetry::{BESIDE, TELEMETRY_TOPICS, TelemetryTopic, place};
use crate::{TOPICS, schema};

/// The channels of a file, and the message that is being put together.
#[derive(Clone, Debug)]
pub(super) struct Assembly {
    /// What is read by the messages' layouts: places in [`TOPICS`] by channel.
    channels: BTreeMap<u16, usize>,
    /// Topics whose messages have what their law shows right behind them, by place in [`TOPICS`].
    beside: BTreeMap<usize, String>,
    /// What the laws show: places in [`LAW_ROLES`] by channel.
    telemetry_channels: BTreeMap<u16, usize>,
    /// What the laws show, in the order of [`LAW_ROLES`].
    telemetry: [Option<TelemetryTopic>; LAW_ROLES.len()],
    /// The message that was read last.
    newest: LogEntry,
    /// Whether what its law shows is still to come.
    waits: bool,
}

impl Assembly {
    /// Before the first channel.
    pub(super) fn new() -> Self {
        Self {
            channels: BTreeMap::new(),
            beside: BTreeMap::new(),
            telemetry_channels: BTreeMap::new(),
            telemetry: [const { None }; LAW_ROLES.len()],
            newest: LogEntry::empty(0),
            waits: false,
        }
    }

    /// Before the first channel of the next file.
    pub(super) fn begin_file(&mut self) {
        self.channels.clear();
        self.beside.clear();
        self.telemetry_channels.clear();
    }

    /// The message that was read last.
    pub(super) const fn newest(&self) -> &LogEntry {
        &self.newest
    }

    /// What the law of a role shows.
    pub(super) fn telemetry(&self, role: Role) -> Option<&TelemetryTopic> {
        self.telemetry[place(role)?].as_ref()
    }

    /// Takes a channel; false where its schema is not the one that is read here.
    pub(super) fn take_channel(&mut self, channel: &Channel, schema: Option<&[u8]>) -> bool {
        if let Some(place) = TELEMETRY_TOPICS.iter().position(|topic| *topic == channel.topic) {
            let told = schema.and_then(|schema| TelemetryTopic::told(LAW_ROLES[place], schema, &channel.metadata));
            self.telemetry_channels.insert(channel.id, place);
            self.telemetry[place] = told;
            return self.telemetry[place].is_some();
        }
        let Some(place) = TOPICS.iter().position(|topic| *topic == channel.topic) else { return true };
        let ours = match LogEntry::empty(place) {
            LogEntry::State(_) => schema::descriptor_set::<State>(),
            LogEntry::Setpoint(_) => schema::descriptor_set::<Setpoint>(),
            LogEntry::Wrench(_) => schema::descriptor_set::<Wrench>(),
            LogEntry::RotorSpeeds(_) => schema::descriptor_set::<RotorSpeeds>(),
            LogEntry::Swap(_) => schema::descriptor_set::<SwapRecord>(),
            LogEntry::Theorem(_) => schema::descriptor_set::<Monitor>(),
        };
        self.channels.insert(channel.id, place);
        self.beside.extend(channel.metadata.get(BESIDE).map(|topic| (place, topic.clone())));
        // Only what is laid out as here can be read.
        schema == Some(&ours)
    }

    /// Takes the bytes of a channel; true where a message is whole now.
    pub(super) fn take(&mut self, channel: u16, data: &[u8]) -> Result<bool, String> {
        if let Some(place) = self.telemetry_channels.get(&channel) {
            return self.take_telemetry(*place, data).map(|()| true);
        }
        let Some(topic) = self.channels.get(&channel).copied() else { return Ok(false) };
        self.check_whole()?;
        if !read(topic, data, &mut self.newest) {
            return Err(format!("a message of topic `{}` does not follow its schema", TOPICS[topic]));
        }
        self.waits = self.beside.contains_key(&topic);
        Ok(!self.waits)
    }

    /// Puts what a law shows into the message that it came in.
    fn take_telemetry(&mut self, place: usize, data: &[u8]) -> Result<(), String> {
        let topic = TELEMETRY_TOPICS[place];
        let is_its = self.beside.get(&self.newest.topic()).is_some_and(|beside| beside == topic);
        if !std::mem::replace(&mut self.waits, false) || !is_its {
            return Err(format!("a message of topic `{topic}` does not stand behind that of its stage"));
        }
        let tick = self.newest.envelope().tick;
        let shown = self.telemetry[place].as_ref().zip(self.newest.telemetry_mut());
        if !shown.is_some_and(|(shown, telemetry)| shown.decode_into(data, tick, telemetry)) {
            return Err(format!("a message of topic `{topic}` does not follow its schema, or is of another tick"));
        }
        Ok(())
    }

    /// Refuses a message whose law's numbers have not come.
    pub(super) fn check_whole(&self) -> Result<(), String> {
        let topic = self.newest.topic();
        match self.beside.get(&topic) {
            Some(beside) if self.waits => {
                let tick = self.newest.envelope().tick;
                Err(format!("the message of topic `{}` of tick {tick} lacks that of topic `{beside}`", TOPICS[topic]))
            }
            _ => Ok(()),
        }
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

#[cfg(test)]
mod tests {
    use model::envelope::{Envelope, Message};
    use model::telemetry::Signal;

    use super::*;
    use crate::codec::encode;

    const WRENCH: u16 = 1;
    const SHOWN: u16 = 2;

    fn topic() -> TelemetryTopic {
        TelemetryTopic::new(Role::Inner, &[Signal { name: "gain", unit: "" }]).unwrap()
    }

    fn channel(id: u16, topic: &str, metadata: BTreeMap<String, String>) -> Channel {
        Channel { id, schema_id: id, topic: topic.into(), message_encoding: "protobuf".into(), metadata }
    }

    /// A file with wrenches, and what their law shows.
    fn file() -> Assembly {
        let mut assembly = Assembly::new();
        let beside = BTreeMap::from([(BESIDE.to_owned(), "inner_telemetry".to_owned())]);
        assert!(assembly.take_channel(&channel(WRENCH, "wrench", beside), Some(&schema::descriptor_set::<Wrench>())));
        let shown = channel(SHOWN, "inner_telemetry", topic().metadata());
        assert!(assembly.take_channel(&shown, Some(&topic().descriptor_set())));
        assembly
    }

    fn wrench(tick: u64) -> Message<Wrench> {
        let mut message = Message { envelope: Envelope { tick, ..Envelope::new() }, content: Wrench::default() };
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
    fn a_message_is_whole_with_what_its_law_shows() {
        let mut file = file();
        for tick in [7, 8] {
            let [wrench_bytes, shown] = bytes(tick);
            assert_eq!(file.take(WRENCH, &wrench_bytes), Ok(false));
            assert_eq!(file.take(SHOWN, &shown), Ok(true));
            assert_eq!(*file.newest(), LogEntry::Wrench(wrench(tick)));
        }
        assert_eq!(file.check_whole(), Ok(()));
    }

    #[test]
    fn what_a_law_shows_is_missed_and_never_put_into_another_message() {
        let (mut file, [seventh, shown], [eighth, _]) = (file(), bytes(7), bytes(8));
        let no_stage = "a message of topic `inner_telemetry` does not stand behind that of its stage";
        assert_eq!(file.take(SHOWN, &shown), Err(no_stage.into()));
        file.take(WRENCH, &seventh).unwrap();
        let lacks = "the message of topic `wrench` of tick 7 lacks that of topic `inner_telemetry`";
        assert_eq!(file.check_whole(), Err(lacks.into()), "at the end of the file");
        assert_eq!(file.take(WRENCH, &eighth), Err(lacks.into()));
        file.take(SHOWN, &shown).unwrap();
        assert_eq!(file.take(SHOWN, &shown), Err(no_stage.into()), "a second one");
        file.take(WRENCH, &eighth).unwrap();
        let other = "a message of topic `inner_telemetry` does not follow its schema, or is of another tick";
        assert_eq!(file.take(SHOWN, &shown), Err(other.into()));
    }

    #[test]
    fn a_topic_with_another_schema_is_refused() {
        let shown = channel(SHOWN, "inner_telemetry", BTreeMap::new());
        assert!(!Assembly::new().take_channel(&shown, Some(&schema::descriptor_set::<Wrench>())));
        assert!(!Assembly::new().take_channel(&shown, None));
    }
}
