//! Files on disks that are full and slow.

use std::fs::File;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use model::telemetry::Signals;

use crate::facts::LogPlan;
use crate::spool::Disk;
use crate::writer::FlightLog;
use crate::writer::file::*;

struct FullDisk;

impl Disk for FullDisk {
    fn free(&self) -> Option<u64> {
        Some(0)
    }

    fn write_at(&self, _: &[u8], _: u64) -> io::Result<()> {
        unreachable!("there is no room")
    }

    fn cut(&self, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn what_waits_for_a_full_disk_is_not_said_to_be_in_the_file() {
    let plan = LogPlan::WHOLE;
    let facts = Facts {
        pace: Pace::Lockstep,
        sample_time_ns: 1_000_000,
        plan,
        signals: Signals::default(),
        no_theorem: None,
        records: Vec::new(),
    };
    let mut file = LogFile::begin(Spool::new(FullDisk, 1).unwrap(), &facts, 0, 0).unwrap();
    let state = Message { envelope: model::envelope::Envelope::new(), content: State::default() };
    file.take(&LogEntry::State(state));
    while file.refused().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    let fate = file.fate();
    assert_eq!((fate.bytes, fate.written, fate.dropped), (0, [0; 6], [1, 0, 0, 0, 0, 0]));
}

/// States that do not get smaller by being compressed.
#[derive(Default)]
struct Noise {
    tick: u64,
    word: u64,
}

impl Noise {
    /// As many as make a chunk.
    fn chunk(&mut self) -> Vec<Message<State>> {
        let mut bytes = Vec::new();
        let mut length = 0;
        let mut states = Vec::new();
        while length < CHUNK_BYTES {
            let mut state = Message { envelope: model::envelope::Envelope::new(), content: State::default() };
            (state.envelope.tick, self.tick) = (self.tick, self.tick + 1);
            for value in
                state.content.measured.position_w_m.iter_mut().chain(&mut state.content.measured.velocity_w_m_s)
            {
                self.word = self.word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                *value = f64::from_bits(self.word >> 2);
            }
            encode(&state, &mut bytes);
            length += bytes.len();
            states.push(state);
        }
        states
    }
}

/// A disk that stands still until it is let go.
struct Stuck(File, Arc<AtomicBool>);

impl Disk for Stuck {
    fn free(&self) -> Option<u64> {
        None
    }

    fn write_at(&self, bytes: &[u8], place: u64) -> io::Result<()> {
        while !self.1.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.0.write_at(bytes, place)
    }

    fn cut(&self, length: u64) -> io::Result<()> {
        self.0.cut(length)
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn what_a_slow_disk_had_no_room_for_is_counted_also_when_its_file_is_removed() {
    let directory = tempfile::tempdir().unwrap();
    let goes_on = Arc::new(AtomicBool::new(false));
    let path = directory.path().join(crate::file_name(0));
    let disk = Stuck(File::create(&path).unwrap(), Arc::clone(&goes_on));
    let plan = LogPlan { around_ticks: None, file_bytes: u64::MAX, files: Some(1) };
    let facts = Facts {
        pace: Pace::Lockstep,
        sample_time_ns: 1_000_000,
        plan,
        signals: Signals::default(),
        no_theorem: None,
        records: Vec::new(),
    };
    let mut log = FlightLog::create(&path, &facts).unwrap();
    log.file = LogFile::begin(Spool::new(disk, 1).unwrap(), &facts, 0, 0).unwrap();
    let mut noise = Noise::default();
    let mut taken = 0;
    let mut fly = |log: &mut FlightLog| {
        for state in noise.chunk() {
            log.take(LogEntry::State(state));
            taken += 1;
        }
        log.keep(taken).unwrap();
        taken
    };
    while !log.file.spool.is_overfull() {
        fly(&mut log);
    }
    fly(&mut log);
    let dropped = log.fate().dropped[0];
    log.facts.plan.file_bytes = 1 << 20;
    goes_on.store(true, Ordering::Relaxed);
    let deadline = std::time::Instant::now() + Duration::from_secs(60);
    let taken = loop {
        let taken = fly(&mut log);
        let fate = log.fate();
        assert_eq!(fate.written[0] + fate.dropped[0] + fate.removed[0], taken);
        if fate.removed[0] > 0 || std::time::Instant::now() > deadline {
            break taken;
        }
    };
    let fate = log.finish(BTreeMap::new()).unwrap();
    assert!(fate.removed[0] > 0 && fate.dropped[0] > 0 && dropped > 0, "{fate:?}");
    assert_eq!(fate.written[0] + fate.dropped[0] + fate.removed[0], taken, "{fate:?}");
}

#[test]
fn a_file_goes_on_after_what_a_slow_disk_had_no_room_for_and_is_whole() {
    let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
    let goes_on = Arc::new(AtomicBool::new(false));
    let disk = Stuck(File::create(&path).unwrap(), Arc::clone(&goes_on));
    let run = [("version", env!("CARGO_PKG_VERSION"))];
    let records = vec![(crate::facts::RUN, crate::facts::record(&run))];
    let facts = Facts {
        pace: Pace::Lockstep,
        sample_time_ns: 1_000_000,
        plan: LogPlan::WHOLE,
        signals: Signals::default(),
        no_theorem: None,
        records,
    };
    let mut file = LogFile::begin(Spool::new(disk, 1).unwrap(), &facts, 0, 0).unwrap();
    let mut noise = Noise::default();
    let mut chunk = |file: &mut LogFile| {
        let begin = noise.tick;
        noise.chunk().into_iter().for_each(|state| file.take(&LogEntry::State(state)));
        assert!(file.keep(noise.tick).unwrap());
        begin..noise.tick
    };
    let mut kept = Vec::new();
    while !file.spool.is_overfull() {
        kept.extend(chunk(&mut file));
    }
    let dropped = chunk(&mut file);
    goes_on.store(true, Ordering::Relaxed);
    while file.spool.is_overfull() {
        std::thread::sleep(Duration::from_millis(1));
    }
    kept.extend(chunk(&mut file));
    file.close(BTreeMap::new()).unwrap();
    file.wait();
    let fate = file.fate();
    assert_eq!((fate.written[0], fate.dropped[0]), (kept.len() as u64, dropped.count() as u64));
    assert!(file.refused().unwrap().contains("the disk is too slow"));
    assert_eq!(fate.bytes, path.metadata().unwrap().len());
    let mut reader = crate::reader::LogReader::open(&path).unwrap();
    let read: Vec<u64> = std::iter::from_fn(|| reader.next_entry().unwrap().copied())
        .map(|entry| match entry {
            LogEntry::State(state) => state.envelope.tick,
            _ => unreachable!("only states were written"),
        })
        .collect();
    assert_eq!((read, reader.end()), (kept, crate::reader::End::Complete));
    // The index says the same.
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().channel_message_counts[&file.channels[<State as Topic>::NAME]], fate.written[0]);
}
