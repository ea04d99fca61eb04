//! Root causes of missed deadlines, each from synthetic evidence.

use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::grid::Grid;
use messages::header::{Header, Message, Stamps};
use messages::role::{Role, STAGES};
use report::candidate_causes::Outage;
use report::candidate_causes::{
    CounterSample, Counters, Life, StageTiming, TickTimings, TimingWindow,
};
use report::miss_analysis::{AROUND_TICKS, MissAnalysis};
use report::miss_causes::{MissCause, classify};
use report::processor_trace::{Runner, Slice};
use report::schema::MACHINE;
use std::collections::BTreeMap;

#[track_caller]
fn assert_class(
    what: &str,
    change: impl Fn(&mut Made),
    class: MissCause,
    stage: Option<Role>,
    words: &str,
) {
    let mut made = made();
    change(&mut made);
    let (found, due_to, evidence) = made.class();
    assert_eq!((found, due_to), (class, stage), "{what}: {evidence}");
    assert!(
        evidence.contains(words),
        "{what}: no `{words}` in `{evidence}`"
    );
}

#[test]
fn when_everybody_is_late_together_the_processor_stalled() {
    assert_class(
        "stall",
        stall,
        MissCause::ProcessorStalled,
        None,
        "although others were due",
    );
    let in_the_chain = |made: &mut Made| {
        // Frozen after the inner loop has sent, for 1.6 ms; the plant's next tick begins late, too.
        made.delays(MISSED, Role::Mixer, 1_600);
        made.delays(MISSED + 1, Role::Plant, 640);
    };
    assert_class(
        "stall in the chain",
        in_the_chain,
        MissCause::ProcessorStalled,
        None,
        "mixer woke 1600 us later",
    );
    let in_a_law = |made: &mut Made| {
        made.computes(MISSED, Role::Inner, 1_600);
        made.delays(MISSED + 1, Role::Plant, 640);
    };
    assert_class(
        "stall in a law",
        in_a_law,
        MissCause::ProcessorStalled,
        None,
        "inner computed 1600 us longer",
    );
    let somebody_ran = |made: &mut Made| {
        long_stall(made);
        made.samples[5..]
            .iter_mut()
            .for_each(|sample| sample.busy = 2);
    };
    assert_class(
        "somebody ran",
        somebody_ran,
        MissCause::CannotTell,
        None,
        "the processor was busy",
    );
}

/// Nobody publishes anything for 20 ticks.
fn long_stall(made: &mut Made) {
    made.silence(MISSED..MISSED + 20);
    made.delays(MISSED + 20, Role::Plant, 100);
}

#[test]
fn when_the_host_took_half_of_the_time_it_is_the_host() {
    let short = |made: &mut Made| {
        // Too short for anybody else to have been due.
        made.delays(MISSED, Role::Plant, 930);
        made.delays(MISSED + 1, Role::Plant, 60);
    };
    assert_class(
        "short",
        short,
        MissCause::CannotTell,
        None,
        "nothing else was due to show it",
    );
    let takes = |made: &mut Made, jiffies: u64| {
        long_stall(made);
        made.samples[5..]
            .iter_mut()
            .for_each(|sample| sample.stolen = jiffies);
    };
    assert_class(
        "half of 20 ms",
        |made| takes(made, 2),
        MissCause::HostStall,
        None,
        "the host took 20 ms",
    );
    // A jiffy by chance is a third of it.
    let chance = |made: &mut Made| {
        made.silence(MISSED..MISSED + 30);
        made.delays(MISSED + 30, Role::Plant, 100);
        made.samples[5..]
            .iter_mut()
            .for_each(|sample| sample.stolen = 1);
    };
    assert_class(
        "a jiffy by chance",
        chance,
        MissCause::ProcessorStalled,
        None,
        "no stage ran",
    );
    // Of another processor, for all that is known.
    let apart = |made: &mut Made| {
        takes(made, 2);
        made.share_processor = false;
    };
    assert_class(
        "apart",
        apart,
        MissCause::CannotTell,
        None,
        "do not share a processor",
    );
    // What was ready to run and had no processor had none because the host had it.
    let ready = |made: &mut Made| {
        takes(made, 2);
        made.counts_from(5, Role::Plant, |counters| counters.waited_ns += 20_000 * US);
    };
    assert_class(
        "ready",
        ready,
        MissCause::HostStall,
        None,
        "the host took 20 ms",
    );
    let on_hardware = |made: &mut Made| {
        short(made);
        made.is_virtual = false;
    };
    assert_class(
        "hardware",
        on_hardware,
        MissCause::WakeLate,
        Some(Role::Plant),
        "plant woke 930 us later",
    );
}

