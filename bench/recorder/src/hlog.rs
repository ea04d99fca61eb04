//! latency.hlog: every series, interval by interval, as an HdrHistogram interval log of whole lines.
//!
//! Its recorder holds a lock on it, which shows whether a flight is still being recorded ([`lives`]).

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriter, IntervalLogWriterBuilder};
use rustix::fs::{FlockOperation, flock};

use analysis::series::SeriesSet;
use errors::{Failure, InFile as _, open_file};
use flight_log::async_writer::AsyncWriter;

use crate::run_directory::LATENCIES;

/// Disk space left free for the report [bytes].
const LEFT_FREE_BYTES: u64 = 1 << 20;

pub struct Hlog<'a> {
    writer: IntervalLogWriter<'a, 'a, AsyncWriter, V2DeflateSerializer>,
    lines: AsyncWriter,
    length: Duration,
    intervals: u32,
}

/// Creates an empty file in a run directory, locked until this process ends.
pub fn create(directory: &Path) -> Result<AsyncWriter, Failure> {
    let path = directory.join(LATENCIES);
    let file = File::create(&path).in_file("write", &path)?;
    // A file system without locks: `lives` then returns false for every flight.
    let _ = flock(&file, FlockOperation::LockExclusive);
    AsyncWriter::new(file, LEFT_FREE_BYTES).in_file("write", &path)
}

impl<'a> Hlog<'a> {
    /// Starts the log of a flight that began at `start_wall_ns` [ns since 1970], in intervals of `length_s` [s]. The first
    /// has the number `intervals`: a recorder may begin in the middle of a flight.
    pub fn begin(
        lines: &AsyncWriter,
        out: &'a mut AsyncWriter,
        serializer: &'a mut V2DeflateSerializer,
        start_wall_ns: u64,
        length_s: u64,
        intervals: u32,
    ) -> Result<Self, Failure> {
        let start: SystemTime = UNIX_EPOCH + Duration::from_nanos(start_wall_ns);
        let writer = IntervalLogWriterBuilder::new()
            .add_comment(&format!(
                "[ironbird: values in nanoseconds, a tag per series, intervals of {length_s} s]"
            ))
            .with_start_time(start)
            .with_base_time(start)
            .with_max_value_divisor(1e6)
            .begin_log_with(out, serializer)
            .map_err(|e| Failure::failed(format!("cannot write {LATENCIES}: {e:?}")))?;
        lines.settle_or_drop();
        Ok(Self {
            writer,
            lines: lines.clone(),
            length: Duration::from_secs(length_s),
            intervals,
        })
    }

    /// Waits until all lines are on the disk.
    pub fn finish(&self) -> Result<(), Failure> {
        let gap = self.lines.finish();
        gap.map_or(Ok(()), |reason| Err(Failure::failed(reason)))
    }

    /// Writes the current interval of every series and starts the next one.
    pub fn close_interval(&mut self, series: &mut SeriesSet) -> Result<(), Failure> {
        let closed =
            series.close_interval(&mut self.writer, self.intervals * self.length, self.length);
        self.lines.settle_or_drop();
        self.intervals += 1;
        closed
    }
}

/// Whether a recorder still writes into a run directory. Returns true if that is unknown.
pub fn lives(directory: &Path) -> bool {
    match open_file(&directory.join(LATENCIES)) {
        Ok(file) => flock(&file, FlockOperation::NonBlockingLockShared).is_err(),
        // A pipe or a device is not a recorder's file.
        Err(e) => e.kind() != ErrorKind::InvalidInput,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use analysis::series::Series;

    #[test]
    fn a_finished_log_is_of_whole_lines_and_free_again() {
        let directory = tempfile::tempdir().unwrap();
        let lines = create(directory.path()).unwrap();
        let (mut out, mut serializer) = (lines.clone(), V2DeflateSerializer::new());
        let start_ns = 1_700_000_000_000_000_000;
        let mut hlog = Hlog::begin(&lines, &mut out, &mut serializer, start_ns, 1, 3).unwrap();
        let mut series = SeriesSet::new().unwrap();
        series.record(Series::Loop, 30_000);
        assert!(lives(directory.path()), "it is locked");
        hlog.close_interval(&mut series).unwrap();
        hlog.finish().unwrap();
        drop(hlog);
        drop((lines, out));
        let text = fs::read_to_string(directory.path().join(LATENCIES)).unwrap();
        let last = text.lines().last().unwrap();
        let is_whole = text.ends_with('\n') && last.starts_with("Tag=loop,3.000,1.000,");
        assert!(is_whole, "{text}");
        while lives(directory.path()) {
            std::thread::yield_now();
        }
    }
}
