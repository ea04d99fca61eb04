//! The outages of the autopsy: their ticks, and every missed deadline in one.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;

use crate::made::{GRID, MISSED, T, US, WINDOW_TICKS, good, made, stall};
use model::envelope::{Envelope, Message, Stamps};
use model::messages::{RotorSpeeds, Setpoint, State, Wrench};
use model::role::{Role, STAGES};
use report::autopsy::Autopsy;
use report::autopsy::classes::Class;
use report::autopsy::evidence::{CounterSample, Life, Passage, TickPassages};
use report::margin::line::MACHINE;

/// Feeds an autopsy as the recorder does, with samples in between; gives the deadlines missed before the last state.
fn feed(autopsy: &mut Autopsy, traces: &BTreeMap<u64, TickPassages>, samples: &[CounterSample]) -> u64 {
    let mut samples = samples.iter().peekable();
    let mut missed = 0;
    let mut judged = 0;
    for (tick, trace) in traces {
        while let Some(sample) = samples.next_if(|sample| sample.at_ns <= GRID.begin_of(*tick)) {
            autopsy.sample(*sample);
        }
        let envelope = |role: Role| {
            let passage = trace[role as usize]?;
            let input = if passage.is_fresh { *tick } else { tick.saturating_sub(1) };
            let mut envelope = Envelope { tick: *tick, input_tick: [input; 3], ..Envelope::new() };
            envelope.stamps[role as usize] = Stamps { receive_ns: passage.receive_ns, send_ns: passage.send_ns };
            Some(envelope)
        };
        if let Some(plant) = envelope(Role::Plant) {
            let mut row = 0;
            // At the beginning of each tick since its last state, the plant looks for the command of the tick before.
            for begun in judged + 1..=*tick {
                let sent_ns =
                    traces.get(&(begun - 1)).and_then(|trace| trace[Role::Mixer as usize]).map(|it| it.send_ns);
                row = if sent_ns.is_some_and(|ns| ns <= GRID.begin_of(begun)) { 0 } else { row + 1 };
                missed += u64::from(row > 0);
            }
            judged = *tick;
            let content = State { deadlines_missed: missed, deadline_miss_run: row, ..State::default() };
            autopsy.state(&Message { envelope: plant, content });
        }
        if let Some(envelope) = envelope(Role::Outer) {
            autopsy.stamps(&Message { envelope, content: Setpoint::default() });
        }
        if let Some(envelope) = envelope(Role::Inner) {
            autopsy.stamps(&Message { envelope, content: Wrench::default() });
        }
        if let Some(envelope) = envelope(Role::Mixer) {
            autopsy.stamps(&Message { envelope, content: RotorSpeeds::default() });
        }
        autopsy.look();
    }
    samples.for_each(|sample| autopsy.sample(*sample));
    missed
}

#[test]
fn every_missed_deadline_is_in_one_outage() {
    let mut made = made();
    stall(&mut made);
    // The last command of all never comes.
    made.silence_of(Role::Mixer, WINDOW_TICKS - 1..WINDOW_TICKS);
    let mut autopsy = Autopsy::new(GRID, true, true);
    let missed = feed(&mut autopsy, &made.traces, &made.samples);
    assert_eq!((missed, autopsy.section().pending), (2, 2), "they wait for the ticks after them");
    autopsy.finish(missed + 1, WINDOW_TICKS);
    let section = autopsy.section();
    assert_eq!(section.classes.iter().map(|class| class.missed).sum::<u64>(), missed + 1);
    let outages: Vec<_> = section.worst.iter().map(|case| (case.tick, case.ticks, case.missed)).collect();
    assert_eq!(outages, [(MISSED, 2, 2), (WINDOW_TICKS - 1, 1, 1)]);
    assert_eq!(section.worst[0].class, Class::ProcessorStalled);
    // From the beginning of the first tick to the plant's waking, 120 us after that of the third.
    assert!((section.worst[0].delay_us - 2_120.0).abs() < 1e-6, "{:?}", section.worst[0]);
    let worked: Vec<_> = section.worst[0].timeline.iter().map(|tick| (tick.tick, tick.stages.len())).collect();
    let expected = [(MISSED - 1, 4), (MISSED, 0), (MISSED + 1, 0), (MISSED + 2, 4), (MISSED + 3, 4)];
    assert_eq!(worked, expected, "also the ticks in which nobody published");
    let text = section.text();
    let line = format!("tick {MISSED} (0.032 s): 2 ticks, 2 missed, a delay of 2120 us: processor stalled (");
    assert!(text.contains(&line), "{text}");
}

