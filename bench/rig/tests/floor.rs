//! The machine's floors: what they count and what ends them; how fast they are is no test's business.

use crate::rig::wait_until;

use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::rig::{IRONBIRD, Rig};
use errors::Failure;
use host::floor::ring::{self, RingFloor, RingSettings, Work};
use host::floor::timer::{self, Schedule};
use serde_json::Value;

fn schedule(duration: Duration) -> Schedule {
    Schedule {
        period_ns: 1_000_000,
        duration,
        cpu: None,
        priority: 80,
    }
}

const FLOWN: Duration = Duration::from_millis(200);

fn ring(
    processes: usize,
    work: Work,
    duration: Duration,
    executable: &str,
) -> Result<RingFloor, Failure> {
    let settings = RingSettings {
        schedule: schedule(duration),
        work: vec![work; processes],
        rehearsal: None,
    };
    ring::measure(&settings, Path::new(executable))
}

#[test]
fn the_timer_accounts_for_every_tick() {
    let floor = timer::measure(&schedule(FLOWN)).unwrap();
    assert_eq!(floor.ticks_run + floor.ticks_skipped, 200);
    assert_eq!(floor.lateness.len(), 200);
    let standing = &floor.standing;
    let refused = standing.refused.iter();
    let is_refused = refused.clone().any(|it| it.starts_with("SCHED_FIFO"));
    assert_eq!(standing.priority == 0, is_refused, "{standing:?}");
}

#[test]
fn a_token_goes_around_once_a_tick_and_work_is_done_in_every_process() {
    let work = Work::lasting(50_000);
    let floor = ring(4, work, FLOWN, IRONBIRD).unwrap();
    assert_eq!(floor.ticks_run + floor.ticks_skipped, 200);
    assert_eq!(floor.lap.len(), floor.ticks_run);
    assert_eq!(floor.chain.len(), floor.ticks_run);
    assert_eq!(floor.lateness.len(), 200);
    // The chain is a part of the lap, three of its four hops.
    assert!(floor.chain.max() <= floor.lap.max());
    assert!(floor.chain.value_at_quantile(0.5) <= floor.lap.value_at_quantile(0.5));
    // Half of what was asked of four processes: a processor may speed up after the calibration.
    assert!(floor.chain.min() >= 100_000, "{}", floor.chain.min());
}

