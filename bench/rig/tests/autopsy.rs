//! The autopsy: each class from evidence that is made up.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;

use model::envelope::{Envelope, Message, Stamps};
use model::grid::Grid;
use model::messages::{RotorSpeeds, Setpoint, State, Wrench};
use model::role::Role;
use report::autopsy::classes::{Class, classify};
use report::autopsy::evidence::{CounterSample, Counters, Life, Passage, Scene, TickPassages};
use report::autopsy::{Autopsy, WINDOW_TICKS};

const T: u64 = 1_000_000;
const GRID: Grid = Grid { t0_ns: 50 * T, period_ns: T };
/// The tick that is missed in every case.
const MISSED: u64 = 32;
const US: u64 = 1_000;

/// What surrounds a miss: 64 ticks of a good flight, and samples each 10 ms, with what a case changes.
struct Made {
    traces: BTreeMap<u64, TickPassages>,
    samples: Vec<CounterSample>,
    is_virtual: bool,
    share_processor: bool,
}

/// A good tick: each stage wakes 10 us after the one before has sent, and computes for 5 us.
fn good(tick: u64) -> TickPassages {
    let begin = GRID.begin_of(tick);
    let at = |us: u64| Passage { receive_ns: begin + us * US, send_ns: begin + (us + 5) * US, is_fresh: true };
    [Some(at(20)), Some(at(35)), Some(at(50)), Some(at(65))]
}

fn made() -> Made {
    let stages: [Counters; 4] = std::array::from_fn(|i| Counters { pid: 100 + i as u64, ..Counters::default() });
    let sample = |i: u64| {
        // A loop waits for others on its processor in every tick: 30 us, and is switched out once.
        let stages = stages.map(|it| Counters { waited_ns: i * 300 * US, involuntary_switches: 10 * i, ..it });
        CounterSample { at_ns: GRID.begin_of(0) + i * 10 * T, stages, stolen: 0, lost: 0 }
    };
    Made {
        traces: (0..WINDOW_TICKS).map(|tick| (tick, good(tick))).collect(),
        samples: (0..=7).map(sample).collect(),
        is_virtual: true,
        share_processor: true,
    }
}

impl Made {
    fn stage(&mut self, tick: u64, role: Role) -> &mut Passage {
        self.traces.get_mut(&tick).unwrap()[role as usize].as_mut().unwrap()
    }

    /// The stage is later by `us` in a tick, from waking on, and so is the rest of the chain.
    fn delays(&mut self, tick: u64, role: Role, us: u64) {
        for later in role as usize..4 {
            let passage = self.traces.get_mut(&tick).unwrap()[later].as_mut().unwrap();
            passage.receive_ns += us * US;
            passage.send_ns += us * US;
        }
    }

    /// The stage computes longer by `us` in a tick, and the rest of the chain is later.
    fn computes(&mut self, tick: u64, role: Role, us: u64) {
        self.stage(tick, role).send_ns += us * US;
        if role != Role::Mixer {
            let next = [Role::Outer, Role::Inner, Role::Mixer][role as usize];
            self.delays(tick, next, us);
        }
    }

    /// Nobody publishes anything in these ticks.
    fn silence(&mut self, ticks: std::ops::Range<u64>) {
        ticks.for_each(|tick| {
            self.traces.remove(&tick);
        });
    }

    fn silence_of(&mut self, role: Role, ticks: std::ops::Range<u64>) {
        ticks.for_each(|tick| self.traces.get_mut(&tick).unwrap()[role as usize] = None);
    }

    /// Counts from a sample on: the fourth is the first one after the missed tick's begin.
    fn counts_from(&mut self, sample: usize, role: Role, count: impl Fn(&mut Counters)) {
        self.samples[sample..].iter_mut().for_each(|sample| count(&mut sample.stages[role as usize]));
    }

    fn class(&self) -> (Class, Option<Role>, String) {
        let stamps = self.traces.values().flatten().flatten().map(|passage| passage.send_ns);
        let scene = Scene {
            grid: GRID,
            traces: &self.traces,
            samples: &self.samples,
            until_ns: stamps.max().unwrap(),
            is_virtual: self.is_virtual,
            share_processor: self.share_processor,
        };
        let opinion = classify(&scene, MISSED);
        (opinion.class, opinion.stage, opinion.evidence)
    }
}

