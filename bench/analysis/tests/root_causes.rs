//! Root causes of missed deadlines, from made-up timings, counters and processor traces.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;
use std::ops::Range;

use MissCause::{
    CannotTell, ComputedLong, HostStall, MessageFault, NotUsed, PageFault, Preempted, ReadyNotRun,
    StoppedOrDead, Throttled,
};
use Role::{Inner, Mixer, Outer, Plant};
use analysis::miss_analysis::{AROUND_TICKS, MissAnalysis};
use analysis::miss_causes::MissCause;
use analysis::observations::{CounterSample, Counters, Life, StageTiming, TickTimings};
use analysis::outages::{OutageCase, OutageSection};
use analysis::processor_trace::{Runner, Slice};
use analysis::schema::MACHINE;
use messages::content::{Loss, RotorSpeeds, Setpoint, State, Wrench};
use messages::grid::Grid;
use messages::header::{Header, Message, Stamps};
use messages::role::{Role, STAGES};
use messages::topic::Topic;

const NOTHING: &str = "nothing observed says why";
const TOO_LITTLE: &str = "less than half of the delay";
const US: u64 = 1_000;
const TICK_US: u64 = 1_000;
const GRID: Grid = Grid {
    t0_ns: 50 * TICK_US * US,
    period_ns: TICK_US * US,
};
/// A tick of the flight's own time [s]: the clock is slowed ten times.
const SLOWED_S: f64 = 1e-4;
/// The first tick whose deadline is missed.
const MISSED: u64 = 32;
const TICKS: u64 = 2 * AROUND_TICKS;
/// The last tick, from the missed one on.
const LAST: i64 = 31;

/// Timings and counters of a flight; a test changes those of a good one.
#[derive(Clone)]
struct Evidence {
    timings: BTreeMap<u64, TickTimings>,
    samples: Vec<CounterSample>,
    slices: Vec<Slice>,
    loss: Option<Loss>,
    /// A stage from which a message fault withholds an input, in these ticks.
    withheld: Option<(Role, Range<u64>)>,
    share_processor: bool,
}

/// A stage that woke and sent at these times after the begin of a tick [us].
fn timing(tick: u64, wake_us: u64, send_us: u64, is_fresh: bool) -> Option<StageTiming> {
    let begin_ns = GRID.begin_of(tick);
    Some(StageTiming {
        receive_ns: begin_ns + wake_us * US,
        send_ns: begin_ns + send_us * US,
        is_fresh,
    })
}

/// Each stage wakes 10 us after the stage before it has sent, and computes for 5 us.
fn good_tick(tick: u64) -> TickTimings {
    [20, 35, 50, 65].map(|us| timing(tick, us, us + 5, true))
}

/// 64 ticks, and a sample every 10 ms.
fn good() -> Evidence {
    // In every tick a stage waits 30 us for others on its processor.
    let counters = |i: u64, stage: usize| Counters {
        pid: 100 + stage as u64,
        waited_ns: i * 300 * US,
        ran_ns: i * 50 * US,
        ..Counters::default()
    };
    let sample = |i: u64| CounterSample {
        from_ns: GRID.begin_of(10 * i),
        at_ns: GRID.begin_of(10 * i),
        stages: std::array::from_fn(|stage| counters(i, stage)),
        ..CounterSample::default()
    };
    Evidence {
        timings: (0..TICKS).map(|tick| (tick, good_tick(tick))).collect(),
        samples: (0..=7).map(sample).collect(),
        slices: Vec::new(),
        loss: None,
        withheld: None,
        share_processor: true,
    }
}

/// Rotor commands that the recorder lost between two ticks.
fn loss(after_tick: u64, before_tick: u64) -> Loss {
    Loss {
        topic: 3,
        channel: 0,
        messages: before_tick - after_tick - 1,
        after_tick,
        before_tick,
    }
}

fn stamp<C: Topic>(analysis: &mut MissAnalysis, header: Option<Header>) {
    if let Some(envelope) = header {
        let content = C::default();
        analysis.stamps(&Message { envelope, content });
    }
}

