//! The machine's floors: what they count and what ends them; how fast they are is no test's business.

use std::path::Path;
use std::time::Duration;

use crate::rig::ironbird;
use errors::Failure;
use host::floor::ring::{self, RingFloor, Work};
use host::floor::timer::Schedule;

const FLOWN: Duration = Duration::from_millis(200);

fn ring(
    processes: usize,
    work: Work,
    duration: Duration,
    executable: &str,
) -> Result<RingFloor, Failure> {
    let schedule = Schedule {
        period_ns: 1_000_000,
        duration,
        cpu: None,
        priority: 80,
    };
    ring::measure(&schedule, vec![work; processes], Path::new(executable))
}

#[test]
fn a_token_goes_around_once_a_tick_and_work_is_done_in_every_process() {
    let work = Work::lasting(50_000);
    let floor = ring(4, work, FLOWN, ironbird()).unwrap();
    assert_eq!(floor.lap.len() + floor.ticks_skipped, 200);
    assert_eq!(floor.chain.len(), floor.lap.len());
    // The chain is a part of the lap, three of its four hops.
    assert!(floor.chain.max() <= floor.lap.max());
    assert!(floor.chain.value_at_quantile(0.5) <= floor.lap.value_at_quantile(0.5));
    // A chain with work is longer than one without; by how much depends on the processor's clock.
    let idle = ring(4, Work::default(), FLOWN, ironbird()).unwrap();
    let [worked_ns, idle_ns] = [&floor, &idle].map(|it| it.chain.min());
    assert!(worked_ns > idle_ns, "{worked_ns} {idle_ns}");
}

#[test]
fn what_is_no_ring_is_refused() {
    let soon = Duration::from_micros(10);
    for (processes, duration, executable, expected) in [
        (1, FLOWN, ironbird(), "2 to 64 processes, not 1"),
        (2, FLOWN, "/none", "cannot start a process of the ring"),
        (2, soon, ironbird(), "no tick of 1000000 ns"),
    ] {
        let measured = ring(processes, Work::default(), duration, executable);
        let error = measured.unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_process_that_dies_ends_the_measurement() {
    // Every process of these rings ends at once, as one that is killed does.
    let measured = ring(3, Work::default(), FLOWN, "/bin/true");
    let error = measured.unwrap_err().to_string();
    let expected = "a process of the ring hangs or has died";
    assert!(error.contains(expected), "{error}");
}