/// Ticks of a flight in which a stage is stopped for a time, as the other stages fly on.
fn stopped(stage: Role, ticks: std::ops::Range<u64>, until: u64) -> BTreeMap<u64, TickPassages> {
    let mut traces: BTreeMap<u64, TickPassages> = (0..until).map(|tick| (tick, good(tick))).collect();
    for tick in ticks {
        let begin_ns = GRID.begin_of(tick);
        let at_cut_off = |role: Role, is_fresh: bool| {
            let receive_ns = begin_ns + T * role.deadline_percent() / 100 + 10 * US;
            Some(Passage { receive_ns, send_ns: receive_ns + 5 * US, is_fresh })
        };
        let [plant, outer, inner, mixer] = good(tick);
        traces.insert(
            tick,
            match stage {
                // Without a state the outer loop publishes nothing, and the inner one what it held.
                // The mixer's command comes too late, as the plant finds out when it is back.
                Role::Plant => {
                    let late = Passage { receive_ns: begin_ns + T, send_ns: begin_ns + T + 10 * US, is_fresh: true };
                    [None, None, at_cut_off(Role::Inner, false), Some(late)]
                }
                Role::Outer => [plant, None, at_cut_off(Role::Inner, false), at_cut_off(Role::Mixer, true)],
                Role::Inner => [plant, outer, None, at_cut_off(Role::Mixer, false)],
                _ => [plant, outer, inner, mixer.filter(|_| false)],
            },
        );
    }
    traces
}

#[test]
fn a_stop_of_any_length_is_one_outage_with_all_its_ticks() {
    for (stage, ticks) in STAGES.into_iter().flat_map(|stage| [5, 100, 3000].map(|ticks| (stage, ticks))) {
        let (first, last) = (MISSED, MISSED + ticks - 1);
        let traces = stopped(stage, first..last + 1, last + WINDOW_TICKS);
        let samples: Vec<CounterSample> = (0..(last + WINDOW_TICKS) / 10 + 2)
            .map(|i| {
                let mut sample = made().samples[0];
                sample.at_ns = GRID.begin_of(10 * i);
                if (first..=last).contains(&(10 * i)) {
                    sample.stages[stage as usize].life = Life::Stopped;
                }
                sample
            })
            .collect();
        let mut autopsy = Autopsy::new(GRID, true, true);
        let missed = feed(&mut autopsy, &traces, &samples);
        autopsy.finish(missed, last + WINDOW_TICKS);
        let section = autopsy.section();
        let [case] = &section.worst[..] else { panic!("{stage} for {ticks} ticks: {}", section.text()) };
        assert_eq!((case.tick, case.ticks, case.missed), (first, ticks, missed), "{stage}: {}", section.text());
        let shown: Vec<u64> = case.timeline.iter().map(|tick| tick.tick).collect();
        let ends = [first - 1, first, first + 1, first + 2, last - 1, last, last + 1, last + 2];
        assert_eq!(shown, ends, "both ends of the outage, and nothing of what lies between");
        let begin = |ns: u64| ns as f64 / 1e3 - GRID.begin_of(first) as f64 / 1e3;
        if stage == Role::Mixer && ticks > 10 {
            let inner = good(first)[Role::Inner as usize].unwrap();
            assert_eq!(case.due_us, begin(inner.send_ns), "the mixer was due when the inner loop had sent");
            let back = good(last + 1)[Role::Mixer as usize].unwrap();
            assert!((case.due_us + case.delay_us - begin(back.receive_ns)).abs() < 1.0, "{case:?}");
        }
        // Without the outer or the inner loop the mixer goes on, and no deadline is missed.
        let is_missed = matches!(stage, Role::Plant | Role::Mixer);
        assert_eq!(missed, if is_missed { ticks } else { 0 }, "{stage}");
        let is_stopped = (case.class, case.stage.as_deref()) == (Class::StoppedOrDead, Some(stage.name()));
        // 5 ticks begin and end between two looks.
        assert_eq!(is_stopped, ticks > 10, "{stage} for {ticks} ticks: {}", section.text());
        let longest = section.longest.unwrap();
        assert_eq!(longest[stage.name()], ticks, "{longest:?}");
        assert!(!longest.contains_key(MACHINE), "{longest:?}");
    }
}