#[test]
fn what_is_no_ring_is_refused() {
    let soon = Duration::from_micros(10);
    for (processes, duration, executable, expected) in [
        (1, FLOWN, IRONBIRD, "2 to 64 processes, not 1"),
        (
            2,
            FLOWN,
            "/nonexistent",
            "cannot start a process of the ring",
        ),
        (2, soon, IRONBIRD, "no tick of 1000000 ns"),
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

#[test]
fn a_process_of_the_ring_started_by_hand_says_that_it_is_none() {
    let rig = Rig::new("hop");
    let launcher = std::process::id().to_string();
    let args = format!(
        "ring-hop --launcher {launcher} --position 1 --processes 2 --cpu 0 --priority 0 --work 0"
    );
    let mut command = std::process::Command::new(IRONBIRD);
    command.args(args.split(' '));
    rig.launch(command)
        .end()
        .expect(2)
        .complains("no link of a ring");
}

#[test]
#[ignore = "long: part of the gate"]
fn the_page_has_a_row_per_comparison_and_its_numbers_lie_beside() {
    let rig = Rig::new("floor");
    let to = rig.path("benchmarks");
    let measure = |options: &str| {
        let to = to.display();
        rig.run("floor", format!("{options} --seconds 1 --write {to}"))
    };
    let read = |name: &str| fs::read_to_string(to.join(name)).unwrap();
    let page = measure("--only lockstep,laws,replay --pairs 1")
        .expect(0)
        .says("| lockstep tick | ")
        .says("| laws, one tick | ")
        .says("| replay --verify, one tick | ")
        .stdout;
    assert_eq!(read("benchmarks.md"), page);
    let numbers: Value = serde_json::from_str(&read("benchmarks.json")).unwrap();
    let sets = numbers["sets"].as_array().unwrap().iter();
    let comparisons = sets.flat_map(|set| set["comparisons"].as_array().unwrap());
    let pairs: Vec<&Value> = comparisons.map(|it| &it["pairs"]["pairs"][0]).collect();
    assert_eq!(pairs.len(), 5);
    for pair in pairs {
        let [ours, floor] = ["ours", "floor"].map(|side| pair[side].as_f64().unwrap());
        assert!(ours > 0.0 && floor > 0.0, "{pair}");
    }
    // One set again: the other set's rows stay as they are, and what cannot be measured takes no row away.
    let again = "--only laws --pairs 2";
    let later = measure(again).expect(0).stdout;
    let rows = |page: &str, name: &str| {
        let rows = page.lines().filter(|line| line.contains(name));
        rows.map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(rows(&later, "lockstep"), rows(&page, "lockstep"));
    for row in ["laws, one tick", "simulate, real time"] {
        // Of the two pairs, those stand apart in which the host stole.
        let is_inconclusive = rows(&later, row)[0].contains("| inconclusive: 2 pairs");
        assert!(is_inconclusive, "{row}: {later}");
    }
    assert_eq!(read("benchmarks.md"), later);
    fs::write(to.join("benchmarks.json"), "{}").unwrap();
    measure(again)
        .expect(2)
        .complains("contains no figures of this version")
        .complains("remove it");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_has_the_floors_of_its_own_ticks_beside_where_they_are_asked_for() {
    let rig = Rig::new("beside");
    // 50 ticks of the laws, of 4 ms each.
    let fly = format!("fly --config {} --duration 50ms", rig.slow(4));
    rig.ok(&fly);
    assert!(rig.report()["beside"].is_null());
    rig.ok(&format!("{fly} --floor 1s"))
        .says("\nFloors    at p50, p99, p99.9: wake.plant is ")
        .says("\nRESULT status=PASS");
    rig.ok("report --section floors")
        .says("Compared with the machine's baseline, 1 s each")
        .says("  times its floor ");
    let report = rig.report();
    let floors = report["beside"]["floors"].as_array().unwrap();
    let names = |key: &str| {
        let names = floors.iter().map(|floor| floor[key].as_str().unwrap());
        names.collect::<Vec<_>>()
    };
    assert_eq!(names("series"), ["wake.plant", "loop"]);
    assert_eq!(names("what"), ["bare timer", "raw futex ring"]);
    let read = |name: &str| fs::read_to_string(rig.out().join("latest").join(name)).unwrap();
    let (text, page) = (read("report.txt"), read("report.html"));
    let times = text
        .lines()
        .filter(|line| line.starts_with("  times its floor "));
    let times: Vec<&str> = times.collect();
    assert_eq!(times.len(), floors.len(), "{text}");
    for (floor, times) in floors.iter().zip(times) {
        let statistics = &floor["statistics"];
        // A second has 250 ticks of 4 ms; those that the ring slept through are not its laps.
        let count = statistics["count"].as_u64().unwrap();
        assert!((1..=250).contains(&count), "{statistics}");
        assert!(statistics["p999_us"].is_null(), "{statistics}");
        let curve = floor["distribution"]["curve"].as_array().unwrap();
        assert!(!curve.is_empty());
        let mut series = report["series"].as_array().unwrap().iter();
        let flown = series.find(|it| it["name"] == floor["series"]).unwrap();
        let [flown_us, floor_us] = [flown, statistics].map(|it| it["p50_us"].as_f64().unwrap());
        let ratio = format!("{:.2}", flown_us / floor_us);
        assert_eq!(times.split_whitespace().nth(3), Some(&*ratio), "{text}");
        assert!(page.contains(floor["what"].as_str().unwrap()), "{floor}");
        assert!(page.contains(&format!(">{ratio}<")), "{ratio}");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn an_interruption_while_the_floors_are_measured_keeps_the_flight() {
    let rig = Rig::new("halfway");
    let flight = rig.take_off("--duration 1s --floor 60s");
    let page = rig.out().join("latest/report.html");
    wait_until("the final report", || page.exists().then_some(()));
    flight.signal(rustix::process::Signal::INT);
    flight
        .end()
        .expect(130)
        .complains("interrupted: the machine's floors are not measured")
        .says("\nRESULT status=PASS");
    let report = rig.report();
    assert_eq!(report["run"]["in_flight"], false);
    assert!(report["beside"].is_null());
    rig.assert_nothing_left();
}

#[test]
fn what_cannot_be_measured_is_said() {
    let rig = Rig::new("nothing");
    let mut command = rig.command("floor", "--only flights --pairs 1 --seconds 1");
    command.env("PATH", "/nowhere");
    // SCHED_FIFO is refused, or cyclictest is not installed.
    let ended = rig.launch(command).end().expect(0);
    ended.says("| flights | not measured: ");
}
