//! Injected faults act like planned ones: in a stage that is late, that has stalled, or after a gap.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use faults::grammar::Fault;
use faults::live::{LIVE, LiveBlackboard, LiveFault, LoopFaults, NOTICE_TICKS};
use ipc::{Blackboard, Sender, Wakes, Wire};
use messages::content::{RotorSpeeds, Stamped, Wrench};
use messages::header::Header;
use messages::role::Role;
use process::stage::{Flight, Input, Stage, StageLoop, TickContext};

use crate::common::{EPOCH, EXPECTED, Site};

/// Ticks and thrusts of the inputs that a stage has worked with.
type Worked = Vec<(u64, f64)>;

/// A mixer that records its inputs.
struct Recorder(Rc<RefCell<Worked>>);

impl Stage for Recorder {
    const ROLE: Role = Role::Mixer;
    type Inputs = Input<Wrench>;
    type Output = RotorSpeeds;

    fn work(&mut self, _tick: u64, wrench: &Stamped<Wrench>) -> Option<RotorSpeeds> {
        let thrust_n = wrench.content.thrust_n;
        self.0.borrow_mut().push((wrench.tick, thrust_n));
        None
    }
}

/// A stage in flight, its sender, and the plant's blackboard.
struct Chain {
    stage: StageLoop<Recorder>,
    worked: Rc<RefCell<Worked>>,
    sender: Sender<Wrench>,
    board: Blackboard<LiveBlackboard>,
}

impl Chain {
    fn new(wire: &Wire, planned: &[LiveFault]) -> Self {
        let mut faults = LoopFaults::none(7, 1_000_000);
        planned.iter().for_each(|fault| faults.take(fault).unwrap());
        let board = wire.blackboard(LIVE).unwrap();
        board.put(LiveBlackboard::default());
        let flight = Flight {
            lockstep: false,
            slowdown: 1,
            faults,
        };
        let worked = Rc::default();
        let mut sender = wire.sender(Wakes::default()).unwrap();
        let mut stage = StageLoop::new(
            wire,
            Recorder(Rc::clone(&worked)),
            Wakes::default(),
            &flight,
        )
        .unwrap();
        sender.arm(EXPECTED, EPOCH).unwrap();
        stage.arm(wire, EXPECTED, EPOCH).unwrap();
        sender.arm(EXPECTED, EPOCH).unwrap();
        Self {
            stage,
            worked,
            sender,
            board,
        }
    }
}

fn work(stage: &mut StageLoop<Recorder>, tick: u64) {
    let context = TickContext {
        tick,
        receive_ns: 0,
        previous_busy_ns: 0,
    };
    stage.tick(&context, |_| ()).unwrap();
}

fn send(sender: &mut Sender<Wrench>, tick: u64) {
    let content = Wrench {
        thrust_n: tick as f64,
        ..Wrench::default()
    };
    sender.send(tick, &Header::new(), content).unwrap();
}

fn board_of(faults: &[LiveFault]) -> LiveBlackboard {
    let mut board = LiveBlackboard::default();
    faults.iter().for_each(|fault| board.push(fault).unwrap());
    board
}

/// A fault of the wrench, as it is typed after `mixer.wrench.`.
fn fault(text: &str) -> LiveFault {
    let fault: Fault = format!("mixer.wrench.{text}").parse().unwrap();
    let span = fault.span(1e-3).unwrap();
    fault.changes[0].faults(span).next().unwrap()
}

/// The inputs of a stage that works in some ticks, of messages that are sent in some; faults are planned, or injected.
fn worked(
    faults: &[LiveFault],
    is_live: bool,
    sends: fn(u64) -> bool,
    works: fn(u64) -> bool,
) -> Worked {
    let site = Site::new();
    let mut chain = Chain::new(&site.wire(), if is_live { &[] } else { faults });
    let first = faults.iter().map(|fault| fault.span.from).min().unwrap();
    for tick in 0..first + 60 {
        if is_live && tick + NOTICE_TICKS == first {
            chain.board.put(board_of(faults));
        }
        if sends(tick) {
            send(&mut chain.sender, tick);
        }
        if works(tick) {
            chain.stage.take(tick + 1).unwrap();
            work(&mut chain.stage, tick);
        }
    }
    chain.worked.take()
}

#[test]
fn injected_faults_act_like_planned_ones_in_a_late_stage_and_after_a_gap() {
    let odd: fn(u64) -> bool = |tick| tick % 2 == 1;
    let gap: fn(u64) -> bool = |tick| !(20..100).contains(&tick);
    let lag = [(101, 98.0), (103, 100.0), (105, 102.0)];
    // A freeze repeats what came long before it was injected.
    let freeze = [(19, 19.0), (100, 19.0), (101, 19.0)];
    for (faults, sends, works, expected) in [
        (
            vec![fault("lag=3@tick100..tick130")],
            None,
            odd,
            Some((50, lag)),
        ),
        (vec![fault("delay=3@tick100")], None, odd, None),
        (
            vec![
                fault("freeze@tick101..tick120"),
                fault("thrust_n.bias=0.25@tick101..tick140"),
            ],
            None,
            odd,
            None,
        ),
        (
            vec![fault("freeze@tick100..tick120")],
            Some(gap),
            |_| true,
            Some((99, freeze)),
        ),
    ] {
        let sends = sends.unwrap_or(|_| true);
        let [planned, injected] =
            [false, true].map(|is_live| worked(&faults, is_live, sends, works));
        assert_eq!(planned, injected, "{faults:?}");
        if let Some((at, expected)) = expected {
            assert_eq!(injected[at..at + 3], expected);
        }
    }
}

#[test]
fn a_stage_that_stalls_while_it_receives_uses_no_message_without_the_faults_of_its_tick() {
    let site = Site::new();
    let wire = site.wire();
    let mut chain = Chain::new(&wire, &[]);
    let (sender, stalls) = (RefCell::new(chain.sender), Cell::new(true));
    send(&mut sender.borrow_mut(), 0);
    // Called after the first message was received: while the stage stalls, the flight goes on and a fault is injected.
    let meanwhile = || {
        if stalls.replace(false) {
            let bias = fault(&format!("thrust_n.bias=0.5@tick{NOTICE_TICKS}..tick90"));
            chain.board.put(board_of(&[bias]));
            (1..=80).for_each(|tick| send(&mut sender.borrow_mut(), tick));
        }
        u64::MAX - 1
    };
    chain.stage.take(meanwhile).unwrap();
    work(&mut chain.stage, 80);
    assert_eq!(chain.worked.take(), [(80, 80.5)]);
}