#[test]
fn a_stage_that_is_late_while_others_run_was_woken_late() {
    let late = |made: &mut Made| made.delays(MISSED, Role::Mixer, 1_500);
    assert_class(
        "mixer",
        late,
        MissCause::WakeLate,
        Some(Role::Mixer),
        "others ran meanwhile",
    );
    // On processors of their own, one stage's life says nothing of another's.
    let apart = |made: &mut Made| {
        late(made);
        made.share_processor = false;
    };
    assert_class(
        "apart",
        apart,
        MissCause::CannotTell,
        None,
        "do not share a processor",
    );
}

#[test]
fn a_stage_that_computes_long_while_others_run_or_again_and_again_is_named() {
    // Woken by its own timer, the mixer of the higher priority works in between.
    let once = |made: &mut Made| {
        made.computes(MISSED, Role::Inner, 1_600);
        *made.stage(MISSED, Role::Mixer) = StageTiming {
            receive_ns: GRID.begin_of(MISSED) + 900 * US,
            send_ns: GRID.begin_of(MISSED + 1) + US,
            is_fresh: false,
        };
    };
    assert_class(
        "once",
        once,
        MissCause::ComputedLong,
        Some(Role::Inner),
        "others ran meanwhile",
    );
    let often = |made: &mut Made| {
        for tick in [MISSED - 10, MISSED, MISSED + 7] {
            made.computes(tick, Role::Mixer, 960);
        }
    };
    assert_class(
        "often",
        often,
        MissCause::ComputedLong,
        Some(Role::Mixer),
        "in other ticks around",
    );
    let hardware = |made: &mut Made| {
        made.computes(MISSED, Role::Mixer, 1_960);
        made.delays(MISSED + 1, Role::Plant, 1_000);
        made.is_virtual = false;
    };
    assert_class(
        "on hardware",
        hardware,
        MissCause::ProcessorStalled,
        None,
        "no stage ran",
    );
    // With the highest priority nobody else can run meanwhile: what the kernel counts for it tells.
    let ran = |made: &mut Made| {
        hardware(made);
        made.counts_from(4, Role::Mixer, |counters| counters.ran_ns += 1_900 * US);
    };
    assert_class(
        "ran",
        ran,
        MissCause::ComputedLong,
        Some(Role::Mixer),
        "it ran for",
    );
}

#[test]
fn a_stage_that_always_takes_longer_than_a_tick_is_at_work_and_not_woken_late() {
    let always = |made: &mut Made| {
        for tick in 0..WINDOW_TICKS {
            let begin = GRID.begin_of(tick);
            let inner = StageTiming {
                receive_ns: begin + 50 * US,
                send_ns: begin + 2_450 * US,
                is_fresh: true,
            };
            let passages = made.traces.get_mut(&tick).unwrap();
            passages[Role::Inner as usize] = (tick % 3 == 0).then_some(inner);
            passages[Role::Mixer as usize] = Some(StageTiming {
                receive_ns: begin + 900 * US,
                send_ns: begin + 905 * US,
                is_fresh: false,
            });
        }
    };
    assert_class(
        "always",
        always,
        MissCause::ComputedLong,
        Some(Role::Inner),
        "inner was at work for",
    );
    // Under real-time scheduling the plant, which is less urgent, does not get the processor meanwhile.
    let instead = |made: &mut Made| {
        always(made);
        for tick in (0..WINDOW_TICKS).filter(|tick| tick % 3 != 0) {
            made.traces.remove(&tick);
        }
    };
    assert_class(
        "instead",
        instead,
        MissCause::ComputedLong,
        Some(Role::Inner),
        "inner was at work for",
    );
}

#[test]
fn a_stage_that_waits_for_a_message_that_was_sent_in_time_names_the_one_it_waits_for() {
    // The mixer did not take the wrench (it rejected it, say), waited until 90 % and was a little late itself.
    let unused = |made: &mut Made| {
        let begin = GRID.begin_of(MISSED);
        *made.stage(MISSED, Role::Mixer) = StageTiming {
            receive_ns: begin + 990 * US,
            send_ns: begin + 1_010 * US,
            is_fresh: false,
        };
    };
    assert_class(
        "unused",
        unused,
        MissCause::NotUsed,
        Some(Role::Inner),
        "what inner had sent in time was waited for",
    );
}

