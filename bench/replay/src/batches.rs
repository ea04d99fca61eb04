//! Passes the messages of a log to the replay thread, chunk by chunk, in the order in which the recorder took them.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use flight_log::entry::LogEntry;

/// Chunks on their way: one is decompressed while another one is replayed.
const ON_THEIR_WAY: usize = 1;

/// A message with its position in the recorder's order.
pub type Positioned = (u64, LogEntry);

#[derive(Debug)]
pub struct ToReplay {
    chunk: Vec<Positioned>,
    number: u64,
    full: SyncSender<Vec<Positioned>>,
}

#[derive(Debug)]
pub struct FromLog {
    full: Receiver<Vec<Positioned>>,
    chunk: VecDeque<Positioned>,
}

pub fn batches() -> (ToReplay, FromLog) {
    let (to_replay, full) = sync_channel(ON_THEIR_WAY);
    let to_replay = ToReplay {
        chunk: Vec::new(),
        number: 0,
        full: to_replay,
    };
    let chunk = VecDeque::new();
    (to_replay, FromLog { full, chunk })
}

impl ToReplay {
    /// Adds a message of a chunk, which has a number of its own.
    pub fn push(&mut self, chunk: u64, message: Positioned) {
        if chunk != self.number {
            self.number = chunk;
            self.hand_over();
        }
        self.chunk.push(message);
    }

    pub fn finish(mut self) {
        self.hand_over();
    }

    fn hand_over(&mut self) {
        let mut chunk = std::mem::take(&mut self.chunk);
        // Stable: messages at one position follow from the same message, and stand in their order.
        chunk.sort_by_key(|(position, _)| *position);
        // The replay may have ended at a difference.
        let _ = self.full.send(chunk);
    }
}

impl FromLog {
    /// Position of the next message; none at the end of the log.
    pub fn position(&mut self) -> Option<u64> {
        while self.chunk.is_empty() {
            self.chunk = self.full.recv().ok()?.into();
        }
        self.chunk.front().map(|(position, _)| *position)
    }

    pub fn next_entry(&mut self) -> Option<LogEntry> {
        self.position()?;
        self.chunk.pop_front().map(|(_, entry)| entry)
    }
}

#[cfg(test)]
mod tests {
    use messages::content::State;
    use messages::header::Message;

    use super::*;

    #[test]
    fn messages_come_in_the_order_of_their_positions_and_the_log_is_read_to_its_end() {
        for most in [usize::MAX, 5] {
            let (mut to_replay, mut from_log) = batches();
            let mut positions = Vec::new();
            std::thread::scope(|scope| {
                scope.spawn(move || {
                    for chunk in 0..100 {
                        for position in [3, 4, 1, 2] {
                            let message = Message::of_tick(position, State::default());
                            let position = 4 * chunk + position;
                            to_replay.push(chunk, (position, LogEntry::State(message)));
                        }
                    }
                    to_replay.finish();
                });
                while positions.len() < most
                    && let Some(position) = from_log.position()
                {
                    positions.push(position);
                    assert!(from_log.next_entry().is_some());
                }
                drop(from_log);
            });
            assert!(positions.into_iter().eq((1..=400).take(most)));
        }
    }
}
