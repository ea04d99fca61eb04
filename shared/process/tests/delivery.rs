//! The state reaches one receiver after the other: in lockstep a stage waits for what its first input was made from.

use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use faults::live::LoopFaults;
use ipc::{Sender, Wakes};
use messages::content::{Setpoint, Stamped, State, Wrench};
use messages::header::Header;
use messages::role::Role;
use messages::topic::Topic;
use process::stage::{Flight, Input, Stage, StageLoop, TickContext};

use crate::common::{EPOCH, EXPECTED, Site};

/// An inner loop that publishes nothing.
struct Inner;

impl Stage for Inner {
    const ROLE: Role = Role::Inner;
    type Inputs = (Input<Setpoint>, Input<State>);
    type Output = Wrench;

    fn work(&mut self, _: u64, _: &(Stamped<Setpoint>, Stamped<State>)) -> Option<Wrench> {
        None
    }
}

fn arm<C: Topic>(sender: &mut Sender<C>) {
    sender.arm(EXPECTED, EPOCH).unwrap();
}

#[test]
fn in_lockstep_a_setpoint_waits_for_its_state() {
    let (lockstep_ticks, ticks) = (0..20_u64, 20..22);
    for (lockstep, ticks) in [(true, lockstep_ticks), (false, ticks)] {
        let site = Site::new();
        let wire = site.wire();
        let flight = Flight {
            lockstep,
            slowdown: 1,
            faults: LoopFaults::none(7, 1_000_000),
        };
        let mut inner = StageLoop::new(&wire, Inner, Wakes::default(), &flight).unwrap();
        let mut setpoints = wire.sender::<Setpoint>(Wakes::default()).unwrap();
        arm(&mut setpoints);
        thread::scope(|scope| {
            let (made, is_made) = mpsc::channel();
            let (send, to_send) = mpsc::channel();
            let site = &site;
            scope.spawn(move || {
                let wire = site.wire();
                let mut states = wire.sender::<State>(Wakes::default()).unwrap();
                arm(&mut states);
                made.send(()).unwrap();
                to_send.recv().unwrap();
                arm(&mut states);
                made.send(()).unwrap();
                for tick in to_send {
                    // So that the setpoint has been received long before.
                    thread::sleep(Duration::from_millis(2));
                    states.send(tick, &Header::new(), State::default()).unwrap();
                    made.send(()).unwrap();
                }
            });
            is_made.recv().unwrap();
            inner.arm(&wire, EXPECTED, EPOCH).unwrap();
            arm(&mut setpoints);
            send.send(0).unwrap();
            is_made.recv().unwrap();
            for tick in ticks {
                setpoints
                    .send(tick, &Header::new(), Setpoint::default())
                    .unwrap();
                send.send(tick).unwrap();
                assert_eq!(inner.take(u64::MAX - 1).unwrap(), tick);
                let context = TickContext {
                    tick,
                    receive_ns: 0,
                    previous_busy_ns: 0,
                };
                // On the clock a state that comes late is stale.
                assert_eq!(inner.tick(&context, |_| ()).unwrap(), lockstep, "{tick}");
                is_made.recv().unwrap();
            }
            drop(send);
        });
    }
}
