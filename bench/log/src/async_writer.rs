//! Buffers writes to a disk that may be full or slow.
//!
//! A piece is written whole, waits, or is dropped. A separate thread writes the pieces and has them synced every
//! `SYNC_EVERY`, so a disk that blocks delays no other thread.
//!
//! ```text
//!   keeping --the disk takes no more--> waiting --it does again--> keeping
//!                                       waiting --MOST_WAITING_BYTES wait--> pieces are dropped until fewer do
//!                                       waiting --the end--> cut after the last whole piece
//! ```

use rustix::fs::fstatvfs;
use std::collections::VecDeque;
use std::fs::{File, Metadata};
use std::io::Write;
use std::os::unix::fs::{FileExt as _, MetadataExt as _};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{io, thread};

/// What may wait for the disk [bytes]: tens of seconds of a flight.
const MOST_WAITING_BYTES: u64 = 16 << 20;
/// Most bytes that one call writes. A kernel without preemption keeps the processor until a call returns, whatever thread waits for it.
const PART_BYTES: usize = 64 << 10;
/// What a log leaves free on its disk, for the report [bytes].
pub const LEFT_FREE_BYTES: u64 = 4 << 20;
/// How often what was written is synced: what a machine that hangs can lose, and a little more.
const SYNC_EVERY: Duration = Duration::from_secs(5);
/// How soon a disk that took nothing is tried again.
const RETRY_EVERY: Duration = Duration::from_millis(500);
/// How long the end of a file, or a flight in lockstep, waits for a disk that makes no progress.
const STANDSTILL_TIMEOUT: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 3 });

/// Where an [`AsyncWriter`] writes: a file, or one that is made when it is first used.
pub trait Disk: Send + 'static {
    fn file(&self) -> io::Result<&File>;

    fn metadata(&self) -> Option<Metadata> {
        self.file().ok()?.metadata().ok()
    }

    /// Bytes that are free on it; nothing where that is not known.
    fn free(&self) -> Option<u64> {
        let disk = fstatvfs(self.file().ok()?).ok()?;
        Some(disk.f_bavail * disk.f_frsize)
    }

    fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
        let file = self.file()?;
        let mut parts = bytes.chunks(PART_BYTES).zip((place..).step_by(PART_BYTES));
        parts.try_for_each(|(part, place)| file.write_all_at(part, place))
    }

    fn cut(&self, length: u64) -> io::Result<()> {
        self.file()?.set_len(length)
    }

    fn sync(&self) -> io::Result<()> {
        self.file()?.sync_data()
    }
}

impl Disk for File {
    fn file(&self) -> io::Result<&File> {
        Ok(self)
    }
}

/// Compares a file with how this process left it: fails if another program has changed it, and says whether one may have
/// written into it. Some file systems set the time later.
pub fn compare(left: &Metadata, there: &Metadata) -> Result<bool, String> {
    if (left.dev(), left.ino()) != (there.dev(), there.ino()) {
        return Err("another program replaced it".into());
    }
    let (before, now) = (left.len(), there.len());
    if before != now {
        let what = format!("another program changed its length from {before} to {now} bytes");
        return Err(what);
    }
    Ok((left.mtime(), left.mtime_nsec()) != (there.mtime(), there.mtime_nsec()))
}

/// A file, shared by the code that writes it and the code that watches it.
#[derive(Clone, Debug)]
pub struct AsyncWriter(Arc<Handle>);

/// The side of the queue that writes; the file ends with it.
#[derive(Debug)]
struct Handle(Arc<Queue>);

#[derive(Debug, Default)]
struct Queue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct QueueState {
    piece: Vec<u8>,
    /// A piece that was written, whose memory is used again.
    spare: Vec<u8>,
    pieces: VecDeque<Vec<u8>>,
    handed: u64,
    on_disk: u64,
    cut: Option<u64>,
    busy: bool,
    unsynced: bool,
    /// When a disk that took nothing the last time is tried again.
    retry_at: Option<Instant>,
    /// Why it did not, the first time.
    refused: Option<String>,
    has_gap: bool,
    has_given_up: bool,
    condition: Condition,
    /// Nothing more comes: what is there is to be written and synced at once.
    is_last: bool,
    is_closed: bool,
}