#[test]
fn what_the_kernel_counts_for_the_late_stage_goes_before_what_it_looks_like() {
    let late = |made: &mut Made| made.delays(MISSED, Role::Mixer, 1_500);
    let faults = |made: &mut Made| {
        late(made);
        made.counts_from(4, Role::Mixer, |counters| counters.faults += 3);
    };
    assert_class(
        "faults",
        faults,
        MissCause::PageFault,
        Some(Role::Mixer),
        "3 page faults",
    );
    let faults_of_another = |made: &mut Made| {
        late(made);
        made.counts_from(4, Role::Outer, |counters| counters.faults += 3);
    };
    assert_class(
        "faults of another",
        faults_of_another,
        MissCause::WakeLate,
        Some(Role::Mixer),
        "others ran",
    );
    let faults_before = |made: &mut Made| {
        late(made);
        made.counts_from(2, Role::Mixer, |counters| counters.faults += 3);
    };
    assert_class(
        "faults before",
        faults_before,
        MissCause::WakeLate,
        Some(Role::Mixer),
        "others ran",
    );
    let preempted = |made: &mut Made| {
        stall(made);
        made.counts_from(4, Role::Plant, |counters| {
            counters.waited_ns += 2_000 * US;
            counters.involuntary_switches += 1;
        });
    };
    assert_class(
        "preempted",
        preempted,
        MissCause::Preempted,
        Some(Role::Plant),
        "2000 us without the processor, 1 involuntary",
    );
    let by_nobody = |made: &mut Made| {
        stall(made);
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 2_000 * US);
    };
    assert_class(
        "by nobody",
        by_nobody,
        MissCause::ReadyNotRun,
        Some(Role::Plant),
        "nobody was seen to run",
    );
    let by_somebody = |made: &mut Made| {
        by_nobody(made);
        made.samples[4..]
            .iter_mut()
            .for_each(|sample| sample.busy = 1);
    };
    let on_hardware = |made: &mut Made| {
        by_somebody(made);
        made.is_virtual = false;
    };
    assert_class(
        "by somebody",
        on_hardware,
        MissCause::Preempted,
        Some(Role::Plant),
        "which was busy for 10 ms",
    );
    // Where the host stops a virtual machine, whoever was on its processor seems to run.
    assert_class(
        "there",
        by_somebody,
        MissCause::ReadyNotRun,
        Some(Role::Plant),
        "nobody was seen to run",
    );
    // Two thirds of the ticks are as bad: what is usual is what the good ones show.
    let all_the_time = |made: &mut Made| {
        stall(made);
        for i in [0, 1, 3, 4, 6] {
            made.counts_from(i + 1, Role::Plant, |counters| {
                counters.waited_ns += 5_000 * US
            });
        }
    };
    assert_class(
        "all the time",
        all_the_time,
        MissCause::ReadyNotRun,
        Some(Role::Plant),
        "without the processor",
    );
    // The mixer got the processor back with the plant, too late for its tick, and found no input in the next one.
    let skipped_on = |made: &mut Made| {
        stall(made);
        made.silence_of(Role::Mixer, MISSED + 2..MISSED + 4);
        made.stage(MISSED + 2, Role::Inner).send_ns += 1_000 * US;
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 2_300 * US);
    };
    assert_class(
        "skipped on",
        skipped_on,
        MissCause::ReadyNotRun,
        Some(Role::Plant),
        "plant woke 2100 us later",
    );
    let waited_little = |made: &mut Made| {
        stall(made);
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 400 * US);
    };
    assert_class(
        "waited little",
        waited_little,
        MissCause::ProcessorStalled,
        None,
        "although others were due",
    );
}

#[test]
fn a_stage_that_was_stopped_or_has_ended_is_named() {
    let stopped = |made: &mut Made| {
        made.silence_of(Role::Mixer, MISSED..MISSED + 20);
        made.samples[4].stages[Role::Mixer as usize].life = Life::Stopped;
    };
    assert_class(
        "stopped",
        stopped,
        MissCause::StoppedOrDead,
        Some(Role::Mixer),
        "its process was stopped",
    );
    let dead = |made: &mut Made| {
        made.silence_of(Role::Mixer, MISSED..WINDOW_TICKS);
        made.counts_from(4, Role::Mixer, |counters| counters.life = Life::Dead);
    };
    assert_class(
        "dead",
        dead,
        MissCause::StoppedOrDead,
        Some(Role::Mixer),
        "its process has ended",
    );
    let replaced = |made: &mut Made| {
        made.silence_of(Role::Mixer, MISSED..MISSED + 20);
        made.counts_from(5, Role::Mixer, |counters| {
            *counters = Counters {
                pid: 900,
                ..Counters::default()
            }
        });
    };
    assert_class(
        "replaced",
        replaced,
        MissCause::StoppedOrDead,
        Some(Role::Mixer),
        "its process has ended",
    );
    assert_class(
        "replaced",
        replaced,
        MissCause::StoppedOrDead,
        Some(Role::Mixer),
        ", and process 900 took its place",
    );
    let killed_as_it_hung = |made: &mut Made| {
        replaced(made);
        made.samples[4].stages[Role::Mixer as usize].life = Life::Stopped;
    };
    let why = "its process was stopped and has ended, and process 900 took its place";
    assert_class(
        "hung",
        killed_as_it_hung,
        MissCause::StoppedOrDead,
        Some(Role::Mixer),
        why,
    );
    // The mixer worked at its cut-off and was late by a little; what it waited for had been stopped.
    let upstream = |made: &mut Made| {
        made.silence_of(Role::Inner, MISSED..MISSED + 20);
        let begin = GRID.begin_of(MISSED);
        *made.stage(MISSED, Role::Mixer) = StageTiming {
            receive_ns: begin + 1_050 * US,
            send_ns: begin + 1_060 * US,
            is_fresh: false,
        };
        made.samples[4].stages[Role::Inner as usize].life = Life::Stopped;
    };
    assert_class(
        "upstream",
        upstream,
        MissCause::StoppedOrDead,
        Some(Role::Inner),
        "its process was stopped",
    );
    // An outage is due to what most of it is due to, not to what it began with.
    let begun_by_another = |made: &mut Made| {
        made.delays(MISSED, Role::Plant, 700);
        made.delays(MISSED + 1, Role::Plant, 600);
        made.silence_of(Role::Mixer, MISSED..MISSED + 20);
        made.samples[4].stages[Role::Mixer as usize].life = Life::Stopped;
    };
    assert_class(
        "begun",
        begun_by_another,
        MissCause::StoppedOrDead,
        Some(Role::Mixer),
        "its process was stopped",
    );
}

