//! Doorbells: no ring is lost or counted twice, and a wait ends at its instant.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use ::ipc::clock::now_ns;
use ::ipc::error::Error;
use ::ipc::{LATEST, Wire};
use messages::content::State;
use messages::header::Header;
use messages::role::Role;

use crate::{EPOCH, EXPECTED, Site};

/// Only ends a test that hangs [ns].
const LONG: u64 = 60_000_000_000;

#[test]
fn a_ring_before_the_wait_ends_it_at_once() {
    let site = Site::new();
    let wire = site.wire();
    let doorbell = wire.doorbell(Role::Outer).unwrap();
    let bell = wire.bell(Role::Outer).unwrap();
    bell.ring().unwrap();
    assert!(doorbell.wait_until(now_ns() + LONG).unwrap());
}

#[test]
fn a_ring_is_answered_even_when_the_instant_has_come() {
    let site = Site::new();
    let wire = site.wire();
    let doorbell = wire.doorbell(Role::Outer).unwrap();
    wire.bell(Role::Outer).unwrap().ring().unwrap();
    assert!(doorbell.wait_until(now_ns()).unwrap());
}

#[test]
fn a_wait_without_a_ring_ends_after_its_instant_and_says_so() {
    let site = Site::new();
    let wire = site.wire();
    let doorbell = wire.doorbell(Role::Inner).unwrap();
    let _bell = wire.bell(Role::Inner).unwrap();
    for wait_ns in [0, 1, 50_000, 300_000, 2_500_000, 30_000_000] {
        let until = now_ns() + wait_ns;
        assert!(!doorbell.wait_until(until).unwrap());
        assert!(
            now_ns() >= until,
            "it came back {} ns early",
            until - now_ns()
        );
    }
    assert!(!doorbell.wait_until(0).unwrap(), "an instant that is over");
}

/// One test, because the alarm's signal rings for every alarm of a process.
#[test]
fn with_an_alarm_a_wait_ends_by_a_ring_or_after_its_instant_too() {
    let site = Site::new();
    let wire = site.wire();
    let doorbell = wire.doorbell_with_alarm(Role::Mixer).unwrap();
    let bell = wire.bell(Role::Mixer).unwrap();
    for wait_ns in [0, 1, 50_000, 300_000, 2_500_000, 30_000_000] {
        let until = now_ns() + wait_ns;
        assert!(doorbell.wait_until(until).unwrap(), "the alarm is a ring");
        assert!(
            now_ns() >= until,
            "it came back {} ns early",
            until - now_ns()
        );
    }
    assert!(doorbell.wait_until(0).unwrap(), "an instant that is over");

    bell.ring().unwrap();
    let begin_ns = now_ns();
    assert!(
        doorbell.wait_until(begin_ns + LONG).unwrap(),
        "a ring before the wait"
    );
    thread::scope(|scope| {
        scope.spawn(|| {
            thread::sleep(Duration::from_millis(5));
            site.wire().bell(Role::Mixer).unwrap().ring().unwrap();
        });
        assert!(
            doorbell.wait_until(begin_ns + LONG).unwrap(),
            "a ring in the wait"
        );
    });
    assert!(now_ns() < begin_ns + LONG);

    // The instant of a wait that a ring has ended passes while nobody waits: the next wait notices, and none after it.
    let instant_ns = now_ns() + 20_000_000;
    thread::scope(|scope| {
        scope.spawn(|| site.wire().bell(Role::Mixer).unwrap().ring().unwrap());
        assert!(doorbell.wait_until(instant_ns).unwrap());
    });
    thread::sleep(Duration::from_millis(30));
    assert!(now_ns() > instant_ns && doorbell.wait_until(now_ns() + LONG).unwrap());
    let until = now_ns() + 10_000_000;
    assert!(doorbell.wait_until(until).unwrap());
    assert!(now_ns() >= until);
}

#[test]
fn rings_that_nobody_waited_for_are_one() {
    let site = Site::new();
    let wire = site.wire();
    let doorbell = wire.doorbell(Role::Mixer).unwrap();
    let bell = wire.bell(Role::Mixer).unwrap();
    for rings in [1, 2, 5] {
        for _ in 0..rings {
            bell.ring().unwrap();
        }
        assert!(
            doorbell.wait_until(now_ns() + LONG).unwrap(),
            "{rings} rings"
        );
        assert!(
            !doorbell.wait_until(now_ns() + 1_000_000).unwrap(),
            "all {rings} were answered together"
        );
    }
}