/// Changes of a flight; ticks are counted from the missed one.
impl Evidence {
    fn stage(&mut self, tick: i64, role: Role) -> &mut Option<StageTiming> {
        let tick = MISSED.strict_add_signed(tick);
        &mut self.timings.get_mut(&tick).unwrap()[role as usize]
    }

    /// A stage wakes later [us], and all stages after it with it.
    fn late(mut self, tick: i64, role: Role, us: u64) -> Self {
        for role in &STAGES[role as usize..] {
            if let Some(timing) = self.stage(tick, *role) {
                timing.receive_ns += us * US;
                timing.send_ns += us * US;
            }
        }
        self
    }

    fn sends_later(mut self, tick: i64, role: Role, us: u64) -> Self {
        self.stage(tick, role).as_mut().unwrap().send_ns += us * US;
        self
    }

    /// The stages after it are later.
    fn computes(self, tick: i64, role: Role, us: u64) -> Self {
        let computed = self.sends_later(tick, role, us);
        match STAGES.get(role as usize + 1) {
            Some(next) => computed.late(tick, *next, us),
            None => computed,
        }
    }

    fn silent(mut self, role: Role, ticks: Range<i64>) -> Self {
        ticks.for_each(|tick| *self.stage(tick, role) = None);
        self
    }

    /// No stage publishes anything in this number of ticks.
    fn stalled(self, ticks: i64) -> Self {
        let stalled = STAGES
            .into_iter()
            .fold(self, |it, role| it.silent(role, 0..ticks));
        stalled.late(ticks, Plant, 100)
    }

    /// The mixer works without the wrench.
    fn mixer_at(mut self, wake_us: u64, send_us: u64) -> Self {
        *self.stage(0, Mixer) = timing(MISSED, wake_us, send_us, false);
        self
    }

    /// Changes samples from one on: the fourth is the first after the begin of the missed tick.
    fn sampled(mut self, from: usize, change: impl Fn(&mut CounterSample)) -> Self {
        self.samples[from..].iter_mut().for_each(change);
        self
    }

    fn counted(self, from: usize, role: Role, change: impl Fn(&mut Counters)) -> Self {
        self.sampled(from, |sample| change(&mut sample.stages[role as usize]))
    }

    fn waited(self, from: usize, us: u64) -> Self {
        self.counted(from, Plant, |it| it.waited_ns += us * US)
    }

    fn throttled(self, role: Role, us: u64) -> Self {
        self.counted(5, role, |it| it.throttled_us += us)
    }

    fn stolen(self, from: usize, jiffies: u64) -> Self {
        self.sampled(from, |it| it.stolen = jiffies)
    }

    fn stopped(mut self, role: Role) -> Self {
        self.samples[4].stages[role as usize].life = Life::Stopped;
        self
    }

    fn replaced(self, role: Role) -> Self {
        let successor = Counters {
            pid: 900,
            ..Counters::default()
        };
        self.counted(5, role, |it| *it = successor)
    }

    /// A message fault withholds an input of a stage, in these ticks.
    fn withheld(mut self, role: Role, ticks: Range<u64>) -> Self {
        self.withheld = Some((role, MISSED + ticks.start..MISSED + ticks.end));
        self
    }

    /// A thread or an interrupt has the processor from an instant after the begin of the missed tick on [us].
    fn ran(mut self, from_us: i64, us: u64, runner: Runner) -> Self {
        let from_ns = GRID.begin_of(MISSED).strict_add_signed(from_us * 1_000);
        let to_ns = from_ns + us * US;
        self.slices.push(Slice {
            from_ns,
            to_ns,
            runner,
        });
        self
    }

    /// The fourth sample was read for some time.
    fn read(mut self, from: u64, to: u64) -> Self {
        let sample = &mut self.samples[4];
        (sample.from_ns, sample.at_ns) = (GRID.begin_of(MISSED + from), GRID.begin_of(MISSED + to));
        self
    }

