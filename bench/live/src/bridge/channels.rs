//! Topics and scene as channels of the WebSocket protocol.

use std::collections::BTreeMap;
use std::sync::Arc;

use foxglove::{Context, PartialMetadata, RawChannel, Schema};
use messages::blackboards::Run;
use messages::header::Message;
use messages::monitor::Monitor;
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use messages::topic::Topic;

use analysis::laws::FlownLaws;
use analysis::theorem::no_theorem;
use errors::Failure;
use flight_log::codec::{Logged, encode};
use flight_log::entry::{FORMATS, LogEntry, with_message};
use flight_log::scene::{self, Placed};
use flight_log::telemetry::TelemetryTopic;
use flight_log::units;

pub(super) struct Channels {
    topics: BTreeMap<&'static str, Arc<RawChannel>>,
    /// The signals of each law, by role.
    telemetry: BTreeMap<Role, (Arc<RawChannel>, TelemetryTopic)>,
    scene: Vec<Arc<RawChannel>>,
    scene_every_ticks: u64,
    /// From the machine's clock to ns since 1970.
    wall_offset_ns: i128,
    newest_ns: u64,
    bytes: Vec<u8>,
}

impl Channels {
    pub(super) fn new(
        context: &Arc<Context>,
        run: &Run,
        laws: &FlownLaws,
    ) -> Result<Self, Failure> {
        let why_not = laws.without_theorem.map(no_theorem);
        let why_not = why_not.as_deref().map(units::not_applicable);
        let mut topics = BTreeMap::new();
        for format in FORMATS {
            let mut metadata = (format.describe)();
            let is_theorem = format.name == <Monitor as Topic>::NAME;
            metadata.extend(why_not.clone().filter(|_| is_theorem));
            let schema = (format.schema_name)();
            let schema = (&*schema, (format.descriptor_set)());
            let channel = channel(context, format.name, schema, metadata)?;
            topics.insert(format.name, channel);
        }
        let mut telemetry = BTreeMap::new();
        for role in LAW_ROLES {
            let Some(topic) = TelemetryTopic::new(role, laws.signals.of(role)) else {
                continue;
            };
            let schema = (&*topic.schema_name(), topic.descriptor_set());
            let channel = channel(context, topic.topic(), schema, topic.metadata())?;
            telemetry.insert(role, (channel, topic));
        }
        let set = scene::descriptor_set();
        let place = |(topic, name)| channel(context, topic, (name, set.clone()), BTreeMap::new());
        Ok(Self {
            topics,
            telemetry,
            scene: scene::CHANNELS
                .into_iter()
                .map(place)
                .collect::<Result<_, _>>()?,
            scene_every_ticks: scene::every_ticks(run.sample_time_ns),
            wall_offset_ns: i128::from(run.t0_wall_ns) - i128::from(run.t0_ns),
            newest_ns: run.t0_wall_ns,
            bytes: Vec::new(),
        })
    }

    /// Withdraws the channels from the clients.
    pub(super) fn close(&self) {
        let telemetry = self.telemetry.values().map(|(channel, _)| channel);
        let all = self.topics.values().chain(telemetry).chain(&self.scene);
        all.for_each(|channel| channel.close());
    }

    /// Sends a message to the clients that have subscribed to its channel.
    pub(super) fn pass_on(&mut self, entry: &LogEntry) {
        with_message!(entry, message => self.send(message));
        match entry {
            LogEntry::State(message) => self.place(message, Placed::airframe),
            LogEntry::Setpoint(message) => self.place(message, Placed::reference),
            _ => {}
        }
    }

    /// Sends a message, and the signals that the law of its sender publishes in it.
    fn send<C: Logged>(&mut self, message: &Message<C>) {
        let time = PartialMetadata::with_log_time(self.time_ns(message));
        let bytes = &mut self.bytes;
        if let Some(channel) = self.topics.get(<C as Topic>::NAME)
            && channel.has_sinks()
        {
            bytes.clear();
            encode(message, bytes);
            channel.log_with_meta(bytes, time);
        }
        let telemetry = self.telemetry.get(&C::SENDER);
        if let Some(((channel, topic), signals)) = telemetry.zip(message.content.telemetry())
            && channel.has_sinks()
        {
            bytes.clear();
            topic.encode(message.envelope.tick, signals, bytes);
            channel.log_with_meta(bytes, time);
        }
    }

    fn place<C: Topic>(&mut self, message: &Message<C>, placed: fn(u64, &C) -> Placed) {
        if !message.envelope.tick.is_multiple_of(self.scene_every_ticks) {
            return;
        }
        let placed = placed(self.time_ns(message), &message.content);
        let time = PartialMetadata::with_log_time(placed.at_ns);
        for (channel, bytes) in placed.messages() {
            self.scene[channel].log_with_meta(&bytes, time);
        }
    }

    /// When a message was sampled [ns since 1970]; the time of the newest sample for a message without one.
    fn time_ns<C: Topic>(&mut self, message: &Message<C>) -> u64 {
        let sample_ns = message.envelope.sample_ns;
        if sample_ns == 0 {
            return self.newest_ns;
        }
        let wall_ns = u64::try_from(i128::from(sample_ns) + self.wall_offset_ns);
        let wall_ns = wall_ns.unwrap_or(sample_ns);
        self.newest_ns = self.newest_ns.max(wall_ns);
        wall_ns
    }
}

fn channel(
    context: &Arc<Context>,
    topic: &str,
    (schema, descriptor_set): (&str, Vec<u8>),
    metadata: BTreeMap<String, String>,
) -> Result<Arc<RawChannel>, Failure> {
    let builder = context.channel_builder(topic).message_encoding("protobuf");
    let builder = builder.schema(Schema::new(schema, "protobuf", descriptor_set));
    let channel = builder.metadata(metadata).build_raw();
    channel.map_err(|e| Failure::failed(format!("cannot make a Foxglove channel: {e}")))
}
