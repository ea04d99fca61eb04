//! Passes the messages of a log to the replay thread, chunk by chunk, in the order in which the recorder took them.

use std::mem::{replace, take};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};

use flight_log::entry::{EntryLists, EntryPlace, EntryRef, LogEntry};

/// Chunks on their way: one is decompressed while another one is replayed.
const ON_THEIR_WAY: usize = 1;
/// Messages that are replayed while one is on its way from the cache of the processor that decoded it.
const FETCHED_AHEAD: usize = 1;

/// The messages of a chunk by topic, as one processor hands every byte of them to another.
#[derive(Debug, Default)]
struct Chunk {
    /// Position in the recorder's order, then in the log; place in the lists.
    order: Vec<(u64, usize, EntryPlace)>,
    lists: EntryLists,
}

#[derive(Debug)]
pub struct ToReplay {
    chunk: Chunk,
    number: u64,
    full: SyncSender<Chunk>,
    /// Replayed chunks, whose memory is used again.
    used: Receiver<Chunk>,
}

#[derive(Debug)]
pub struct FromLog {
    chunk: Chunk,
    /// Messages of the chunk that were replayed.
    replayed: usize,
    full: Receiver<Chunk>,
    used: Sender<Chunk>,
}

pub fn batches() -> (ToReplay, FromLog) {
    let ((to_replay, full), (to_log, used)) = (sync_channel(ON_THEIR_WAY), channel());
    let to_replay = ToReplay {
        chunk: Chunk::default(),
        number: 0,
        full: to_replay,
        used,
    };
    let from_log = FromLog {
        chunk: Chunk::default(),
        replayed: 0,
        full,
        used: to_log,
    };
    (to_replay, from_log)
}

impl ToReplay {
    /// Adds a message of a chunk, which has a number of its own, with its position in the recorder's order.
    pub fn push(&mut self, chunk: u64, position: u64, message: &LogEntry) {
        if chunk != self.number {
            self.number = chunk;
            self.hand_over();
        }
        let Chunk { order, lists } = &mut self.chunk;
        order.push((position, order.len(), lists.push(message)));
    }

    pub fn finish(mut self) {
        self.hand_over();
    }

    fn hand_over(&mut self) {
        let mut chunk = take(&mut self.chunk);
        // Messages at one position follow from the same message, and stand in the log in their order. Those of a topic are sorted already.
        chunk.order.sort();
        // The replay may have ended at a difference.
        let _ = self.full.send(chunk);
        self.chunk = self.used.try_recv().unwrap_or_default();
        self.chunk.order.clear();
        self.chunk.lists.clear();
    }
}

impl FromLog {
    /// Position of the next message; none at the end of the log.
    pub fn position(&mut self) -> Option<u64> {
        while self.replayed == self.chunk.order.len() {
            let used = replace(&mut self.chunk, self.full.recv().ok()?);
            self.replayed = 0;
            // The log may have ended.
            let _ = self.used.send(used);
        }
        Some(self.chunk.order[self.replayed].0)
    }

    pub fn next_entry(&mut self) -> Option<EntryRef<'_>> {
        self.position()?;
        let (.., place) = self.chunk.order[self.replayed];
        self.replayed += 1;
        if let Some((.., soon)) = self.chunk.order.get(self.replayed + FETCHED_AHEAD) {
            self.chunk.lists.at(*soon).prefetch();
        }
        Some(self.chunk.lists.at(place))
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
                            to_replay.push(chunk, position, &LogEntry::State(message));
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
