//! The machine's floors: what they count and what ends them; how fast they are is no test's business.

use crate::rig;

use std::path::Path;
use std::time::Duration;

use crate::rig::{IRONBIRD, Rig};
use host::floor::link::WakeMechanism;
use host::floor::work::Work;
use host::floor::{ring, timer};

const TICK_NS: u64 = 1_000_000;
const WAKES: [WakeMechanism; 2] = [WakeMechanism::Eventfd, WakeMechanism::Futex];

fn ring_of(work: Vec<Work>, wake: WakeMechanism) -> ring::RingSettings {
    ring::RingSettings {
        wake,
        period_ns: TICK_NS,
        duration: Duration::from_millis(200),
        cpu: None,
        priority: 80,
        work,
        rehearsal: None,
    }
}

#[test]
fn the_timer_accounts_for_every_tick() {
    let settings = timer::TimerSettings {
        period_ns: TICK_NS,
        duration: Duration::from_millis(200),
        cpu: None,
        priority: 80,
    };
    let floor = timer::measure(&settings).unwrap();
    assert_eq!(floor.ticks_run + floor.ticks_skipped, 200);
    assert_eq!(floor.lateness.len(), 200);
    let is_other = floor.standing.priority == 0;
    assert_eq!(
        is_other,
        floor
            .standing
            .refused
            .iter()
            .any(|r| r.starts_with("SCHED_FIFO")),
        "{:?}",
        floor.standing
    );
}

#[test]
fn a_token_goes_around_once_a_tick_by_either_wake() {
    for wake in WAKES {
        let floor = ring::measure(
            &ring_of(vec![Work::default(); 4], wake),
            Path::new(IRONBIRD),
        )
        .unwrap();
        assert_eq!(floor.ticks_run + floor.ticks_skipped, 200, "{wake:?}");
        assert_eq!(
            (floor.lap.len(), floor.chain.len(), floor.lateness.len()),
            (floor.ticks_run, floor.ticks_run, 200)
        );
        // The chain is a part of the lap, three of its four hops.
        assert!(
            floor.chain.min() > 0 && floor.chain.max() <= floor.lap.max(),
            "{wake:?}"
        );
        assert!(
            floor.chain.value_at_quantile(0.5) <= floor.lap.value_at_quantile(0.5),
            "{wake:?}"
        );
    }
}

#[test]
fn work_is_done_in_every_process_of_the_ring() {
    let work = Work::lasting(50_000);
    for wake in WAKES {
        let floor = ring::measure(&ring_of(vec![work; 4], wake), Path::new(IRONBIRD)).unwrap();
        // Half of what was asked of four processes: a processor may speed up after the calibration.
        assert!(
            floor.chain.min() >= 100_000,
            "{wake:?}: {} ns for four times 50 us",
            floor.chain.min()
        );
    }
}

#[test]
fn what_is_no_ring_is_refused() {
    let error = ring::measure(
        &ring_of(vec![Work::default()], WakeMechanism::Futex),
        Path::new(IRONBIRD),
    )
    .unwrap_err();
    assert!(
        error.to_string().contains("2 to 64 processes, not 1"),
        "{error}"
    );
    let error = ring::measure(
        &ring_of(vec![Work::default(); 2], WakeMechanism::Futex),
        Path::new("/nonexistent"),
    )
    .unwrap_err();
    assert!(
        error
            .to_string()
            .contains("cannot start a process of the ring"),
        "{error}"
    );
    let mut settings = ring_of(vec![Work::default(); 2], WakeMechanism::Futex);
    settings.duration = Duration::from_micros(10);
    let error = ring::measure(&settings, Path::new(IRONBIRD)).unwrap_err();
    assert!(
        error.to_string().contains("no tick of 1000000 ns"),
        "{error}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_process_that_dies_ends_the_measurement() {
    // Every process of these rings ends at once, as one that is killed does.
    let measured = WAKES.map(|wake| {
        std::thread::spawn(move || {
            ring::measure(
                &ring_of(vec![Work::default(); 3], wake),
                Path::new("/bin/true"),
            )
        })
    });
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
    let args = [
        "--position",
        "1",
        "--processes",
        "2",
        "--cpu",
        "0",
        "--priority",
        "0",
        "--work",
        "0",
    ];
    let mut command = std::process::Command::new(IRONBIRD);
    command
        .args(["ring-hop", "--wake", "futex", "--launcher", &launcher])
        .args(args);
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
    let without = |set: &str| {
        let mut command = rig.command("floor", format!("--only {set} --pairs 1 --seconds 1"));
        command.env("PATH", "/nowhere");
        rig.launch(command).end().expect(0)
    };
    without("calls").says("| calls | not measured: strace is not installed |");
    // Where SCHED_FIFO is refused that is said first.
    without("flights").says("| flights | not measured: ");
}
