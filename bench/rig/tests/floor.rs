//! The machine's floors: what they count and what ends them; how fast they are is no test's business.

use crate::rig;

use std::path::Path;
use std::time::Duration;

use crate::rig::{IRONBIRD, Rig};
use errors::Failure;
use host::floor::ring::{self, RingFloor, RingSettings, WakeMechanism, Work};
use host::floor::timer::{self, Schedule};

const WAKES: [WakeMechanism; 2] = [WakeMechanism::Eventfd, WakeMechanism::Futex];

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
    wake: WakeMechanism,
    duration: Duration,
    executable: &str,
) -> Result<RingFloor, Failure> {
    let settings = RingSettings {
        wake,
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
fn a_token_goes_around_once_a_tick_by_either_wake_and_work_is_done_in_every_process() {
    let work = Work::lasting(50_000);
    for wake in WAKES {
        let floor = ring(4, work, wake, FLOWN, IRONBIRD).unwrap();
        assert_eq!(floor.ticks_run + floor.ticks_skipped, 200, "{wake:?}");
        assert_eq!(
            (floor.lap.len(), floor.chain.len(), floor.lateness.len()),
            (floor.ticks_run, floor.ticks_run, 200)
        );
        // The chain is a part of the lap, three of its four hops.
        assert!(floor.chain.max() <= floor.lap.max(), "{wake:?}");
        assert!(
            floor.chain.value_at_quantile(0.5) <= floor.lap.value_at_quantile(0.5),
            "{wake:?}"
        );
        // Half of what was asked of four processes: a processor may speed up after the calibration.
        assert!(
            floor.chain.min() >= 100_000,
            "{wake:?}: {}",
            floor.chain.min()
        );
    }
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
        let measured = ring(
            processes,
            Work::default(),
            WakeMechanism::Futex,
            duration,
            executable,
        );
        let error = measured.unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_process_that_dies_ends_the_measurement() {
    // Every process of these rings ends at once, as one that is killed does.
    let measured = WAKES
        .map(|wake| std::thread::spawn(move || ring(3, Work::default(), wake, FLOWN, "/bin/true")));
    for measured in measured {
        let error = measured.join().unwrap().unwrap_err();
        assert!(
            error
                .to_string()
                .contains("a process of the ring hangs or has died"),
            "{error}"
        );
    }
}

#[test]
fn a_process_of_the_ring_started_by_hand_says_that_it_is_none() {
    let rig = Rig::new("hop");
    let launcher = std::process::id().to_string();
    let args = format!(
        "ring-hop --wake futex --launcher {launcher} --position 1 --processes 2 --cpu 0 --priority 0 --work 0"
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
    let options = format!(
        "--only lockstep,laws,replay --pairs 1 --seconds 1 --write {}",
        to.to_str().unwrap()
    );
    let ended = rig
        .run("floor", &options)
        .expect(0)
        .says("| lockstep tick | ")
        .says("| laws, one tick | ");
    let page = ended.says("| replay --verify, one tick | ").stdout;
    assert_eq!(
        std::fs::read_to_string(to.join("benchmarks.md")).unwrap(),
        page
    );
    let numbers = std::fs::read_to_string(to.join("benchmarks.json")).unwrap();
    let numbers: serde_json::Value = serde_json::from_str(&numbers).unwrap();
    let sets = numbers["sets"].as_array().unwrap();
    let comparisons: Vec<_> = sets
        .iter()
        .flat_map(|set| set["comparisons"].as_array().unwrap())
        .collect();
    assert_eq!(comparisons.len(), 5);
    for comparison in comparisons {
        let pair = &comparison["pairs"]["pairs"][0];
        assert!(
            pair["ours"].as_f64().unwrap() > 0.0 && pair["floor"].as_f64().unwrap() > 0.0,
            "{comparison}"
        );
    }
    // One set again: the other one's rows stay as they are, and what cannot be measured takes no row away.
    let again = format!(
        "--only laws --pairs 2 --seconds 1 --write {}",
        to.to_str().unwrap()
    );
    let rows = |page: &str, name: &str| {
        page.lines()
            .filter(|line| line.contains(name))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    let later = rig.run("floor", &again).expect(0).stdout;
    assert_eq!(rows(&later, "lockstep"), rows(&page, "lockstep"));
    for row in ["laws, one tick", "simulate, real time"] {
        // Of the two pairs, those stand apart in which the host stole.
        assert!(
            rows(&later, row)[0].contains("| inconclusive: 2 pairs"),
            "{row}: {later}"
        );
    }
    assert_eq!(
        std::fs::read_to_string(to.join("benchmarks.md")).unwrap(),
        later
    );
    std::fs::write(to.join("benchmarks.json"), "{}").unwrap();
    rig.run("floor", &again)
        .expect(2)
        .complains("contains no figures of this version")
        .complains("remove it");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_has_the_floors_of_its_own_ticks_beside_where_they_are_asked_for() {
    let rig = Rig::new("beside");
    let slow = rig.slow(4);
    // 50 ticks of the laws, of 4 ms each.
    rig.ok(&format!("fly --config {slow} --duration 50ms"));
    assert!(rig.report()["beside"].is_null());
    let ended = rig.ok(&format!("fly --config {slow} --duration 50ms --floor 1s"));
    ended
        .says("\nFloors    at p50, p99, p99.9: wake.plant is ")
        .says("\nRESULT status=PASS");
    let floors = rig.ok("report --section floors");
    floors
        .says("Compared with the machine's baseline, 1 s each")
        .says("  times its floor ");
    let report = rig.report();
    let floors = report["beside"]["floors"].as_array().unwrap();
    let of = |key: &str| {
        floors
            .iter()
            .map(|floor| floor[key].as_str().unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(
        (of("series"), of("what")),
        (
            vec!["wake.plant", "loop"],
            vec!["bare timer", "raw futex ring"]
        )
    );
    for floor in floors {
        let statistics = &floor["statistics"];
        // A second has 250 ticks of 4 ms; those that the ring slept through are not its laps.
        assert!(
            (1..=250).contains(&statistics["count"].as_u64().unwrap()),
            "{statistics}"
        );
        assert!(
            statistics["p50_us"].as_f64().unwrap() > 0.0 && statistics["p999_us"].is_null(),
            "{statistics}"
        );
        assert!(
            !floor["distribution"]["curve"]
                .as_array()
                .unwrap()
                .is_empty()
        );
    }
    let read = |name: &str| std::fs::read_to_string(rig.out().join("latest").join(name)).unwrap();
    let (text, page) = (read("report.txt"), read("report.html"));
    let times: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with("  times its floor "))
        .collect();
    assert_eq!(times.len(), floors.len(), "{text}");
    for (floor, times) in floors.iter().zip(times) {
        let flown = report["series"]
            .as_array()
            .unwrap()
            .iter()
            .find(|series| series["name"] == floor["series"])
            .unwrap();
        let ratio =
            flown["p50_us"].as_f64().unwrap() / floor["statistics"]["p50_us"].as_f64().unwrap();
        let ratio = format!("{ratio:.2}");
        assert_eq!(
            times.split_whitespace().nth(3),
            Some(ratio.as_str()),
            "{text}"
        );
        assert!(
            page.contains(floor["what"].as_str().unwrap()) && page.contains(&format!(">{ratio}<")),
            "{ratio}"
        );
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn an_interruption_while_the_floors_are_measured_keeps_the_flight() {
    let rig = Rig::new("halfway");
    let flight = rig.take_off("--duration 1s --floor 60s");
    rig::wait_until("the final report", || {
        rig.out().join("latest/report.html").exists().then_some(())
    });
    flight.signal(rustix::process::Signal::INT);
    let ended = flight
        .end()
        .expect(130)
        .complains("interrupted: the machine's floors are not measured");
    ended.says("\nRESULT status=PASS");
    let report = rig.report();
    assert_eq!(
        (&report["run"]["in_flight"], &report["beside"]),
        (&false.into(), &serde_json::Value::Null)
    );
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