    /// Asserts the cause of the outage with the missed tick, and a part of the evidence.
    #[track_caller]
    fn is(&self, class: MissCause, stage: Option<Role>, evidence: &str) {
        let (mut analysis, missed) = self.analysed();
        analysis.miss(MISSED);
        analysis.finish(missed);
        let worst = analysis.section().worst;
        let is_it = |it: &&OutageCase| (it.tick..it.tick + it.ticks).contains(&MISSED);
        let case = worst.iter().find(is_it).unwrap();
        let found = (case.class, case.stage.as_deref());
        assert_eq!(found, (class, stage.map(Role::name)), "{case:?}");
        let said = &case.evidence;
        assert!(said.contains(evidence), "no `{evidence}` in `{said}`");
        assert_eq!(case.time_s, case.tick as f64 * SLOWED_S);
    }

    /// Feeds an analysis as the recorder does; gives the deadlines missed before the last state, too.
    fn analysed(&self) -> (MissAnalysis, u64) {
        let mut analysis =
            MissAnalysis::new(GRID, SLOWED_S, self.share_processor, [0, 250 * US, 0]);
        analysis.slices(self.slices.clone());
        self.loss.iter().for_each(|loss| analysis.loss(loss));
        let mut samples = self.samples.iter().peekable();
        let (mut missed, mut judged) = (0, 0);
        for (tick, stages) in &self.timings {
            while let Some(sample) = samples.next_if(|it| it.at_ns <= GRID.begin_of(*tick)) {
                analysis.sample(*sample);
            }
            if let Some((stage, ticks)) = &self.withheld
                && ticks.contains(tick)
            {
                analysis.withheld(*tick, *stage);
            }
            let header = |role: Role| {
                let timing = stages[role as usize]?;
                let mut header = Header {
                    tick: *tick,
                    input_tick: [tick.saturating_sub(u64::from(!timing.is_fresh)); 3],
                    ..Header::new()
                };
                header.stamps[role as usize] = Stamps {
                    receive_ns: timing.receive_ns,
                    send_ns: timing.send_ns,
                };
                Some(header)
            };
            if let Some(envelope) = header(Plant) {
                // The plant looks for the commands of all ticks since its last state.
                for judged in judged..*tick {
                    let command = self.timings[&judged][Mixer as usize];
                    if command.is_none_or(|it| it.send_ns > GRID.begin_of(judged + 1)) {
                        missed += 1;
                        analysis.miss(judged);
                    }
                }
                judged = *tick;
                let content = State::default();
                analysis.state(&Message { envelope, content });
            }
            stamp::<Setpoint>(&mut analysis, header(Outer));
            stamp::<Wrench>(&mut analysis, header(Inner));
            stamp::<RotorSpeeds>(&mut analysis, header(Mixer));
            analysis.look();
        }
        samples.for_each(|sample| analysis.sample(*sample));
        (analysis, missed)
    }

    /// The report's section after the flight.
    fn section(&self) -> OutageSection {
        let (mut analysis, missed) = self.analysed();
        analysis.finish(missed);
        analysis.section()
    }
}

#[test]
fn a_process_that_was_seen_stopped_or_gone_is_named() {
    let silent = || good().silent(Mixer, 0..20);
    let dies = |it: &mut Counters| it.life = Life::Dead;
    let replaced = silent().replaced(Mixer);
    // Beside shorter delays of other stages.
    let beside = (1..8).fold(silent().stopped(Mixer), |it, tick| {
        it.late(tick, Plant, 900).computes(tick, Inner, 900)
    });
    // The sample that showed the stop ended after it.
    let late = || good().late(0, Mixer, 1500);
    let short = late().stopped(Mixer).read(0, 3);
    for (evidence, words) in [
        (silent().stopped(Mixer), "its process was stopped"),
        (short, "its process was stopped"),
        (beside, "its process was stopped"),
        (silent().counted(4, Mixer, dies), "its process has ended"),
        // It worked before a sample showed it.
        (late().counted(4, Mixer, |it| it.pid = 900), "process 900"),
        (replaced.clone(), "has ended, and process 900 took its"),
        (replaced.stopped(Mixer), "was stopped and has ended, and"),
    ] {
        evidence.is(StoppedOrDead, Some(Mixer), words);
    }
    // The mixer worked at its cut-off, a little late; the stage that it waited for was stopped.
    let inner = good().silent(Inner, 0..20).mixer_at(1050, 1060);
    let inner = inner.stopped(Inner);
    inner.is(StoppedOrDead, Some(Inner), "its process was stopped");
    let other = silent().stopped(Outer);
    other.is(CannotTell, Some(Mixer), NOTHING);
    let other_channel = silent().replaced(Mixer).sampled(5, |it| it.channel = 1);
    other_channel.is(CannotTell, Some(Mixer), NOTHING);
}

