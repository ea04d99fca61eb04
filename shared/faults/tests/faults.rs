//! What faults make of messages: each kind at an inlet, and what they do not depend on.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use faults::filter::FaultyInput;
use faults::grammar::Fault;
use faults::live::{LiveFault, LoopFaults, NOTICE_TICKS};
use faults::{FAULTS, FaultSpec, Kind, LONGEST_DELAY_TICKS, MessageFaults, Port, Span, ValueType};
use messages::content::{NO_TICK, Wrench};
use messages::header::Message;
use messages::inspection::Reason;
use proptest::prelude::*;

const PORT: Port = Port::MixerWrench;

/// Faults of the wrench, each as it is typed after `mixer.wrench.`.
fn table(seed: u64, faults: &[&str]) -> MessageFaults {
    let mut table = LoopFaults::none(seed, 1_000_000);
    for text in faults {
        let fault: Fault = format!("mixer.wrench.{text}").parse().unwrap();
        let span = fault.span(1e-3).unwrap();
        // What contradicts an earlier one is left out.
        let _ = fault.changes[0]
            .faults(span)
            .try_for_each(|it| table.take(&it));
    }
    table.messages
}

/// The wrench of a tick: its thrust says which.
fn wrench(tick: u64) -> Message<Wrench> {
    let mut message = Message::of_tick(tick, Wrench::default());
    message.content.thrust_n = tick as f64;
    message
}

/// Tick and thrust of what the stage has at each tick, where a wrench comes in every one.
fn had(faults: &MessageFaults, ticks: u64) -> Vec<(u64, f64)> {
    let mut inlet = FaultyInput::new(faults, PORT);
    let at = |tick| {
        inlet.arrive(&wrench(tick));
        let newest = inlet.settle(tick);
        (newest.envelope.tick, newest.content.thrust_n)
    };
    (0..ticks).map(at).collect()
}

