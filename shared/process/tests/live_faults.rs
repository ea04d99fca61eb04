//! What was injected meets messages as what was planned: in a stage that is late, that was away, that has heard nothing.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use faults::live::{FaultKind, LIVE, LiveBlackboard, LiveFault, LoopFaults, NOTICE_TICKS};
use faults::{Kind, Place, Port, Span};
use ipc::{Blackboard, Sender, Wire};
use messages::content::{RotorSpeeds, Stamped, Wrench};
use messages::header::Header;
use messages::role::Role;
use process::shell::{Flight, Input, Job, Made, Shell};
use process::stage::{Stage as _, TickContext};

use crate::common::{EPOCH, EXPECTED, Site};

const THRUST: Place = Place {
    field: 0,
    axis: None,
};

/// Ticks and thrusts of what a stage has worked with.
type Had = Vec<(u64, f64)>;

/// A mixer that remembers what it had.
struct Witness(Rc<RefCell<Had>>);

impl Job for Witness {
    const ROLE: Role = Role::Mixer;
    type Inputs = Input<Wrench>;
    type Output = RotorSpeeds;

    fn work(&mut self, _tick: u64, wrench: &Stamped<Wrench>) -> Made<RotorSpeeds> {
        self.0
            .borrow_mut()
            .push((wrench.tick, wrench.content.thrust_n));
        Made {
            output: None,
            wants_end: None,
        }
    }

    fn rehearse(&mut self, _tick: u64, _wrench: &Stamped<Wrench>) -> Option<RotorSpeeds> {
        None
    }
}

/// A stage in flight, with who sends to it and the plant's board.
struct Post {
    shell: Shell<Witness>,
    had: Rc<RefCell<Had>>,
    sender: Sender<Wrench>,
    board: Blackboard<LiveBlackboard>,
}

impl Post {
    fn new(wire: &Wire, planned: &[LiveFault]) -> Self {
        let mut faults = LoopFaults::none(7);
        planned.iter().for_each(|fault| faults.take(fault).unwrap());
        let (had, board, mut sender) = (
            Rc::default(),
            wire.blackboard(LIVE).unwrap(),
            wire.sender(None).unwrap(),
        );
        board.put(LiveBlackboard::default());
        let flight = Flight {
            lockstep: false,
            slowdown: 1,
            faults,
        };
        let mut shell = Shell::of_flight(wire, Witness(Rc::clone(&had)), None, &flight).unwrap();
        sender.arm(EXPECTED, EPOCH).unwrap();
        shell.arm(wire, EXPECTED, EPOCH).unwrap();
        sender.arm(EXPECTED, EPOCH).unwrap();
        Self {
            shell,
            had,
            sender,
            board,
        }
    }

    fn work(&mut self, tick: u64) {
        self.shell.take(tick).unwrap();
        work(&mut self.shell, tick);
    }
}

fn work(shell: &mut Shell<Witness>, tick: u64) {
    let context = TickContext {
        tick,
        receive_ns: 0,
        previous_busy_ns: 0,
    };
    shell.tick(&context, &mut |_| ()).unwrap();
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

fn fault(kind: Kind, from: u64, to: u64) -> LiveFault {
    LiveFault {
        kind: FaultKind::Messages {
            port: Port::MixerWrench,
            kind,
        },
        ends: false,
        span: Span { from, to },
    }
}

/// What a stage has that works in some ticks, of messages that are sent in some; faults are planned, or injected.
fn had(faults: &[LiveFault], is_live: bool, sends: fn(u64) -> bool, works: fn(u64) -> bool) -> Had {
    let site = Site::new();
    let wire = site.wire();
    let mut place = Post::new(&wire, if is_live { &[] } else { faults });
    let first = faults.iter().map(|fault| fault.span.from).min().unwrap();
    for tick in 0..first + 60 {
        if is_live && tick + NOTICE_TICKS == first {
            place.board.put(board_of(faults));
        }
        if sends(tick) {
            send(&mut place.sender, tick);
        }
        if works(tick) {
            place.work(tick);
        }
    }
    place.had.take()
}

#[test]
fn a_late_stage_has_what_it_would_have_if_the_fault_had_been_planned() {
    for faults in [
        vec![fault(Kind::Lag(3), 100, 130)],
        vec![fault(Kind::Delay(3), 100, Span::FOR_GOOD)],
        vec![
            fault(Kind::Freeze, 101, 120),
            fault(Kind::Bias(THRUST, 0.25), 101, 140),
        ],
    ] {
        let [planned, injected] =
            [false, true].map(|is_live| had(&faults, is_live, |_| true, |tick| tick % 2 == 1));
        assert_eq!(planned, injected, "{faults:?}");
    }
    let lags = had(
        &[fault(Kind::Lag(3), 100, 130)],
        true,
        |_| true,
        |tick| tick % 2 == 1,
    );
    assert_eq!(lags[50..53], [(101, 98.0), (103, 100.0), (105, 102.0)]);
}

#[test]
fn a_freeze_repeats_what_came_long_before_it_was_injected() {
    let faults = [fault(Kind::Freeze, 100, 120)];
    let sends = |tick| !(20..100).contains(&tick);
    let [planned, injected] = [false, true].map(|is_live| had(&faults, is_live, sends, |_| true));
    assert_eq!(injected[99..102], [(19, 19.0), (100, 19.0), (101, 19.0)]);
    assert_eq!(planned, injected);
}

#[test]
fn a_stage_that_is_away_with_its_hand_at_the_port_uses_no_message_that_a_fault_strikes() {
    let site = Site::new();
    let wire = site.wire();
    let Post {
        mut shell,
        had,
        sender,
        board,
    } = Post::new(&wire, &[]);
    let (sender, is_away) = (RefCell::new(sender), Cell::new(true));
    send(&mut sender.borrow_mut(), 0);
    // Asked with the first message in hand: while the stage is away the flight goes on, and a fault is injected.
    let meanwhile = || {
        if is_away.replace(false) {
            board.put(board_of(&[fault(
                Kind::Bias(THRUST, 0.5),
                NOTICE_TICKS,
                90,
            )]));
            (1..=80).for_each(|tick| send(&mut sender.borrow_mut(), tick));
        }
        u64::MAX - 1
    };
    shell.take(meanwhile).unwrap();
    work(&mut shell, 80);
    assert_eq!(had.take(), [(80, 80.5)]);
}