#[test]
fn a_bell_that_nobody_answers_never_stops_the_one_who_rings() {
    let site = Site::new();
    let wire = site.wire();
    let bell = wire.bell(Role::Outer).unwrap();
    bell.ring().unwrap();
    let doorbell = wire.doorbell(Role::Outer).unwrap();
    // More than any queue of the kernel holds.
    for _ in 0..100_000 {
        bell.ring().unwrap();
    }
    assert!(doorbell.wait_until(now_ns() + LONG).unwrap());
    assert!(!doorbell.wait_until(now_ns()).unwrap(), "and none is left");
}

#[test]
fn a_ring_ends_a_wait_in_another_thread() {
    let site = Site::new();
    thread::scope(|scope| {
        let (tell, told) = mpsc::channel();
        let waiter = scope.spawn({
            let site = &site;
            move || {
                let wire = site.wire();
                let doorbell = wire.doorbell(Role::Inner).unwrap();
                tell.send(()).unwrap();
                doorbell.wait_until(now_ns() + LONG).unwrap()
            }
        });
        told.recv().unwrap();
        let bell = site.wire().bell(Role::Inner).unwrap();
        thread::sleep(Duration::from_millis(5));
        bell.ring().unwrap();
        assert!(waiter.join().unwrap());
    });
}

#[test]
fn a_bell_rings_at_its_role_alone() {
    let site = Site::new();
    let wire = site.wire();
    let (outer, mixer) = (
        wire.doorbell(Role::Outer).unwrap(),
        wire.doorbell(Role::Mixer).unwrap(),
    );
    wire.bell(Role::Mixer).unwrap().ring().unwrap();
    assert!(!outer.wait_until(now_ns() + 1_000_000).unwrap());
    assert!(mixer.wait_until(now_ns() + LONG).unwrap());
}

#[test]
fn a_message_is_there_when_its_sender_rings() {
    let site = Site::new();
    let wire = site.wire();
    let doorbell = wire.doorbell(Role::Outer).unwrap();
    let mut sender = wire
        .sender::<State>(Some(wire.bell(Role::Outer).unwrap()))
        .unwrap();
    let mut receiver = wire.receiver::<State>(LATEST).unwrap();
    sender.arm(EXPECTED, EPOCH).unwrap();
    receiver.arm(EXPECTED).unwrap();
    for tick in 0..1000 {
        sender.send(tick, &Header::new(), State::default()).unwrap();
        assert!(doorbell.wait_until(now_ns() + LONG).unwrap());
        assert_eq!(receiver.take(tick).unwrap(), tick);
    }
}

#[test]
fn a_page_of_another_build_is_incompatible() {
    let site = Site::new();
    let page = page_of(&site);
    // The token of the last of 64 bells of 64 bytes.
    let theirs = [vec![0; 63 * 64 + 8], vec![7; 8], vec![0; 48]].concat();
    fs::write(&page, &theirs).unwrap();
    drop(Wire::open(&site.instance).expect("nobody uses it: it was left"));
    let _other_build = site.instance.enter().unwrap();
    fs::write(&page, &theirs).unwrap();
    let error = Wire::open(&site.instance).unwrap_err();
    assert!(matches!(&error, Error::Incompatible { .. }), "{error}");
    assert!(
        error.to_string().contains("the page of doorbells"),
        "{error}"
    );
    assert!(!page.exists(), "nobody else had it");
}

#[test]
fn the_page_goes_with_the_last_one_who_has_it() {
    let site = Site::new();
    let page = page_of(&site);
    let (first, second) = (site.wire(), site.wire());
    let (doorbell, bell) = (
        first.doorbell(Role::Outer).unwrap(),
        second.bell(Role::Outer).unwrap(),
    );
    assert!(page.exists());
    drop(first);
    assert!(page.exists(), "one still has it");
    let third = site.wire();
    third.bell(Role::Outer).unwrap().ring().unwrap();
    assert!(
        doorbell.wait_until(now_ns() + LONG).unwrap(),
        "who comes later rings at the same door"
    );
    drop((second, third));
    assert!(!page.exists());
    bell.ring().unwrap();
    assert!(
        doorbell.wait_until(now_ns()).unwrap(),
        "what is mapped stays"
    );
}

#[test]
fn processes_that_come_and_go_at_once_share_one_page() {
    let site = Site::new();
    let stays = site.wire();
    let doorbell = stays.doorbell(Role::Inner).unwrap();
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                (0..50).for_each(|_| site.wire().bell(Role::Inner).unwrap().ring().unwrap())
            });
        }
    });
    assert!(doorbell.wait_until(now_ns()).unwrap());
    drop((doorbell, stays));
    assert!(!page_of(&site).exists());
}

fn page_of(site: &Site) -> PathBuf {
    Path::new("/dev/shm").join(format!("{}bells", site.instance.prefix()))
}
