//! Topics and scene as channels of the WebSocket protocol.

use std::sync::Arc;

use foxglove::{Context, FoxgloveError, PartialMetadata, RawChannel, Schema};
use model::boards::Run;
use model::envelope::Message;
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::monitor::Monitor;
use model::topic::Topic;

use crate::observe::ObservedMessage;
use failure::Failure;
use flight_log::codec::{Logged, encode};
use flight_log::scene::{self, Placed};
use flight_log::{schema, units};

/// Every channel.
#[allow(missing_debug_implementations, reason = "the channels have none")]
pub(super) struct Channels {
    states: Arc<RawChannel>,
    setpoints: Arc<RawChannel>,
    wrenches: Arc<RawChannel>,
    rotor_speeds: Arc<RawChannel>,
    swaps: Arc<RawChannel>,
    theorem: Arc<RawChannel>,
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
            let wall_ns = u64::try_from(i128::from(sample_ns) + self.wall_offset_ns).unwrap_or(sample_ns);
            self.newest_ns = self.newest_ns.max(wall_ns);
            return wall_ns;
        }
        self.newest_ns
    }
}

impl Channels {
    /// Channels for a run.
    ///
    /// # Errors
    /// [`Failure`] where the SDK refuses one.
    pub(super) fn new(context: &Arc<Context>, run: &Run) -> Result<Self, Failure> {
        let broken = |e: FoxgloveError| Failure::failed(format!("cannot make a Foxglove channel: {e}"));
        let set = scene::descriptor_set();
        let place = |(topic, name): (&str, &str)| {
            let schema = Schema::new(name, "protobuf", set.clone());
            context.channel_builder(topic).message_encoding("protobuf").schema(schema).build_raw()
        };
        let [actual, reference, transforms] = scene::CHANNELS.map(place);
        Ok(Self {
            states: topic::<State>(context).map_err(broken)?,
            setpoints: topic::<Setpoint>(context).map_err(broken)?,
            wrenches: topic::<Wrench>(context).map_err(broken)?,
            rotor_speeds: topic::<RotorSpeeds>(context).map_err(broken)?,
            swaps: topic::<SwapRecord>(context).map_err(broken)?,
            theorem: topic::<Monitor>(context).map_err(broken)?,
            scene: [actual.map_err(broken)?, reference.map_err(broken)?, transforms.map_err(broken)?],
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
        let (clock, bytes) = (&mut self.clock, &mut self.bytes);
        match seen {
            ObservedMessage::State(message) => {
                write(&self.states, message, clock, bytes);
                self.place(message, Placed::airframe);
            }
            ObservedMessage::Setpoint(message) => {
                write(&self.setpoints, message, clock, bytes);
                self.place(message, Placed::reference);
            }
            ObservedMessage::Wrench(message) => write(&self.wrenches, message, clock, bytes),
            ObservedMessage::RotorSpeeds(message) => write(&self.rotor_speeds, message, clock, bytes),
            ObservedMessage::Swap(message) => write(&self.swaps, message, clock, bytes),
            ObservedMessage::Theorem(message) => write(&self.theorem, message, clock, bytes),
        }
    }

    fn place<C: Topic>(&mut self, message: &Message<C>, placed: fn(u64, &C) -> Placed) {
        if !message.envelope.tick.is_multiple_of(self.scene_every_ticks) {
            return;
        }
        let placed = placed(self.clock.of(message), &message.content);
        for (channel, bytes) in placed.messages() {
            self.scene[channel].log_with_meta(&bytes, PartialMetadata::with_log_time(placed.at_ns()));
        }
    }
}

fn topic<C: Logged>(context: &Arc<Context>) -> Result<Arc<RawChannel>, FoxgloveError> {
    context
        .channel_builder(<C as Topic>::NAME)
        .message_encoding("protobuf")
        .schema(Schema::new(schema::name::<C>(), "protobuf", schema::descriptor_set::<C>()))
        .metadata(units::describe::<C>())
        .build_raw()
}

fn write<C: Logged>(channel: &RawChannel, message: &Message<C>, clock: &mut Clock, bytes: &mut Vec<u8>) {
    let log_time = clock.of(message);
    if channel.has_sinks() {
        bytes.clear();
        encode(message, bytes);
        channel.log_with_meta(bytes, PartialMetadata::with_log_time(log_time));
    }
}
