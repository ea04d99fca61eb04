//! Bad messages on live ports: a process forges, another one receives, over real shared memory (`bench/drill`).
//!
//!     cargo run --example forge -- KIND MESSAGES ROOT
//!
//! The forger holds the topic's only publisher and writes each message into a slot that is in use: it is sent, and the
//! receiver takes it out of this slot. One message in eight is good. The last line says what became of them, as JSON.
#![allow(
    clippy::unwrap_used,
    reason = "what goes wrong here is a bug of the drill"
)]
#![allow(unsafe_code, reason = "a flipped bit has no name in a safe language")]

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use ::ipc::instance::Instance;
use ::ipc::sys::Sealed;
use ::ipc::{DEEP, Wire};
use iceoryx2::prelude::{NodeBuilder, SignalHandlingMode, ipc};
use messages::checks::switch_off;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use messages::header::{Header, Message};
use messages::inspection::{Expected, Reason};
use messages::layout::{Field, Visit, VisitorMut};
use messages::topic::Topic;

const EXPECTED: Expected = Expected {
    run_id: 7,
    settings: 9,
};
const EPOCH: u64 = 100;
const INSTANCE: &str = "forged";
/// What good messages carry, and bad ones do not.
const GOOD: u64 = 0x600d;
const BATCH: u64 = 2000;
/// Ticks that have begun when a message is inspected: the newest good one's.
const GOOD_EVERY: u64 = 8;

/// What is wrong with a message.
const KINDS: [(&str, Reason); 12] = [
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

/// Numbers that look drawn, the same in every trial.
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb)
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }
}

/// Puts a number into the field of a content with a place; counts the fields. Telemetry may be anything, and is none.
struct Put {
    at: u64,
    number: f64,
    seen: u64,
}

