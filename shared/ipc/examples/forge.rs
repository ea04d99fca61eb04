//! Bad messages on live ports: a forger sends, a receiver inspects, over real shared memory (`bench/drill`).
//!
//!     cargo run --example forge -- KIND MESSAGES ROOT
//!
//! The forger writes each message into a slot that is in use: it is sent, and the receiver takes it out of this slot.
//! One message in eight is good. One line of JSON per topic says what became of its messages.
#![allow(clippy::unwrap_used, reason = "a failure here is a bug of the drill")]
#![allow(unsafe_code, reason = "bits are flipped in memory")]

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/common/forgery.rs"]
mod forgery;

use std::path::Path;

use ipc::instance::Instance;
use ipc::{DEEP, TopicPorts, Wire};
use messages::checks::switch_off;
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::inspection::Reason;

use forgery::{Draw, EXPECTED, Forger, GOOD, KINDS, good};

const BATCH: u64 = 2000;
const GOOD_EVERY: u64 = 8;

/// Sends so many bad messages of a kind on a topic, and receives them as a loop does.
fn forge<C: TopicPorts>(instance: &Instance, kind: &str, messages: u64) {
    let wire = Wire::open(instance).unwrap();
    let mut receiver = wire.receiver::<C>(DEEP).unwrap();
    let forger = Forger::<C>::on(instance);
    receiver.arm(EXPECTED).unwrap();
    let (mut draw, mut tick) = (Draw(1), 10);
    let (mut offered, mut accepted, mut passed) = (0_u64, 0_u64, 0_u64);
    forger.send(good(tick));
    while offered < messages {
        let batch = BATCH.min(messages - offered);
        for i in 0..batch {
            forger.send_bad(kind, tick, &mut draw);
            if i % GOOD_EVERY == 0 {
                tick += 1;
                forger.send(good(tick));
            }
        }
        offered += batch;
        // The newest tick that has begun when these are inspected is the next one.
        let drained = receiver.drain(tick + 1, |message| {
            let is_good = message.envelope.previous_busy_ns == GOOD;
            passed += u64::from(is_good);
            accepted += u64::from(!is_good);
        });
        drained.unwrap();
    }
    let rejected = Reason::ALL.iter().map(|reason| {
        let count = receiver.rejections().of(*reason);
        format!("\"{}\":{count}", reason.name())
    });
    let rejected = rejected.collect::<Vec<_>>().join(",");
    let (_, reason) = KINDS.iter().find(|(name, _)| *name == kind).unwrap();
    println!(
        "{{\"topic\":\"{}\",\"offered\":{offered},\"sent_good\":{},\"reason\":\"{}\",\
         \"accepted\":{accepted},\"good\":{passed},\"rejected\":{{{rejected}}}}}",
        C::NAME,
        tick - 9,
        reason.name()
    );
}

fn main() {
    if let Ok(check) = std::env::var("IRONBIRD_CHECK_OFF") {
        switch_off(&check);
    }
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [kind, messages, root] = &words[..] else {
        let kinds = KINDS.map(|(name, _)| name).join(", ");
        panic!("forge KIND MESSAGES ROOT; kinds: {kinds}")
    };
    let instance = Instance::under(Path::new(root), "forged").unwrap();
    let share = messages.parse::<u64>().unwrap().div_ceil(4);
    forge::<State>(&instance, kind, share);
    forge::<Setpoint>(&instance, kind, share);
    forge::<Wrench>(&instance, kind, share);
    forge::<RotorSpeeds>(&instance, kind, share);
    instance.remove_leftovers().unwrap();
}
