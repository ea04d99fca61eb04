//! Passes the messages of a log to the replay thread in batches.

use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, channel, sync_channel};

use errors::Failure;
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
    /// Calls `fly` with each batch until it returns false.
    pub fn each(self, mut fly: impl FnMut(&Batch) -> Result<bool, Failure>) -> Result<(), Failure> {
        for batch in &self.full {
            if !fly(&batch)? {
                break;
            }
            // A reader that has finished needs none.
            let _ = self.empty.send(batch);
        }
        Ok(())
    }
}
