//! Topics and scene as channels of the WebSocket protocol.

use std::sync::Arc;

use foxglove::{Context, FoxgloveError, PartialMetadata, RawChannel, Schema};
use messages::blackboards::Run;
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;
use messages::telemetry::LAW_ROLES;
use messages::topic::Topic;

use crate::observation::ObservedMessage;
use errors::Failure;
use flight_log::codec::{Logged, encode};
use flight_log::scene;
use flight_log::scene::Placed;
use flight_log::telemetry::TelemetryTopic;
use flight_log::{schema, units};
use report::laws::{FlownLaws, no_theorem};

#[allow(missing_debug_implementations, reason = "the channels have none")]
pub(super) struct Channels {
    states: Arc<RawChannel>,
    setpoints: Arc<RawChannel>,
    wrenches: Arc<RawChannel>,
    rotor_speeds: Arc<RawChannel>,
    swaps: Arc<RawChannel>,
    theorem: Arc<RawChannel>,
    /// What outer, inner and mixer law show.
    telemetry: [Option<(Arc<RawChannel>, TelemetryTopic)>; LAW_ROLES.len()],
    scene: [Arc<RawChannel>; scene::CHANNELS.len()],
    scene_every_ticks: u64,
    clock: Clock,
    bytes: Vec<u8>,
}

/// The machine's clock as ns since 1970.
struct Clock {
    wall_offset_ns: i128,
    newest_ns: u64,
}

impl Clock {
    /// When a message was sampled; that of the newest sample where it goes back to none.
    fn of<C: Topic>(&mut self, message: &Message<C>) -> u64 {
        let sample_ns = message.envelope.sample_ns;
        if sample_ns > 0 {
            let wall_ns =
                u64::try_from(i128::from(sample_ns) + self.wall_offset_ns).unwrap_or(sample_ns);
            self.newest_ns = self.newest_ns.max(wall_ns);
            return wall_ns;
        }
        self.newest_ns
    }
}

impl Channels {
    /// Channels for a run of these laws.
    pub(super) fn new(
        context: &Arc<Context>,
        run: &Run,
        laws: &FlownLaws,
    ) -> Result<Self, Failure> {
        let broken =
            |e: FoxgloveError| Failure::failed(format!("cannot make a Foxglove channel: {e}"));
        let set = scene::descriptor_set();
        let place = |(topic, name): (&str, &str)| {
            let schema = Schema::new(name, "protobuf", set.clone());
            context
                .channel_builder(topic)
                .message_encoding("protobuf")
                .schema(schema)
                .build_raw()
        };
        let mut telemetry = [const { None }; LAW_ROLES.len()];
        for (telemetry, role) in telemetry.iter_mut().zip(LAW_ROLES) {
            let Some(shown) = TelemetryTopic::new(role, laws.signals.of(role)) else {
                continue;
            };
            *telemetry = Some((telemetry_channel(context, &shown).map_err(broken)?, shown));
        }
        let why_not = laws.without_theorem.map(no_theorem);
        let [actual, reference, transforms] = scene::CHANNELS.map(place);
        Ok(Self {
            states: topic::<State>(context, None).map_err(broken)?,
            setpoints: topic::<Setpoint>(context, None).map_err(broken)?,
            wrenches: topic::<Wrench>(context, None).map_err(broken)?,
            rotor_speeds: topic::<RotorSpeeds>(context, None).map_err(broken)?,
            swaps: topic::<SwapRecord>(context, None).map_err(broken)?,
            theorem: topic::<Monitor>(context, why_not.as_deref()).map_err(broken)?,
            telemetry,
            scene: [
                actual.map_err(broken)?,
                reference.map_err(broken)?,
                transforms.map_err(broken)?,
            ],
            scene_every_ticks: scene::every_ticks(run.sample_time_ns),
            clock: Clock {
                wall_offset_ns: i128::from(run.t0_wall_ns) - i128::from(run.t0_ns),
                newest_ns: run.t0_wall_ns,
            },
            bytes: Vec::new(),
        })
    }

    /// Passes a message on to whoever has subscribed to its channel.
    pub(super) fn pass_on(&mut self, seen: ObservedMessage<'_>) {
        match seen {
            ObservedMessage::State(message) => {
                write(&self.states, message, &mut self.clock, &mut self.bytes);
                self.place(message, Placed::airframe);
            }
            ObservedMessage::Setpoint(message) => {
                write(&self.setpoints, message, &mut self.clock, &mut self.bytes);
                self.show(message);
                self.place(message, Placed::reference);
            }
            ObservedMessage::Wrench(message) => {
                write(&self.wrenches, message, &mut self.clock, &mut self.bytes);
                self.show(message);
            }
            ObservedMessage::RotorSpeeds(message) => {
                write(
                    &self.rotor_speeds,
                    message,
                    &mut self.clock,
                    &mut self.bytes,
                );
                self.show(message);
            }
            ObservedMessage::Swap(message) => {
                write(&self.swaps, message, &mut self.clock, &mut self.bytes)
            }
            ObservedMessage::Theorem(message) => {
                write(&self.theorem, message, &mut self.clock, &mut self.bytes)
            }
        }
    }

    /// Passes on what the law of a message's sender shows in it.
    fn show<C: Topic>(&mut self, message: &Message<C>) {
        let log_time = self.clock.of(message);
        let channel = LAW_ROLES
            .iter()
            .position(|role| *role == C::SENDER)
            .and_then(|i| self.telemetry[i].as_ref());
        if let Some(((channel, shown), telemetry)) = channel.zip(message.content.telemetry())
            && channel.has_sinks()
        {
            shown.encode(message.envelope.tick, telemetry, &mut self.bytes);
            channel.log_with_meta(&self.bytes, PartialMetadata::with_log_time(log_time));
        }
    }

    fn place<C: Topic>(&mut self, message: &Message<C>, placed: fn(u64, &C) -> Placed) {
        if !message.envelope.tick.is_multiple_of(self.scene_every_ticks) {
            return;
        }
        let placed = placed(self.clock.of(message), &message.content);
        for (channel, bytes) in placed.messages() {
            self.scene[channel].log_with_meta(&bytes, PartialMetadata::with_log_time(placed.at_ns));
        }
    }
}

/// A topic; says why it does not apply, where it does not.
fn topic<C: Logged>(
    context: &Arc<Context>,
    why_not: Option<&str>,
) -> Result<Arc<RawChannel>, FoxgloveError> {
    let mut metadata = units::describe::<C>();
    metadata.extend(why_not.map(units::not_applicable));
    context
        .channel_builder(<C as Topic>::NAME)
        .message_encoding("protobuf")
        .schema(Schema::new(
            schema::name::<C>(),
            "protobuf",
            schema::descriptor_set::<C>(),
        ))
        .metadata(metadata)
        .build_raw()
}

fn telemetry_channel(
    context: &Arc<Context>,
    shown: &TelemetryTopic,
) -> Result<Arc<RawChannel>, FoxgloveError> {
    context
        .channel_builder(shown.topic())
        .message_encoding("protobuf")
        .schema(Schema::new(
            shown.schema_name(),
            "protobuf",
            shown.descriptor_set(),
        ))
        .metadata(shown.metadata())
        .build_raw()
}

fn write<C: Logged>(
    channel: &RawChannel,
    message: &Message<C>,
    clock: &mut Clock,
    bytes: &mut Vec<u8>,
) {
    let log_time = clock.of(message);
    if channel.has_sinks() {
        bytes.clear();
        encode(message, bytes);
        channel.log_with_meta(bytes, PartialMetadata::with_log_time(log_time));
    }
}