/// Ticks and thrusts that a stage has at each tick, under faults of one message after the other.
#[test]
fn each_kind_of_fault_does_what_it_says() {
    let never = NO_TICK;
    type Case<'a> = (&'a [&'a str], &'a [u64], &'a [f64]);
    let cases: [Case<'_>; 10] = [
        (&[], &[0, 1, 2, 3], &[0.0, 1.0, 2.0, 3.0]),
        (&["drop=1@tick2..tick5"], &[0, 1, 1, 1, 1, 5, 6], &[]),
        (&["drop=1@tick0..tick2"], &[never, never, 2], &[]),
        (
            &["drop=2/3@tick1..tick8"],
            &[0, 0, 0, 3, 3, 3, 6, 6, 8],
            &[],
        ),
        // Delayed messages come under their own tick, and are overtaken at the end.
        (&["delay=2@tick2..tick6"], &[0, 1, 1, 1, 2, 3, 6, 7, 8], &[]),
        // What lags is older, under the tick of now.
        (
            &["lag=2@tick3..tick6"],
            &[0, 1, 2, 3, 4, 5, 6],
            &[0.0, 1.0, 2.0, 1.0, 2.0, 3.0, 6.0],
        ),
        (&["lag=2@tick0..tick4"], &[never, never, 2, 3, 4], &[]),
        // A frozen topic repeats the last message before.
        (
            &["freeze@tick3..tick6"],
            &[0, 1, 2, 3, 4, 5, 6],
            &[0.0, 1.0, 2.0, 2.0, 2.0, 2.0, 6.0],
        ),
        (&["freeze@tick0..tick2"], &[never, never, 2], &[]),
        (
            &["thrust_n.bias=0.5@tick1..tick3"],
            &[0, 1, 2, 3],
            &[0.0, 1.5, 2.5, 3.0],
        ),
    ];
    for (faults, ticks, thrusts) in cases {
        let had = had(&table(7, faults), ticks.len() as u64);
        assert!(
            had.iter().map(|it| it.0).eq(ticks.iter().copied()),
            "{faults:?}: {had:?}"
        );
        for ((_, thrust), expected) in had.iter().zip(thrusts) {
            assert_eq!(thrust, expected, "{faults:?}");
        }
    }
    let longest = format!("lag={LONGEST_DELAY_TICKS}@tick0");
    let longest = had(&table(7, &[&longest]), 200);
    assert_eq!(longest[199].1, (199 - LONGEST_DELAY_TICKS) as f64);
    let several = ["delay=1@tick0", "lag=2@tick0", "thrust_n.bias=0.5@tick0"];
    assert_eq!(had(&table(7, &several), 9)[8], (7, 5.5));
    let one_axis = table(7, &["torque_b_nm.z.bias=0.5@tick0"]);
    let mut inlet = FaultyInput::new(&one_axis, PORT);
    inlet.arrive(&wrench(0));
    assert_eq!(inlet.settle(0).content.torque_b_nm, [0.0, 0.0, 0.5]);
}

#[test]
fn a_share_is_lost_at_random_and_by_seed() {
    let faults = ["drop=0.2@tick0"];
    let lost = |seed| -> Vec<u64> {
        let had = had(&table(seed, &faults), 10_000).into_iter().zip(0..);
        had.filter(|((had, _), tick)| had != tick)
            .map(|(_, tick)| tick)
            .collect()
    };
    // Two thousand, with a standard deviation of 40.
    assert!((1800..2200).contains(&lost(7).len()), "{}", lost(7).len());
    assert_eq!(lost(7), lost(7));
    assert_ne!(lost(7), lost(8));
}

#[test]
fn noise_has_its_deviation() {
    let had = had(&table(7, &["thrust_n.noise=0.1@tick100..tick9000"]), 9000);
    let squares = had.iter().zip(0..).skip(100).map(|((_, thrust), tick)| {
        let error = thrust - f64::from(tick);
        error * error
    });
    let deviation = (squares.sum::<f64>() / 8900.0).sqrt();
    assert!((deviation / 0.1 - 1.0).abs() < 0.05, "{deviation}");
}

#[test]
fn what_is_no_number_or_not_possible_never_comes_and_is_counted() {
    for (kind, reason) in [
        ("nan", Reason::NonFinite),
        ("bias=1e308", Reason::Implausible),
        ("bias=-100", Reason::Implausible),
    ] {
        let text = format!("thrust_n.{kind}@tick2..tick5");
        let mut inlet = FaultyInput::new(&table(7, &[&text]), PORT);
        let at = |tick| {
            inlet.arrive(&wrench(tick));
            inlet.settle(tick).envelope.tick
        };
        assert!((0..7).map(at).eq([0, 1, 1, 1, 1, 5, 6]), "{kind:?}");
        let rejections = inlet.rejections();
        assert_eq!(
            (rejections.of(reason), rejections.total()),
            (3, 3),
            "{kind:?}"
        );
    }
}

/// Every kind of message fault, with a value.
fn kinds() -> impl Strategy<Value = String> {
    let kinds = (0..FAULTS.len(), 0.01..1.0_f64, 1..=60_u64, 0..4_u64);
    kinds.prop_filter_map("faults of messages", |(kind, share, first, more)| {
        let FaultSpec {
            kind, name, value, ..
        } = FAULTS[kind];
        let place = match kind {
            Kind::Message(_) => "",
            Kind::Number(_) => "thrust_n.",
            Kind::Stage(_) | Kind::Processor(_) | Kind::Channel(_) => return None,
        };
        let value = match value {
            ValueType::None => String::new(),
            ValueType::Pattern => format!("={first}/{}", first + more),
            ValueType::Integer { .. } => format!("={first}"),
            ValueType::Share | ValueType::Positive(_) => format!("={share}"),
            ValueType::NotZero => format!("={}", if more == 0 { -1e9 } else { share }),
            ValueType::Time | ValueType::TimeRange => return None,
        };
        Some(format!("{place}{name}{value}"))
    })
}

fn faults() -> impl Strategy<Value = MessageFaults> {
    let fault = (kinds(), 0_u64..300, 1_u64..300)
        .prop_map(|(kind, from, length)| format!("{kind}@tick{from}..tick{}", from + length));
    (any::<u64>(), proptest::collection::vec(fault, 0..6)).prop_map(|(seed, faults)| {
        let faults: Vec<&str> = faults.iter().map(String::as_str).collect();
        table(seed, &faults)
    })
}

proptest! {
    #[test]
    fn the_same_faults_make_the_same_messages_and_none_that_inspection_refuses(faults in faults()) {
        let (one, two) = (had(&faults, 400), had(&faults, 400));
        prop_assert_eq!(&one, &two);
        prop_assert!(one.iter().all(|(_, thrust)| (0.0..=1e4).contains(thrust)));
        let rises = one.windows(2).all(|pair| pair[0].0 == NO_TICK || (pair[1].0 != NO_TICK && pair[0].0 <= pair[1].0));
        prop_assert!(rises, "a stage never gets an older message");
        prop_assert!(one.iter().zip(0..).all(|((tick, _), now)| *tick == NO_TICK || *tick <= now));
    }

    /// A stage that sleeps for some ticks has, when it wakes, what it would have had.
    #[test]
    fn when_a_stage_looks_does_not_matter(faults in faults(), sleeps in proptest::collection::vec(1_u64..20, 1..40)) {
        let awake = had(&faults, 400);
        let mut inlet = FaultyInput::new(&faults, PORT);
        let (mut tick, mut next) = (0, 0);
        for slept in sleeps {
            next = (next + slept).min(399);
            while tick <= next {
                inlet.arrive(&wrench(tick));
                tick += 1;
            }
            let newest = inlet.settle(next);
            prop_assert_eq!((newest.envelope.tick, newest.content.thrust_n), awake[next as usize]);
        }
    }

    /// Faults that an input gets in flight, with as much notice as the plant gives, are those that it always knew.
    #[test]
    fn when_an_input_gets_its_faults_does_not_matter(faults in faults()) {
        let first = faults.iter().map(|(_, fault)| fault.span.from).min().unwrap_or(0);
        let late = NOTICE_TICKS + 40;
        let moved = |fault: &LiveFault| {
            let Span { from, to } = fault.span;
            let span = Span { from: from - first + late, to: to.saturating_add(late) };
            LiveFault { span, ..*fault }
        };
        let (mut known, mut changed) = (LoopFaults::none(7, 1), FaultyInput::changing(&MessageFaults::none(7), PORT));
        for (_, fault) in faults.iter() {
            let _ = known.take(&moved(fault));
        }
        let known = known.messages;
        let always = had(&known, 400);
        let mut newest = Message::default();
        for tick in 0..400 {
            if tick == late - NOTICE_TICKS {
                changed.change(&known, PORT, &newest);
            }
            // Before that it is shown nothing, as where there is no fault.
            if tick < late - NOTICE_TICKS {
                newest = wrench(tick);
                continue;
            }
            changed.arrive(&wrench(tick));
            let had = changed.settle(tick);
            prop_assert_eq!((had.envelope.tick, had.content.thrust_n), always[tick as usize], "tick {}", tick);
        }
    }
}