/// Length and identity of a file that was written, to compare it with later.
#[derive(Clone, Debug, Default)]
pub struct Condition {
    /// The file as it was left.
    pub left: Option<Metadata>,
    /// Whether another program may have written into it.
    pub is_doubtful: bool,
}

enum DiskJob {
    Write(Vec<u8>, u64),
    Cut(u64),
    Sync,
    End,
}

impl AsyncWriter {
    /// Of an empty file, which leaves so many bytes free on its disk.
    pub fn new(disk: impl Disk, left_free: u64) -> io::Result<Self> {
        let queue = Arc::new(Queue::default());
        let theirs = Arc::clone(&queue);
        thread::Builder::new()
            .name("disk".into())
            .spawn(move || theirs.serve(&disk, left_free))?;
        Ok(Self(Arc::new(Handle(queue))))
    }

    fn state(&self) -> MutexGuard<'_, QueueState> {
        self.0.0.state()
    }

    /// Ends a piece and hands it over, without waiting. Gives the length up to which everything is on the disk [bytes].
    pub fn settle(&self) -> u64 {
        let mut state = self.state();
        if !state.piece.is_empty() {
            let next = std::mem::take(&mut state.spare);
            let piece = std::mem::replace(&mut state.piece, next);
            state.handed += piece.len() as u64;
            state.pieces.push_back(piece);
            self.0.0.changed.notify_all();
        }
        state.on_disk
    }

    /// As [`Self::settle`]; but a piece for which too much waits is dropped, and the ones after it are not.
    pub fn settle_or_drop(&self) {
        if self.is_overfull() {
            self.state().piece.clear();
            self.note_dropped();
        } else {
            self.settle();
        }
    }

    pub fn note_dropped(&self) {
        let mib = MOST_WAITING_BYTES >> 20;
        let why = format!("the disk is too slow: {mib} MiB waited for it");
        self.state().note_gap(why);
    }

    /// As [`Self::settle`], has what is there synced at once, and takes nothing more.
    pub fn end(&self) {
        self.settle();
        self.state().end();
        self.0.0.changed.notify_all();
    }

    pub fn is_at_rest(&self) -> bool {
        self.state().is_at_rest()
    }

    /// As [`Self::end`], and waits until the disk has it all and has synced it. Where it takes nothing more, the file
    /// is cut after the last whole piece. Gives why it is not whole, where it is not.
    pub fn finish(&self) -> Option<String> {
        let on_disk = self.rest();
        if on_disk < self.written() {
            self.give_up(on_disk);
            self.rest();
        }
        self.gap()
    }

    /// As [`Self::end`], and waits until the disk has it all and has synced it, or takes nothing more; gives what it
    /// has [bytes].
    fn rest(&self) -> u64 {
        self.end();
        self.0.0.await_while(|state| !state.is_at_rest())
    }

    /// Length of the file when everything that was written is there [bytes].
    pub fn written(&self) -> u64 {
        let state = self.state();
        state.handed + state.piece.len() as u64
    }

    /// Whether so much waits that nothing more can.
    pub fn is_overfull(&self) -> bool {
        self.state().is_overfull()
    }

    /// Waits until more can wait, or the disk stands still.
    pub fn await_room(&self) {
        self.0.0.await_while(QueueState::is_overfull);
    }

    /// Takes nothing more, and has the file cut to a length at which it is readable [bytes].
    fn give_up(&self, length: u64) {
        let (mut state, seconds) = (self.state(), STANDSTILL_TIMEOUT.as_secs());
        state.refuse(format!("the disk took nothing for {seconds} s"));
        state.piece = Vec::new();
        state.pieces.clear();
        (state.has_gap, state.has_given_up) = (true, true);
        (state.handed, state.on_disk, state.cut) = (length, length, Some(length));
        self.0.0.changed.notify_all();
    }

    /// Why the file may lack something.
    pub fn gap(&self) -> Option<String> {
        let state = self.state();
        let has_gap = state.has_gap || state.on_disk < state.handed;
        state.refused.clone().filter(|_| has_gap)
    }

    pub fn condition(&self) -> Condition {
        self.state().condition.clone()
    }

    pub fn refused(&self) -> Option<String> {
        self.state().refused.clone()
    }
}

