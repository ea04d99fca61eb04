//! The classes of the autopsy, each from evidence that is made up.

use crate::made::{GRID, MISSED, Made, US, WINDOW_TICKS, made, stall};
use model::role::Role;
use report::autopsy::classes::Class;
use report::autopsy::evidence::{Counters, Life, Passage};
use report::autopsy::runners::{Runner, Slice};
#[track_caller]
fn assert_class(what: &str, change: impl Fn(&mut Made), class: Class, stage: Option<Role>, words: &str) {
    let mut made = made();
    change(&mut made);
    let (found, due_to, evidence) = made.class();
    assert_eq!((found, due_to), (class, stage), "{what}: {evidence}");
    assert!(evidence.contains(words), "{what}: no `{words}` in `{evidence}`");
}

#[test]
fn when_everybody_is_late_together_the_processor_stalled() {
    assert_class("stall", stall, Class::ProcessorStalled, None, "although others were due");
    let in_the_chain = |made: &mut Made| {
        // Frozen after the inner loop has sent, for 1.6 ms; the plant's next tick begins late, too.
        made.delays(MISSED, Role::Mixer, 1_600);
        made.delays(MISSED + 1, Role::Plant, 640);
    };
    assert_class("stall in the chain", in_the_chain, Class::ProcessorStalled, None, "mixer woke 1600 us later");
    let in_a_law = |made: &mut Made| {
        made.computes(MISSED, Role::Inner, 1_600);
        made.delays(MISSED + 1, Role::Plant, 640);
    };
    assert_class("stall in a law", in_a_law, Class::ProcessorStalled, None, "inner computed 1600 us longer");
    let somebody_ran = |made: &mut Made| {
        long_stall(made);
        made.samples[5..].iter_mut().for_each(|sample| sample.busy = 2);
    };
    assert_class("somebody ran", somebody_ran, Class::CannotTell, None, "the processor was busy");
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
    assert_class("short", short, Class::CannotTell, None, "nothing else was due to show it");
    let takes = |made: &mut Made, jiffies: u64| {
        long_stall(made);
        made.samples[5..].iter_mut().for_each(|sample| sample.stolen = jiffies);
    };
    assert_class("half of 20 ms", |made| takes(made, 2), Class::HostStall, None, "the host took 20 ms");
    // A jiffy by chance is a third of it.
    let chance = |made: &mut Made| {
        made.silence(MISSED..MISSED + 30);
        made.delays(MISSED + 30, Role::Plant, 100);
        made.samples[5..].iter_mut().for_each(|sample| sample.stolen = 1);
    };
    assert_class("a jiffy by chance", chance, Class::ProcessorStalled, None, "no stage ran");
    // Of another processor, for all that is known.
    let apart = |made: &mut Made| {
        takes(made, 2);
        made.share_processor = false;
    };
    assert_class("apart", apart, Class::CannotTell, None, "do not share a processor");
    // What was ready to run and had no processor had none because the host had it.
    let ready = |made: &mut Made| {
        takes(made, 2);
        made.counts_from(5, Role::Plant, |counters| counters.waited_ns += 20_000 * US);
    };
    assert_class("ready", ready, Class::HostStall, None, "the host took 20 ms");
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
    assert_class("apart", apart, Class::CannotTell, None, "do not share a processor");
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
    assert_class("on hardware", hardware, Class::ProcessorStalled, None, "no stage ran");
    // With the highest priority nobody else can run meanwhile: what the kernel counts for it tells.
    let ran = |made: &mut Made| {
        hardware(made);
        made.counts_from(4, Role::Mixer, |counters| counters.ran_ns += 1_900 * US);
    };
    assert_class("ran", ran, Class::ComputedLong, Some(Role::Mixer), "it ran for");
}

