//! Bits that flip in a slot between a sender and a receiver: none gets through, on any topic.
#![allow(
    unsafe_code,
    reason = "what the hardware does to memory has no name in a safe language"
)]

use ::ipc::DEEP;
use ::ipc::sys::Sealed;
use iceoryx2::prelude::ipc;
use iceoryx2::sample_mut::SampleMut;
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::{Header, Message};
use messages::inspection::{Expected, Reason};
use messages::monitor::Monitor;
use messages::topic::Topic;

use crate::{EPOCH, EXPECTED, Site, node};

/// Flips a bit of what lies in a slot that is about to be sent.
fn flip<C: Topic>(slot: &mut SampleMut<ipc::Service, Sealed<Message<C>>, ()>, bit: usize) {
    let bytes = std::ptr::from_mut(slot.payload_mut()).cast::<u8>();
    assert!(bit < 8 * size_of::<Sealed<Message<C>>>());
    // SAFETY: the byte lies within the payload, which is borrowed for writing and consists of numbers.
    unsafe { *bytes.add(bit / 8) ^= 1 << (bit % 8) };
}

/// Sends a message once with each of its bits flipped, the check word's own among them, and then as it is.
fn no_flipped_bit_gets_through<C: Topic + PartialEq>() {
    let site = Site::new();
    let wire = site.wire();
    let mut receiver = wire.receiver::<C>(DEEP).unwrap();
    let theirs = node(&site);
    let name = format!("ironbird/test/{}", C::NAME);
    let service = theirs
        .service_builder(&name.as_str().try_into().unwrap())
        .publish_subscribe::<Sealed<Message<C>>>()
        .open()
        .unwrap();
    let publisher = service.publisher_builder().create().unwrap();
    receiver.arm(EXPECTED).unwrap();
    let Expected { run_id, settings } = EXPECTED;
    let message = Message {
        envelope: Header {
            run_id,
            settings,
            epoch: EPOCH,
            seq: 3,
            tick: 3,
            ..Header::new()
        },
        content: C::default(),
    };
    let bits = 8 * size_of::<Sealed<Message<C>>>();
    for bit in 0..bits {
        let mut slot = publisher
            .loan_uninit()
            .unwrap()
            .write_payload(Sealed::new(message));
        flip(&mut slot, bit);
        slot.send().unwrap();
        receiver
            .drain(1000, |_| panic!("{}: bit {bit} got through", C::NAME))
            .unwrap();
    }
    assert_eq!(
        (
            receiver.rejections().of(Reason::Checksum),
            receiver.rejections().total()
        ),
        (bits as u64, bits as u64)
    );
    publisher
        .loan_uninit()
        .unwrap()
        .write_payload(Sealed::new(message))
        .send()
        .unwrap();
    assert_eq!(
        receiver.take(1000).unwrap(),
        3,
        "the same message undamaged"
    );
    assert_eq!(receiver.newest(), &message);
}

#[test]
fn no_flipped_bit_of_any_message_gets_through() {
    no_flipped_bit_gets_through::<State>();
    no_flipped_bit_gets_through::<Setpoint>();
    no_flipped_bit_gets_through::<Wrench>();
    no_flipped_bit_gets_through::<RotorSpeeds>();
    no_flipped_bit_gets_through::<SwapRecord>();
    no_flipped_bit_gets_through::<Monitor>();
}
