//! The service `parameters`: an order, its answer, and what happens without one.

use std::thread;
use std::time::Duration;

use ::ipc::clock::now_ns;
use ::ipc::error::Error;
use ::ipc::sys::Payload;
use messages::content::NO_TICK;
use messages::parameters::{PARAMETERS, Parameter};

use ::ipc::{Owner, SwapAnswer, SwapCall, SwapOrder, SwapOutcome, SwapServer, Wire};

use crate::{Site, assert_incompatible, node};

/// Only ends a test that hangs.
const LONG: Duration = Duration::from_secs(60);

fn order(mass_kg: f64) -> SwapOrder {
    let mut order = SwapOrder {
        at_tick: NO_TICK,
        in_ticks: 3,
        count: 1,
        parameter: [0; PARAMETERS],
        value: [0.0; PARAMETERS],
        steps: [1; PARAMETERS],
    };
    (order.parameter[0], order.value[0]) = (Parameter::Mass as u64, mass_kg);
    order
}

fn answer(tick: u64) -> SwapAnswer {
    let verdict = SwapOutcome::Applied as u64;
    SwapAnswer {
        verdict,
        tick,
        parameter_epoch: 1,
        parameter: 0,
        old: [0.52; PARAMETERS],
    }
}

fn next(server: &SwapServer) -> SwapCall {
    let until = now_ns() + LONG.as_nanos() as u64;
    while now_ns() < until {
        if let Some(call) = server.next().unwrap() {
            return call;
        }
        thread::sleep(Duration::from_millis(1));
    }
    panic!("no order came");
}

#[test]
fn an_order_rings_at_the_plant_and_its_answer_comes_back() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.swap_server().unwrap();
    let doorbell = wire.doorbell(Owner::Desk).unwrap();
    assert!(server.next().unwrap().is_none());
    thread::scope(|scope| {
        let asked = scope.spawn(|| {
            let client = site.wire().swap_client().unwrap();
            (0..20)
                .map(|i| client.ask(order(f64::from(i) / 10.0), LONG).unwrap())
                .collect::<Vec<_>>()
        });
        for i in 0..20 {
            assert!(
                doorbell
                    .wait_until(now_ns() + LONG.as_nanos() as u64)
                    .unwrap()
            );
            let call = next(&server);
            assert_eq!(call.order(), order(f64::from(i) / 10.0));
            call.answer(answer(i as u64));
        }
        assert_eq!(
            asked.join().unwrap(),
            (0..20).map(answer).collect::<Vec<_>>()
        );
    });
}

fn assert_absent(result: Result<SwapAnswer, Error>) {
    let error = result.unwrap_err();
    assert!(matches!(error, Error::Absent { .. }), "{error}");
    assert!(
        error
            .to_string()
            .contains("the plant did not answer within 20ms"),
        "{error}"
    );
    assert_eq!(error.exit_code(), 1);
}

const SHORT: Duration = Duration::from_millis(20);
/// Longer than the plant takes to look.
const A_WHILE: Duration = Duration::from_secs(1);

#[test]
fn without_an_answer_the_client_says_who_was_silent_and_may_ask_again() {
    let site = Site::new();
    let wire = site.wire();
    let client = wire.swap_client().unwrap();
    let begin = now_ns();
    assert_absent(client.ask(order(0.6), SHORT));
    assert!(now_ns() >= begin + 20_000_000);
    // Now there is a plant, which does not answer.
    let _server = wire.swap_server().unwrap();
    for _ in 0..10 {
        assert_absent(client.ask(order(0.6), SHORT));
    }
}

#[test]
fn a_late_answer_is_not_taken_for_that_of_the_next_order() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.swap_server().unwrap();
    thread::scope(|scope| {
        let (timed_out, told) = std::sync::mpsc::channel();
        let asked = scope.spawn({
            let site = &site;
            move || {
                let client = site.wire().swap_client().unwrap();
                assert_absent(client.ask(order(0.6), SHORT));
                timed_out.send(()).unwrap();
                client.ask(order(0.7), LONG).unwrap()
            }
        });
        told.recv().unwrap();
        let second = loop {
            let call = next(&server);
            if call.order() == order(0.7) {
                break call;
            }
            // Its client has given up, so that this goes nowhere.
            call.answer(answer(6));
        };
        second.answer(answer(7));
        assert_eq!(asked.join().unwrap(), answer(7));
    });
}