#[test]
fn a_stage_that_always_takes_longer_than_a_tick_is_at_work_and_not_woken_late() {
    let always = |made: &mut Made| {
        for tick in 0..WINDOW_TICKS {
            let begin = GRID.begin_of(tick);
            let inner = Passage { receive_ns: begin + 50 * US, send_ns: begin + 2_450 * US, is_fresh: true };
            let passages = made.traces.get_mut(&tick).unwrap();
            passages[Role::Inner as usize] = (tick % 3 == 0).then_some(inner);
            passages[Role::Mixer as usize] =
                Some(Passage { receive_ns: begin + 900 * US, send_ns: begin + 905 * US, is_fresh: false });
        }
    };
    assert_class("always", always, Class::ComputedLong, Some(Role::Inner), "inner was at work for");
    // Under real-time scheduling the plant, which is less urgent, does not get the processor meanwhile.
    let instead = |made: &mut Made| {
        always(made);
        for tick in (0..WINDOW_TICKS).filter(|tick| tick % 3 != 0) {
            made.traces.remove(&tick);
        }
    };
    assert_class("instead", instead, Class::ComputedLong, Some(Role::Inner), "inner was at work for");
}

#[test]
fn a_stage_that_waits_for_a_message_that_was_sent_in_time_names_the_one_it_waits_for() {
    // The mixer did not take the wrench (it rejected it, say), waited until 90 % and was a little late itself.
    let unused = |made: &mut Made| {
        let begin = GRID.begin_of(MISSED);
        *made.stage(MISSED, Role::Mixer) =
            Passage { receive_ns: begin + 990 * US, send_ns: begin + 1_010 * US, is_fresh: false };
    };
    assert_class("unused", unused, Class::NotUsed, Some(Role::Inner), "what inner had sent in time was waited for");
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
    let by_nobody = |made: &mut Made| {
        stall(made);
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 2_000 * US);
    };
    assert_class("by nobody", by_nobody, Class::ReadyNotRun, Some(Role::Plant), "nobody was seen to run");
    let by_somebody = |made: &mut Made| {
        by_nobody(made);
        made.samples[4..].iter_mut().for_each(|sample| sample.busy = 1);
    };
    let on_hardware = |made: &mut Made| {
        by_somebody(made);
        made.is_virtual = false;
    };
    assert_class("by somebody", on_hardware, Class::Preempted, Some(Role::Plant), "which was busy for 10 ms");
    // Where the host stops a virtual machine, whoever was on its processor seems to run.
    assert_class("there", by_somebody, Class::ReadyNotRun, Some(Role::Plant), "nobody was seen to run");
    // Two thirds of the ticks are as bad: what is usual is what the good ones show.
    let all_the_time = |made: &mut Made| {
        stall(made);
        for i in [0, 1, 3, 4, 6] {
            made.counts_from(i + 1, Role::Plant, |counters| counters.waited_ns += 5_000 * US);
        }
    };
    assert_class("all the time", all_the_time, Class::ReadyNotRun, Some(Role::Plant), "without the processor");
    // The mixer got the processor back with the plant, too late for its tick, and found no input in the next one.
    let skipped_on = |made: &mut Made| {
        stall(made);
        made.silence_of(Role::Mixer, MISSED + 2..MISSED + 4);
        made.stage(MISSED + 2, Role::Inner).send_ns += 1_000 * US;
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 2_300 * US);
    };
    assert_class("skipped on", skipped_on, Class::ReadyNotRun, Some(Role::Plant), "plant woke 2100 us later");
    let waited_little = |made: &mut Made| {
        stall(made);
        made.counts_from(4, Role::Plant, |counters| counters.waited_ns += 400 * US);
    };
    assert_class("waited little", waited_little, Class::ProcessorStalled, None, "although others were due");
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
    assert_class("replaced", replaced, Class::StoppedOrDead, Some(Role::Mixer), ", and process 900 took its place");
    let killed_as_it_hung = |made: &mut Made| {
        replaced(made);
        made.samples[4].stages[Role::Mixer as usize].life = Life::Stopped;
    };
    let why = "its process was stopped and has ended, and process 900 took its place";
    assert_class("hung", killed_as_it_hung, Class::StoppedOrDead, Some(Role::Mixer), why);
    // The mixer worked at its cut-off and was late by a little; what it waited for had been stopped.
    let upstream = |made: &mut Made| {
        made.silence_of(Role::Inner, MISSED..MISSED + 20);
        let begin = GRID.begin_of(MISSED);
        *made.stage(MISSED, Role::Mixer) =
            Passage { receive_ns: begin + 1_050 * US, send_ns: begin + 1_060 * US, is_fresh: false };
        made.samples[4].stages[Role::Inner as usize].life = Life::Stopped;
    };
    assert_class("upstream", upstream, Class::StoppedOrDead, Some(Role::Inner), "its process was stopped");
    // An outage is due to what most of it is due to, not to what it began with.
    let begun_by_another = |made: &mut Made| {
        made.delays(MISSED, Role::Plant, 700);
        made.delays(MISSED + 1, Role::Plant, 600);
        made.silence_of(Role::Mixer, MISSED..MISSED + 20);
        made.samples[4].stages[Role::Mixer as usize].life = Life::Stopped;
    };
    assert_class("begun", begun_by_another, Class::StoppedOrDead, Some(Role::Mixer), "its process was stopped");
}