impl QueueState {
    fn refuse(&mut self, reason: String) {
        self.refused.get_or_insert(reason);
    }

    fn note_gap(&mut self, why: String) {
        if !std::mem::replace(&mut self.has_gap, true) {
            self.refused = Some(why);
        }
    }

    fn end(&mut self) {
        (self.is_last, self.retry_at) = (true, None);
    }

    fn is_overfull(&self) -> bool {
        self.handed - self.on_disk > MOST_WAITING_BYTES
    }

    fn is_at_rest(&self) -> bool {
        self.pieces.is_empty()
            && self.cut.is_none()
            && !self.busy
            && !(self.is_last && self.unsynced)
    }
}

impl Queue {
    fn state(&self) -> MutexGuard<'_, QueueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until this is no longer so, or the disk stands still; gives what is on the disk.
    fn await_while(&self, is_so: impl Fn(&QueueState) -> bool) -> u64 {
        let (mut moved_at, mut on_disk) = (Instant::now(), None);
        let mut state = self.state();
        while is_so(&state) && state.retry_at.is_none() && moved_at.elapsed() < STANDSTILL_TIMEOUT {
            if on_disk.replace(state.on_disk) != Some(state.on_disk) {
                moved_at = Instant::now();
            }
            state = self.wait(state);
        }
        state.on_disk
    }

    fn wait<'a>(&self, state: MutexGuard<'a, QueueState>) -> MutexGuard<'a, QueueState> {
        let waited = self.changed.wait_timeout(state, RETRY_EVERY);
        waited.unwrap_or_else(PoisonError::into_inner).0
    }

    fn serve(&self, disk: &impl Disk, left_free: u64) {
        let mut synced_at = Instant::now();
        loop {
            let job = self.next(synced_at);
            let found = disk.metadata();
            let outcome = match &job {
                DiskJob::Write(piece, place) => write(disk, piece, *place, left_free),
                DiskJob::Cut(length) => {
                    let cut = disk.cut(*length);
                    cut.map_err(|e| format!("cannot cut the file: {e}"))
                }
                DiskJob::Sync => {
                    synced_at = Instant::now();
                    let synced = disk.sync();
                    synced.map_err(|e| format!("cannot sync the file: {e}"))
                }
                DiskJob::End => return,
            };
            self.end_job(job, outcome, found, disk.metadata());
        }
    }

    /// Takes what came of a job, and the file before and after it. A piece that was not taken is tried again.
    fn end_job(
        &self,
        job: DiskJob,
        outcome: Result<(), String>,
        found: Option<Metadata>,
        left: Option<Metadata>,
    ) {
        let mut state = self.state();
        let before = state.condition.left.as_ref().zip(found);
        match before.map_or(Ok(false), |(left, found)| compare(left, &found)) {
            Ok(is_doubtful) => state.condition.is_doubtful |= is_doubtful,
            Err(why) => state.note_gap(why),
        }
        state.condition.left = left;
        state.busy = false;
        match (job, outcome) {
            (DiskJob::Write(..), _) if state.has_given_up => {}
            (DiskJob::Write(mut piece, _), Ok(())) => {
                state.on_disk += piece.len() as u64;
                piece.clear();
                state.spare = piece;
                (state.unsynced, state.retry_at) = (true, None);
            }
            (DiskJob::Write(piece, _), Err(reason)) => {
                state.refuse(reason);
                state.retry_at = Some(Instant::now() + RETRY_EVERY);
                state.pieces.push_front(piece);
            }
            (_, Ok(())) => {}
            (_, Err(why)) => state.note_gap(why),
        }
        self.changed.notify_all();
    }

    fn next(&self, synced_at: Instant) -> DiskJob {
        let mut state = self.state();
        loop {
            let is_due = synced_at.elapsed() >= SYNC_EVERY || state.is_last;
            let may_write = state.retry_at.is_none_or(|at| Instant::now() >= at);
            let job = if let Some(length) = state.cut.take() {
                DiskJob::Cut(length)
            } else if let Some(piece) = state.pieces.pop_front_if(|_| may_write) {
                DiskJob::Write(piece, state.on_disk)
            } else if state.unsynced && is_due {
                state.unsynced = false;
                DiskJob::Sync
            } else if state.is_closed && (state.pieces.is_empty() || state.retry_at.is_some()) {
                DiskJob::End
            } else {
                state = self.wait(state);
                continue;
            };
            // No job follows the last one.
            state.busy = !matches!(job, DiskJob::End);
            return job;
        }
    }
}