#[test]
fn a_client_that_left_is_no_error_for_the_plant() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.swap_server().unwrap();
    for i in 0..20 {
        let client = site.wire().swap_client().unwrap();
        assert_absent(client.ask(order(0.6), SHORT));
        let call = server.next().unwrap();
        drop(client);
        if let Some(call) = call {
            call.answer(answer(i));
        }
    }
    thread::scope(|scope| {
        let asked = scope.spawn(|| {
            site.wire()
                .swap_client()
                .unwrap()
                .ask(order(0.8), LONG)
                .unwrap()
        });
        next(&server).answer(answer(99));
        assert_eq!(
            asked.join().unwrap(),
            answer(99),
            "the next client finds the plant as it was"
        );
    });
}

#[test]
fn an_answer_to_one_who_has_left_goes_to_nobody_and_who_comes_into_his_place_is_answered() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.swap_server().unwrap();
    for is_forgotten in [true, false] {
        thread::scope(|scope| {
            let gone = scope.spawn(|| site.wire().swap_client().unwrap().ask(order(0.6), A_WHILE));
            let first = next(&server);
            assert!(server.is_awaited(&first));
            gone.join().unwrap().unwrap_err();
            assert!(!server.is_awaited(&first));
            let first = (!is_forgotten).then_some(first);
            // As many as there are places, so that one of them has his.
            let asked: Vec<_> = (10..18_u32)
                .map(|i| {
                    let site = &site;
                    let ask = move || {
                        site.wire()
                            .swap_client()
                            .unwrap()
                            .ask(order(f64::from(i)), A_WHILE)
                    };
                    (i, scope.spawn(ask))
                })
                .collect();
            let calls: Vec<_> = asked.iter().map(|_| next(&server)).collect();
            // Who forgets to forget cuts somebody off, but tells nobody what is not his.
            if let Some(first) = first {
                first.answer(answer(6));
                // Whoever takes it for his own has it before his own comes.
                thread::sleep(Duration::from_millis(50));
            }
            for call in calls {
                let tick = call.order().value[0] as u64;
                call.answer(answer(tick));
            }
            for (i, asked) in asked {
                match asked.join().unwrap() {
                    Ok(answered) => assert_eq!(answered, answer(u64::from(i))),
                    Err(error) => assert!(!is_forgotten, "{error}"),
                }
            }
        });
    }
}

#[test]
fn a_call_that_is_dropped_unanswered_leaves_the_client_to_its_time_out() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.swap_server().unwrap();
    thread::scope(|scope| {
        let asked = scope.spawn(|| site.wire().swap_client().unwrap().ask(order(0.6), SHORT));
        // The client may have given up before this looks.
        let until = now_ns() + 100_000_000;
        while now_ns() < until && server.next().unwrap().is_none() {}
        assert_absent(asked.join().unwrap());
    });
}

#[test]
fn eight_clients_may_ask_at_once_and_one_plant_answers() {
    let site = Site::new();
    let wires: Vec<Wire> = (0..9).map(|_| site.wire()).collect();
    let _server = wires[0].swap_server().unwrap();
    assert!(matches!(
        wires[1].swap_server().unwrap_err(),
        Error::Wire { .. }
    ));
    let clients: Vec<_> = wires[..8]
        .iter()
        .map(|wire| wire.swap_client().unwrap())
        .collect();
    assert!(matches!(
        wires[8].swap_client().unwrap_err(),
        Error::Wire { .. }
    ));
    drop(clients);
    wires[8].swap_client().unwrap();
}

#[test]
fn a_service_of_another_build_is_incompatible() {
    let site = Site::new();
    let _other_build = site.instance.enter().unwrap();
    let theirs = node(&site);
    let _service = theirs
        .service_builder(&"ironbird/test/parameters".try_into().unwrap())
        .request_response::<Payload<SwapOrder>, Payload<SwapAnswer>>()
        .create()
        .unwrap();
    assert_incompatible(site.wire().swap_client(), "`parameters`");
    assert_incompatible(site.wire().swap_server(), "`parameters`");
}
