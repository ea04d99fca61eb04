//! Relays: observers that come and go get messages unchanged.

use ::ipc::error::Error;
use ::ipc::instance::Instance;
use ::ipc::{OBSERVED, OBSERVERS, Receiver, Wire};
use messages::content::Measured;
use messages::content::State;
use messages::header::{Header, Message};

use crate::{EPOCH, EXPECTED, Site};

/// A message of the plant's, as the recorder has it.
fn message(tick: u64) -> Message<State> {
    let mut envelope = Header {
        run_id: EXPECTED.run_id,
        settings: EXPECTED.settings,
        epoch: EPOCH,
        seq: tick,
        tick,
        sample_ns: 1_000 * tick,
        previous_busy_ns: 16,
        ..Header::new()
    };
    envelope.stamps[0].send_ns = 1_000 * tick + 5;
    let measured = Measured {
        position_w_m: [tick as f64, 0.0, 0.0],
        ..Measured::default()
    };
    Message {
        envelope,
        content: State {
            measured,
            ..State::default()
        },
    }
}

fn observer(wire: &Wire) -> Receiver<State> {
    let mut observer = wire.observer().unwrap();
    observer.arm(EXPECTED).unwrap();
    observer
}

fn drain(observer: &mut Receiver<State>) -> Vec<u64> {
    let mut ticks = Vec::new();
    observer
        .drain(u64::MAX - 1, |passed| {
            assert_eq!(
                *passed,
                message(passed.envelope.tick),
                "as it came, stamps and all"
            );
            ticks.push(passed.envelope.tick);
        })
        .unwrap();
    ticks
}

#[test]
fn observers_get_what_is_passed_on_from_when_they_joined() {
    let site = Site::new();
    let (wire, elsewhere) = (site.wire(), site.wire());
    let relay = wire.relay().unwrap();
    (0..3).for_each(|tick| relay.pass_on(&message(tick)).unwrap());
    let mut first = observer(&elsewhere);
    (3..5).for_each(|tick| relay.pass_on(&message(tick)).unwrap());
    let mut second = observer(&elsewhere);
    (5..7).for_each(|tick| relay.pass_on(&message(tick)).unwrap());
    assert_eq!(
        (drain(&mut first), drain(&mut second)),
        (vec![3, 4, 5, 6], vec![5, 6])
    );
    drop(first);
    relay.pass_on(&message(7)).unwrap();
    assert_eq!(drain(&mut second), [7]);
    let error = elsewhere.relay::<State>().unwrap_err();
    assert!(
        error.to_string().contains("the relay of topic `state`"),
        "{error}"
    );
}

#[test]
fn one_that_sleeps_loses_its_oldest_and_holds_nobody_up() {
    let site = Site::new();
    let wire = site.wire();
    let relay = wire.relay().unwrap();
    let (mut sleeper, mut awake) = (observer(&wire), observer(&wire));
    let sent = 3 * OBSERVED as u64;
    // Were the relay to wait for the sleeper, this would never end.
    for tick in 0..sent {
        relay.pass_on(&message(tick)).unwrap();
        assert_eq!(drain(&mut awake), [tick]);
    }
    assert_eq!(
        drain(&mut sleeper),
        (sent - OBSERVED as u64..sent).collect::<Vec<_>>()
    );
}

#[test]
fn one_too_many_is_told_what_to_do_and_finds_the_place_of_one_that_left() {
    let site = Site::new();
    let wire = site.wire();
    let mut crowd: Vec<_> = (0..OBSERVERS).map(|_| observer(&wire)).collect();
    let error = wire.observer::<State>().unwrap_err();
    assert!(
        matches!(
            error,
            Error::Crowded {
                most: OBSERVERS,
                ..
            }
        ),
        "{error}"
    );
    assert_eq!(error.exit_code(), 5);
    assert!(
        error.remedy().unwrap().contains("ironbird watch"),
        "{error}"
    );
    crowd.pop();
    observer(&wire);
}

#[test]
fn what_an_observer_uses_is_nobodys_leftover() {
    let site = Site::new();
    let wire = site.wire();
    let mut observer = observer(&wire);
    assert!(!site.instance.is_alive(), "no role of it lives");
    assert_eq!(
        site.instance.remove_leftovers().unwrap(),
        Vec::<std::path::PathBuf>::new()
    );
    let relay = site.wire().relay().unwrap();
    relay.pass_on(&message(1)).unwrap();
    assert_eq!(
        drain(&mut observer),
        [1],
        "the next flight's recorder meets it"
    );
    drop((observer, relay, wire));
    let removed = site.instance.remove_leftovers().unwrap();
    assert!(removed.contains(&site.instance.directory()), "{removed:?}");
    // Whoever comes next makes everything anew.
    let again = Instance::under(site.root(), "test").unwrap();
    drop(Wire::open(&again).unwrap());
}
