//! Hands the messages of a log to the thread that flies them again, many at a time.

use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, channel, sync_channel};

use failure::Failure;
use flight_log::entry::LogEntry;

/// Messages handed over at once: they take longer than the waking of a thread.
const BATCH: usize = 256;
/// Batches on their way: a chunk of the log, which is decompressed at once.
const ON_THEIR_WAY: usize = 16;

/// The end that reads.
#[derive(Debug)]
pub struct ToFlight {
    batch: Vec<LogEntry>,
    full: SyncSender<Vec<LogEntry>>,
    /// To be filled again: new memory costs as much as what is put there.
    empty: Receiver<Vec<LogEntry>>,
}

/// The end that flies.
#[derive(Debug)]
pub struct FromLog {
    full: Receiver<Vec<LogEntry>>,
    empty: Sender<Vec<LogEntry>>,
}

/// A way from one thread to another.
#[must_use]
pub fn batches() -> (ToFlight, FromLog) {
    let (full, from_log) = sync_channel(ON_THEIR_WAY);
    let (to_log, empty) = channel();
    (ToFlight { batch: Vec::with_capacity(BATCH), full, empty }, FromLog { full: from_log, empty: to_log })
}

impl ToFlight {
    /// Takes a message; nothing happens to it where the flight has ended.
    pub fn push(&mut self, entry: &LogEntry) {
        self.batch.push(*entry);
        if self.batch.len() == BATCH {
            self.hand_over();
        }
    }

    /// Hands over what is left.
    pub fn finish(mut self) {
        self.hand_over();
    }

    fn hand_over(&mut self) {
        let next = match self.empty.try_recv() {
            Ok(mut empty) => {
                empty.clear();
                empty
            }
            Err(TryRecvError::Empty) => Vec::with_capacity(BATCH),
            // The flight has ended. The log is still read to its end.
            Err(TryRecvError::Disconnected) => return self.batch.clear(),
        };
        // It may end between the two.
        let _ = self.full.send(std::mem::replace(&mut self.batch, next));
    }
}

impl FromLog {
    /// Calls `fly` with the batches as they come, as long as it wants more.
    ///
    /// # Errors
    /// Those of `fly`.
    pub fn each(self, mut fly: impl FnMut(&[LogEntry]) -> Result<bool, Failure>) -> Result<(), Failure> {
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
