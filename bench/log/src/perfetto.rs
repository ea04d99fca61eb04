//! A flight as a Perfetto trace: a track per stage, missed deadlines, swaps and faults as instants, and what else ran in
//! outages; with several channels, a track per stage of what was flown, and of each channel.
//!
//! The field numbers are those of Perfetto's `trace_packet.proto`, `track_event.proto`, `track_descriptor.proto` and `debug_annotation.proto`.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::io::{self, Write};

use messages::content::{Change, State, SwapRecord};
use messages::grid::Pace;
use messages::header::Message;
use messages::role::{Channel, Role, STAGES};
use messages::topic::Topic;

use crate::entry::LogEntry;
use crate::protobuf::Value::{self, Message as Nested, Number, Text};
use crate::protobuf::message;

pub const FILE: &str = "flight.perfetto-trace";

const SEQUENCE: u64 = 1;
/// Tracks beside those of the stages, which have the numbers of [`STAGES`] and one more. After them are those of channels.
const MISSES: u64 = STAGES.len() as u64 + 1;
const SWAPS: u64 = MISSES + 1;
const FAULTS: u64 = SWAPS + 1;
const OTHERS: u64 = FAULTS + 1;
const FLIGHT: u64 = OTHERS + 1;

const SLICE_BEGIN: u64 = 1;
const SLICE_END: u64 = 2;
const INSTANT: u64 = 3;

const EXPLICIT_ORDER: u64 = 3;

#[derive(Debug)]
pub struct PerfettoWriter<W> {
    out: W,
    /// Begins and ends of faults by their tick, the latest first.
    faults: Vec<(u64, String)>,
    pace: Option<Pace>,
    /// As the newest state counts them; none before the first one.
    deadlines_missed: Option<u64>,
    /// When the first state of each parameter epoch was sampled [ns].
    epochs: BTreeMap<u64, u64>,
    waiting: Vec<Message<SwapRecord>>,
    /// What the tracks of the present log are numbered from.
    before: u64,
    pub slices: u64,
    pub instants: u64,
}

/// More parameter changes without a state are no flight's.
const MOST_WAITING: usize = 10_000;

impl<W: Write> PerfettoWriter<W> {
    /// Starts a trace; `faults` are their begins and ends, by tick. `pace` gives the time of ticks that the log lacks.
    pub fn new(out: W, mut faults: Vec<(u64, String)>, pace: Option<Pace>) -> io::Result<Self> {
        faults.sort_by_key(|(tick, _)| Reverse(*tick));
        let mut writer = Self {
            out,
            faults,
            pace,
            deadlines_missed: None,
            epochs: BTreeMap::new(),
            waiting: Vec::new(),
            before: 0,
            slices: 0,
            instants: 0,
        };
        writer.track(FLIGHT, "ironbird", None)?;
        for (number, stage) in (1..).zip(STAGES) {
            writer.track(number, stage.name(), Some(FLIGHT))?;
        }
        writer.track(MISSES, "deadlines missed", Some(FLIGHT))?;
        writer.track(SWAPS, "swaps", Some(FLIGHT))?;
        writer.track(FAULTS, "faults", Some(FLIGHT))?;
        writer.track(OTHERS, "other programs, in outages", Some(FLIGHT))?;
        Ok(writer)
    }

    /// Enters which programs had the loops' processor from an instant to another one [ns].
    pub fn others(&mut self, [from_ns, to_ns]: [u64; 2], ran: &str) -> io::Result<()> {
        self.slices += 1;
        let begin = [
            (9, Number(SLICE_BEGIN)),
            (11, Number(OTHERS)),
            (23, Text(ran)),
        ];
        self.event(from_ns, &begin)?;
        self.event(
            to_ns.max(from_ns),
            &[(9, Number(SLICE_END)), (11, Number(OTHERS))],
        )
    }

    /// Begins with the messages that a channel sent.
    pub fn begin_channel(&mut self, channel: Channel) -> io::Result<()> {
        self.before = FLIGHT + STAGES.len() as u64 * channel as u64;
        for stage in STAGES.into_iter().skip(1) {
            let name = format!("{channel}.{stage}");
            self.track(self.before + stage as u64 + 1, &name, Some(FLIGHT))?;
        }
        Ok(())
    }

    /// Takes a message of the present log: of that of a channel, only what the channel sent.
    pub fn take(&mut self, entry: &LogEntry) -> io::Result<()> {
        match entry {
            LogEntry::State(message) if self.before == 0 => self.state(message),
            LogEntry::Swap(message) if self.before == 0 => self.swap(message),
            LogEntry::Setpoint(message) => self.work(message),
            LogEntry::Wrench(message) => self.work(message),
            LogEntry::RotorSpeeds(message) => self.work(message),
            _ => Ok(()),
        }
    }