#[track_caller]
fn assert_class(what: &str, change: impl Fn(&mut Made), class: Class, stage: Option<Role>, words: &str) {
    let mut made = made();
    change(&mut made);
    let (found, due_to, evidence) = made.class();
    assert_eq!((found, due_to), (class, stage), "{what}: {evidence}");
    assert!(evidence.contains(words), "{what}: no `{words}` in `{evidence}`");
}

/// The plant wakes 2.1 ms late, and everybody else with it: two ticks are left out.
fn stall(made: &mut Made) {
    made.silence(MISSED..MISSED + 2);
    made.delays(MISSED + 2, Role::Plant, 100);
}

#[test]
fn when_everybody_is_late_together_it_is_the_host() {
    assert_class("stall", stall, Class::HostStall, None, "although others were due");
    let in_the_chain = |made: &mut Made| {
        // Frozen after the inner loop has sent, for 1.6 ms; the plant's next tick begins late, too.
        made.delays(MISSED, Role::Mixer, 1_600);
        made.delays(MISSED + 1, Role::Plant, 640);
    };
    assert_class("stall in the chain", in_the_chain, Class::HostStall, None, "mixer woke 1600 us later");
    let in_a_law = |made: &mut Made| {
        made.computes(MISSED, Role::Inner, 1_600);
        made.delays(MISSED + 1, Role::Plant, 640);
    };
    assert_class("stall in a law", in_a_law, Class::HostStall, None, "inner computed 1600 us longer");
}

#[test]
fn when_the_host_says_that_it_took_time_it_is_the_host() {
    let short = |made: &mut Made| {
        // Too short for anybody else to have been due.
        made.delays(MISSED, Role::Plant, 930);
        made.delays(MISSED + 1, Role::Plant, 60);
    };
    assert_class("short", short, Class::CannotTell, None, "on a virtual machine");
    let stolen = |made: &mut Made| {
        short(made);
        made.samples[4..].iter_mut().for_each(|sample| sample.stolen = 1);
    };
    assert_class("stolen", stolen, Class::HostStall, None, "the host took time");
    let on_hardware = |made: &mut Made| {
        short(made);
        made.is_virtual = false;
    };
    assert_class("hardware", on_hardware, Class::WakeLate, Some(Role::Plant), "plant woke 930 us later");
}

#[test]
fn a_stage_that_is_late_while_others_run_was_woken_late() {
    let late = |made: &mut Made| made.delays(MISSED, Role::Mixer, 1_500);
    assert_class("mixer", late, Class::WakeLate, Some(Role::Mixer), "others ran meanwhile");
    // On processors of their own, one stage's life says nothing of another's.
    let apart = |made: &mut Made| {
        late(made);
        made.share_processor = false;
    };
    assert_class("apart", apart, Class::CannotTell, None, "on a virtual machine");
}

#[test]
fn a_stage_that_computes_long_while_others_run_or_again_and_again_is_named() {
    // Woken by its own timer, the mixer of the higher priority works in between.
    let once = |made: &mut Made| {
        made.computes(MISSED, Role::Inner, 1_600);
        *made.stage(MISSED, Role::Mixer) = Passage {
            receive_ns: GRID.begin_of(MISSED) + 900 * US,
            send_ns: GRID.begin_of(MISSED + 1) + US,
            is_fresh: false,
        };
    };
    assert_class("once", once, Class::ComputedLong, Some(Role::Inner), "others ran meanwhile");
    let often = |made: &mut Made| {
        for tick in [MISSED - 10, MISSED, MISSED + 7] {
            made.computes(tick, Role::Mixer, 960);
        }
    };
    assert_class("often", often, Class::ComputedLong, Some(Role::Mixer), "in other ticks around");
    let hardware = |made: &mut Made| {
        made.computes(MISSED, Role::Mixer, 1_960);
        made.delays(MISSED + 1, Role::Plant, 1_000);
        made.is_virtual = false;
    };
    assert_class("on hardware", hardware, Class::ComputedLong, Some(Role::Mixer), "nothing interrupted it");
}