#[test]
fn a_cause_needs_an_observation_that_explains_half_of_the_delay() {
    let stall = |ticks| good().stalled(ticks);
    let (quota, host) = (stall(20).throttled(Plant, 19_000), stall(20).stolen(5, 2));
    let mut apart = host.clone();
    apart.share_processor = false;
    // Two thirds of the ticks are as bad: the good ones show what is usual.
    let often = [1, 2, 4, 5, 7].into_iter();
    let often = often.fold(stall(2), |it, from| it.waited(from, 5000));
    // The mixer got the processor with the plant, too late for its tick, and found no input in the next one.
    let follows = stall(2).silent(Mixer, 2..4).sends_later(2, Inner, 1000);
    for (evidence, class, words) in [
        (quota.clone(), Throttled, "quota"),
        (quota.clone().waited(5, 20_000), Throttled, "quota"),
        (quota.stolen(5, 2), Throttled, "quota"),
        (stall(20).throttled(Plant, 9_000), CannotTell, TOO_LITTLE),
        (stall(20).throttled(Mixer, 19_000), CannotTell, NOTHING),
        (host.clone(), HostStall, "the host took 20 ms"),
        (host.waited(5, 20_000), HostStall, "the host took 20 ms"),
        // One of these 10 ms may be chance.
        (
            stall(30).stolen(5, 1),
            CannotTell,
            "the host took 10 ms: less",
        ),
        // Another processor may have been stolen.
        (apart, CannotTell, NOTHING),
        (stall(2).waited(4, 2000), ReadyNotRun, "for 2000 us without"),
        (stall(2).waited(4, 400), CannotTell, TOO_LITTLE),
        // It came back while the fourth sample was read, after its counters: they do not yet count its wait.
        (stall(2).read(1, 3).waited(5, 2000), ReadyNotRun, "ready"),
        (often, ReadyNotRun, "ready to run for"),
        (follows.waited(4, 2300), ReadyNotRun, "woke 2100 us later"),
    ] {
        let is_of_all = matches!(class, HostStall | Throttled);
        evidence.is(class, (!is_of_all).then_some(Plant), words);
    }
    let late = || good().late(0, Mixer, 1500);
    let long = || good().computes(0, Mixer, 1960);
    let ran = |us: u64| move |it: &mut Counters| it.ran_ns += us * US;
    let faults = |it: &mut Counters| it.faults += 3;
    for (evidence, class, words) in [
        (long().counted(4, Mixer, ran(1900)), ComputedLong, "1900 us"),
        (long().counted(4, Mixer, ran(900)), CannotTell, TOO_LITTLE),
        // A thread that polls seems to run while the host has the processor.
        (late().counted(4, Mixer, ran(1900)), CannotTell, NOTHING),
        (late().counted(4, Mixer, faults), PageFault, "3 page faults"),
        (late().counted(4, Outer, faults), CannotTell, NOTHING),
        (late().counted(2, Mixer, faults), CannotTell, NOTHING),
        // It rejected what had come in time, say.
        (good().mixer_at(990, 1010), NotUsed, "that inner had sent"),
    ] {
        evidence.is(class, Some(Mixer), words);
    }
    let not_sent = good().computes(0, Inner, 1600).mixer_at(900, 1001);
    not_sent.is(CannotTell, Some(Inner), NOTHING);
    // In channel b it had waited until its own cut-off, 67.5 % of the tick.
    let before_cut_off = [Plant, Outer, Inner].into_iter();
    let before_cut_off = before_cut_off.fold(good(), |it, role| it.computes(0, role, 215));
    let before_cut_off = before_cut_off.mixer_at(960, 1010);
    before_cut_off.is(NotUsed, Some(Mixer), "that inner had sent");
    assert!(!before_cut_off.section().longest.contains_key("inner"));
    let before_cut_off = before_cut_off.sampled(0, |it| it.channel = 1);
    before_cut_off.is(CannotTell, Some(Mixer), NOTHING);
    assert_eq!(before_cut_off.section().longest["inner"], 1);
    let alike = STAGES.into_iter();
    let alike = alike.fold(good(), |it, role| it.late(0, role, 240));
    alike.is(CannotTell, Some(Plant), "the longest of 4 delays");
}

