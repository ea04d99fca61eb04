//! Wake-up events: no notification is lost or counted twice, and a wait ends at its instant.

use std::fs;
use std::thread;
use std::time::Duration;

use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::{WakeEvent, Wire};
use messages::role::Role;

use crate::{Site, page};

/// Only ends a test that hangs [ns].
const LONG: u64 = 60_000_000_000;

fn notify(wire: &Wire, role: Role) {
    wire.notifier(role).unwrap().notify().unwrap();
}

/// Waits for a time [ns]; whether it was notified.
fn wait(event: &WakeEvent, time_ns: u64) -> bool {
    let until_ns = now_ns() + time_ns;
    // The wake-up call of an earlier notification may come late, and then ends a wait.
    while !event.wait_until(until_ns).unwrap() {
        if now_ns() >= until_ns {
            return false;
        }
    }
    true
}

#[test]
fn a_notification_before_the_wait_ends_it_at_once_and_many_are_one() {
    let site = Site::new();
    let wire = site.wire();
    let notifier = wire.notifier(Role::Outer).unwrap();
    notifier.notify().unwrap();
    let event = wire.wake_event(Role::Outer).unwrap();
    // The last is more than any queue of the kernel holds.
    for (count, wait_ns) in [(1, LONG), (1, 0), (2, LONG), (5, LONG), (100_000, LONG)] {
        (0..count).for_each(|_| notifier.notify().unwrap());
        assert!(wait(&event, wait_ns), "{count}");
        assert!(!wait(&event, 1_000_000), "{count} were answered together");
    }
}

#[test]
fn a_wait_without_a_notification_ends_after_its_instant() {
    let site = Site::new();
    let wire = site.wire();
    let event = wire.wake_event(Role::Inner).unwrap();
    // Another role is notified.
    let other = wire.wake_event(Role::Mixer).unwrap();
    notify(&wire, Role::Mixer);
    for wait_ns in [0, 1, 50_000, 300_000, 2_500_000, 30_000_000] {
        let until = now_ns() + wait_ns;
        assert!(!event.wait_until(until).unwrap());
        assert!(now_ns() >= until, "{} ns early", until - now_ns());
    }
    assert!(!event.wait_until(0).unwrap(), "an instant that is over");
    assert!(wait(&other, LONG));
}

/// One test, because the alarm's signal reaches every alarm of a process.
#[test]
fn with_an_alarm_a_wait_ends_by_a_notification_or_after_its_instant_too() {
    let site = Site::new();
    let wire = site.wire();
    let event = wire.wake_event_with_alarm(Role::Mixer).unwrap();
    for wait_ns in [0, 1, 50_000, 300_000, 2_500_000, 30_000_000] {
        let until = now_ns() + wait_ns;
        assert!(event.wait_until(until).unwrap(), "the alarm notifies");
        assert!(now_ns() >= until, "{} ns early", until - now_ns());
    }
    assert!(event.wait_until(0).unwrap(), "an instant that is over");

    notify(&wire, Role::Mixer);
    let begin_ns = now_ns();
    assert!(
        event.wait_until(begin_ns + LONG).unwrap(),
        "before the wait"
    );
    thread::scope(|scope| {
        scope.spawn(|| {
            thread::sleep(Duration::from_millis(5));
            notify(&site.wire(), Role::Mixer);
        });
        assert!(event.wait_until(begin_ns + LONG).unwrap(), "in the wait");
    });
    assert!(now_ns() < begin_ns + LONG);

    // The instant of a wait that a notification has ended passes while no process waits: only the next wait sees it.
    let instant_ns = now_ns() + 20_000_000;
    thread::scope(|scope| {
        scope.spawn(|| notify(&site.wire(), Role::Mixer));
        assert!(event.wait_until(instant_ns).unwrap());
    });
    thread::sleep(Duration::from_millis(30));
    assert!(now_ns() > instant_ns && wait(&event, LONG));
    let until = now_ns() + 10_000_000;
    assert!(event.wait_until(until).unwrap());
    assert!(now_ns() >= until);
}

#[test]
fn a_page_of_another_build_is_incompatible() {
    let site = Site::new();
    let page = page(&site.instance);
    // The token of the last of 64 events of 64 bytes.
    let theirs = [vec![0; 63 * 64 + 8], vec![7; 8], vec![0; 48]].concat();
    fs::write(&page, &theirs).unwrap();
    drop(Wire::open(&site.instance).expect("no process uses it: it was left"));
    let _other_build = site.instance.enter().unwrap();
    fs::write(&page, &theirs).unwrap();
    let error = Wire::open(&site.instance).unwrap_err();
    assert!(matches!(&error, Error::Incompatible { .. }), "{error}");
    let words = error.to_string();
    assert!(words.contains("the page of wake-up events"), "{words}");
    assert!(!page.exists(), "no other process had it");
}

#[test]
fn the_page_goes_with_the_last_process_that_has_it() {
    let site = Site::new();
    let page = page(&site.instance);
    let (first, second) = (site.wire(), site.wire());
    let event = first.wake_event(Role::Outer).unwrap();
    let notifier = second.notifier(Role::Outer).unwrap();
    assert!(page.exists());
    drop(first);
    assert!(page.exists(), "one still has it");
    // Later processes, which come and go at once, have the same page.
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| (0..50).for_each(|_| notify(&site.wire(), Role::Outer)));
        }
    });
    assert!(wait(&event, 0));
    drop(second);
    assert!(!page.exists());
    notifier.notify().unwrap();
    assert!(wait(&event, 0), "what is mapped stays");
}

#[test]
fn who_polls_sees_every_notification_and_is_woken_by_the_kernel_afterwards() {
    let site = Site::new();
    let wire = site.wire();
    let event = wire.wake_event(Role::Outer).unwrap();
    let until_ns = now_ns() + 1_000_000;
    assert!(!event.poll_until(until_ns) && now_ns() >= until_ns);
    thread::scope(|scope| {
        scope.spawn(|| {
            let wire = site.wire();
            let (outer, inner) = (
                wire.notifier(Role::Outer).unwrap(),
                wire.wake_event(Role::Inner).unwrap(),
            );
            for _ in 0..2000 {
                outer.notify().unwrap();
                assert!(wait(&inner, LONG));
            }
        });
        let inner = wire.notifier(Role::Inner).unwrap();
        for turn in 0..2000_u64 {
            // Polls for a while that may end just as the notification comes, and then waits.
            let polled = event.poll_until(now_ns() + turn % 50 * 200);
            assert!(polled || wait(&event, LONG), "turn {turn}");
            inner.notify().unwrap();
        }
    });
    // A process that was killed while it polled has left its mark.
    assert!(!wire.wake_event(Role::Outer).unwrap().poll_until(0));
}
