//! Swaps at the edges: clients that are killed while they wait, and a swap for the tick after the last.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::thread::sleep;
use std::time::Duration;

use crate::rig::{Rig, Running};
use model::boards::{RUN, Run, RunPhase};
use model::parameters::{PARAMETERS, Parameter};
use rustix::process::Signal;
use wire::{SwapOrder, SwapOutcome, Wire};

/// Only ends a test that hangs.
const LONG: Duration = Duration::from_secs(60);

fn mass(at_tick: u64, mass_kg: f64) -> SwapOrder {
    let (parameter, value, steps) = ([0; PARAMETERS], [0.0; PARAMETERS], [1; PARAMETERS]);
    let mut order = SwapOrder { at_tick, in_ticks: 0, count: 1, parameter, value, steps };
    (order.parameter[0], order.value[0]) = (Parameter::Mass as u64, mass_kg);
    order
}

#[test]
#[ignore = "long: part of the gate"]
fn a_swap_for_the_tick_after_the_last_is_answered_so_and_changes_nothing() {
    let rig = Rig::new("late-swap");
    let flight = rig.take_off(&["--rt", "off", "--duration", "4s", "--max-miss-rate", "1000000"]);
    {
        let wire = Wire::open(&rig.known()).unwrap();
        let board = wire.board_reader::<Run>(RUN).unwrap().unwrap();
        let answer = wire.swap_client().unwrap().ask(mass(board.get().last_tick + 1, 0.6), LONG).unwrap();
        assert_eq!(SwapOutcome::from_wire(answer.verdict), Some(SwapOutcome::Ended));
        let run = board.get();
        assert_eq!((run.phase(), run.parameter_epoch), (RunPhase::Closed, 0), "no swap has taken hold");
    }
    flight.end().expect(0);
    assert_eq!(rig.report()["swaps"].as_array().unwrap().len(), 0);
    rig.run("clean", &[]);
}

#[test]
#[ignore = "long: part of the gate"]
fn clients_that_are_killed_while_they_wait_keep_no_place_and_get_nobody_elses_answer() {
    let rig = Rig::new("killed-client");
    let flight = rig.take_off(&["--rt", "off", "--duration", "1h"]);
    for round in 0..4 {
        let clients: Vec<Running> = (0..5).map(|_| rig.start("inject", &["mass_kg=0.6", "--in", "100s"])).collect();
        // Long enough for most of them to have asked. One that has not takes no place, which makes the test milder.
        sleep(Duration::from_secs(1));
        for (i, mut client) in clients.into_iter().enumerate() {
            assert!(client.is_running(), "client {i} of round {round} waits: {}", client.stderr());
            client.signal(Signal::KILL);
            assert_eq!(client.end().code, None);
        }
    }
    let answer = rig.run("inject", &["mass_kg=0.55"]).expect(0);
    answer.says("parameter epoch 1\n").says("  mass_kg  0.52 -> 0.55 kg\n");
    flight.signal(Signal::INT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}