#[test]
fn a_stage_that_waits_for_a_message_that_was_sent_in_time_names_the_one_it_waits_for() {
    // The mixer did not take the wrench (it rejected it, say), waited until 90 % and was a little late itself.
    let unused = |made: &mut Made| {
        let begin = GRID.begin_of(MISSED);
        *made.stage(MISSED, Role::Mixer) =
            Passage { receive_ns: begin + 990 * US, send_ns: begin + 1_010 * US, is_fresh: false };
    };
    assert_class("unused", unused, Class::UpstreamLate, Some(Role::Inner), "inner was waited for");
}

#[test]
fn what_the_kernel_counts_for_the_late_stage_goes_before_what_it_looks_like() {
    let late = |made: &mut Made| made.delays(MISSED, Role::Mixer, 1_500);
    let faults = |made: &mut Made| {
        late(made);
        made.counts_from(4, Role::Mixer, |counters| counters.faults += 3);
    };
    assert_class("faults", faults, Class::PageFault, Some(Role::Mixer), "3 page faults");
    let faults_of_another = |made: &mut Made| {
        late(made);
        made.counts_from(4, Role::Outer, |counters| counters.faults += 3);
    };
    assert_class("faults of another", faults_of_another, Class::WakeLate, Some(Role::Mixer), "others ran");
    let faults_before = |made: &mut Made| {
        late(made);
        made.counts_from(2, Role::Mixer, |counters| counters.faults += 3);
    };
    assert_class("faults before", faults_before, Class::WakeLate, Some(Role::Mixer), "others ran");
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
        Class::Preempted,
        Some(Role::Plant),
        "2000 us without the processor, 1 involuntary",
    );
    // Two thirds of the ticks are as bad: what is usual is what the good ones show.
    let all_the_time = |made: &mut Made| {
        stall(made);
        for i in [0, 1, 3, 4, 6] {
            made.counts_from(i + 1, Role::Plant, |counters| counters.waited_ns += 5_000 * US);
        }
    };
    assert_class("all the time", all_the_time, Class::Preempted, Some(Role::Plant), "without the processor");
    // The mixer got the processor back with the plant, too late for its tick, and found no input in the next one.
    let skipped_on = |made: &mut Made| {
        stall(made);
        made.silence_of(Role::Mixer, MISSED + 2..MISSED + 4);
        made.stage(MISSED + 2, Role::Inner).send_ns += 1_000 * US;
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 2_300 * US);
    };
    assert_class("skipped on", skipped_on, Class::Preempted, Some(Role::Plant), "plant woke 2100 us later");
    let waited_little = |made: &mut Made| {
        stall(made);
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 400 * US);
    };
    assert_class("waited little", waited_little, Class::HostStall, None, "although others were due");
}

#[test]
fn a_stage_that_was_stopped_or_has_ended_is_named() {
    let stopped = |made: &mut Made| {
        made.silence_of(Role::Mixer, MISSED..MISSED + 20);
        made.samples[4].stages[Role::Mixer as usize].life = Life::Stopped;
    };
    assert_class("stopped", stopped, Class::StoppedOrDead, Some(Role::Mixer), "its process was stopped");
    let dead = |made: &mut Made| {
        made.silence_of(Role::Mixer, MISSED..WINDOW_TICKS);
        made.counts_from(4, Role::Mixer, |counters| counters.life = Life::Dead);
    };
    assert_class("dead", dead, Class::StoppedOrDead, Some(Role::Mixer), "its process has ended");
    let replaced = |made: &mut Made| {
        made.silence_of(Role::Mixer, MISSED..MISSED + 20);
        made.counts_from(5, Role::Mixer, |counters| *counters = Counters { pid: 900, ..Counters::default() });
    };
    assert_class("replaced", replaced, Class::StoppedOrDead, Some(Role::Mixer), "its process has ended");
    // The mixer worked at its cut-off and was late by a little; what it waited for had been stopped.
    let upstream = |made: &mut Made| {
        made.silence_of(Role::Inner, MISSED..MISSED + 20);
        let begin = GRID.begin_of(MISSED);
        *made.stage(MISSED, Role::Mixer) =
            Passage { receive_ns: begin + 1_050 * US, send_ns: begin + 1_060 * US, is_fresh: false };
        made.samples[4].stages[Role::Inner as usize].life = Life::Stopped;
    };
    assert_class("upstream", upstream, Class::StoppedOrDead, Some(Role::Inner), "its process was stopped");
}

