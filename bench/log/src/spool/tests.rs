//! The spool on disks that are whole, full, broken, and blocked.

use std::io::{Read as _, Seek as _};
use std::sync::mpsc::{Receiver, Sender, channel};

use crate::spool::*;

/// A disk that writes when it is allowed to, and says what it did.
struct Gate {
    file: File,
    allowed: Mutex<Receiver<()>>,
    done: Sender<&'static str>,
}

impl Disk for Gate {
    fn free(&self) -> Option<u64> {
        None
    }

    fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
        let allowed = self.allowed.lock().unwrap().recv();
        self.done.send("write").unwrap();
        // Who allows nothing more is a disk that is gone.
        allowed.map_err(|_| io::Error::other("gone"))?;
        self.file.write_all_at(bytes, place)
    }

    fn cut(&self, length: u64) -> io::Result<()> {
        self.file.set_len(length)
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

fn gated() -> (File, Spool, Sender<()>, Receiver<&'static str>) {
    let file = tempfile::tempfile().unwrap();
    let ((allow, allowed), (done, was_done)) = (channel(), channel());
    let disk = Gate { file: file.try_clone().unwrap(), allowed: Mutex::new(allowed), done };
    (file, Spool::new(disk, 0).unwrap(), allow, was_done)
}

#[test]
fn what_waits_goes_in_order_and_what_is_given_up_is_cut() {
    let mut file = tempfile::tempfile().unwrap();
    let mut spool = Spool::new(file.try_clone().unwrap(), 0).unwrap();
    spool.write_all(b"first").unwrap();
    assert_eq!((spool.written(), spool.rest(), spool.written()), (5, 5, 5));
    spool.write_all(b" second").unwrap();
    assert_eq!(spool.rest(), 12);
    spool.give_up(5);
    spool.write_all(b" third").unwrap();
    assert_eq!((spool.rest(), spool.gap().is_some(), spool.written()), (5, true, 5));
    assert_eq!(text(&mut file), "first");
}

#[test]
fn a_disk_that_blocks_holds_nobody_up_and_loses_nothing_that_fits() {
    let (mut file, mut spool, allow, done) = gated();
    for piece in ["one ", "two ", "three"] {
        spool.write_all(piece.as_bytes()).unwrap();
        // Were it the writer that waits for the disk, it would wait for ever: nothing is allowed yet.
        assert_eq!(spool.settle(), 0);
    }
    assert_eq!((spool.written(), spool.refused(), text(&mut file).as_str()), (13, None, ""));
    (0..3).for_each(|_| allow.send(()).unwrap());
    assert_eq!((spool.rest(), spool.finish()), (13, None));
    assert_eq!(text(&mut file), "one two three");
    assert_eq!(done.try_iter().collect::<Vec<_>>(), ["write", "write", "write", "sync"], "synced at the end");
}

#[test]
fn a_file_that_is_ended_while_its_disk_blocks_is_waited_for_by_nobody() {
    let (mut file, mut spool, allow, done) = gated();
    spool.write_all(b"last").unwrap();
    spool.end();
    assert!(!spool.is_at_rest(), "nothing is allowed yet");
    allow.send(()).unwrap();
    while !spool.is_at_rest() {
        thread::yield_now();
    }
    assert_eq!((text(&mut file).as_str(), spool.settle()), ("last", 4));
    assert_eq!(done.try_iter().collect::<Vec<_>>(), ["write", "sync"]);
}

#[test]
fn what_a_disk_that_blocks_for_too_long_has_no_room_for_is_dropped_and_what_comes_after_it_is_not() {
    let (mut file, mut spool, allow, done) = gated();
    let much = vec![b'x'; PATIENCE_BYTES as usize + 1];
    for piece in [&much[..], b" dropped", b" too"] {
        spool.write_all(piece).unwrap();
        spool.settle_or_drop();
    }
    assert!(spool.is_overfull());
    assert_eq!(spool.written(), PATIENCE_BYTES + 1);
    assert!(spool.gap().unwrap().contains("the disk is too slow: 16 MiB waited"), "{:?}", spool.gap());
    allow.send(()).unwrap();
    assert_eq!(done.recv(), Ok("write"));
    while spool.is_overfull() {
        thread::yield_now();
    }
    spool.write_all(b" kept").unwrap();
    spool.settle_or_drop();
    allow.send(()).unwrap();
    assert_eq!(spool.rest(), PATIENCE_BYTES + 6);
    assert_eq!(text(&mut file).trim_start_matches('x'), " kept");
    assert!(spool.gap().is_some(), "what was dropped stays so");
}

#[test]
fn a_disk_that_stands_still_at_the_end_is_named_and_the_file_ends_with_a_whole_piece() {
    let (mut file, mut spool, allow, done) = gated();
    spool.write_all(b"whole").unwrap();
    spool.settle();
    allow.send(()).unwrap();
    done.recv().unwrap();
    while spool.settle() < 5 {
        thread::yield_now();
    }
    assert_eq!(spool.gap(), None);
    spool.write_all(b" and a piece").unwrap();
    assert_eq!(spool.finish().as_deref(), Some("the disk took nothing for 3 s"));
    // It is still in the middle of that write.
    allow.send(()).unwrap();
    assert_eq!((spool.rest(), text(&mut file).as_str()), (5, "whole"));
}

#[test]
fn a_disk_with_too_little_room_is_left_alone_and_said_so() {
    let file = tempfile::tempfile().unwrap();
    let mut spool = Spool::new(file.try_clone().unwrap(), u64::MAX >> 1).unwrap();
    spool.write_all(&[0; 100]).unwrap();
    assert_eq!((spool.rest(), file.metadata().unwrap().len()), (0, 0));
    assert!(spool.refused().unwrap().contains("left free on the disk"));
    assert!(!spool.is_overfull());
    spool.write_all(&vec![0; PATIENCE_BYTES as usize]).unwrap();
    spool.settle();
    assert!(spool.is_overfull());
}

#[test]
fn a_file_that_cannot_be_written_is_no_failure_of_the_writer() {
    let mut spool = Spool::new(File::open("/dev/null").unwrap(), 0).unwrap();
    spool.write_all(b"lost").unwrap();
    assert_eq!(spool.rest(), 0);
    assert!(spool.refused().is_some_and(|reason| reason.contains("Bad file descriptor")), "{:?}", spool.refused());
}

#[test]
fn what_a_full_disk_took_of_a_piece_is_taken_back() {
    struct Full(File);
    impl Disk for Full {
        fn free(&self) -> Option<u64> {
            None
        }
        fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
            let fits = bytes.len().min(7 - place as usize);
            self.0.write_all_at(&bytes[..fits], place)?;
            if fits == bytes.len() { Ok(()) } else { Err(io::Error::from(io::ErrorKind::StorageFull)) }
        }
        fn cut(&self, length: u64) -> io::Result<()> {
            self.0.set_len(length)
        }
        fn sync(&self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut file = tempfile::tempfile().unwrap();
    let mut spool = Spool::new(Full(file.try_clone().unwrap()), 0).unwrap();
    spool.write_all(b"line\n").unwrap();
    spool.rest();
    spool.write_all(b"a second line\n").unwrap();
    assert_eq!((spool.rest(), text(&mut file).as_str()), (5, "line\n"));
    assert!(spool.refused().is_some());
}

#[test]
fn a_spool_that_is_dropped_waits_for_no_thread_that_has_ended() {
    for _ in 0..50 {
        let mut spool = Spool::new(tempfile::tempfile().unwrap(), 0).unwrap();
        spool.write_all(b"piece").unwrap();
        spool.rest();
        let begun = Instant::now();
        drop(spool);
        assert!(begun.elapsed() < END_PATIENCE, "it was waited for a thread that says nothing any more");
    }
}
