//! Passes the messages of a log to the replay thread in batches.

use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, channel, sync_channel};

use flight_log::entry::LogEntry;

/// Batch size [messages]: replaying one takes longer than waking a thread.
const BATCH: usize = 256;
/// Batches in flight: one chunk of the log, which is decompressed at once.
const ON_THEIR_WAY: usize = 16;

/// Messages in the order of the log.
pub type Batch = Vec<LogEntry>;

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
    newest: Batch,
}

pub fn batches() -> (ToFlight, FromLog) {
    let (to_flight, full) = sync_channel(ON_THEIR_WAY);
    let (to_log, empty) = channel();
    let to_flight = ToFlight {
        batch: Batch::with_capacity(BATCH),
        full: to_flight,
        empty,
    };
    let from_log = FromLog {
        full,
        empty: to_log,
        newest: Batch::new(),
    };
    (to_flight, from_log)
}

impl ToFlight {
    /// Adds a message; ignored after the replay has ended.
    pub fn push(&mut self, entry: &LogEntry) {
        self.batch.push(*entry);
        if self.batch.len() == BATCH {
            self.hand_over();
        }
    }

    pub fn finish(mut self) {
        self.hand_over();
    }

    fn hand_over(&mut self) {
        let mut next = match self.empty.try_recv() {
            Ok(empty) => empty,
            Err(TryRecvError::Empty) => Batch::with_capacity(BATCH),
            // The flight has ended. The log is still read to its end.
            Err(TryRecvError::Disconnected) => return self.batch.clear(),
        };
        next.clear();
        // The flight may end between the two.
        let _ = self.full.send(std::mem::replace(&mut self.batch, next));
    }
}

impl FromLog {
    /// The next batch; none at the end of the log.
    pub fn next_batch(&mut self) -> Option<&Batch> {
        let batch = self.full.recv().ok()?;
        // A reader that has finished needs none.
        let _ = self.empty.send(std::mem::replace(&mut self.newest, batch));
        Some(&self.newest)
    }
}

#[cfg(test)]
mod tests {
    use messages::content::State;
    use messages::header::Message;

    use super::*;

    const MESSAGES: u64 = 3 * (BATCH * ON_THEIR_WAY) as u64 + 1;

    /// The ticks that a flight gets of a log, if it ends after `batches`.
    fn ticks_until(most_batches: usize) -> Vec<u64> {
        let (mut to_flight, mut from_log) = batches();
        let mut ticks = Vec::new();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for tick in 0..MESSAGES {
                    let message = Message::of_tick(tick, State::default());
                    to_flight.push(&LogEntry::State(message));
                }
                to_flight.finish();
            });
            for _ in 0..most_batches {
                let Some(batch) = from_log.next_batch() else {
                    break;
                };
                ticks.extend(batch.iter().map(|entry| entry.envelope().tick));
            }
            drop(from_log);
        });
        ticks
    }

    #[test]
    fn every_message_arrives_once_and_in_order() {
        assert!(ticks_until(usize::MAX).into_iter().eq(0..MESSAGES));
    }

    #[test]
    fn the_log_is_read_to_its_end_after_the_flight_has_ended() {
        assert_eq!(ticks_until(1).len(), BATCH);
    }
}
