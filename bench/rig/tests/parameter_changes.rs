//! Parameter changes in flight: as ramps, from clients that are killed, after the last tick.

use crate::rig::{Rig, read_log};
use flight_log::entry::LogEntry;
use ipc::{SwapOrder, SwapOutcome, Wire};
use messages::blackboards::{RUN, Run, RunPhase};
use messages::parameters::{PARAMETERS, Parameter};
use rustix::process::Signal;
use std::thread::sleep;
use std::time::Duration;

/// Only ends a test that hangs.
const LONG: Duration = Duration::from_secs(60);

pub(crate) fn mass(at_tick: u64, mass_kg: f64) -> SwapOrder {
    let mut order = SwapOrder {
        at_tick,
        in_ticks: 0,
        count: 1,
        parameter: [0; PARAMETERS],
        value: [0.0; PARAMETERS],
        steps: [1; PARAMETERS],
    };
    (order.parameter[0], order.value[0]) = (Parameter::Mass as u64, mass_kg);
    order
}

#[test]
#[ignore = "long: part of the gate"]
fn a_change_for_the_tick_after_the_last_is_refused_and_changes_nothing() {
    let rig = Rig::new("late-swap");
    let flight = rig.take_off("--rt off --duration 4s --max-miss-rate 1000000");
    {
        let wire = Wire::open(&rig.known()).unwrap();
        let board = wire.blackboard_reader::<Run>(RUN).unwrap().unwrap();
        let order = mass(board.get().last_tick + 1, 0.6);
        let answer = wire
            .client::<SwapOrder>()
            .unwrap()
            .request(order, LONG)
            .unwrap();
        let outcome = SwapOutcome::from_wire(answer.verdict);
        assert_eq!(outcome, Some(SwapOutcome::Ended));
        let run = board.get();
        assert_eq!((run.phase(), run.parameter_epoch), (RunPhase::Closed, 0));
    }
    flight.end().expect(0);
    assert_eq!(rig.report()["swaps"].as_array().unwrap().len(), 0);
    rig.run("clean", "");
}

#[test]
#[ignore = "long: part of the gate"]
fn clients_that_are_killed_while_they_wait_keep_no_place_and_get_no_other_clients_answer() {
    let rig = Rig::new("killed-client");
    let flight = rig.take_off("--rt off --duration 1h");
    for _ in 0..4 {
        let clients = [(); 5].map(|()| rig.start("inject", "mass_kg=0.6 --in 100s"));
        // Long enough for most of them to have asked. One that has not takes no place, which makes the test milder.
        sleep(Duration::from_secs(1));
        for mut client in clients {
            assert!(client.is_running(), "{}", client.stderr());
            client.signal(Signal::KILL);
            assert_eq!(client.end().code, None);
        }
    }
    rig.ok("inject mass_kg=0.55")
        .says("parameter epoch 1\n")
        .says("  mass_kg  0.52 -> 0.55 kg\n");
    flight.interrupt().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn a_flight_with_ramps_is_the_same_in_processes_in_one_and_in_replay() {
    let rig = Rig::new("ramped");
    // The second ramp is replaced halfway, and the third outlasts the flight.
    let faults = [
        "mass_kg=0.55~500ms@300ms",
        "rotational_drag_nm_s=0.3~800ms@tick200",
        "rotational_drag_nm_s=0.15@tick600",
        "rotor_efficiency_2=-3%~1m@tick900",
    ];
    let faults = faults.map(|fault| format!(" --fault {fault}")).concat();
    rig.flies_as_simulated(&format!("--duration 1500ms{faults}"), 1501);
    rig.assert_replayed();
    rig.ok("replay")
        .says("swap 2 at tick 300: mass_kg 0.52 -> 0.55 over 0.5 s from tick 300\n");

    let (entries, _) = read_log(&rig.out().join("latest/flight.mcap"));
    let swaps = entries.iter().filter(|it| matches!(it, LogEntry::Swap(_)));
    assert_eq!(swaps.count(), 4, "a record for each, whatever its length");
    let report = rig.report();
    let change = |swap: usize| {
        let change = &report["swaps"][swap]["changes"][0];
        ["old", "new", "over_s"].map(|key| change[key].as_f64().unwrap())
    };
    assert_eq!(change(0), [0.105, 0.3, 0.8]);
    // The value halfway through the ramp.
    assert_eq!(
        change(2),
        [0.105 + (0.3 - 0.105) * 400.0 / 800.0, 0.15, 0.0]
    );
    // The ramp of the drag, that of the mass within it, and the end.
    assert_eq!(report["theorem"]["live_swaps"], 3);
    rig.ok("report --full")
        .says("  swap 1 at tick 200 (0.200 s): rotational_drag_nm_s 0.105 -> 0.3 over 0.8 s from tick 200\n")
        .says("  swap 4 at tick 900 (0.900 s): rotor_efficiency_2 1 -> 0.97 over 60 s from tick 900\n");
    let page = rig.flown("report.html");
    assert!(page.contains("mass_kg 0.52 -&gt; 0.55 over 0.5 s from tick 300"));
}

#[test]
fn an_injected_ramp_continues_in_the_active_parameters() {
    let rig = Rig::new("injected");
    let flight = rig.take_off(rig.slowly(5, "1h"));
    rig.ok("inject mass_kg=+5%~20m rotor_efficiency_1=0.99")
        .says("parameter epoch 1\n")
        .says("  mass_kg  0.52 -> 0.546 kg over 1200 s\n")
        .says("  rotor_efficiency_1  1.0 -> 0.99\n");
    let mass_kg = || {
        let parameters = rig.ok("params --json").json();
        parameters[0]["in_force"].as_f64().unwrap()
    };
    let (first, then) = (mass_kg(), mass_kg());
    assert!(
        0.52 < first && first < then && then < 0.546,
        "{first} {then}"
    );
    rig.ok("inject mass_kg=nominal").says(" -> 0.52 kg\n");
    assert_eq!(mass_kg(), 0.52, "the rest of the ramp is replaced");
    flight.interrupt().expect(130);
}