#[test]
fn a_trace_shows_who_ran_instead() {
    let hog = |pid: u64, priority: u64| Runner::Thread {
        pid,
        priority,
        name: "hog".into(),
    };
    let before_ns = GRID.begin_of(MISSED - 10);
    let from_ns = GRID.begin_of(MISSED);
    let to_ns = from_ns + 1_820 * US;
    let late = |made: &mut Made, slices: Vec<Slice>| {
        made.silence(MISSED..MISSED + 1);
        made.delays(MISSED + 1, Role::Plant, 800);
        made.slices = slices;
    };
    let hogged = |made: &mut Made| {
        let idle = Slice {
            from_ns,
            to_ns: from_ns + 200 * US,
            runner: Runner::Idle,
        };
        let plant = Slice {
            from_ns: before_ns,
            to_ns: before_ns + US,
            runner: hog(100, 19),
        };
        late(
            made,
            vec![
                plant,
                idle,
                Slice {
                    from_ns: from_ns + 200 * US,
                    to_ns,
                    runner: hog(4711, 0),
                },
            ],
        );
    };
    let words = "interrupts, or a thread at least as urgent, had the processor; meanwhile ran hog (4711) 1620 us, idle 200 us";
    assert_class(
        "hogged",
        hogged,
        MissCause::Preempted,
        Some(Role::Plant),
        words,
    );
    // The plant itself, nobody, or who is less urgent than the plant: that kept nobody from the processor.
    for runner in [hog(100, 19), Runner::Idle, hog(4711, 120)] {
        let mut made = made();
        let plant = Slice {
            from_ns: before_ns,
            to_ns: before_ns + US,
            runner: hog(100, 19),
        };
        late(
            &mut made,
            vec![
                plant,
                Slice {
                    from_ns,
                    to_ns,
                    runner,
                },
            ],
        );
        let (class, _, evidence) = made.class();
        assert_ne!(class, MissCause::Preempted, "{evidence}");
        assert!(
            evidence.contains("no stage ran, although others were due; meanwhile ran"),
            "{evidence}"
        );
    }
    let interrupted = |made: &mut Made| {
        let timer = Runner::Interrupt {
            name: "softirq TIMER".into(),
        };
        let plant = Slice {
            from_ns: before_ns,
            to_ns: before_ns + US,
            runner: hog(100, 19),
        };
        let idle = Slice {
            from_ns,
            to_ns,
            runner: Runner::Idle,
        };
        late(
            made,
            vec![
                plant,
                idle,
                Slice {
                    from_ns,
                    to_ns,
                    runner: timer,
                },
            ],
        );
    };
    let words = "interrupts, or a thread at least as urgent, had the processor; meanwhile ran";
    assert_class(
        "interrupted",
        interrupted,
        MissCause::Preempted,
        Some(Role::Plant),
        words,
    );
}

#[test]
fn an_outage_of_many_delays_is_due_to_whose_they_mostly_are() {
    let slow = |made: &mut Made| {
        for tick in MISSED..MISSED + 20 {
            made.computes(tick, Role::Inner, if tick % 2 == 0 { 1_100 } else { 1_200 });
            // Its output is of no use to the mixer, which waited until its cut-off and is in time.
            let begin = GRID.begin_of(tick);
            *made.stage(tick, Role::Mixer) = StageTiming {
                receive_ns: begin + 860 * US,
                send_ns: begin + 865 * US,
                is_fresh: false,
            };
        }
        made.delays(MISSED + 3, Role::Plant, 300);
    };
    assert_class(
        "slow",
        slow,
        MissCause::ComputedLong,
        Some(Role::Inner),
        "in the longest of 20 delays",
    );
}

