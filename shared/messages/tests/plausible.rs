//! What is plausible of each number and word of a message is as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! messages` accepts a change.

use messages::content::{NO_TICK, RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::Message;
use messages::layout::change_words;
use messages::message_window::MessageWindow;
use messages::monitor::Monitor;
use messages::topic::Topic;

/// A line for each field: how many of the first words are plausible, the largest power of ten that is, below and above
/// zero, and whether what is no number is finite and plausible.
fn ranges<C: Topic>() -> String {
    let mut lines = Vec::new();
    for place in 0.. {
        let mut name = "";
        let mut with = |bits: u64| {
            let (mut content, mut places) = (C::default(), 0..);
            change_words(&mut content, |field, word| {
                if places.next() == Some(place) {
                    name = field.name;
                    return bits;
                }
                word
            });
            (content.finite(), content.plausible())
        };
        let words = (0..70).filter(|word| with(*word).1).count();
        let mut powers = |sign: f64| {
            let is_plausible = |power: &i32| with((sign * 10_f64.powi(*power)).to_bits()).1;
            (-2..=20).filter(is_plausible).last()
        };
        let powers = (powers(-1.0), powers(1.0));
        let nan = with(f64::NAN.to_bits());
        if name.is_empty() {
            break;
        }
        lines.push(format!("{}.{name} {words} {powers:?} {nan:?}\n", C::NAME));
    }
    lines.dedup();
    lines.concat()
}

#[test]
fn what_is_plausible_is_its_snapshot() {
    let first = ranges::<State>() + &ranges::<Setpoint>() + &ranges::<Wrench>();
    let others = ranges::<RotorSpeeds>() + &ranges::<SwapRecord>() + &ranges::<Monitor>();
    insta::assert_snapshot!(first + &others);
}

#[test]
fn a_window_finds_messages_by_tick_with_and_without_gaps() {
    let mut window = MessageWindow::<Wrench>::keeping(8);
    (0..12)
        .chain(20..30)
        .for_each(|tick| window.push(&Message::of_tick(tick, Wrench::default())));
    for (tick, is_there) in [
        (19, false),
        (20, false),
        (21, true),
        (29, true),
        (30, false),
    ] {
        let found = window.input(tick).map(|it| it.tick);
        assert_eq!(found, is_there.then_some(tick));
    }
    window.push(&Message::of_tick(40, Wrench::default()));
    let found = [28, 40, NO_TICK].map(|tick| window.input(tick).map(|it| it.tick));
    assert_eq!(found, [Some(28), Some(40), Some(NO_TICK)]);
}
