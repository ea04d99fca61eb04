//! A flight as a Perfetto trace: a track per stage, missed deadlines and swaps as instants.
//!
//! The messages below are the part of Perfetto's trace format that this needs, with the field numbers of its
//! `trace_packet.proto`, `track_event.proto`, `track_descriptor.proto` and `debug_annotation.proto`.

use std::collections::BTreeMap;
use std::io::{self, Write};

use messages::content::{Change, State, SwapRecord};
use messages::header::Message;
use messages::role::{Role, STAGES};
use messages::topic::Topic;
use prost::Message as _;

pub const FILE: &str = "flight.perfetto-trace";

const SEQUENCE: u32 = 1;
/// Tracks beside those of the stages, which have the numbers of [`STAGES`] and one more.
const MISSES: u64 = STAGES.len() as u64 + 1;
const SWAPS: u64 = MISSES + 1;
const FLIGHT: u64 = SWAPS + 1;

const SLICE_BEGIN: i32 = 1;
const SLICE_END: i32 = 2;
const INSTANT: i32 = 3;

#[derive(Clone, PartialEq, prost::Message)]
struct Trace {
    #[prost(message, repeated, tag = "1")]
    packet: Vec<TracePacket>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct TracePacket {
    #[prost(uint64, optional, tag = "8")]
    timestamp: Option<u64>,
    #[prost(uint32, optional, tag = "10")]
    trusted_packet_sequence_id: Option<u32>,
    #[prost(message, optional, tag = "11")]
    track_event: Option<TrackEvent>,
    #[prost(message, optional, tag = "60")]
    track_descriptor: Option<TrackDescriptor>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct TrackEvent {
    #[prost(message, repeated, tag = "4")]
    debug_annotations: Vec<DebugAnnotation>,
    #[prost(int32, optional, tag = "9")]
    r#type: Option<i32>,
    #[prost(uint64, optional, tag = "11")]
    track_uuid: Option<u64>,
    #[prost(string, optional, tag = "23")]
    name: Option<String>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct TrackDescriptor {
    #[prost(uint64, optional, tag = "1")]
    uuid: Option<u64>,
    #[prost(string, optional, tag = "2")]
    name: Option<String>,
    #[prost(uint64, optional, tag = "5")]
    parent_uuid: Option<u64>,
    #[prost(int32, optional, tag = "11")]
    child_ordering: Option<i32>,
    #[prost(int32, optional, tag = "12")]
    sibling_order_rank: Option<i32>,
}

const EXPLICIT_ORDER: i32 = 3;

#[derive(Clone, PartialEq, prost::Message)]
struct DebugAnnotation {
    #[prost(uint64, optional, tag = "3")]
    uint_value: Option<u64>,
    #[prost(string, optional, tag = "6")]
    string_value: Option<String>,
    #[prost(string, optional, tag = "10")]
    name: Option<String>,
}

#[derive(Debug)]
pub struct PerfettoWriter<W> {
    out: W,
    /// As the newest state counts them; none before the first one.
    deadlines_missed: Option<u64>,
    /// When the first state of each parameter epoch was sampled [ns].
    epochs: BTreeMap<u64, u64>,
    waiting: Vec<Message<SwapRecord>>,
    pub slices: u64,
    pub instants: u64,
}

impl<W: Write> PerfettoWriter<W> {
    pub fn new(out: W) -> io::Result<Self> {
        let mut writer = Self {
            out,
            deadlines_missed: None,
            epochs: BTreeMap::new(),
            waiting: Vec::new(),
            slices: 0,
            instants: 0,
        };
        writer.track(FLIGHT, "ironbird", None)?;
        for (number, stage) in (1..).zip(STAGES) {
            writer.track(number, stage.name(), Some(FLIGHT))?;
        }
        writer.track(MISSES, "deadlines missed", Some(FLIGHT))?;
        writer.track(SWAPS, "swaps", Some(FLIGHT))?;
        Ok(writer)
    }

    /// Takes a state: the plant's work of its tick, and the deadlines that it found missed at the tick's begin.
    pub fn state(&mut self, message: &Message<State>) -> io::Result<()> {
        let at_ns = message.envelope.stamps_of(Role::Plant).receive_ns;
        let missed = message.content.deadlines_missed;
        // What was missed before a log whose first files are gone was not missed now.
        let tick = message.envelope.tick;
        let first = if tick == 0 { 0 } else { missed };
        let before = self.deadlines_missed.replace(missed).unwrap_or(first);
        if missed > before {
            let count = number("count", missed - before);
            let annotations = vec![count, number("up to tick", tick)];
            self.instant(MISSES, at_ns, "missed", annotations)?;
        }
        self.epochs
            .entry(message.content.parameter_epoch)
            .or_insert(at_ns);
        for swap in std::mem::take(&mut self.waiting) {
            self.swap(&swap)?;
        }
        self.work(message)
    }

    /// Takes what a stage published: a slice from its waking to its publishing.
    pub fn work<C: Topic>(&mut self, message: &Message<C>) -> io::Result<()> {
        let envelope = &message.envelope;
        let stamps = envelope.stamps_of(C::SENDER);
        // The mixer's last word of a run answers no state.
        if stamps.receive_ns == 0 {
            return Ok(());
        }
        let (stage, track) = (C::SENDER as usize, C::SENDER as u64 + 1);
        let is_fresh = stage
            .checked_sub(1)
            .is_none_or(|input| envelope.input_tick[input] == envelope.tick);
        let name = if is_fresh {
            C::SENDER.name().to_owned()
        } else {
            format!("{} (stale input)", C::SENDER)
        };
        self.slices += 1;
        let begin = TrackEvent {
            r#type: Some(SLICE_BEGIN),
            track_uuid: Some(track),
            name: Some(name),
            debug_annotations: vec![number("tick", envelope.tick)],
        };
        self.event(stamps.receive_ns, begin)?;
        let end = TrackEvent {
            r#type: Some(SLICE_END),
            track_uuid: Some(track),
            ..TrackEvent::default()
        };
        self.event(stamps.send_ns.max(stamps.receive_ns), end)
    }

    /// Takes a swap: an instant at the first state that was flown with it, which may be in the log before or behind it.
    pub fn swap(&mut self, message: &Message<SwapRecord>) -> io::Result<()> {
        // A swap that another one follows at once is in no state by itself.
        let Some((_, at_ns)) = self.epochs.range(message.content.parameter_epoch..).next() else {
            self.waiting.push(*message);
            return Ok(());
        };
        let at_ns = *at_ns;
        let change = |change: Change| {
            let Change { old, new, .. } = change;
            let over = match change.steps {
                1 => String::new(),
                ticks => format!(" over {ticks} ticks"),
            };
            DebugAnnotation {
                name: Some(change.parameter.name().to_owned()),
                string_value: Some(format!("{old} -> {new}{over}")),
                ..DebugAnnotation::default()
            }
        };
        let mut changes: Vec<_> = message.content.changes().map(change).collect();
        changes.push(number("tick", message.envelope.tick));
        self.instant(SWAPS, at_ns, "swap", changes)
    }

    /// Ends the trace. Swaps that no state was flown with are not in it: they were never in force.
    pub fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    fn instant(
        &mut self,
        track: u64,
        at_ns: u64,
        name: &str,
        debug_annotations: Vec<DebugAnnotation>,
    ) -> io::Result<()> {
        self.instants += 1;
        let event = TrackEvent {
            r#type: Some(INSTANT),
            track_uuid: Some(track),
            name: Some(name.to_owned()),
            debug_annotations,
        };
        self.event(at_ns, event)
    }

    fn event(&mut self, at_ns: u64, event: TrackEvent) -> io::Result<()> {
        self.packet(TracePacket {
            timestamp: Some(at_ns),
            track_event: Some(event),
            ..TracePacket::default()
        })
    }

    fn track(&mut self, uuid: u64, name: &str, parent: Option<u64>) -> io::Result<()> {
        let descriptor = TrackDescriptor {
            uuid: Some(uuid),
            name: Some(name.to_owned()),
            parent_uuid: parent,
            child_ordering: parent.is_none().then_some(EXPLICIT_ORDER),
            sibling_order_rank: parent.and(i32::try_from(uuid).ok()),
        };
        self.packet(TracePacket {
            track_descriptor: Some(descriptor),
            ..TracePacket::default()
        })
    }

    /// A trace is its packets, one after the other.
    fn packet(&mut self, mut packet: TracePacket) -> io::Result<()> {
        packet.trusted_packet_sequence_id = Some(SEQUENCE);
        let packet = vec![packet];
        self.out.write_all(&Trace { packet }.encode_to_vec())
    }
}

fn number(name: &str, value: u64) -> DebugAnnotation {
    DebugAnnotation {
        name: Some(name.to_owned()),
        uint_value: Some(value),
        ..DebugAnnotation::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(tick: u64, epoch: u64, missed: u64) -> Message<State> {
        let mut message = Message::<State>::default();
        message.envelope.tick = tick;
        message.envelope.stamps[Role::Plant as usize].receive_ns = 1_000 + tick;
        message.content.parameter_epoch = epoch;
        message.content.deadlines_missed = missed;
        message
    }

    #[test]
    fn every_swap_that_was_flown_with_is_in_it_and_what_was_missed_before_it_began_is_not() {
        let mut writer = PerfettoWriter::new(Vec::new()).unwrap();
        let mut swap = Message::<SwapRecord>::default();
        // Two in one tick: the first one is in no state by itself; and one that no state follows.
        for epoch in 1..=3 {
            swap.content.parameter_epoch = epoch;
            writer.swap(&swap).unwrap();
        }
        writer.state(&state(100, 0, 7)).unwrap();
        assert_eq!(writer.instants, 0);
        writer.state(&state(101, 2, 7)).unwrap();
        assert_eq!(writer.instants, 2);
        writer.state(&state(102, 2, 9)).unwrap();
        assert_eq!(writer.instants, 3);
        writer.finish().unwrap();
    }
}