    /// Takes a state: the plant's work of its tick, and the deadlines that it found missed at the tick's begin.
    fn state(&mut self, message: &Message<State>) -> io::Result<()> {
        let at_ns = message.envelope.stamps_of(Role::Plant).receive_ns;
        let missed = message.content.deadlines_missed;
        // What was missed before a log whose first files are gone was not missed now.
        let tick = message.envelope.tick;
        let first = if tick == 0 { 0 } else { missed };
        let before = self.deadlines_missed.replace(missed).unwrap_or(first);
        if missed > before {
            let count = number("count", missed - before);
            let annotations = [count, number("up to tick", tick)];
            self.instant(MISSES, at_ns, "missed", &annotations)?;
        }
        while let Some((of, fault)) = self.faults.pop_if(|(of, _)| *of <= tick) {
            let at_ns = match self.pace {
                Some(Pace::Realtime(grid)) if of < tick => grid.begin_of(of),
                _ => at_ns,
            };
            self.instant(FAULTS, at_ns, &fault, &[number("tick", of)])?;
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
    fn work<C: Topic>(&mut self, message: &Message<C>) -> io::Result<()> {
        let envelope = &message.envelope;
        let stamps = envelope.stamps_of(C::SENDER);
        // The mixer's last word of a run answers no state.
        if stamps.receive_ns == 0 {
            return Ok(());
        }
        let (stage, track) = (C::SENDER as usize, self.before + C::SENDER as u64 + 1);
        let is_fresh = stage
            .checked_sub(1)
            .is_none_or(|input| envelope.input_tick[input] == envelope.tick);
        let name = match is_fresh {
            true => C::SENDER.name().to_owned(),
            false => format!("{} (stale input)", C::SENDER),
        };
        self.slices += 1;
        let tick = number("tick", envelope.tick);
        let begin = [
            (4, Nested(&tick)),
            (9, Number(SLICE_BEGIN)),
            (11, Number(track)),
            (23, Text(&name)),
        ];
        self.event(stamps.receive_ns, &begin)?;
        let end = [(9, Number(SLICE_END)), (11, Number(track))];
        self.event(stamps.send_ns.max(stamps.receive_ns), &end)
    }

    /// Takes a swap: an instant at the first state that was flown with it, which may be in the log before or behind it.
    fn swap(&mut self, swap: &Message<SwapRecord>) -> io::Result<()> {
        // A swap that another one follows at once is in no state by itself.
        let Some((_, at_ns)) = self.epochs.range(swap.content.parameter_epoch..).next() else {
            if self.waiting.len() == MOST_WAITING {
                let what = format!("{MOST_WAITING} parameter changes are in no state");
                return Err(io::Error::other(what));
            }
            self.waiting.push(*swap);
            return Ok(());
        };
        let at_ns = *at_ns;
        let change = |change: Change| {
            let Change { old, new, .. } = change;
            let over = match change.steps {
                1 => String::new(),
                ticks => format!(" over {ticks} ticks"),
            };
            let text = format!("{old} -> {new}{over}");
            message(&[(6, Text(&text)), (10, Text(change.parameter.name()))])
        };
        let mut changes: Vec<_> = swap.content.changes().map(change).collect();
        changes.push(number("tick", swap.envelope.tick));
        self.instant(SWAPS, at_ns, "swap", &changes)
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
        annotations: &[Vec<u8>],
    ) -> io::Result<()> {
        self.instants += 1;
        let annotations = annotations.iter().map(|it| (4, Nested(it)));
        let event = [(9, Number(INSTANT)), (11, Number(track)), (23, Text(name))];
        self.event(at_ns, &annotations.chain(event).collect::<Vec<_>>())
    }

    fn event(&mut self, at_ns: u64, event: &[(u32, Value<'_>)]) -> io::Result<()> {
        let event = message(event);
        self.packet(&[
            (8, Number(at_ns)),
            (10, Number(SEQUENCE)),
            (11, Nested(&event)),
        ])
    }

    fn track(&mut self, uuid: u64, name: &str, parent: Option<u64>) -> io::Result<()> {
        let mut track = vec![(1, Number(uuid)), (2, Text(name))];
        match parent {
            Some(parent) => track.extend([(5, Number(parent)), (12, Number(uuid))]),
            None => track.push((11, Number(EXPLICIT_ORDER))),
        }
        let track = message(&track);
        self.packet(&[(10, Number(SEQUENCE)), (60, Nested(&track))])
    }

    /// A trace is its packets, one after the other.
    fn packet(&mut self, packet: &[(u32, Value<'_>)]) -> io::Result<()> {
        let packet = message(packet);
        self.out.write_all(&message(&[(1, Nested(&packet))]))
    }
}

fn number(name: &str, value: u64) -> Vec<u8> {
    message(&[(3, Number(value)), (10, Text(name))])
}