#[test]
fn a_trace_shows_who_ran_instead() {
    let hog = |pid: u64, priority: u64| Runner::Thread { pid, priority, name: "hog".into() };
    let before_ns = GRID.begin_of(MISSED - 10);
    let from_ns = GRID.begin_of(MISSED);
    let to_ns = from_ns + 1_820 * US;
    let late = |made: &mut Made, slices: Vec<Slice>| {
        made.silence(MISSED..MISSED + 1);
        made.delays(MISSED + 1, Role::Plant, 800);
        made.slices = slices;
    };
    let hogged = |made: &mut Made| {
        let idle = Slice { from_ns, to_ns: from_ns + 200 * US, runner: Runner::Idle };
        let plant = Slice { from_ns: before_ns, to_ns: before_ns + US, runner: hog(100, 19) };
        late(made, vec![plant, idle, Slice { from_ns: from_ns + 200 * US, to_ns, runner: hog(4711, 0) }]);
    };
    let words =
        "interrupts, or a thread at least as urgent, had the processor; there ran hog (4711) 1620 us, idle 200 us";
    assert_class("hogged", hogged, Class::Preempted, Some(Role::Plant), words);
    // The plant itself, nobody, or who is less urgent than the plant: that kept nobody from the processor.
    for runner in [hog(100, 19), Runner::Idle, hog(4711, 120)] {
        let mut made = made();
        let plant = Slice { from_ns: before_ns, to_ns: before_ns + US, runner: hog(100, 19) };
        late(&mut made, vec![plant, Slice { from_ns, to_ns, runner }]);
        let (class, _, evidence) = made.class();
        assert_ne!(class, Class::Preempted, "{evidence}");
        assert!(evidence.contains("no stage ran, although others were due; there ran"), "{evidence}");
    }
    let interrupted = |made: &mut Made| {
        let timer = Runner::Interrupt { name: "softirq TIMER".into() };
        let plant = Slice { from_ns: before_ns, to_ns: before_ns + US, runner: hog(100, 19) };
        let idle = Slice { from_ns, to_ns, runner: Runner::Idle };
        late(made, vec![plant, idle, Slice { from_ns, to_ns, runner: timer }]);
    };
    let words = "interrupts, or a thread at least as urgent, had the processor; there ran";
    assert_class("interrupted", interrupted, Class::Preempted, Some(Role::Plant), words);
}

#[test]
fn an_outage_of_many_delays_is_due_to_whose_they_mostly_are() {
    let slow = |made: &mut Made| {
        for tick in MISSED..MISSED + 20 {
            made.computes(tick, Role::Inner, if tick % 2 == 0 { 1_100 } else { 1_200 });
            // Its output is of no use to the mixer, which waited until its cut-off and is in time.
            let begin = GRID.begin_of(tick);
            *made.stage(tick, Role::Mixer) =
                Passage { receive_ns: begin + 860 * US, send_ns: begin + 865 * US, is_fresh: false };
        }
        made.delays(MISSED + 3, Role::Plant, 300);
    };
    assert_class("slow", slow, Class::ComputedLong, Some(Role::Inner), "in the longest of 20 delays");
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
