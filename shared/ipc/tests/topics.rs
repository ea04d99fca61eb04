//! Topics: newest message for loops, every message for the recorder, one sender.
//!
//! All messages of a topic have one layout.

use ::ipc::error::Error;
use ::ipc::instance::Instance;
use ::ipc::sys::Sealed;
use ::ipc::{DEEP, LATEST, Receiver, Sender, Wire};
use iceoryx2::prelude::AttributeSpecifier;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use messages::content::Measured;
use messages::content::{NO_TICK, Setpoint, State, Wrench};
use messages::header::{Header, Message};
use messages::role::Role;
use messages::topic::Topic;

use crate::{EPOCH, EXPECTED, Site, assert_incompatible, node};

/// A state that is known again by its number.
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
    let mut sender = wire.sender(None).unwrap();
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
    let mut ticks = Vec::new();
    receiver
        .drain(4, |message| ticks.push(message.envelope.tick))
        .unwrap();
    assert_eq!(
        ticks,
        [4],
        "four were overwritten before they were looked at"
    );
    assert!(receiver.has_any());
    assert_eq!(
        (receiver.dated().tick, receiver.dated().content),
        (4, state(4))
    );
    assert_eq!(
        receiver.take(4).unwrap(),
        4,
        "nothing new: the newest stays"
    );
    send(&mut sender, 5..6);
    assert_eq!(receiver.take(5).unwrap(), 5);
    assert_eq!(receiver.newest().content, state(5));
    assert_eq!(receiver.rejections().total(), 0);
}

#[test]
fn a_message_carries_its_origin_and_hands_the_history_on() {
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
    assert_eq!(
        (envelope.run_id, envelope.settings, envelope.epoch),
        (EXPECTED.run_id, EXPECTED.settings, EPOCH)
    );
    assert_eq!(
        (envelope.seq, envelope.tick),
        (1, 1),
        "the second message of its sender"
    );
    assert_eq!((envelope.sample_ns, envelope.parameter_epoch), (11, 12));
    assert_eq!(
        (envelope.input_tick, envelope.previous_busy_ns),
        ([13, 14, 15], 16)
    );
    assert!(envelope.stamps_of(Role::Plant).send_ns > 0);
    assert_eq!(
        envelope.stamps_of(Role::Outer).send_ns,
        0,
        "a stage not passed has no stamp"
    );
}

#[test]
fn the_recorder_has_every_message_in_order() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut receiver) = connected(&wire, DEEP);
    send(&mut sender, 0..1000);
    assert_eq!(drain(&mut receiver), (0..1000).collect::<Vec<_>>());
    send(&mut sender, 1000..1000 + DEEP as u64);
    assert_eq!(
        drain(&mut receiver).len(),
        DEEP,
        "a buffer of this depth is a full one"
    );
    assert_eq!(receiver.rejections().total(), 0);
}

#[test]
fn a_recorder_that_sleeps_loses_its_oldest_and_never_blocks_the_sender() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut sleeper) = connected(&wire, DEEP);
    let mut awake = wire.receiver::<State>(LATEST).unwrap();
    awake.arm(EXPECTED).unwrap();
    sender.arm(EXPECTED, EPOCH).unwrap();
    let sent = 3 * DEEP as u64;
    // Were the sender to wait for the sleeper, this would never end.
    for tick in 0..sent {
        send(&mut sender, tick..tick + 1);
        assert_eq!(awake.take(tick).unwrap(), tick);
    }
    assert_eq!(
        drain(&mut sleeper),
        (sent - DEEP as u64..sent).collect::<Vec<_>>()
    );
}

#[test]
fn what_was_sent_before_a_run_is_not_seen_in_it() {
    let site = Site::new();
    let wire = site.wire();
    let (mut sender, mut receiver) = connected(&wire, LATEST);
    send(&mut sender, 0..3);
    assert_eq!(receiver.take(2).unwrap(), 2);
    let next_run = messages::inspection::Expected {
        run_id: 8,
        ..EXPECTED
    };
    sender.arm(next_run, EPOCH).unwrap();
    receiver.arm(next_run).unwrap();
    assert_eq!(receiver.take(2).unwrap(), NO_TICK);
    send(&mut sender, 0..1);
    assert_eq!(receiver.take(0).unwrap(), 0, "tick and sequence begin anew");
}

#[test]
fn a_topic_has_one_sender() {
    let site = Site::new();
    let (here, there) = (site.wire(), site.wire());
    let first = here.sender::<State>(None).unwrap();
    for wire in [&here, &there] {
        let error = wire.sender::<State>(None).unwrap_err();
        assert!(matches!(error, Error::Wire { .. }), "{error}");
        assert!(
            error.to_string().contains("the sender of topic `state`"),
            "{error}"
        );
    }
    let _other_topic = there.sender::<Setpoint>(None).unwrap();
    drop(first);
    there.sender::<State>(None).unwrap();
}