#[test]
fn what_the_evidence_does_not_decide_is_not_decided() {
    let lost = |made: &mut Made| {
        stall(made);
        made.samples[5..]
            .iter_mut()
            .for_each(|sample| sample.lost = 1);
    };
    assert_class("lost", lost, MissCause::CannotTell, None, "lost messages");
    let several = |made: &mut Made| {
        for role in [Role::Plant, Role::Outer, Role::Inner, Role::Mixer] {
            made.delays(MISSED, role, 240);
        }
    };
    assert_class(
        "several",
        several,
        MissCause::CannotTell,
        None,
        "none accounts for most",
    );
    assert_class(
        "nothing",
        |_| {},
        MissCause::CannotTell,
        None,
        "no stage was later than usual",
    );
}

/// Feeds an autopsy as the recorder does, with samples in between; gives the deadlines missed before the last state.
fn feed(
    autopsy: &mut MissAnalysis,
    traces: &BTreeMap<u64, TickTimings>,
    samples: &[CounterSample],
) -> u64 {
    let mut samples = samples.iter().peekable();
    let mut missed = 0;
    let mut judged = 0;
    for (tick, trace) in traces {
        while let Some(sample) = samples.next_if(|sample| sample.at_ns <= GRID.begin_of(*tick)) {
            autopsy.sample(*sample);
        }
        let envelope = |role: Role| {
            let passage = trace[role as usize]?;
            let input = if passage.is_fresh {
                *tick
            } else {
                tick.saturating_sub(1)
            };
            let mut envelope = Header {
                tick: *tick,
                input_tick: [input; 3],
                ..Header::new()
            };
            envelope.stamps[role as usize] = Stamps {
                receive_ns: passage.receive_ns,
                send_ns: passage.send_ns,
            };
            Some(envelope)
        };
        if let Some(plant) = envelope(Role::Plant) {
            let mut row = 0;
            // At the beginning of each tick since its last state, the plant looks for the command of the tick before.
            for begun in judged + 1..=*tick {
                let sent_ns = traces
                    .get(&(begun - 1))
                    .and_then(|trace| trace[Role::Mixer as usize])
                    .map(|it| it.send_ns);
                row = if sent_ns.is_some_and(|ns| ns <= GRID.begin_of(begun)) {
                    0
                } else {
                    row + 1
                };
                missed += u64::from(row > 0);
            }
            judged = *tick;
            let content = State {
                deadlines_missed: missed,
                deadline_miss_run: row,
                ..State::default()
            };
            autopsy.state(&Message {
                envelope: plant,
                content,
            });
        }
        if let Some(envelope) = envelope(Role::Outer) {
            autopsy.stamps(&Message {
                envelope,
                content: Setpoint::default(),
            });
        }
        if let Some(envelope) = envelope(Role::Inner) {
            autopsy.stamps(&Message {
                envelope,
                content: Wrench::default(),
            });
        }
        if let Some(envelope) = envelope(Role::Mixer) {
            autopsy.stamps(&Message {
                envelope,
                content: RotorSpeeds::default(),
            });
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
    let mut autopsy = MissAnalysis::new(GRID, true, true);
    let missed = feed(&mut autopsy, &made.traces, &made.samples);
    assert_eq!(
        (missed, autopsy.section().pending),
        (2, 2),
        "they wait for the ticks after them"
    );
    autopsy.finish(missed + 1, WINDOW_TICKS);
    let section = autopsy.section();
    assert_eq!(
        section
            .classes
            .iter()
            .map(|class| class.missed)
            .sum::<u64>(),
        missed + 1
    );
    let outages: Vec<_> = section
        .worst
        .iter()
        .map(|case| (case.tick, case.ticks, case.missed))
        .collect();
    assert_eq!(outages, [(MISSED, 2, 2), (WINDOW_TICKS - 1, 1, 1)]);
    assert_eq!(section.worst[0].class, MissCause::ProcessorStalled);
    // From the beginning of the first tick to the plant's waking, 120 us after that of the third.
    assert!(
        (section.worst[0].delay_us - 2_120.0).abs() < 1e-6,
        "{:?}",
        section.worst[0]
    );
    let worked: Vec<_> = section.worst[0]
        .timeline
        .iter()
        .map(|tick| (tick.tick, tick.stages.len()))
        .collect();
    let expected = [
        (MISSED - 1, 4),
        (MISSED, 0),
        (MISSED + 1, 0),
        (MISSED + 2, 4),
        (MISSED + 3, 4),
    ];
    assert_eq!(worked, expected, "also the ticks in which nobody published");
    let text = section.text();
    let line = format!(
        "tick {MISSED} (0.032 s): 2 ticks, 2 missed, a delay of 2120 us: processor stalled ("
    );
    assert!(text.contains(&line), "{text}");
}

/// Ticks of a flight in which a stage is stopped for a time, as the other stages fly on.
fn stopped(stage: Role, ticks: std::ops::Range<u64>, until: u64) -> BTreeMap<u64, TickTimings> {
    let mut traces: BTreeMap<u64, TickTimings> =
        (0..until).map(|tick| (tick, good(tick))).collect();
    for tick in ticks {
        let begin_ns = GRID.begin_of(tick);
        let at_cut_off = |role: Role, is_fresh: bool| {
            let receive_ns = begin_ns + T * role.deadline_percent() / 100 + 10 * US;
            Some(StageTiming {
                receive_ns,
                send_ns: receive_ns + 5 * US,
                is_fresh,
            })
        };
        let [plant, outer, inner, mixer] = good(tick);
        traces.insert(
            tick,
            match stage {
                // Without a state the outer loop publishes nothing, and the inner one what it held.
                // The mixer's command comes too late, as the plant finds out when it is back.
                Role::Plant => {
                    let late = StageTiming {
                        receive_ns: begin_ns + T,
                        send_ns: begin_ns + T + 10 * US,
                        is_fresh: true,
                    };
                    [None, None, at_cut_off(Role::Inner, false), Some(late)]
                }
                Role::Outer => [
                    plant,
                    None,
                    at_cut_off(Role::Inner, false),
                    at_cut_off(Role::Mixer, true),
                ],
                Role::Inner => [plant, outer, None, at_cut_off(Role::Mixer, false)],
                _ => [plant, outer, inner, mixer.filter(|_| false)],
            },
        );
    }
    traces
}

#[test]
fn a_stop_of_any_length_is_one_outage_with_all_its_ticks() {
    for (stage, ticks) in STAGES
        .into_iter()
        .flat_map(|stage| [5, 100, 3000].map(|ticks| (stage, ticks)))
    {
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
        let mut autopsy = MissAnalysis::new(GRID, true, true);
        let missed = feed(&mut autopsy, &traces, &samples);
        autopsy.finish(missed, last + WINDOW_TICKS);
        let section = autopsy.section();
        let [case] = &section.worst[..] else {
            panic!("{stage} for {ticks} ticks: {}", section.text())
        };
        assert_eq!(
            (case.tick, case.ticks, case.missed),
            (first, ticks, missed),
            "{stage}: {}",
            section.text()
        );
        let shown: Vec<u64> = case.timeline.iter().map(|tick| tick.tick).collect();
        let ends = [
            first - 1,
            first,
            first + 1,
            first + 2,
            last - 1,
            last,
            last + 1,
            last + 2,
        ];
        assert_eq!(
            shown, ends,
            "both ends of the outage, and nothing of what lies between"
        );
        let begin = |ns: u64| ns as f64 / 1e3 - GRID.begin_of(first) as f64 / 1e3;
        if stage == Role::Mixer && ticks > 10 {
            let inner = good(first)[Role::Inner as usize].unwrap();
            assert_eq!(
                case.due_us,
                begin(inner.send_ns),
                "the mixer was due when the inner loop had sent"
            );
            let back = good(last + 1)[Role::Mixer as usize].unwrap();
            assert!(
                (case.due_us + case.delay_us - begin(back.receive_ns)).abs() < 1.0,
                "{case:?}"
            );
        }
        // Without the outer or the inner loop the mixer goes on, and no deadline is missed.
        let is_missed = matches!(stage, Role::Plant | Role::Mixer);
        assert_eq!(missed, if is_missed { ticks } else { 0 }, "{stage}");
        let is_stopped =
            (case.class, case.stage.as_deref()) == (MissCause::StoppedOrDead, Some(stage.name()));
        // 5 ticks begin and end between two looks.
        assert_eq!(
            is_stopped,
            ticks > 10,
            "{stage} for {ticks} ticks: {}",
            section.text()
        );
        let longest = section.longest.unwrap();
        assert_eq!(longest[stage.name()], ticks, "{longest:?}");
        assert!(!longest.contains_key(MACHINE), "{longest:?}");
    }
}

#[test]
fn what_came_in_time_and_was_not_used_is_no_outage_of_its_sender_and_all_stages_out_are_the_machine()
 {
    let longest = |change: &dyn Fn(&mut TickTimings)| {
        let mut made = made();
        (MISSED..MISSED + 8).for_each(|tick| change(made.traces.get_mut(&tick).unwrap()));
        let mut autopsy = MissAnalysis::new(GRID, true, true);
        let missed = feed(&mut autopsy, &made.traces, &made.samples);
        autopsy.finish(missed, WINDOW_TICKS - 1);
        let section = autopsy.section();
        assert!(!section.classes.is_empty());
        (section.longest.unwrap(), section.classes[0].class)
    };
    let unused =
        |trace: &mut TickTimings| trace[Role::Mixer as usize].as_mut().unwrap().is_fresh = false;
    assert_eq!(longest(&unused), (BTreeMap::new(), MissCause::NotUsed));
    let (all, _) = longest(&|trace| *trace = TickTimings::default());
    assert_eq!(all.len(), 5, "{all:?}");
    assert!(all.values().all(|ticks| *ticks == 8), "{all:?}");
}

#[test]
fn an_outage_that_the_recorder_did_not_see_whole_is_measured_by_nobody() {
    let mut made = made();
    (MISSED..MISSED + 8)
        .for_each(|tick| *made.traces.get_mut(&tick).unwrap() = TickTimings::default());
    let half = made.samples.len() / 2;
    made.samples[half..]
        .iter_mut()
        .for_each(|sample| sample.lost = 1);
    let mut autopsy = MissAnalysis::new(GRID, true, true);
    let missed = feed(&mut autopsy, &made.traces, &made.samples);
    autopsy.finish(missed, WINDOW_TICKS - 1);
    let section = autopsy.section();
    assert_eq!(
        (section.longest, section.unmeasured),
        (Some(BTreeMap::new()), 1)
    );
}

#[test]
fn an_end_of_the_flight_and_what_was_before_a_stage_began_are_no_outages() {
    let mut made = made();
    made.silence_of(Role::Inner, 0..3);
    made.silence_of(Role::Mixer, WINDOW_TICKS - 1..WINDOW_TICKS);
    let mut autopsy = MissAnalysis::new(GRID, true, true);
    assert_eq!(feed(&mut autopsy, &made.traces, &made.samples), 0);
    autopsy.finish(0, WINDOW_TICKS - 1);
    let none = report::outages::OutageSection {
        longest: Some(BTreeMap::new()),
        ..Default::default()
    };
    assert_eq!(autopsy.section(), none);
}

/// A stage that dies in the last tick, and ends the run with it, before any sample shows it.
#[test]
fn whoever_ends_the_run_by_its_death_is_named() {
    let made = made();
    let mut autopsy = MissAnalysis::new(GRID, true, true);
    made.samples
        .iter()
        .filter(|sample| sample.at_ns < GRID.begin_of(MISSED))
        .for_each(|s| autopsy.sample(*s));
    for (tick, trace) in made.traces.range(..=MISSED) {
        let stamps = trace.map(|passage| {
            passage.map(|it| Stamps {
                receive_ns: it.receive_ns,
                send_ns: it.send_ns,
            })
        });
        let envelope = |role: Role| {
            let mut envelope = Header {
                tick: *tick,
                input_tick: [*tick; 3],
                ..Header::new()
            };
            envelope.stamps[role as usize] = stamps[role as usize].unwrap();
            envelope
        };
        autopsy.state(&Message {
            envelope: envelope(Role::Plant),
            content: State::default(),
        });
        autopsy.stamps(&Message {
            envelope: envelope(Role::Outer),
            content: Setpoint::default(),
        });
        autopsy.stamps(&Message {
            envelope: envelope(Role::Inner),
            content: Wrench::default(),
        });
        if *tick < MISSED {
            autopsy.stamps(&Message {
                envelope: envelope(Role::Mixer),
                content: RotorSpeeds::default(),
            });
        }
    }
    let (mut with, mut without) = (autopsy.clone(), autopsy);
    with.fallen([false, false, false, true], GRID.begin_of(MISSED + 4));
    with.finish(1, MISSED + 1);
    let of = |autopsy: &MissAnalysis| {
        let section = autopsy.section();
        section
            .classes
            .iter()
            .map(|it| (it.class, it.stage.clone(), it.missed))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        of(&with),
        [(MissCause::StoppedOrDead, Some("mixer".into()), 1)]
    );
    without.fallen([false; 4], GRID.begin_of(MISSED + 4));
    without.finish(1, MISSED + 1);
    assert!(
        of(&without)
            .iter()
            .all(|(class, ..)| *class != MissCause::StoppedOrDead),
        "{:?}",
        of(&without)
    );
}

pub const T: u64 = 1_000_000;
pub const GRID: Grid = Grid {
    t0_ns: 50 * T,
    period_ns: T,
};
/// The tick that is missed in every case.
pub const MISSED: u64 = 32;
pub const US: u64 = 1_000;
pub const WINDOW_TICKS: u64 = 2 * AROUND_TICKS;

/// What surrounds a miss: 64 ticks of a good flight, and samples each 10 ms, with what a case changes.
pub struct Made {
    pub traces: BTreeMap<u64, TickTimings>,
    pub samples: Vec<CounterSample>,
    pub slices: Vec<Slice>,
    pub is_virtual: bool,
    pub share_processor: bool,
}

/// A good tick: each stage wakes 10 us after the one before has sent, and computes for 5 us.
pub fn good(tick: u64) -> TickTimings {
    let begin = GRID.begin_of(tick);
    let at = |us: u64| StageTiming {
        receive_ns: begin + us * US,
        send_ns: begin + (us + 5) * US,
        is_fresh: true,
    };
    [Some(at(20)), Some(at(35)), Some(at(50)), Some(at(65))]
}

pub fn made() -> Made {
    let stages: [Counters; 4] = std::array::from_fn(|i| Counters {
        pid: 100 + i as u64,
        ..Counters::default()
    });
    let sample = |i: u64| {
        // A loop waits for others on its processor in every tick: 30 us, and is switched out once.
        let stages = stages.map(|it| Counters {
            waited_ns: i * 300 * US,
            ran_ns: i * 50 * US,
            involuntary_switches: 10 * i,
            ..it
        });
        CounterSample {
            at_ns: GRID.begin_of(0) + i * 10 * T,
            stages,
            ..CounterSample::default()
        }
    };
    Made {
        traces: (0..WINDOW_TICKS).map(|tick| (tick, good(tick))).collect(),
        samples: (0..=7).map(sample).collect(),
        slices: Vec::new(),
        is_virtual: true,
        share_processor: true,
    }
}

impl Made {
    pub fn stage(&mut self, tick: u64, role: Role) -> &mut StageTiming {
        self.traces.get_mut(&tick).unwrap()[role as usize]
            .as_mut()
            .unwrap()
    }

    /// The stage is later by `us` in a tick, from waking on, and so is the rest of the chain.
    pub fn delays(&mut self, tick: u64, role: Role, us: u64) {
        for later in role as usize..4 {
            let passage = self.traces.get_mut(&tick).unwrap()[later].as_mut().unwrap();
            passage.receive_ns += us * US;
            passage.send_ns += us * US;
        }
    }

    /// The stage computes longer by `us` in a tick, and the rest of the chain is later.
    pub fn computes(&mut self, tick: u64, role: Role, us: u64) {
        self.stage(tick, role).send_ns += us * US;
        if role != Role::Mixer {
            let next = [Role::Outer, Role::Inner, Role::Mixer][role as usize];
            self.delays(tick, next, us);
        }
    }

    /// Nobody publishes anything in these ticks.
    pub fn silence(&mut self, ticks: std::ops::Range<u64>) {
        ticks.for_each(|tick| {
            self.traces.remove(&tick);
        });
    }

    pub fn silence_of(&mut self, role: Role, ticks: std::ops::Range<u64>) {
        ticks.for_each(|tick| self.traces.get_mut(&tick).unwrap()[role as usize] = None);
    }

    /// Counts from a sample on: the fourth is the first one after the missed tick's begin.
    pub fn counts_from(&mut self, sample: usize, role: Role, count: impl Fn(&mut Counters)) {
        self.samples[sample..]
            .iter_mut()
            .for_each(|sample| count(&mut sample.stages[role as usize]));
    }

    pub fn class(&self) -> (MissCause, Option<Role>, String) {
        let stamps = self
            .traces
            .values()
            .flatten()
            .flatten()
            .map(|passage| passage.send_ns);
        let is_whole = |tick: &u64| {
            self.traces
                .get(tick)
                .is_some_and(|trace| trace.iter().all(|it| it.is_some_and(|it| it.is_fresh)))
        };
        let last = (MISSED..WINDOW_TICKS)
            .take_while(|tick| *tick == MISSED || !is_whole(tick))
            .last()
            .unwrap();
        let scene = TimingWindow {
            grid: GRID,
            outage: Outage {
                first: MISSED,
                last,
                missed: 1,
            },
            traces: &self.traces,
            samples: &self.samples,
            slices: &self.slices,
            until_ns: stamps.max().unwrap(),
            is_virtual: self.is_virtual,
            share_processor: self.share_processor,
        };
        let opinion = classify(&scene);
        (opinion.class, opinion.stage, opinion.evidence)
    }
}

/// The plant wakes 2.1 ms late, and everybody else with it: two ticks are left out.
pub fn stall(made: &mut Made) {
    made.silence(MISSED..MISSED + 2);
    made.delays(MISSED + 2, Role::Plant, 100);
}
