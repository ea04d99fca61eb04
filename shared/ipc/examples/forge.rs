//! Bad messages on live ports: a process forges, another one receives, over real shared memory (`bench/drill`).
//!
//!     cargo run --example forge -- KIND MESSAGES ROOT
//!
//! The forger writes each message into a slot that is in use: it is sent, and the receiver takes it out of this slot.
//! One message in eight is good. The last line of each topic says what became of its messages, as JSON.
#![allow(clippy::unwrap_used, reason = "a failure here is a bug of the drill")]
#![allow(unsafe_code, reason = "bits are flipped in memory")]

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/common/forgery.rs"]
mod forgery;

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use ipc::instance::Instance;
use ipc::{DEEP, Wire};
use messages::checks::switch_off;
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::inspection::Reason;
use messages::topic::Topic;

use forgery::{Draw, EXPECTED, Forger, GOOD, KINDS, good};

const INSTANCE: &str = "forged";
const BATCH: u64 = 2000;
const GOOD_EVERY: u64 = 8;

/// Sends so many bad messages of a kind on a topic.
fn forge<C: Topic>(root: &str, kind: &str, messages: u64) {
    let instance = Instance::under(Path::new(root), INSTANCE).unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["receive", C::NAME, root])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut to = child.stdin.take().unwrap();
    let mut from = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut expect = |word: &str| assert_eq!(from.next().unwrap().unwrap(), word);
    expect("ready");
    let forger = Forger::<C>::on(&instance);
    writeln!(to, "arm").unwrap();
    expect("armed");
    let (mut draw, mut tick, mut offered) = (Draw(1), 10, 0);
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
        // The newest tick that has begun when these are inspected.
        writeln!(to, "{}", tick + 1).unwrap();
        expect("drained");
    }
    drop(to);
    let counts = from.next().unwrap().unwrap();
    assert!(child.wait().unwrap().success());
    let (_, reason) = KINDS.iter().find(|(name, _)| *name == kind).unwrap();
    println!(
        "{{\"topic\":\"{}\",\"offered\":{offered},\"sent_good\":{},\"reason\":\"{}\",{counts}}}",
        C::NAME,
        tick - 9,
        reason.name()
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
        let kinds = KINDS.map(|(name, _)| name).join(", ");
        panic!("forge KIND MESSAGES ROOT; kinds: {kinds}")
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