#[test]
fn what_came_in_time_and_was_not_used_is_no_outage_of_its_sender_and_all_stages_out_are_the_machine() {
    let longest = |change: &dyn Fn(&mut TickPassages)| {
        let mut made = made();
        (MISSED..MISSED + 8).for_each(|tick| change(made.traces.get_mut(&tick).unwrap()));
        let mut autopsy = Autopsy::new(GRID, true, true);
        let missed = feed(&mut autopsy, &made.traces, &made.samples);
        autopsy.finish(missed, WINDOW_TICKS - 1);
        let section = autopsy.section();
        assert!(!section.classes.is_empty());
        (section.longest.unwrap(), section.classes[0].class)
    };
    let unused = |trace: &mut TickPassages| trace[Role::Mixer as usize].as_mut().unwrap().is_fresh = false;
    assert_eq!(longest(&unused), (BTreeMap::new(), Class::NotUsed));
    let (all, _) = longest(&|trace| *trace = TickPassages::default());
    assert_eq!(all.len(), 5, "{all:?}");
    assert!(all.values().all(|ticks| *ticks == 8), "{all:?}");
}

#[test]
fn an_outage_that_the_recorder_did_not_see_whole_is_measured_by_nobody() {
    let mut made = made();
    (MISSED..MISSED + 8).for_each(|tick| *made.traces.get_mut(&tick).unwrap() = TickPassages::default());
    let half = made.samples.len() / 2;
    made.samples[half..].iter_mut().for_each(|sample| sample.lost = 1);
    let mut autopsy = Autopsy::new(GRID, true, true);
    let missed = feed(&mut autopsy, &made.traces, &made.samples);
    autopsy.finish(missed, WINDOW_TICKS - 1);
    let section = autopsy.section();
    assert_eq!((section.longest, section.unmeasured), (Some(BTreeMap::new()), 1));
}

#[test]
fn an_end_of_the_flight_and_what_was_before_a_stage_began_are_no_outages() {
    let mut made = made();
    made.silence_of(Role::Inner, 0..3);
    made.silence_of(Role::Mixer, WINDOW_TICKS - 1..WINDOW_TICKS);
    let mut autopsy = Autopsy::new(GRID, true, true);
    assert_eq!(feed(&mut autopsy, &made.traces, &made.samples), 0);
    autopsy.finish(0, WINDOW_TICKS - 1);
    let none = report::autopsy::section::Section { longest: Some(BTreeMap::new()), ..Default::default() };
    assert_eq!(autopsy.section(), none);
}

/// A stage that dies in the last tick, and ends the run with it, before any sample shows it.
#[test]
fn whoever_ends_the_run_by_its_death_is_named() {
    let made = made();
    let mut autopsy = Autopsy::new(GRID, true, true);
    made.samples.iter().filter(|sample| sample.at_ns < GRID.begin_of(MISSED)).for_each(|s| autopsy.sample(*s));
    for (tick, trace) in made.traces.range(..=MISSED) {
        let stamps = trace.map(|passage| passage.map(|it| Stamps { receive_ns: it.receive_ns, send_ns: it.send_ns }));
        let envelope = |role: Role| {
            let mut envelope = Envelope { tick: *tick, input_tick: [*tick; 3], ..Envelope::new() };
            envelope.stamps[role as usize] = stamps[role as usize].unwrap();
            envelope
        };
        autopsy.state(&Message { envelope: envelope(Role::Plant), content: State::default() });
        autopsy.stamps(&Message { envelope: envelope(Role::Outer), content: Setpoint::default() });
        autopsy.stamps(&Message { envelope: envelope(Role::Inner), content: Wrench::default() });
        if *tick < MISSED {
            autopsy.stamps(&Message { envelope: envelope(Role::Mixer), content: RotorSpeeds::default() });
        }
    }
    let (mut with, mut without) = (autopsy.clone(), autopsy);
    with.fallen([false, false, false, true], GRID.begin_of(MISSED + 4));
    with.finish(1, MISSED + 1);
    let of = |autopsy: &Autopsy| {
        let section = autopsy.section();
        section.classes.iter().map(|it| (it.class, it.stage.clone(), it.missed)).collect::<Vec<_>>()
    };
    assert_eq!(of(&with), [(Class::StoppedOrDead, Some("mixer".into()), 1)]);
    without.fallen([false; 4], GRID.begin_of(MISSED + 4));
    without.finish(1, MISSED + 1);
    assert!(of(&without).iter().all(|(class, ..)| *class != Class::StoppedOrDead), "{:?}", of(&without));
}