#[test]
fn what_the_evidence_does_not_decide_is_not_decided() {
    let lost = |made: &mut Made| {
        stall(made);
        made.samples[5..].iter_mut().for_each(|sample| sample.lost = 1);
    };
    assert_class("lost", lost, Class::CannotTell, None, "lost messages");
    let several = |made: &mut Made| {
        for role in [Role::Plant, Role::Outer, Role::Inner, Role::Mixer] {
            made.delays(MISSED, role, 240);
        }
    };
    assert_class("several", several, Class::CannotTell, None, "none of them by most");
    assert_class("nothing", |_| {}, Class::CannotTell, None, "no stage was later than usual");
}

/// An autopsy that is fed as the recorder feeds it, with a stall.
#[test]
fn the_classes_add_up_to_the_deadlines_missed() {
    let mut made = made();
    stall(&mut made);
    let mut autopsy = Autopsy::new(GRID, true, true);
    made.samples.iter().for_each(|sample| autopsy.sample(*sample));
    let mut missed = 0;
    for (tick, trace) in &made.traces {
        let envelope = |role: Role| {
            let passage = trace[role as usize].unwrap();
            let mut envelope = Envelope { tick: *tick, input_tick: [*tick; 3], ..Envelope::new() };
            envelope.stamps[role as usize] = Stamps { receive_ns: passage.receive_ns, send_ns: passage.send_ns };
            envelope
        };
        let is_late = *tick == MISSED + 2;
        // Ticks 33 and 34 began without the commands of ticks 32 and 33.
        missed += if is_late { 2 } else { 0 };
        let content = State { deadlines_missed: missed, deadline_miss_run: u64::from(is_late) * 2, ..State::default() };
        autopsy.state(&Message { envelope: envelope(Role::Plant), content });
        autopsy.stamps(&Message { envelope: envelope(Role::Outer), content: Setpoint::default() });
        autopsy.stamps(&Message { envelope: envelope(Role::Inner), content: Wrench::default() });
        // The last command of all never comes.
        if *tick + 1 < WINDOW_TICKS {
            autopsy.stamps(&Message { envelope: envelope(Role::Mixer), content: RotorSpeeds::default() });
        }
        autopsy.look();
    }
    assert_eq!(autopsy.section().pending, 2, "they wait for the ticks after them");
    autopsy.finish(missed + 1, WINDOW_TICKS);
    let section = autopsy.section();
    assert_eq!(section.classes.iter().map(|class| class.count).sum::<u64>(), missed + 1);
    let rows: Vec<_> = section.worst.iter().map(|case| (case.tick, case.in_a_row)).collect();
    assert_eq!(rows, [(MISSED, 2), (WINDOW_TICKS - 1, 1)]);
    assert_eq!(section.worst[0].class, Class::HostStall);
    // Published 170 us after the begin of the third tick, against a deadline at that of the second.
    assert!((section.worst[0].late_us - 1_170.0).abs() < 1e-6, "{:?}", section.worst[0]);
    let text = section.text();
    assert!(
        text.contains("host stall")
            && text.contains(&format!("tick {MISSED} (0.032 s), the first of 2, late by 1170.0 us")),
        "{text}"
    );
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
        section.classes.iter().map(|it| (it.class, it.stage.clone(), it.count)).collect::<Vec<_>>()
    };
    assert_eq!(of(&with), [(Class::StoppedOrDead, Some("mixer".into()), 1)]);
    without.fallen([false; 4], GRID.begin_of(MISSED + 4));
    without.finish(1, MISSED + 1);
    assert!(of(&without).iter().all(|(class, ..)| *class != Class::StoppedOrDead), "{:?}", of(&without));
}
