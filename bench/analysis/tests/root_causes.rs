//! Root causes of missed deadlines, from made-up timings, counters and processor traces.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;
use std::ops::Range;

use MissCause::{CannotTell, NotUsed, StoppedOrDead};
use Role::{Inner, Mixer, Outer, Plant};
use analysis::miss_analysis::{AROUND_TICKS, MissAnalysis};
use analysis::miss_causes::{MissCause, OBSERVATIONS, classify};
use analysis::observations::{
    CounterSample, Counters, Life, Observations, Outage, StageTiming, TickTimings,
};
use analysis::outages::OutageSection;
use analysis::processor_trace::{Runner, Slice};
use analysis::schema::MACHINE;
use messages::content::{Loss, RotorSpeeds, Setpoint, State, Wrench};
use messages::grid::Grid;
use messages::header::{Header, Message, Stamps};
use messages::role::{Role, STAGES};
use messages::topic::Topic;

const US: u64 = 1_000;
const TICK_US: u64 = 1_000;
const GRID: Grid = Grid {
    t0_ns: 50 * TICK_US * US,
    period_ns: TICK_US * US,
};
/// The first tick whose deadline is missed.
const MISSED: u64 = 32;
const TICKS: u64 = 2 * AROUND_TICKS;

/// Timings and counters of a flight; a test changes those of a good one.
#[derive(Clone)]
struct Evidence {
    timings: BTreeMap<u64, TickTimings>,
    samples: Vec<CounterSample>,
    slices: Vec<Slice>,
    loss: Option<Loss>,
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
    // In every tick a stage waits 30 us for others on its processor, and is switched out once.
    let counters = |i: u64, stage: usize| Counters {
        pid: 100 + stage as u64,
        waited_ns: i * 300 * US,
        ran_ns: i * 50 * US,
        involuntary_switches: 10 * i,
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

impl Evidence {
    fn stage(&mut self, tick: u64, role: Role) -> &mut Option<StageTiming> {
        &mut self.timings.get_mut(&tick).unwrap()[role as usize]
    }

    /// A stage wakes later [us], and all stages after it with it.
    fn delays(&mut self, tick: u64, role: Role, us: u64) {
        for stage in &mut self.timings.get_mut(&tick).unwrap()[role as usize..] {
            let timing = stage.as_mut().unwrap();
            timing.receive_ns += us * US;
            timing.send_ns += us * US;
        }
    }

    fn silence(&mut self, ticks: Range<u64>) {
        self.timings.retain(|tick, _| !ticks.contains(tick));
    }

    fn silence_of(&mut self, role: Role, ticks: Range<u64>) {
        ticks.for_each(|tick| *self.stage(tick, role) = None);
    }

    /// Changes samples from one on: the fourth is the first after the begin of the missed tick.
    fn sampled(&mut self, from: usize, change: impl Fn(&mut CounterSample)) {
        self.samples[from..].iter_mut().for_each(change);
    }

    fn counted(&mut self, from: usize, role: Role, change: impl Fn(&mut Counters)) {
        self.sampled(from, |sample| change(&mut sample.stages[role as usize]));
    }

    /// Applies a change of `root_causes.txt`.
    fn apply(&mut self, change: &str) {
        let words: Vec<&str> = change.split_whitespace().collect();
        let number = |i: usize| words[i].parse::<u64>().unwrap();
        let tick = |i: usize| MISSED.strict_add_signed(words[i].parse().unwrap());
        let role = |i: usize| stage(words[i]).unwrap();
        match words[0] {
            "good" => {}
            "stall" => {
                self.silence(MISSED..MISSED + number(1));
                self.delays(MISSED + number(1), Plant, 100);
            }
            "gone" => *self.stage(tick(2), role(1)) = None,
            "silent" => self.silence_of(role(1), MISSED..MISSED + number(2)),
            "late" => self.delays(tick(2), role(1), number(3)),
            "computes" => {
                // The stages after it are later.
                self.stage(tick(2), role(1)).as_mut().unwrap().send_ns += number(3) * US;
                if let Some(next) = STAGES.get(role(1) as usize + 1) {
                    self.delays(tick(2), *next, number(3));
                }
            }
            "sends-later" => {
                self.stage(tick(2), role(1)).as_mut().unwrap().send_ns += number(3) * US
            }
            // Without what the inner loop has sent.
            "mixer-at" => {
                *self.stage(tick(1), Mixer) = timing(tick(1), number(2), number(3), false)
            }
            "stolen" => self.sampled(number(1) as usize, |it| it.stolen = number(2)),
            "throttled" => self.counted(number(1) as usize, role(2), |it| {
                it.throttled_us += number(3)
            }),
            "lost" => self.loss = Some(loss(tick(1), tick(2))),
            "faults" => self.counted(number(1) as usize, role(2), |it| it.faults += number(3)),
            "waited" => self.counted(number(1) as usize, role(2), |it| {
                it.waited_ns += number(3) * US
            }),
            "ran" => self.counted(number(1) as usize, role(2), |it| {
                it.ran_ns += number(3) * US
            }),
            "switched" => self.counted(4, role(1), |it| it.involuntary_switches += 1),
            "stopped" => self.samples[4].stages[role(1) as usize].life = Life::Stopped,
            "dead" => self.counted(4, role(1), |it| it.life = Life::Dead),
            "replaced" => self.counted(5, role(1), |it| {
                *it = Counters {
                    pid: 900,
                    ..Counters::default()
                };
            }),
            "read" => {
                let sample = &mut self.samples[number(1) as usize];
                (sample.from_ns, sample.at_ns) = (GRID.begin_of(tick(2)), GRID.begin_of(tick(3)));
            }
            "apart" => self.share_processor = false,
            other => panic!("no change `{other}`"),
        }
    }

    /// Asserts the cause of the outage that begins with the missed tick.
    #[track_caller]
    fn is(&self, case: &str, class: &str, stage: Option<Role>, evidence: &str) {
        let is_whole = |tick: &u64| {
            let is_fresh = |stage: &Option<StageTiming>| stage.is_some_and(|it| it.is_fresh);
            let stages = self.timings.get(tick);
            stages.is_some_and(|stages| stages.iter().all(is_fresh))
        };
        let outage = (MISSED..TICKS).take_while(|tick| *tick == MISSED || !is_whole(tick));
        let sent = self.timings.values().flatten().flatten();
        let cause = classify(&Observations {
            grid: GRID,
            outage: Outage {
                first: MISSED,
                last: outage.last().unwrap(),
                missed: 1,
            },
            messages_lost: self.loss.is_some(),
            timings: &self.timings,
            samples: &self.samples,
            slices: &self.slices,
            until_ns: sent.map(|timing| timing.send_ns).max().unwrap(),
            share_processor: self.share_processor,
        });
        let said = &cause.evidence;
        let found = format!("{:?}", cause.class);
        assert_eq!((&*found, cause.stage), (class, stage), "{case}: {said}");
        assert!(
            said.contains(evidence),
            "{case}: no `{evidence}` in `{said}`"
        );
    }

    /// Feeds an analysis as the recorder does; gives the deadlines missed before the last state, too.
    fn analysed(&self) -> (MissAnalysis, u64) {
        let mut analysis = MissAnalysis::new(GRID, true);
        self.loss.iter().for_each(|loss| analysis.loss(loss));
        let mut samples = self.samples.iter().peekable();
        let (mut missed, mut judged) = (0, 0);
        for (tick, stages) in &self.timings {
            while let Some(sample) = samples.next_if(|it| it.at_ns <= GRID.begin_of(*tick)) {
                analysis.sample(*sample);
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
                let mut content = State::default();
                // At the begin of each tick since its last state, the plant looks for the command of the tick before.
                for begun in judged + 1..=*tick {
                    let before = self.timings.get(&(begun - 1));
                    let command = before.and_then(|stages| stages[Mixer as usize]);
                    if command.is_some_and(|it| it.send_ns <= GRID.begin_of(begun)) {
                        content.deadline_miss_run = 0;
                    } else {
                        content.deadline_miss_run += 1;
                        missed += 1;
                        analysis.miss(begun - 1);
                    }
                }
                judged = *tick;
                content.deadlines_missed = missed;
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

/// The stage of a name; none of `-`.
fn stage(name: &str) -> Option<Role> {
    STAGES.into_iter().find(|role| role.name() == name)
}

#[test]
fn each_case_has_its_cause() {
    let cases = include_str!("root_causes.txt");
    for (cause, _) in OBSERVATIONS {
        assert!(cases.contains(&format!("| {cause:?}")), "{cause:?}");
    }
    let lines = cases.lines();
    for case in lines.filter(|line| !line.starts_with('#')) {
        let (changes, expected) = case.split_once(" | ").unwrap();
        let mut evidence = good();
        changes
            .split(", ")
            .for_each(|change| evidence.apply(change));
        let mut expected = expected.splitn(3, ' ');
        let mut next = || expected.next().unwrap();
        evidence.is(case, next(), stage(next()), next());
    }
}

#[test]
fn a_trace_shows_which_thread_ran_instead() {
    let thread = |pid: u64, priority: u64| Runner::Thread {
        pid,
        priority,
        name: "hog".into(),
    };
    // The plant's own priority is known from a slice of ten ticks before.
    let traced = |slices: &[(u64, u64, Runner)]| {
        let mut late = good();
        late.silence(MISSED..MISSED + 1);
        late.delays(MISSED + 1, Plant, 800);
        let slice = |tick: u64, from_us: u64, to_us: u64, runner| Slice {
            from_ns: GRID.begin_of(tick) + from_us * US,
            to_ns: GRID.begin_of(tick) + to_us * US,
            runner,
        };
        late.slices.push(slice(MISSED - 10, 0, 1, thread(100, 19)));
        for (from_us, to_us, runner) in slices.iter().cloned() {
            late.slices.push(slice(MISSED, from_us, to_us, runner));
        }
        late
    };
    let urgent = "interrupts, or a thread at least as urgent, had the processor; meanwhile ran";
    let hogged = traced(&[(0, 200, Runner::Idle), (200, 1_820, thread(4711, 0))]);
    let words = format!("{urgent} hog (4711) 1620 us, idle 200 us");
    hogged.is("hogged", "Preempted", Some(Plant), &words);
    let timer = Runner::Interrupt {
        name: "softirq TIMER".into(),
    };
    let interrupted = traced(&[(0, 1_820, Runner::Idle), (0, 1_820, timer)]);
    interrupted.is("interrupted", "Preempted", Some(Plant), urgent);
    // The plant itself, the idle task and a less urgent thread keep no stage from the processor.
    for runner in [thread(100, 19), Runner::Idle, thread(4711, 120)] {
        let words = "nothing observed says why; meanwhile ran";
        traced(&[(0, 1_820, runner)]).is("other", "CannotTell", Some(Plant), words);
    }
}

#[test]
fn every_missed_deadline_is_in_one_outage() {
    let mut evidence = good();
    // The plant, and with it every stage, wakes 2.1 ms late: two ticks are skipped.
    evidence.apply("stall 2");
    // The last command of all never comes.
    evidence.silence_of(Mixer, TICKS - 1..TICKS);
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
    let out = || {
        let mut evidence = good();
        let silent = (MISSED..MISSED + 8).map(|tick| (tick, TickTimings::default()));
        evidence.timings.extend(silent);
        evidence
    };
    let longest = out().section().longest;
    assert_eq!(longest.len(), 5, "every stage and the machine: {longest:?}");
    assert!(longest.values().all(|ticks| *ticks == 8), "{longest:?}");
    // The recorder lost messages.
    let mut unseen = out();
    unseen.loss = Some(loss(MISSED - 1, MISSED + 8));
    let section = unseen.section();
    assert_eq!((section.longest.len(), section.unmeasured), (0, 1));
    // A message in time that was not used is no outage of its sender.
    let mut unused = good();
    for tick in MISSED..MISSED + 8 {
        *unused.stage(tick, Mixer) = timing(tick, 910, 915, false);
    }
    let section = unused.section();
    assert_eq!(section.classes[0].class, NotUsed);
    assert_eq!(section.longest, BTreeMap::new());
    // Neither are the ticks before a stage began and after the flight.
    let mut ends = good();
    ends.silence_of(Inner, 0..3);
    ends.silence_of(Mixer, TICKS - 1..TICKS);
    assert_eq!(ends.section(), OutageSection::default());
}

/// A stage dies in the last tick, and ends the flight with it, before a sample shows it.
#[test]
fn a_stage_that_ends_the_flight_by_its_death_is_named() {
    let mut evidence = good();
    evidence.timings.retain(|tick, _| *tick <= MISSED);
    evidence.silence_of(Mixer, MISSED..MISSED + 1);
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
    let mut evidence = good();
    evidence.apply("stall 20");
    evidence.apply("stolen 4 2");
    evidence.samples.truncate(5);
    let (mut analysis, missed) = evidence.analysed();
    analysis.ended_stages([false; STAGES.len()], GRID.begin_of(TICKS));
    analysis.finish(missed);
    assert_eq!(analysis.section().classes[0].class, MissCause::HostStall);
}
