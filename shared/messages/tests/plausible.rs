//! What is plausible of each number and word of a message is as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! messages` accepts a change.

use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
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
    let mut window = MessageWindow::<Wrench>::keeping(6);
    for tick in (0..12).chain(20..30) {
        window.push(Message::of_tick(tick, Wrench::default()));
        window.advance();
    }
    fn ticks<'a>(found: Option<impl Iterator<Item = &'a Message<Wrench>>>) -> Option<Vec<u64>> {
        Some(found?.map(|message| message.envelope.tick).collect())
    }
    let of = [19, 22, 23, 26, 29, 30].map(|tick| window.of(tick).map(|it| it.envelope.tick));
    assert_eq!(of, [None, None, Some(23), Some(26), Some(29), None]);
    assert_eq!(window.newest_tick(), Some(29));
    assert_eq!(ticks(window.up_to(27, 3)), Some(vec![25, 26, 27]));
    assert_eq!(
        (ticks(window.up_to(24, 3)), ticks(window.up_to(24, 0))),
        (None, Some(vec![]))
    );
    assert_eq!(ticks(window.parted(23, 1, 28, 2)), Some(vec![24, 27, 28]));
    assert_eq!(ticks(window.parted(23, 3, 28, 2)), None);
    window.forget_before(26);
    assert_eq!((window.of(25), window.next()), (None, None));
    window.push(Message::of_tick(31, Wrench::default()));
    assert_eq!(window.next().map(|it| it.envelope.tick), Some(31));
}
