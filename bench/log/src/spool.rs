//! Buffers chunks between the log's writer and a disk that may be full.
//!
//! A chunk is written whole, waits, or is left out.
//!
//! ```text
//!   keeping --the disk takes no more--> waiting --it does again--> keeping
//!                                       waiting --PATIENCE_BYTES wait--> given up, cut after the last whole chunk
//! ```

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt as _;
use std::rc::Rc;

use rustix::fs::fstatvfs;

/// What may wait for the disk [bytes]: tens of seconds of a flight.
const PATIENCE_BYTES: usize = 16 << 20;
/// What the log leaves free on its disk, for the report [bytes].
const LEFT_FREE_BYTES: u64 = 4 << 20;

/// The file of a log, shared by the one who writes it and the one who looks after it.
#[derive(Clone, Debug)]
pub struct Spool(Rc<RefCell<Kept>>);

#[derive(Debug)]
struct Kept {
    file: File,
    /// What the disk has [bytes].
    on_disk: u64,
    waiting: Vec<u8>,
    left_free: u64,
    /// Why the disk did not take something, the first time.
    refused: Option<String>,
    has_given_up: bool,
}

impl Spool {
    /// Of an empty file.
    #[must_use]
    pub fn new(file: File) -> Self {
        Self::leaving(file, LEFT_FREE_BYTES)
    }

    fn leaving(file: File, left_free: u64) -> Self {
        let kept = Kept { file, on_disk: 0, waiting: Vec::new(), left_free, refused: None, has_given_up: false };
        Self(Rc::new(RefCell::new(kept)))
    }

    /// Hands what waits to the disk. Gives the length up to which everything is there [bytes].
    pub fn settle(&self) -> u64 {
        self.0.borrow_mut().settle()
    }

    /// Length of the file when everything that was written is there [bytes].
    #[must_use]
    pub fn written(&self) -> u64 {
        let kept = self.0.borrow();
        kept.on_disk + kept.waiting.len() as u64
    }

    /// Whether so much waits that it makes no sense to write more.
    #[must_use]
    pub fn is_overfull(&self) -> bool {
        self.0.borrow().waiting.len() > PATIENCE_BYTES
    }

    /// Takes nothing more, and cuts the file to a length at which it is readable [bytes].
    pub fn give_up(&self, length: u64) {
        let mut kept = self.0.borrow_mut();
        kept.has_given_up = true;
        kept.waiting = Vec::new();
        if let Err(e) = kept.file.set_len(length) {
            kept.refuse(format!("cannot cut the file: {e}"));
        }
        kept.on_disk = length;
    }

    /// Whether it has given up.
    #[must_use]
    pub fn has_given_up(&self) -> bool {
        self.0.borrow().has_given_up
    }

    /// Why the disk did not take something, the first time.
    #[must_use]
    pub fn refused(&self) -> Option<String> {
        self.0.borrow().refused.clone()
    }
}

impl Kept {
    fn refuse(&mut self, reason: String) {
        self.refused.get_or_insert(reason);
    }

    fn settle(&mut self) -> u64 {
        if self.waiting.is_empty() || self.has_given_up {
            return self.on_disk;
        }
        if let Ok(disk) = fstatvfs(&self.file)
            && disk.f_bavail * disk.f_frsize < self.left_free + self.waiting.len() as u64
        {
            self.refuse(format!("less than {} MiB would be left free on the disk", self.left_free >> 20));
            return self.on_disk;
        }
        // At its place, so that what a failed call left of it is written over by the next one.
        match self.file.write_all_at(&self.waiting, self.on_disk) {
            Ok(()) => {
                self.on_disk += self.waiting.len() as u64;
                self.waiting.clear();
            }
            Err(e) => self.refuse(e.to_string()),
        }
        self.on_disk
    }
}

impl Write for Spool {
    /// Never fails: what the disk does not take now waits.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut kept = self.0.borrow_mut();
        if !kept.has_given_up {
            kept.waiting.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Seek as _};

    use super::*;

    #[test]
    fn what_waits_goes_in_order_and_what_is_given_up_is_cut() {
        let mut file = tempfile::tempfile().unwrap();
        let mut spool = Spool::leaving(file.try_clone().unwrap(), 0);
        spool.write_all(b"first").unwrap();
        assert_eq!((spool.written(), spool.settle(), spool.written()), (5, 5, 5));
        spool.write_all(b" second").unwrap();
        assert_eq!(spool.settle(), 12);
        spool.give_up(5);
        spool.write_all(b" third").unwrap();
        assert_eq!((spool.settle(), spool.has_given_up(), spool.refused()), (5, true, None));
        let mut text = String::new();
        file.rewind().unwrap();
        file.read_to_string(&mut text).unwrap();
        assert_eq!(text, "first");
    }

    #[test]
    fn a_disk_with_too_little_room_is_left_alone_and_said_so() {
        let file = tempfile::tempfile().unwrap();
        let mut spool = Spool::leaving(file.try_clone().unwrap(), u64::MAX >> 1);
        spool.write_all(&[0; 100]).unwrap();
        assert_eq!((spool.settle(), file.metadata().unwrap().len()), (0, 0));
        assert!(spool.refused().unwrap().contains("left free on the disk"));
        assert!(!spool.is_overfull());
        spool.write_all(&vec![0; PATIENCE_BYTES]).unwrap();
        assert!(spool.is_overfull());
    }

    #[test]
    fn a_file_that_cannot_be_written_is_no_failure_of_the_writer() {
        let mut spool = Spool::leaving(File::open("/dev/null").unwrap(), 0);
        spool.write_all(b"lost").unwrap();
        assert_eq!(spool.settle(), 0);
        assert!(spool.refused().is_some_and(|reason| reason.contains("Bad file descriptor")), "{:?}", spool.refused());
    }
}