#[test]
fn a_stage_that_computes_long_in_most_of_an_outage_is_its_cause_whoever_was_late_for_longest() {
    let ticks = || (0..5).chain(7..10);
    let busy = ticks().fold(good(), |it, tick| it.computes(tick, Outer, 1200));
    // Kept from the processor, the plant leaves out two ticks.
    let late = STAGES
        .into_iter()
        .fold(busy, |it, role| it.silent(role, 5..7))
        .late(7, Plant, 400);
    let ran = |us: u64| move |it: &mut Counters| it.ran_ns += us * US;
    let words =
        "outer computed 1200 us longer than usual, the longest of 8 delays; it ran for 9000 us";
    late.counted(4, Outer, ran(9000))
        .is(ComputedLong, Some(Outer), words);
}

#[test]
fn what_a_message_fault_withheld_is_no_mystery() {
    let of_plant = "message faults withheld an input of plant in 1 tick";
    let of_mixer = "message faults withheld an input of mixer in 1 tick";
    // The plant drops the command: no stage is late.
    let dropped = good().withheld(Plant, 0..1);
    dropped.is(MessageFault, None, of_plant);
    // Nor is one that is late by less than a tick a reason.
    let late = dropped.late(0, Inner, 300);
    late.is(MessageFault, None, of_plant);
    let mixer = good().mixer_at(990, 1010).withheld(Mixer, 0..1);
    mixer.is(MessageFault, None, of_mixer);
    // A stage does nothing without a state.
    let silent = good().silent(Outer, 0..5).withheld(Outer, 0..5);
    silent.is(MessageFault, None, "an input of outer in 5 ticks");
    // One late tick does not explain the others, also where no message was sent in it that could be withheld.
    for withheld in [0..10, 0..6] {
        let said = format!("{} ticks; plant woke 1500 us later", withheld.end);
        let late = good().silent(Outer, 0..10).late(4, Plant, 1500);
        late.withheld(Outer, withheld).is(MessageFault, None, &said);
    }
    // A fault in another tick explains nothing, and neither does one beside a stop.
    let other = good().withheld(Plant, 1..2);
    other.is(CannotTell, None, "no stage was later than usual");
    let stopped = good().silent(Mixer, 0..20).stopped(Mixer);
    let beside = stopped.withheld(Plant, 0..20);
    beside.is(StoppedOrDead, Some(Mixer), "its process was stopped");
}

#[test]
fn without_a_late_stage_nothing_is_named() {
    good().is(CannotTell, None, "no stage was later than usual");
    let mut unseen = good().stalled(2);
    unseen.loss = Some(loss(MISSED - 1, MISSED + 2));
    unseen.is(CannotTell, None, "the recorder lost messages");
}

#[test]
fn a_trace_shows_which_thread_ran_instead() {
    let thread = |pid: u64, priority: u64| Runner::Thread {
        pid,
        priority,
        name: "hog".into(),
    };
    let name = "softirq TIMER".into();
    let timer = Runner::Interrupt { name };
    // The plant's own priority is known from a slice of ten ticks before.
    let late = good().stalled(1).late(1, Plant, 700);
    let late = late.ran(-10 * 1_000, 1, thread(100, 19));
    let idle = || late.clone().ran(0, 200, Runner::Idle);
    let urgent = "interrupts, or a thread at least as urgent, had the processor for";
    let words = format!("{urgent} 1620 us; meanwhile ran hog (4711) 1620 us, idle 200 us");
    let hogged = idle().ran(200, 1_620, thread(4711, 0));
    hogged.is(Preempted, Some(Plant), &words);
    let interrupted = idle().ran(200, 1_620, Runner::Idle).ran(0, 1_820, timer);
    interrupted.is(Preempted, Some(Plant), urgent);
    // The plant itself, the idle task and a less urgent thread keep no stage from the processor.
    for runner in [thread(100, 19), Runner::Idle, thread(4711, 120)] {
        let other = late.clone().ran(0, 1_820, runner);
        other.is(CannotTell, Some(Plant), "says why; meanwhile ran");
    }
}

