//! Blackboards: writing never waits, reading never disturbs, a dead writer is replaced.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ipc::{Blackboard, BlackboardReader, Wire};
use messages::blackboards::{ActiveParameters, SettingsText};

use crate::{Site, assert_incompatible, assert_taken};

const NAME: &str = "in_force";

fn at(tick: u64) -> ActiveParameters {
    ActiveParameters {
        tick,
        ..ActiveParameters::default()
    }
}

fn board(wire: &Wire) -> Blackboard<ActiveParameters> {
    wire.blackboard(NAME).unwrap()
}

fn reader(wire: &Wire) -> Option<BlackboardReader<ActiveParameters>> {
    wire.blackboard_reader(NAME).unwrap()
}

#[test]
fn a_board_has_one_writer() {
    let site = Site::new();
    let (here, there) = (site.wire(), site.wire());
    let board = board(&here);
    for wire in [&here, &there] {
        let second = wire.blackboard::<ActiveParameters>(NAME);
        assert_taken(second, "the writer of board `in_force`");
    }
    board.put(at(3));
    assert_eq!(reader(&there).unwrap().get(), at(3));
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
struct Pose {
    north_m: u64,
    east_m: u64,
}

/// The same of another build: of one size, with its fields swapped.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
struct SwappedPose {
    east_m: u64,
    north_m: u64,
}

messages::layout!(Pose { north_m, east_m });
messages::layout!(SwappedPose { east_m, north_m });

#[test]
fn a_board_of_another_layout_is_incompatible() {
    let site = Site::new();
    let wire = site.wire();
    let board = wire.blackboard::<Pose>("pose").unwrap();
    let pose = Pose {
        north_m: 1,
        east_m: 2,
    };
    board.put(pose);
    let swapped_reader = wire.blackboard_reader::<SwappedPose>("pose");
    assert_incompatible(swapped_reader, "board `pose`");
    assert_incompatible(wire.blackboard::<SwappedPose>("pose"), "board `pose`");
    let other_reader = wire.blackboard_reader::<ActiveParameters>("pose");
    assert_incompatible(other_reader, "board `pose`");
    let reader = wire.blackboard_reader::<Pose>("pose").unwrap().unwrap();
    assert_eq!(reader.get(), pose);
}

#[test]
fn a_reader_never_sees_a_value_half_written() {
    let site = Site::new();
    let wire = site.wire();
    let board = wire.blackboard::<SettingsText>("settings").unwrap();
    let text = |letter: char| SettingsText::new(&letter.to_string().repeat(8192)).unwrap();
    let texts = [text('a'), text('b')];
    // One thread writes until the other has read enough changes.
    let enough = 200;
    let (changes, over) = (AtomicU64::new(0), AtomicBool::new(false));
    let until = Instant::now() + Duration::from_secs(60);
    std::thread::scope(|scope| {
        let (changes, over, site, texts) = (&changes, &over, &site, &texts);
        scope.spawn(move || {
            let wire = site.wire();
            let reader = wire.blackboard_reader("settings").unwrap().unwrap();
            let mut last = SettingsText::default();
            while !over.load(Ordering::Relaxed) {
                let seen: SettingsText = reader.get();
                let is_whole = seen == SettingsText::default() || texts.contains(&seen);
                if !is_whole {
                    // A panic alone would not stop the writer.
                    over.store(true, Ordering::Relaxed);
                }
                assert!(is_whole, "a mixture: {}", seen.text());
                changes.fetch_add(u64::from(seen != last), Ordering::Relaxed);
                last = seen;
            }
        });
        let mut written = 0;
        let is_enough = || changes.load(Ordering::Relaxed) >= enough;
        while !is_enough() && !over.load(Ordering::Relaxed) && Instant::now() < until {
            board.put(texts[written % 2]);
            written += 1;
        }
        over.store(true, Ordering::Relaxed);
    });
    assert!(changes.into_inner() >= enough);
}