impl VisitorMut for Put {
    fn integers(&mut self, _: &'static Field, _: &mut [u64]) {}

    fn numbers(&mut self, _: &'static Field, values: &mut [f64]) {
        for value in values {
            if self.seen == self.at {
                *value = self.number;
            }
            self.seen += 1;
        }
    }

    fn structs<L: Visit>(&mut self, _: &'static Field, values: &mut [L]) {
        if L::STRUCT != "Telemetry" {
            values.iter_mut().for_each(|value| value.visit_mut(self));
        }
    }
}

fn fields<C: Topic>() -> u64 {
    let mut count = Put {
        at: u64::MAX,
        number: 0.0,
        seen: 0,
    };
    C::default().visit_mut(&mut count);
    count.seen
}

/// A message that nothing is wrong with.
fn good<C: Topic>(tick: u64) -> Message<C> {
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

/// A message with the fault `kind`, after a good one of `tick`.
fn bad<C: Topic>(kind: &str, tick: u64, draw: &mut Draw) -> Message<C> {
    let mut message = good::<C>(tick + 1);
    message.envelope.previous_busy_ns = 0;
    let envelope = &mut message.envelope;
    match kind {
        "other_layout" => envelope.layout ^= 1 << draw.below(64),
        "other_run" => envelope.run_id = draw.next() | 8,
        "other_settings" => envelope.settings = draw.next() | 16,
        "repeated" => (envelope.seq, envelope.tick) = (tick, tick),
        "old_sequence" => envelope.seq = draw.below(tick + 1),
        "replaced_sender" => envelope.epoch = draw.below(EPOCH),
        "future_tick" => envelope.tick = tick + 2 + draw.below(NO_TICK - tick - 2),
        "past_tick" => envelope.tick = draw.below(tick + 1),
        "not_finite" => {
            let number =
                [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -f64::NAN][draw.below(4) as usize];
            message.content.visit_mut(&mut Put {
                at: draw.below(fields::<C>()),
                number,
                seen: 0,
            });
        }
        "implausible" => {
            let number = [1e300, -1e300, f64::MAX, f64::MIN][draw.below(4) as usize];
            message.content.visit_mut(&mut Put {
                at: draw.below(fields::<C>()),
                number,
                seen: 0,
            });
        }
        _ => {}
    }
    message
}

/// Changes what lies in a slot: a bit, or up to 64 bytes in a row.
fn damage<T>(slot: &mut T, kind: &str, draw: &mut Draw) {
    let bytes = std::ptr::from_mut(slot).cast::<u8>();
    let size = size_of::<T>() as u64;
    let begin = draw.below(size);
    let length = if kind == "garbage" {
        1 + draw.below(64)
    } else {
        1
    };
    for at in begin..size.min(begin + length) {
        let with = if kind == "garbage" {
            1 + draw.below(255) as u8
        } else {
            1 << draw.below(8)
        };
        // SAFETY: a byte of the slot, which is borrowed for writing and consists of numbers.
        unsafe { *bytes.add(at as usize) ^= with };
    }
}

/// Offers so many bad messages of a kind on a topic.
fn forge<C: Topic>(root: &str, kind: &str, messages: u64) {
    let instance = Instance::under(Path::new(root), INSTANCE).unwrap();
    let receiver = [
        std::env::current_exe().unwrap().into_os_string(),
        "receive".into(),
        C::NAME.into(),
    ];
    let mut child = Command::new(&receiver[0])
        .args(&receiver[1..])
        .arg(root)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut to, mut from) = (
        child.stdin.take().unwrap(),
        BufReader::new(child.stdout.take().unwrap()).lines(),
    );
    assert_eq!(from.next().unwrap().unwrap(), "ready");
    let node = NodeBuilder::new()
        .config(&instance.config().unwrap())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .unwrap();
    let name = format!("ironbird/{}/{}", instance.name(), C::NAME);
    let service = node
        .service_builder(&name.as_str().try_into().unwrap())
        .publish_subscribe::<Sealed<Message<C>>>()
        .open()
        .unwrap();
    let publisher = service.publisher_builder().create().unwrap();
    let send = |message| publisher.send_copy(Sealed::new(message)).unwrap();
    writeln!(to, "arm").unwrap();
    assert_eq!(from.next().unwrap().unwrap(), "armed");
    let (mut draw, mut tick, mut offered) = (Draw(1), 10, 0);
    send(good::<C>(tick));
    while offered < messages {
        let batch = BATCH.min(messages - offered);
        for i in 0..batch {
            let mut slot = publisher
                .loan_uninit()
                .unwrap()
                .write_payload(Sealed::new(bad::<C>(kind, tick, &mut draw)));
            if matches!(kind, "flipped_bit" | "garbage") {
                damage(slot.payload_mut(), kind, &mut draw);
            }
            slot.send().unwrap();
            if i % GOOD_EVERY == 0 {
                tick += 1;
                send(good::<C>(tick));
            }
        }
        offered += batch;
        writeln!(to, "{}", tick + 1).unwrap();
        assert_eq!(from.next().unwrap().unwrap(), "drained");
    }
    drop(to);
    let said = from.next().unwrap().unwrap();
    assert!(child.wait().unwrap().success());
    let (topic, reason) = (
        C::NAME,
        KINDS
            .iter()
            .find(|(name, _)| *name == kind)
            .unwrap()
            .1
            .name(),
    );
    let good = tick - 9;
    println!(
        "{{\"topic\":\"{topic}\",\"offered\":{offered},\"sent_good\":{good},\"reason\":\"{reason}\",{said}}}"
    );
}

/// Receives a topic as a loop does, until the forger has no more.
fn receive<C: Topic>(instance: &Instance) {
    let wire = Wire::open(instance).unwrap();
    let mut receiver = wire.receiver::<C>(DEEP).unwrap();
    let mut out = std::io::stdout();
    let (mut accepted, mut passed) = (0_u64, 0_u64);
    writeln!(out, "ready").unwrap();
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        if line == "arm" {
            receiver.arm(EXPECTED).unwrap();
            writeln!(out, "armed").unwrap();
            continue;
        }
        let newest: u64 = line.parse().unwrap();
        receiver
            .drain(newest, |message| {
                let is_good = message.envelope.previous_busy_ns == GOOD;
                passed += u64::from(is_good);
                accepted += u64::from(!is_good);
            })
            .unwrap();
        writeln!(out, "drained").unwrap();
    }
    let counts: Vec<String> = Reason::ALL
        .iter()
        .map(|reason| {
            format!(
                "\"{}\":{}",
                reason.name(),
                receiver.rejections().of(*reason)
            )
        })
        .collect();
    let counts = counts.join(",");
    writeln!(
        out,
        "\"accepted\":{accepted},\"good\":{passed},\"rejected\":{{{counts}}}"
    )
    .unwrap();
}

fn main() {
    if let Ok(guard) = std::env::var("IRONBIRD_GUARD_OFF") {
        switch_off(&guard);
    }
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [kind, what, root] = &words[..] else {
        panic!(
            "forge KIND MESSAGES ROOT; kinds: {}",
            KINDS.map(|(name, _)| name).join(", ")
        )
    };
    if kind == "receive" {
        let instance = Instance::under(Path::new(root), INSTANCE).unwrap();
        return match what.as_str() {
            State::NAME => receive::<State>(&instance),
            Setpoint::NAME => receive::<Setpoint>(&instance),
            Wrench::NAME => receive::<Wrench>(&instance),
            _ => receive::<RotorSpeeds>(&instance),
        };
    }
    let share = what.parse::<u64>().unwrap().div_ceil(4);
    forge::<State>(root, kind, share);
    forge::<Setpoint>(root, kind, share);
    forge::<Wrench>(root, kind, share);
    forge::<RotorSpeeds>(root, kind, share);
}