#[test]
fn every_missed_deadline_is_in_one_outage() {
    // The plant, and with it every stage, wakes 2.1 ms late: two ticks are skipped. The last command never comes.
    let evidence = good().stalled(2).silent(Mixer, LAST..LAST + 1);
    let (mut analysis, missed) = evidence.analysed();
    assert_eq!((missed, analysis.section().pending), (2, 2));
    analysis.miss(TICKS - 1);
    analysis.finish(missed + 1);
    let section = analysis.section();
    let counted: u64 = section.classes.iter().map(|class| class.missed).sum();
    assert_eq!(counted, missed + 1);
    let outages = section.worst.iter();
    let outages: Vec<_> = outages.map(|it| (it.tick, it.ticks, it.missed)).collect();
    assert_eq!(outages, [(MISSED, 2, 2), (TICKS - 1, 1, 1)]);
    let worst = &section.worst[0];
    assert_eq!(worst.class, CannotTell);
    // From the begin of the first tick to the plant's waking, 120 us after the begin of the third.
    assert!((worst.delay_us - 2_120.0).abs() < 1e-6, "{worst:?}");
    let timeline = worst.timeline.iter();
    let timeline: Vec<_> = timeline.map(|it| (it.tick, it.stages.len())).collect();
    let stages = [4, 0, 0, 4, 4];
    assert_eq!(timeline, Vec::from_iter((MISSED - 1..).zip(stages)));
}

#[test]
fn missed_deadlines_before_the_first_state_are_an_outage() {
    let mut evidence = good();
    for tick in 0..4 {
        evidence.timings.insert(tick, TickTimings::default());
    }
    let (mut analysis, missed) = evidence.analysed();
    analysis.finish(missed);
    let outages = analysis.section().worst.into_iter();
    let outages: Vec<_> = outages.map(|it| (it.tick, it.ticks, it.missed)).collect();
    assert_eq!((missed, outages), (4, vec![(0, 4, 4)]));
}

/// What is published in a tick while one stage is stopped.
fn tick_without(stage: Role, tick: u64) -> TickTimings {
    let at_cut_off = |role: Role, is_fresh: bool| {
        let wake_us = TICK_US * role.deadline_percent() / 100 + 10;
        timing(tick, wake_us, wake_us + 5, is_fresh)
    };
    let [plant, outer, inner, mixer] = good_tick(tick);
    match stage {
        // Without a state the outer loop publishes nothing, and the inner loop holds its output. The plant finds the
        // mixer's command too late once it is back.
        Plant => {
            let late = timing(tick, TICK_US, TICK_US + 10, true);
            [None, None, at_cut_off(Inner, false), late]
        }
        Outer => [
            plant,
            None,
            at_cut_off(Inner, false),
            at_cut_off(Mixer, true),
        ],
        Inner => [plant, outer, None, at_cut_off(Mixer, false)],
        _ => [plant, outer, inner, mixer.filter(|_| false)],
    }
}

