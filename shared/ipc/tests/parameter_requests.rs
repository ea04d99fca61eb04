//! The service `parameters`: a request, its reply, and what happens without one.

use std::thread;
use std::time::Duration;

use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::sys::Payload;
use ipc::{Call, RequestServer, SwapAnswer, SwapOrder, SwapOutcome, Wire};
use messages::content::NO_TICK;
use messages::parameters::{PARAMETERS, Parameter};

use crate::forgery::node;
use crate::{Site, assert_incompatible, assert_taken};

/// Only ends a test that hangs.
const LONG: Duration = Duration::from_secs(60);
const SHORT: Duration = Duration::from_millis(20);
/// Longer than the plant takes to look.
const A_WHILE: Duration = Duration::from_secs(1);

fn order(mass_kg: f64) -> SwapOrder {
    SwapOrder::new(NO_TICK, 3, &[(Parameter::Mass, mass_kg, 1)])
}

fn answer(tick: u64) -> SwapAnswer {
    SwapAnswer {
        verdict: SwapOutcome::Applied as u64,
        tick,
        parameter_epoch: 1,
        parameter: 0,
        old: [0.52; PARAMETERS],
    }
}

/// Sends a request from a process of its own.
fn ask(site: &Site, mass_kg: f64, timeout: Duration) -> Result<SwapAnswer, Error> {
    let client = site.wire().client::<SwapOrder>().unwrap();
    client.request(order(mass_kg), timeout)
}

fn next(server: &RequestServer<SwapOrder>) -> Call<SwapOrder> {
    let until = now_ns() + LONG.as_nanos() as u64;
    while now_ns() < until {
        if let Some(call) = server.next().unwrap() {
            return call;
        }
        thread::sleep(Duration::from_millis(1));
    }
    panic!("no request came");
}

fn assert_absent(result: Result<SwapAnswer, Error>) {
    let error = result.unwrap_err();
    let words = "the plant did not answer within 20ms";
    assert!(error.to_string().contains(words), "{error}");
    assert_eq!(error.exit_code(), 1);
}

#[test]
fn without_a_reply_the_client_names_the_plant_and_may_ask_again() {
    let site = Site::new();
    let wire = site.wire();
    let client = wire.client::<SwapOrder>().unwrap();
    let begin = now_ns();
    assert_absent(client.request(order(0.6), SHORT));
    assert!(now_ns() >= begin + 20_000_000);
    // Now there is a plant, which does not reply, and then one that drops the request.
    let server = wire.server::<SwapOrder>().unwrap();
    for _ in 0..10 {
        assert_absent(client.request(order(0.6), SHORT));
    }
    drop(client);
    thread::scope(|scope| {
        let client = scope.spawn(|| ask(&site, 0.6, SHORT));
        // The client may have timed out before the request is received.
        let until = now_ns() + 100_000_000;
        while now_ns() < until && server.next().unwrap().is_none() {}
        assert_absent(client.join().unwrap());
    });
}

#[test]
fn a_client_that_takes_the_place_of_one_that_left_gets_its_own_reply() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.server::<SwapOrder>().unwrap();
    for is_dropped in [true, false] {
        thread::scope(|scope| {
            let gone = scope.spawn(|| ask(&site, 0.6, A_WHILE));
            let first = next(&server);
            assert!(server.is_awaited(&first));
            gone.join().unwrap().unwrap_err();
            assert!(!server.is_awaited(&first));
            let first = (!is_dropped).then_some(first);
            // As many as there are places, so that one of them has the same.
            let site = &site;
            let asked: Vec<_> = (10..18_u32)
                .map(|i| (i, scope.spawn(move || ask(site, f64::from(i), A_WHILE))))
                .collect();
            let calls: Vec<_> = asked.iter().map(|_| next(&server)).collect();
            // A reply to a client that has left may cut another client off, but no client takes it for its own.
            if let Some(first) = first {
                first.reply(answer(6));
                // A client that takes it has it before its own comes.
                thread::sleep(Duration::from_millis(50));
            }
            for call in calls {
                let tick = call.order().value[0] as u64;
                call.reply(answer(tick));
            }
            for (i, asked) in asked {
                match asked.join().unwrap() {
                    Ok(answered) => assert_eq!(answered, answer(u64::from(i))),
                    Err(error) => assert!(!is_dropped, "{error}"),
                }
            }
        });
    }
}

#[test]
fn eight_clients_may_ask_at_once_and_one_plant_answers() {
    let site = Site::new();
    let wires: Vec<Wire> = (0..9).map(|_| site.wire()).collect();
    let _server = wires[0].server::<SwapOrder>().unwrap();
    assert_taken(wires[1].server::<SwapOrder>(), "`parameters`");
    let client = |wire: &Wire| wire.client::<SwapOrder>();
    let clients: Vec<_> = wires[..8]
        .iter()
        .map(|wire| client(wire).unwrap())
        .collect();
    assert_taken(client(&wires[8]), "`parameters`");
    drop(clients);
    client(&wires[8]).unwrap();
}

#[test]
fn a_service_of_another_build_is_incompatible() {
    let site = Site::new();
    let _other_build = site.instance.enter().unwrap();
    let theirs = node(&site.instance);
    let _service = theirs
        .service_builder(&"ironbird/test/parameters".try_into().unwrap())
        .request_response::<Payload<SwapOrder>, Payload<SwapAnswer>>()
        .create()
        .unwrap();
    assert_incompatible(site.wire().client::<SwapOrder>(), "`parameters`");
    assert_incompatible(site.wire().server::<SwapOrder>(), "`parameters`");
}

#[test]
fn a_late_reply_is_not_taken_for_that_of_the_next_request() {
    let site = Site::new();
    let wire = site.wire();
    let server = wire.server::<SwapOrder>().unwrap();
    thread::scope(|scope| {
        let (give_up, has_given_up) = std::sync::mpsc::channel();
        let replies = scope.spawn({
            let site = &site;
            move || {
                let client = site.wire().client::<SwapOrder>().unwrap();
                assert_absent(client.request(order(0.6), SHORT));
                give_up.send(()).unwrap();
                client.request(order(0.7), LONG).unwrap()
            }
        });
        has_given_up.recv().unwrap();
        let second = loop {
            let call = next(&server);
            if call.order() == order(0.7) {
                break call;
            }
            // The first request, which has timed out.
            call.reply(answer(6));
        };
        second.reply(answer(7));
        assert_eq!(replies.join().unwrap(), answer(7));
    });
}
