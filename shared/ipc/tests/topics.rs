//! Topics: the newest message for loops, every message for the recorder, one sender; relays for observers.

use iceoryx2::prelude::AttributeSpecifier;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use ipc::sys::Sealed;
use ipc::{DEEP, LATEST, OBSERVED, OBSERVERS, Receiver, Sender, Wakes, Wire};
use messages::content::{Measured, NO_TICK, Setpoint, State, Wrench};
use messages::header::{Header, Message};
use messages::inspection::Expected;
use messages::role::Role;
use messages::topic::Topic;

use crate::common::{EPOCH, EXPECTED};
use crate::forgery::{good, node};
use crate::{Site, assert_incompatible, assert_taken};

fn state(number: u64) -> State {
    State {
        measured: Measured {
            position_w_m: [number as f64, 0.0, 0.0],
            ..Measured::default()
        },
        ..State::default()
    }
}

fn send(sender: &mut Sender<State>, ticks: std::ops::Range<u64>) {
    for tick in ticks {
        sender.send(tick, &Header::new(), state(tick)).unwrap();
    }
}

/// Ticks of everything that has come.
fn drain(receiver: &mut Receiver<State>) -> Vec<u64> {
    let mut ticks = Vec::new();
    receiver
        .drain(u64::MAX - 1, |message| {
            assert_eq!(message.content, state(message.envelope.tick));
            ticks.push(message.envelope.tick);
        })
        .unwrap();
    ticks
}

fn connected(wire: &Wire, depth: usize) -> (Sender<State>, Receiver<State>) {
    let mut sender = wire.sender(Wakes::default()).unwrap();
    let mut receiver = wire.receiver(depth).unwrap();
    sender.arm(EXPECTED, EPOCH).unwrap();
    receiver.arm(EXPECTED).unwrap();
    (sender, receiver)
}

#[test]
fn a_loop_has_the_newest_message_and_no_other() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut receiver) = connected(&wire, LATEST);
    assert_eq!(receiver.take(0).unwrap(), NO_TICK);
    assert!(!receiver.has_any());
    send(&mut sender, 0..5);
    assert_eq!(drain(&mut receiver), [4], "four were overwritten");
    assert!(receiver.has_any());
    assert_eq!(receiver.stamped().content, state(4));
    assert_eq!(receiver.take(4).unwrap(), 4, "the newest stays");
    send(&mut sender, 5..6);
    assert_eq!(receiver.take(5).unwrap(), 5);
    assert_eq!(receiver.newest().content, state(5));
    assert_eq!(receiver.rejections().total(), 0);
}

#[test]
fn a_message_carries_its_origin_and_the_history_of_its_input() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut receiver) = connected(&wire, LATEST);
    let history = Header {
        seq: 77,
        run_id: 1,
        settings: 2,
        epoch: 3,
        sample_ns: 11,
        parameter_epoch: 12,
        input_tick: [13, 14, 15],
        previous_busy_ns: 16,
        ..Header::new()
    };
    sender.send(0, &history, state(0)).unwrap();
    sender.send(1, &history, state(1)).unwrap();
    receiver.take(1).unwrap();
    let envelope = receiver.newest().envelope;
    let mut expected = Header {
        run_id: EXPECTED.run_id,
        settings: EXPECTED.settings,
        epoch: EPOCH,
        seq: 1,
        tick: 1,
        ..history
    };
    expected.stamps[Role::Plant as usize] = envelope.stamps_of(Role::Plant);
    assert_eq!(envelope, expected);
    assert!(envelope.stamps_of(Role::Plant).send_ns > 0);
}

#[test]
fn the_recorder_has_every_message_in_order_and_loses_the_oldest_when_it_sleeps() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut sleeper) = connected(&wire, DEEP);
    let mut awake = wire.receiver::<State>(LATEST).unwrap();
    awake.arm(EXPECTED).unwrap();
    sender.arm(EXPECTED, EPOCH).unwrap();
    send(&mut sender, 0..1000);
    assert!(drain(&mut sleeper).into_iter().eq(0..1000));
    let sent = 1000 + 3 * DEEP as u64;
    // If the sender waited for the sleeper, this would never end.
    for tick in 1000..sent {
        send(&mut sender, tick..tick + 1);
        assert_eq!(awake.take(tick).unwrap(), tick);
    }
    assert!(drain(&mut sleeper).into_iter().eq(sent - DEEP as u64..sent));
    assert_eq!(sleeper.rejections().total(), 0);
}

#[test]
fn what_was_sent_before_a_run_is_not_seen_in_it() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut receiver) = connected(&wire, LATEST);
    send(&mut sender, 0..3);
    assert_eq!(receiver.take(2).unwrap(), 2);
    let next_run = Expected {
        run_id: 8,
        ..EXPECTED
    };
    sender.arm(next_run, EPOCH).unwrap();
    receiver.arm(next_run).unwrap();
    assert_eq!(receiver.take(2).unwrap(), NO_TICK);
    send(&mut sender, 0..1);
    // Tick and sequence start again.
    assert_eq!(receiver.take(0).unwrap(), 0);
}

