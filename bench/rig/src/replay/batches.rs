//! Passes the messages of a log to the replay thread in batches.

use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, channel, sync_channel};

use errors::Failure;
use flight_log::entry::LogEntry;
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;

/// Batch size [messages]: replaying one takes longer than waking a thread.
const BATCH: usize = 256;
/// Batches in flight: one chunk of the log, which is decompressed at once.
const ON_THEIR_WAY: usize = 16;

/// Messages by topic, each in the order of the log.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    pub states: Vec<Message<State>>,
    pub setpoints: Vec<Message<Setpoint>>,
    pub wrenches: Vec<Message<Wrench>>,
    pub rotor_speeds: Vec<Message<RotorSpeeds>>,
    pub swaps: Vec<Message<SwapRecord>>,
    pub theorem: Vec<Message<Monitor>>,
    length: usize,
}

impl Batch {
    fn push(&mut self, entry: &LogEntry) {
        match entry {
            LogEntry::State(message) => self.states.push(*message),
            LogEntry::Setpoint(message) => self.setpoints.push(*message),
            LogEntry::Wrench(message) => self.wrenches.push(*message),
            LogEntry::RotorSpeeds(message) => self.rotor_speeds.push(*message),
            LogEntry::Swap(message) => self.swaps.push(*message),
            LogEntry::Theorem(message) => self.theorem.push(*message),
        }
        self.length += 1;
    }

    fn clear(&mut self) {
        self.states.clear();
        self.setpoints.clear();
        self.wrenches.clear();
        self.rotor_speeds.clear();
        self.swaps.clear();
        self.theorem.clear();
        self.length = 0;
    }
}

#[derive(Debug)]
pub struct ToFlight {
    batch: Batch,
    full: SyncSender<Batch>,
    /// Empty batches for reuse: new memory costs as much as the messages.
    empty: Receiver<Batch>,
}

#[derive(Debug)]
pub struct FromLog {
    full: Receiver<Batch>,
    empty: Sender<Batch>,
}

#[must_use]
pub fn batches() -> (ToFlight, FromLog) {
    let (full, from_log) = sync_channel(ON_THEIR_WAY);
    let (to_log, empty) = channel();
    (
        ToFlight {
            batch: Batch::default(),
            full,
            empty,
        },
        FromLog {
            full: from_log,
            empty: to_log,
        },
    )
}

impl ToFlight {
    /// Adds a message; ignored after the replay has ended.
    pub fn push(&mut self, entry: &LogEntry) {
        self.batch.push(entry);
        if self.batch.length == BATCH {
            self.hand_over();
        }
    }

    pub fn finish(mut self) {
        self.hand_over();
    }

    fn hand_over(&mut self) {
        let next = match self.empty.try_recv() {
            Ok(mut empty) => {
                empty.clear();
                empty
            }
            Err(TryRecvError::Empty) => Batch::default(),
            // The flight has ended. The log is still read to its end.
            Err(TryRecvError::Disconnected) => return self.batch.clear(),
        };
        // It may end between the two.
        let _ = self.full.send(std::mem::replace(&mut self.batch, next));
    }
}

impl FromLog {
    /// Calls `fly` with each batch until it returns false.
    pub fn each(self, mut fly: impl FnMut(&Batch) -> Result<bool, Failure>) -> Result<(), Failure> {
        for batch in &self.full {
            if !fly(&batch)? {
                break;
            }
            // One that reads no more needs none.
            let _ = self.empty.send(batch);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use messages::header::Header;

    use super::*;

    fn state(tick: u64) -> LogEntry {
        LogEntry::State(Message {
            envelope: Header {
                tick,
                ..Header::new()
            },
            content: State::default(),
        })
    }

    #[test]
    fn every_message_comes_once_and_in_order_also_of_the_last_batch() {
        const MESSAGES: u64 = 3 * (BATCH * ON_THEIR_WAY) as u64 + 1;
        let (mut to_flight, from_log) = batches();
        let mut came = Vec::new();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                (0..MESSAGES).for_each(|tick| to_flight.push(&state(tick)));
                to_flight.finish();
            });
            let mut take = |batch: &Batch| {
                came.extend(batch.states.iter().map(|message| message.envelope.tick))
            };
            from_log
                .each(|batch| {
                    take(batch);
                    Ok(true)
                })
                .unwrap();
        });
        assert!(came.iter().copied().eq(0..MESSAGES), "{} came", came.len());
    }

    #[test]
    fn a_flight_that_has_ended_keeps_nobody_from_reading_on() {
        let (mut to_flight, from_log) = batches();
        std::thread::scope(|scope| {
            let flight = scope.spawn(move || from_log.each(|_| Ok(false)));
            for tick in 0..3 * (BATCH * ON_THEIR_WAY) as u64 {
                to_flight.push(&state(tick));
            }
            to_flight.finish();
            flight.join().unwrap().unwrap();
        });
    }
}