#[test]
fn a_topic_has_as_many_receivers_as_it_was_made_for() {
    let site = Site::new();
    let wire = site.wire();
    let _loops: Vec<_> = (0..Wrench::SUBSCRIBERS)
        .map(|_| wire.receiver::<Wrench>(LATEST).unwrap())
        .collect();
    let error = wire.receiver::<Wrench>(LATEST).unwrap_err();
    assert!(matches!(error, Error::Wire { .. }), "{error}");
}

#[test]
fn two_instances_of_one_name_under_two_roots_do_not_hear_each_other() {
    let (ours, theirs) = (Site::new(), Site::new());
    let (our_wire, their_wire) = (ours.wire(), theirs.wire());
    let (mut sender, mut receiver) = connected(&our_wire, LATEST);
    let (_sender, mut stranger) = connected(&their_wire, LATEST);
    send(&mut sender, 0..1);
    assert_eq!(
        (receiver.take(0).unwrap(), stranger.take(0).unwrap()),
        (0, NO_TICK)
    );
}

#[test]
fn another_instance_under_the_same_root_does_not_hear_either() {
    let site = Site::new();
    let other = Instance::under(site.root(), "other").unwrap();
    {
        let (wire, other_wire) = (site.wire(), Wire::open(&other).unwrap());
        let (mut sender, mut receiver) = connected(&wire, LATEST);
        let (_sender, mut stranger) = connected(&other_wire, LATEST);
        send(&mut sender, 0..1);
        assert_eq!(
            (receiver.take(0).unwrap(), stranger.take(0).unwrap()),
            (0, NO_TICK)
        );
    }
    other.remove_leftovers().unwrap();
}

/// The topic `state` as another build may have it: of the same size, with another meaning.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
struct ForeignState {
    state: State,
}
messages::layout!(ForeignState { state });

impl Topic for ForeignState {
    const NAME: &'static str = State::NAME;
    const SENDER: Role = State::SENDER;
    const SUBSCRIBERS: usize = State::SUBSCRIBERS;

    fn numbers(&self, look: impl FnMut(&[f64])) {
        self.state.numbers(look);
    }

    fn plausible(&self) -> bool {
        self.state.plausible()
    }
}

#[test]
fn a_topic_of_another_type_is_incompatible() {
    let site = Site::new();
    let wire = site.wire();
    let _foreign = wire.sender::<ForeignState>(None).unwrap();
    assert_incompatible(wire.receiver::<State>(LATEST), "`state`");
    assert_incompatible(wire.sender::<State>(None), "`state`");
}

#[test]
fn a_topic_of_the_same_type_with_another_layout_is_incompatible() {
    let site = Site::new();
    let layout = AttributeKey::try_from("layout").unwrap();
    let other = AttributeValue::try_from("0123456789abcdef").unwrap();
    let _other_build = site.instance.enter().unwrap();
    let theirs = node(&site);
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
fn a_topic_that_is_full_of_processes_is_not_called_incompatible() {
    let site = Site::new();
    let wire = site.wire();
    let topic = wire.sender::<State>(None).unwrap();
    let crowd: Vec<_> = (1..28)
        .map(|_| {
            node(&site)
                .service_builder(&"ironbird/test/state".try_into().unwrap())
                .publish_subscribe::<Sealed<Message<State>>>()
                .open()
                .unwrap()
        })
        .collect();
    let latecomer = site.wire();
    let error = latecomer.receiver::<State>(LATEST).unwrap_err();
    assert!(matches!(error, Error::Wire { .. }), "{error}");
    drop(crowd);
    latecomer.receiver::<State>(LATEST).unwrap();
    drop(topic);
}

#[test]
fn the_clock_is_looked_at_when_a_message_is_there_and_not_before() {
    let site = Site::new();
    let wire = site.wire();
    let mut receiver = wire.receiver::<State>(DEEP).unwrap();
    let mut sender = wire.sender::<State>(None).unwrap();
    receiver.arm(EXPECTED).unwrap();
    sender.arm(EXPECTED, EPOCH).unwrap();
    let looks = std::cell::Cell::new(0);
    // A clock that stands for the machine: each look finds it a tick further on.
    let clock = || {
        looks.set(looks.get() + 1);
        looks.get()
    };
    assert_eq!((receiver.take(clock).unwrap(), looks.get()), (NO_TICK, 0));
    for tick in 1..=3 {
        sender.send(tick, &Header::new(), State::default()).unwrap();
    }
    assert_eq!(
        receiver.take(clock).unwrap(),
        3,
        "each was there when its tick had begun"
    );
    assert_eq!((looks.get(), receiver.rejections().total()), (3, 0));
}