#[test]
fn a_stop_of_any_length_is_one_outage_with_all_its_ticks() {
    for (stage, ticks) in STAGES
        .into_iter()
        .flat_map(|it| [(it, 5), (it, 100), (it, 3000)])
    {
        let (first, last, end) = (MISSED, MISSED + ticks - 1, MISSED + ticks - 1 + TICKS);
        let mut evidence = good();
        evidence.timings = (0..end).map(|tick| (tick, good_tick(tick))).collect();
        evidence.samples = vec![evidence.samples[0]; end as usize / 10 + 2];
        for tick in first..=last {
            evidence.timings.insert(tick, tick_without(stage, tick));
        }
        for (sample, tick) in evidence.samples.iter_mut().zip((0..).step_by(10)) {
            (sample.from_ns, sample.at_ns) = (GRID.begin_of(tick), GRID.begin_of(tick));
            if (first..=last).contains(&tick) {
                sample.stages[stage as usize].life = Life::Stopped;
            }
        }
        let section = evidence.section();
        let [case] = &section.worst[..] else {
            panic!("{stage} for {ticks} ticks: {section:?}")
        };
        // Without the outer or the inner loop the mixer goes on, and no deadline is missed.
        let missed = ticks * u64::from(matches!(stage, Plant | Mixer));
        let outage = (case.tick, case.ticks, case.missed);
        assert_eq!(outage, (first, ticks, missed), "{stage}");
        let shown = case.timeline.iter().map(|tick| tick.tick);
        let ends = (first - 1..first + 3).chain(last - 1..last + 3);
        assert!(shown.eq(ends), "{case:?}");
        if stage == Mixer && ticks > 10 {
            // It is due when the inner loop has sent.
            assert_eq!(case.due_us, 55.0);
            let back_us = (ticks * TICK_US + 65) as f64;
            let off_us = case.due_us + case.delay_us - back_us;
            assert!(off_us.abs() < 1.0, "{case:?}");
        }
        // A stop of 5 ticks lies between two samples.
        let is_stopped = (case.class, case.stage.as_deref()) == (StoppedOrDead, Some(stage.name()));
        assert_eq!(is_stopped, ticks > 10, "{stage}, {ticks}: {case:?}");
        let longest = section.longest;
        assert_eq!(longest[stage.name()], ticks, "{longest:?}");
        assert!(!longest.contains_key(MACHINE), "{longest:?}");
    }
}

#[test]
fn outages_are_those_of_stages_that_published_nothing_and_were_seen_whole() {
    let out = good().stalled(8);
    let longest = out.section().longest;
    assert_eq!(longest.len(), 5, "every stage and the machine: {longest:?}");
    assert!(longest.values().all(|ticks| *ticks == 8), "{longest:?}");
    // The recorder lost messages.
    let mut unseen = out;
    unseen.loss = Some(loss(MISSED - 1, MISSED + 8));
    let section = unseen.section();
    assert_eq!((section.longest.len(), section.unmeasured), (0, 1));
    // A message in time that was not used is no outage of its sender.
    let section = good().mixer_at(910, 915).section();
    assert_eq!(section.classes[0].class, NotUsed);
    assert_eq!(section.longest, BTreeMap::new());
    // Neither are the ticks before a stage began and after the flight.
    let first = -MISSED.cast_signed();
    let ends = good()
        .silent(Inner, first..first + 3)
        .silent(Mixer, LAST..LAST + 1);
    assert_eq!(ends.section(), OutageSection::default());
}

/// A stage dies in the last tick, and ends the flight with it, before a sample shows it.
#[test]
fn a_stage_that_ends_the_flight_by_its_death_is_named() {
    let mut evidence = good().silent(Mixer, 0..1);
    evidence.timings.retain(|tick, _| *tick <= MISSED);
    evidence.samples.truncate(4);
    for is_dead in [true, false] {
        let (mut analysis, _) = evidence.analysed();
        analysis.ended_stages([false, false, false, is_dead], GRID.begin_of(MISSED + 4));
        analysis.miss(MISSED);
        analysis.finish(1);
        let section = analysis.section();
        let [cause] = &section.classes[..] else {
            panic!("{section:?}")
        };
        assert_eq!(cause.class == StoppedOrDead, is_dead, "{cause:?}");
        if is_dead {
            assert_eq!((cause.stage.as_deref(), cause.missed), (Some("mixer"), 1));
        }
    }
}

#[test]
fn the_last_sample_is_evidence_where_the_flight_ends_in_an_outage() {
    let mut evidence = good().stalled(20).stolen(4, 2);
    evidence.samples.truncate(5);
    let (mut analysis, missed) = evidence.analysed();
    analysis.ended_stages([false; STAGES.len()], GRID.begin_of(TICKS));
    analysis.finish(missed);
    assert_eq!(analysis.section().classes[0].class, HostStall);
}
