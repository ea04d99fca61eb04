//! The reference for wake-up latency: `cyclictest` of Debian's rt-tests.
//!
//! It runs on the same processor, with the same priority and period.

use std::process::Command;

use analysis::series::Latencies;
use errors::Failure;
use process::rt::{end_with_this_thread, loops_cpu};

use super::timer::Schedule;

/// How late it woke [ns].
///
/// It prints nothing for ticks that it slept through; they enter with their whole lateness, as the rig's do.
pub fn measure(schedule: &Schedule) -> Result<Latencies, Failure> {
    let (period_ns, priority) = (schedule.period_ns, schedule.priority);
    let cpu = schedule.cpu.unwrap_or_else(loops_cpu);
    let (period_us, seconds) = (period_ns / 1000, schedule.duration.as_secs().max(1));
    // Every sample in nanoseconds on standard output.
    let arguments = format!(
        "--mlockall --threads=1 --distance=0 --nsecs --verbose --affinity={cpu} --priority={priority} \
         --interval={period_us} --duration={seconds}"
    );
    let output = end_with_this_thread(Command::new("cyclictest").args(arguments.split(' ')))
        .output()
        .map_err(|e| {
            Failure::failed(format!("cannot start cyclictest: {e}"))
                .help("apt-get install rt-tests")
        })?;
    if !output.status.success() {
        let (status, complaint) = (output.status, String::from_utf8_lossy(&output.stderr));
        let complaint = complaint.trim().replace('\n', " ");
        return Err(Failure::failed(format!(
            "cyclictest ended with {status}: {complaint}"
        )));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let mut lateness = Latencies::new()?;
    for sample in text.lines().filter_map(sample) {
        owed(sample, period_ns).for_each(|late| lateness.record(late));
    }
    if lateness.is_empty() {
        return Err(Failure::failed("cyclictest printed no sample"));
    }
    Ok(lateness)
}

/// The lateness of the tick that a sample is of, and of those after it that had begun by then [ns].
fn owed(sample: u64, period_ns: u64) -> impl Iterator<Item = u64> {
    std::iter::successors(Some(sample), move |late| late.checked_sub(period_ns))
}

/// The lateness in a line `thread: cycle: lateness` [ns].
fn sample(line: &str) -> Option<u64> {
    let mut parts = line.split(':').map(str::trim);
    let (thread, cycle, lateness) = (parts.next()?, parts.next()?, parts.next()?);
    thread.parse::<u64>().ok()?;
    cycle.parse::<u64>().ok()?;
    lateness.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_lines_of_numbers_and_ticks_slept_through_are_owed() {
        assert_eq!(sample("       0:      17:   28231"), Some(28_231));
        for other in ["Max CPUs = 2", "# /dev/cpu_dma_latency set to 0us", ""] {
            assert_eq!(sample(other), None, "{other}");
        }
        assert!(owed(17_000, 1_000_000).eq([17_000]));
        assert!(owed(2_300_000, 1_000_000).eq([2_300_000, 1_300_000, 300_000]));
    }
}
