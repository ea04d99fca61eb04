//! Messages that a receiver must reject, and a publisher that sends them.
//!
//! The forger holds the topic's only publisher, so none of the sender's checks protect the receiver.

use ::ipc::instance::Instance;
use ::ipc::sys::Sealed;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{Node, NodeBuilder, SignalHandlingMode, ipc};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use messages::content::NO_TICK;
use messages::header::{Header, Message};
use messages::inspection::{Expected, Reason};
use messages::layout::{Kind, Layout as _, change_words};
use messages::noise::uniform;
use messages::telemetry::Telemetry;
use messages::topic::Topic;

use crate::common::{EPOCH, EXPECTED};

/// `previous_busy_ns` of good messages; bad ones have 0.
pub const GOOD: u64 = 0x600d;

/// What can be wrong with a message, and the reason for which it must be rejected.
pub const KINDS: [(&str, Reason); 12] = [
    ("flipped_bit", Reason::Checksum),
    ("garbage", Reason::Checksum),
    ("other_layout", Reason::Layout),
    ("other_run", Reason::Run),
    ("other_settings", Reason::Settings),
    ("repeated", Reason::Sequence),
    ("old_sequence", Reason::Sequence),
    ("replaced_sender", Reason::Sequence),
    ("future_tick", Reason::Tick),
    ("past_tick", Reason::Tick),
    ("not_finite", Reason::NonFinite),
    ("implausible", Reason::Implausible),
];

/// Pseudo-random numbers, the same in every trial.
pub struct Draw(pub u64);

impl Draw {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 += 1;
        (uniform(1, self.0, 0) * bound as f64) as u64
    }
}

/// Sets the number at a place of a content; counts the numbers. Telemetry may be anything, and is left out.
fn set_number<C: Topic>(content: &mut C, at: u64, number: f64) -> u64 {
    let mut seen = 0;
    change_words(content, |field, word| {
        let is_number = field.kind == Kind::F64 && !Telemetry::FIELDS.contains(field);
        seen += u64::from(is_number);
        if is_number && seen == at.wrapping_add(1) {
            return number.to_bits();
        }
        word
    });
    seen
}

/// A message that nothing is wrong with.
pub fn good<C: Topic>(tick: u64) -> Message<C> {
    let Expected { run_id, settings } = EXPECTED;
    let envelope = Header {
        run_id,
        settings,
        epoch: EPOCH,
        seq: tick,
        tick,
        previous_busy_ns: GOOD,
        ..Header::new()
    };
    Message {
        envelope,
        content: C::default(),
    }
}

/// A message of a kind, after a good one of `tick`. That of a damaged message is good: [`damage`] follows.
pub fn bad<C: Topic>(kind: &str, tick: u64, draw: &mut Draw) -> Message<C> {
    let mut message = good::<C>(tick + 1);
    let Message { envelope, content } = &mut message;
    envelope.previous_busy_ns = 0;
    let mut set_any = |numbers: [f64; 4], draw: &mut Draw| {
        let count = set_number(content, u64::MAX, 0.0);
        let number = numbers[draw.below(4) as usize];
        set_number(content, draw.below(count), number);
    };
    match kind {
        "other_layout" => envelope.layout ^= 1 << draw.below(64),
        "other_run" => envelope.run_id = draw.below(u64::MAX) | 8,
        "other_settings" => envelope.settings = draw.below(u64::MAX) | 16,
        "repeated" => (envelope.seq, envelope.tick) = (tick, tick),
        "old_sequence" => envelope.seq = draw.below(tick + 1),
        "replaced_sender" => envelope.epoch = draw.below(EPOCH),
        "future_tick" => envelope.tick = tick + 2 + draw.below(NO_TICK - tick - 2),
        "past_tick" => envelope.tick = draw.below(tick + 1),
        "not_finite" => set_any(
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -f64::NAN],
            draw,
        ),
        "implausible" => set_any([1e300, -1e300, f64::MAX, f64::MIN], draw),
        _ => {}
    }
    message
}

/// Changes a message in its slot: one bit, or up to 64 bytes in a row.
fn damage<T>(slot: &mut T, kind: &str, draw: &mut Draw) {
    let size = size_of::<T>() as u64;
    let begin = draw.below(size);
    if kind != "garbage" {
        return flip(slot, begin, 1 << draw.below(8));
    }
    let end = size.min(begin + 1 + draw.below(64));
    (begin..end).for_each(|at| flip(slot, at, 1 + draw.below(255) as u8));
}

fn flip<T>(slot: &mut T, at: u64, bits: u8) {
    assert!(at < size_of::<T>() as u64);
    // SAFETY: a byte of the slot, which is borrowed for writing and consists of numbers.
    unsafe { *std::ptr::from_mut(slot).cast::<u8>().add(at as usize) ^= bits };
}

/// A node of the middleware that does not follow the rules of `ipc`.
pub fn node(instance: &Instance) -> Node<ipc::Service> {
    NodeBuilder::new()
        .config(&instance.config().unwrap())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
        .unwrap()
}

/// The publisher of a topic that a receiver has created.
pub struct Forger<C: Topic> {
    publisher: Publisher<ipc::Service, Sealed<Message<C>>, ()>,
    _service: PortFactory<ipc::Service, Sealed<Message<C>>, ()>,
    _node: Node<ipc::Service>,
}

impl<C: Topic> Forger<C> {
    pub fn on(instance: &Instance) -> Self {
        let node = node(instance);
        let name = format!("ironbird/{}/{}", instance.name(), C::NAME);
        let service = node
            .service_builder(&name.as_str().try_into().unwrap())
            .publish_subscribe::<Sealed<Message<C>>>()
            .open()
            .unwrap();
        Self {
            publisher: service.publisher_builder().create().unwrap(),
            _service: service,
            _node: node,
        }
    }

    pub fn send(&self, message: Message<C>) {
        self.publisher.send_copy(Sealed::new(message)).unwrap();
    }

    /// Sends a message of a kind after a good one of `tick`.
    pub fn send_bad(&self, kind: &str, tick: u64, draw: &mut Draw) {
        let message = Sealed::new(bad::<C>(kind, tick, draw));
        let mut slot = self.publisher.loan_uninit().unwrap().write_payload(message);
        if matches!(kind, "flipped_bit" | "garbage") {
            damage(slot.payload_mut(), kind, draw);
        }
        slot.send().unwrap();
    }

    /// Sends a message with one bit flipped.
    pub fn send_flipped(&self, message: Message<C>, bit: u64) {
        let message = Sealed::new(message);
        let mut slot = self.publisher.loan_uninit().unwrap().write_payload(message);
        flip(slot.payload_mut(), bit / 8, 1 << (bit % 8));
        slot.send().unwrap();
    }
}