#[test]
fn a_topic_has_one_sender_and_as_many_receivers_as_it_was_made_for() {
    let site = Site::new();
    let (here, there) = (site.wire(), site.wire());
    let first = here.sender::<State>(Wakes::default()).unwrap();
    for wire in [&here, &there] {
        let second = wire.sender::<State>(Wakes::default());
        assert_taken(second, "the sender of topic `state`");
    }
    let _other_topic = there.sender::<Setpoint>(Wakes::default()).unwrap();
    drop(first);
    there.sender::<State>(Wakes::default()).unwrap();

    let receiver = || here.receiver::<Wrench>(LATEST);
    let _loops: Vec<_> = (0..Wrench::SUBSCRIBERS)
        .map(|_| receiver().unwrap())
        .collect();
    assert_taken(receiver(), "topic `wrench`");
}

#[test]
fn a_topic_of_the_same_type_with_another_layout_is_incompatible() {
    let site = Site::new();
    let layout = AttributeKey::try_from("layout").unwrap();
    let other = AttributeValue::try_from("0123456789abcdef").unwrap();
    let _other_build = site.instance.enter().unwrap();
    let theirs = node(&site.instance);
    let _service = theirs
        .service_builder(&"ironbird/test/state".try_into().unwrap())
        .publish_subscribe::<Sealed<Message<State>>>()
        .max_publishers(1)
        .max_subscribers(State::SUBSCRIBERS)
        .subscriber_max_buffer_size(DEEP)
        .max_nodes(28)
        .create_with_attributes(&AttributeSpecifier::new().define(&layout, &other).unwrap())
        .unwrap();
    assert_incompatible(site.wire().receiver::<State>(LATEST), "`state`");
}

#[test]
fn the_clock_is_read_when_a_message_is_there_and_not_before() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut receiver) = connected(&wire, DEEP);
    let looks = std::cell::Cell::new(0);
    // Each look finds the clock a tick further on.
    let clock = || {
        looks.set(looks.get() + 1);
        looks.get()
    };
    assert_eq!((receiver.take(clock).unwrap(), looks.get()), (NO_TICK, 0));
    send(&mut sender, 1..4);
    assert_eq!(receiver.take(clock).unwrap(), 3);
    assert_eq!((looks.get(), receiver.rejections().total()), (3, 0));
}

/// A message of the plant's, as the recorder has it.
fn message(tick: u64) -> Message<State> {
    let mut message = good(tick);
    message.content = state(tick);
    message.envelope.sample_ns = 1_000 * tick;
    message.envelope.stamps[0].send_ns = 1_000 * tick + 5;
    message
}

fn observer(wire: &Wire) -> Receiver<State> {
    let mut observer = wire.observer().unwrap();
    observer.arm(EXPECTED).unwrap();
    observer
}

#[test]
fn observers_get_what_is_relayed_from_when_they_joined() {
    let site = Site::new();
    let (wire, elsewhere) = (site.wire(), site.wire());
    let mut relay = wire.relay().unwrap();
    let mut pass_on = |tick| relay.pass_on(&message(tick)).unwrap();
    (0..3).for_each(&mut pass_on);
    let mut first = observer(&elsewhere);
    (3..5).for_each(&mut pass_on);
    let mut second = observer(&elsewhere);
    (5..7).for_each(&mut pass_on);
    assert_eq!(drain(&mut first), [3, 4, 5, 6]);
    assert_eq!(drain(&mut second), [5, 6]);
    assert_eq!(second.newest(), &message(6), "with header and stamps");
    drop(first);
    pass_on(7);
    assert_eq!(drain(&mut second), [7]);
    let error = elsewhere.relay::<State>().unwrap_err().to_string();
    assert!(error.contains("the relay of topic `state`"), "{error}");
}

#[test]
fn a_slow_observer_loses_the_oldest_and_delays_no_loop() {
    let site = Site::new();
    let wire = site.wire();
    let mut relay = wire.relay().unwrap();
    let (mut sleeper, mut awake) = (observer(&wire), observer(&wire));
    let sent = 3 * OBSERVED as u64;
    for tick in 0..sent {
        relay.pass_on(&message(tick)).unwrap();
        assert_eq!(drain(&mut awake), [tick]);
    }
    let newest = drain(&mut sleeper).into_iter();
    assert!(newest.eq(sent - OBSERVED as u64..sent));
    let _crowd: Vec<_> = (2..OBSERVERS).map(|_| observer(&wire)).collect();
    let error = wire.observer::<State>().unwrap_err();
    assert!(error.to_string().contains("observers already"), "{error}");
    assert_eq!(error.exit_code(), 5);
    assert!(error.remedy().unwrap().contains("ironbird watch"));
    drop(sleeper);
    observer(&wire);
}

#[test]
fn what_an_observer_uses_is_not_removed() {
    let site = Site::new();
    let wire = site.wire();
    let mut observer = observer(&wire);
    assert!(!site.instance.is_alive(), "no role of it lives");
    assert!(site.instance.remove_leftovers().unwrap().is_empty());
    let mut relay = site.wire().relay().unwrap();
    relay.pass_on(&message(1)).unwrap();
    // The recorder of the next flight relays to it.
    assert_eq!(drain(&mut observer), [1]);
    drop((observer, relay, wire));
    let removed = site.instance.remove_leftovers().unwrap();
    assert!(removed.contains(&site.instance.directory()), "{removed:?}");
    // The next process makes everything anew.
    drop(site.wire());
}