fn write(disk: &impl Disk, piece: &[u8], place: u64, left_free: u64) -> Result<(), String> {
    let needed = left_free + piece.len() as u64;
    if disk.free().is_some_and(|free| free < needed) {
        let mib = left_free >> 20;
        return Err(format!(
            "less than {mib} MiB would be left free on the disk"
        ));
    }
    disk.write_at(piece, place).map_err(|e| {
        // A reader finds whole pieces meanwhile; if this fails too, the next try overwrites it.
        let _ = disk.cut(place);
        e.to_string()
    })
}

impl Write for AsyncWriter {
    /// Never fails: what the disk does not take now waits.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.state();
        if !state.has_given_up {
            state.piece.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Handle {
    /// What was handed over is still written, if the disk takes it.
    fn drop(&mut self) {
        let mut state = self.0.state();
        state.end();
        state.is_closed = true;
        drop(state);
        self.0.changed.notify_all();
        self.0.await_while(|state| !state.is_at_rest());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read as _, Seek as _};
    use std::sync::mpsc::{Receiver, Sender, channel};

    /// A disk that writes when it is allowed to, and says what it did.
    struct Gate {
        file: File,
        allowed: Mutex<Receiver<()>>,
        done: Sender<&'static str>,
    }

    impl Disk for Gate {
        fn file(&self) -> io::Result<&File> {
            Ok(&self.file)
        }

        fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
            let allowed = self.allowed.lock().unwrap().recv();
            self.done.send("write").unwrap();
            // Who allows nothing more is a disk that is gone.
            allowed.map_err(|_| io::Error::other("gone"))?;
            self.file.write_all_at(bytes, place)
        }

        fn sync(&self) -> io::Result<()> {
            self.done.send("sync").map_err(io::Error::other)
        }
    }

    fn text(file: &mut File) -> String {
        let mut text = String::new();
        file.rewind().unwrap();
        file.read_to_string(&mut text).unwrap();
        text
    }

    fn gated() -> (File, AsyncWriter, Sender<()>, Receiver<&'static str>) {
        let file = tempfile::tempfile().unwrap();
        let ((allow, allowed), (done, was_done)) = (channel(), channel());
        let disk = Gate {
            file: file.try_clone().unwrap(),
            allowed: Mutex::new(allowed),
            done,
        };
        (file, AsyncWriter::new(disk, 0).unwrap(), allow, was_done)
    }

    #[test]
    fn a_disk_that_blocks_holds_nobody_up_and_loses_nothing_that_fits() {
        let (mut file, mut output, allow, done) = gated();
        for piece in ["one ", "two ", "three"] {
            output.write_all(piece.as_bytes()).unwrap();
            // Were it the writer that waits for the disk, it would wait for ever: nothing is allowed yet.
            assert_eq!(output.settle(), 0);
        }
        assert_eq!((output.written(), output.refused()), (13, None));
        output.end();
        assert!(text(&mut file).is_empty() && !output.is_at_rest());
        (0..3).for_each(|_| allow.send(()).unwrap());
        assert_eq!((output.rest(), output.finish()), (13, None));
        assert_eq!(text(&mut file), "one two three");
        let done = done.try_iter().collect::<Vec<_>>();
        assert_eq!(done, ["write", "write", "write", "sync"]);
    }

    #[test]
    fn a_disk_that_stands_still_at_the_end_is_named_and_the_file_ends_with_a_whole_piece() {
        let (mut file, mut output, allow, done) = gated();
        output.write_all(b"whole").unwrap();
        output.settle();
        allow.send(()).unwrap();
        done.recv().unwrap();
        while output.settle() < 5 {
            thread::yield_now();
        }
        assert_eq!(output.gap(), None);
        output.write_all(b" and a piece").unwrap();
        let reason = output.finish().unwrap();
        assert_eq!(reason, "the disk took nothing for 1 s");
        output.write_all(b" and too late").unwrap();
        // It is still in the middle of that write.
        allow.send(()).unwrap();
        assert_eq!((output.rest(), text(&mut file).as_str()), (5, "whole"));
    }

    #[test]
    fn a_disk_with_too_little_room_is_left_alone_and_a_file_that_cannot_be_written_is_no_failure() {
        let file = tempfile::tempfile().unwrap();
        let null = File::open("/dev/null").unwrap();
        let full = (file.try_clone().unwrap(), u64::MAX >> 1);
        for ((disk, left_free), why) in [
            (full, "left free on the disk"),
            ((null, 0), "Bad file descriptor"),
        ] {
            let mut output = AsyncWriter::new(disk, left_free).unwrap();
            output.write_all(&[0; 100]).unwrap();
            assert_eq!((output.rest(), file.metadata().unwrap().len()), (0, 0));
            assert!(output.refused().unwrap().contains(why), "{why}");
            assert!(!output.is_overfull());
            let much = vec![0; MOST_WAITING_BYTES as usize];
            output.write_all(&much).unwrap();
            output.settle();
            assert!(output.is_overfull());
        }
    }

    #[test]
    fn a_piece_that_is_written_in_parts_is_whole() {
        let mut file = tempfile::tempfile().unwrap();
        let mut output = AsyncWriter::new(file.try_clone().unwrap(), 0).unwrap();
        let lines: String = (0..40_000).map(|i| format!("{i}\n")).collect();
        assert!(lines.len() > 3 * PART_BYTES);
        output.write_all(lines.as_bytes()).unwrap();
        assert_eq!(output.rest(), lines.len() as u64);
        assert_eq!(text(&mut file), lines);
    }

    #[test]
    fn what_a_full_disk_took_of_a_piece_is_taken_back() {
        struct Full(File);
        impl Disk for Full {
            fn file(&self) -> io::Result<&File> {
                Ok(&self.0)
            }

            fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
                let fits = bytes.len().min(7 - place as usize);
                self.0.write_all_at(&bytes[..fits], place)?;
                if fits < bytes.len() {
                    return Err(io::ErrorKind::StorageFull.into());
                }
                Ok(())
            }
        }
        let mut file = tempfile::tempfile().unwrap();
        let mut output = AsyncWriter::new(Full(file.try_clone().unwrap()), 0).unwrap();
        output.write_all(b"line\n").unwrap();
        output.rest();
        output.write_all(b"a second line\n").unwrap();
        assert_eq!((output.rest(), text(&mut file).as_str()), (5, "line\n"));
        assert!(output.refused().is_some());
    }
}
