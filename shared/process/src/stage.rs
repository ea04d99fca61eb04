//! A stage of the chain - outer loop, inner loop, mixer: its inputs, its output, and its loop.
//!
//! Deadline first, event second: a stage waits for its input until its own deadline inside the tick. It then works with
//! the newest data it has, and its message says so. If a tick is over before the stage got to it, the tick is skipped
//! and counted. Skipped ticks are never made up for in a burst.
//!
//! One [`StageLoop`] serves all stages; a [`Stage`] says what differs. The first input is the one that wakes the stage.
//! The header passes from the input to the output.

mod continuity;
mod inputs;
mod pacer;
mod work;

use std::thread;
use std::time::Duration;

use self::continuity::{Continuity, TickPlan};
pub use self::inputs::{ActiveFaults, Input, Inputs};
use self::pacer::{Pacer, WakeReason};
pub use self::work::{Stage, StageInputs};
use crate::lead;
use crate::rt::UsageMeter;
use crate::session::{Armed, RoleSession, log_landing};
use crate::wakes::{is_first, wakes};
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, SavedState};
use faults::live::LoopFaults;
use ipc::clock::{Horizon, busy_wait, now_ns};
use ipc::error::Error;
use ipc::{Sender, WakeEvent, Wakes, Wire};
use messages::blackboards::{EndReason, RunPhase};
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::flight_plan::LOCKSTEP_PATIENCE_NS;
use messages::grid::{NS_PER_S, Pace};
use messages::header::{Header, Stamps};
use messages::history::LawState;
use messages::inspection::Expected;
use messages::role::{Channel, Replica, Role, STAGES};

/// How often a stage in lockstep looks for an input that is being delivered.
const DELIVERY_LOOK_UP: Duration = Duration::from_micros(20);

#[derive(Clone, Copy, Debug)]
pub struct Flight {
    /// Whether the ticks are not tied to the clock.
    pub lockstep: bool,
    /// How much longer than in flight a tick takes on the clock.
    pub slowdown: u64,
    pub faults: LoopFaults,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickContext {
    pub tick: u64,
    /// When the stage woke for it [ns].
    pub receive_ns: u64,
    /// How long the previous tick kept the stage busy [ns].
    pub previous_busy_ns: u64,
}

/// A stage with its ports and the faults that act on it.
pub struct StageLoop<S: Stage> {
    stage: S,
    inputs: S::Inputs,
    output: Sender<S::Output>,
    lockstep: bool,
    faults: ActiveFaults,
    slowdown: u64,
    channel: Channel,
    /// The state that the law has now.
    law_state: LawState,
    /// Nothing in lockstep, where a stage that fails ends the flight.
    continuity: Option<Continuity>,
}

impl<S: Stage> StageLoop<S> {
    /// Creates the ports. `wakes` has no receiver where that keeps to the clock.
    pub fn new(wire: &Wire, stage: S, wakes: Wakes, flight: &Flight) -> Result<Self, Error> {
        let replica = Replica::new(S::ROLE, wire.channel());
        Ok(Self {
            stage,
            inputs: S::Inputs::new(wire, S::ROLE, &flight.faults.messages)?,
            output: wire.sender(wakes)?,
            lockstep: flight.lockstep,
            faults: ActiveFaults::new(replica, flight.faults),
            slowdown: flight.slowdown,
            channel: replica.channel,
            law_state: LawState::INITIAL,
            continuity: match flight.lockstep {
                true => None,
                false => Some(Continuity::new(wire, replica)?),
            },
        })
    }

    pub fn arm(&mut self, wire: &Wire, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.faults.arm(wire)?;
        self.inputs.arm(expected)?;
        self.output.arm(expected, epoch)
    }

    /// Takes what has arrived, and returns the tick of the input that wakes the stage ([`NO_TICK`]: none yet).
    ///
    /// [`NO_TICK`]: messages::content::NO_TICK
    pub fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        let mut tick = self.inputs.take(horizon, &mut self.faults)?;
        if self.lockstep && !self.inputs.is_complete() {
            // The state reaches one receiver after the other, and the outer loop may have answered it already. A flight in
            // lockstep does not depend on when the plant lost its processor in between.
            let until_ns = now_ns() + LOCKSTEP_PATIENCE_NS;
            while !self.inputs.is_complete() && now_ns() < until_ns {
                thread::sleep(DELIVERY_LOOK_UP);
                tick = self.inputs.take(horizon, &mut self.faults)?;
            }
        }
        // Also if nothing has come: a stage may be late in a tick without a message.
        self.faults.version();
        Ok(tick)
    }

    /// Works a tick with what was taken: step, limit, publish. Says whether all inputs were of this tick.
    pub fn tick(
        &mut self,
        context: &TickContext,
        end: impl FnOnce(EndReason),
    ) -> Result<bool, Error> {
        let tick = context.tick;
        self.inputs.settle(tick);
        let fresh = self.inputs.fresh(tick);
        let law_state = &mut self.law_state;
        if let Some(continuity) = &mut self.continuity
            && continuity.plan(&mut self.stage, tick, fresh, law_state) == TickPlan::Skip
        {
            return Ok(fresh);
        }
        let inputs = self.inputs.stamped();
        let output = self.stage.work(tick, &inputs);
        let late_ns = self.faults.late_ns(tick);
        if late_ns > 0 {
            busy_wait(self.slowdown.saturating_mul(late_ns));
        }
        if let Some(output) = output {
            if let Some(reason) = self.stage.end(&output, &inputs) {
                end(reason);
            }
            let mut history = self.inputs.history(tick);
            history.previous_busy_ns = context.previous_busy_ns;
            history.stamps[S::ROLE as usize] = Stamps {
                receive_ns: context.receive_ns,
                send_ns: 0,
            };
            self.law_state.advance(tick, self.inputs.histories());
            history.law_state = self.law_state;
            self.output.send(tick, &history, output)?;
            if let Some(continuity) = &mut self.continuity {
                // Its inputs, and what they were made from.
                let before = &history.input_tick[..S::ROLE as usize];
                let is_fresh = before.iter().all(|it| *it == tick);
                continuity.publish(&mut self.stage, tick, is_fresh, &self.law_state);
            }
            self.law_state = LawState::after(tick, self.channel, self.law_state.after);
        } else if self.lockstep {
            // Nothing else wakes the next stage.
            self.output.pass(tick)?;
        }
        Ok(fresh)
    }

    /// Does what [`Self::tick`] would, with what was taken last as if it were of this tick, and changes nothing: the law
    /// works on a copy, and no message is sent. The next stage is notified of its warm-up run. False if the law cannot be
    /// copied: then neither this stage nor those after it do a warm-up run.
    fn rehearse(&mut self, tick: u64) -> Result<bool, Error> {
        let inputs = self.inputs.stamped_as_of(tick);
        let Some(output) = self.stage.rehearse(tick, &inputs) else {
            return Ok(false);
        };
        let history = self.inputs.history(tick);
        self.output.rehearse(tick, &history, output).map(|()| true)
    }

    /// Sends the last message to the next stage when the run is over.
    fn finish(&mut self, tick: u64) -> Result<(), Error> {
        self.stage
            .last_output()
            .map_or(Ok(()), |last| self.output.send(tick, &Header::new(), last))
    }
}

/// The outer loop: a setpoint from a state of this tick, and an end to a flight that is lost.
struct Outer {
    law: GuardedOuter,
    /// Distance from the reference beyond which the flight ends [m].
    position_error_max_m: f64,
}

impl Stage for Outer {
    const ROLE: Role = Role::Outer;
    type Inputs = Input<State>;
    type Output = Setpoint;

    fn work(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        self.law.tick(tick, state)
    }

    fn end(&self, setpoint: &Setpoint, state: &Stamped<State>) -> Option<EndReason> {
        let error_m = state.content.position_error_m(&setpoint.reference);
        (error_m > self.position_error_max_m).then_some(EndReason::Position)
    }

    fn rehearse(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        self.law.rehearse(tick, state)
    }

    fn save(&mut self, state: &mut SavedState) -> bool {
        self.law.save(state)
    }

    fn load(&mut self, state: &[u8]) -> bool {
        self.law.load(state)
    }
}

impl Stage for GuardedInner {
    const ROLE: Role = Role::Inner;
    type Inputs = (Input<Setpoint>, Input<State>);
    type Output = Wrench;

    fn work(&mut self, tick: u64, inputs: &StageInputs<Self>) -> Option<Wrench> {
        let (setpoint, state) = inputs;
        Some(self.tick(tick, state, setpoint))
    }

    fn rehearse(&mut self, tick: u64, inputs: &StageInputs<Self>) -> Option<Wrench> {
        let (setpoint, state) = inputs;
        Self::rehearse(self, tick, state, setpoint)
    }

    fn save(&mut self, state: &mut SavedState) -> bool {
        Self::save(self, state)
    }

    fn load(&mut self, state: &[u8]) -> bool {
        Self::load(self, state)
    }
}

impl Stage for GuardedMixer {
    const ROLE: Role = Role::Mixer;
    type Inputs = Input<Wrench>;
    type Output = RotorSpeeds;

    fn work(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> Option<RotorSpeeds> {
        Some(self.tick(tick, wrench))
    }

    fn rehearse(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> Option<RotorSpeeds> {
        Self::rehearse(self, tick, wrench)
    }

    fn last_output(&self) -> Option<RotorSpeeds> {
        Some(self.idle())
    }

    fn save(&mut self, state: &mut SavedState) -> bool {
        Self::save(self, state)
    }

    fn load(&mut self, state: &[u8]) -> bool {
        Self::load(self, state)
    }
}

pub fn outer(
    session: RoleSession,
    law: GuardedOuter,
    position_error_max_m: f64,
    flight: &Flight,
) -> Result<(), Error> {
    let stage = Outer {
        law,
        position_error_max_m,
    };
    run(stage, session, flight)
}

// Not generic, so that this crate is where the loops are compiled and optimised.

pub fn inner(session: RoleSession, law: GuardedInner, flight: &Flight) -> Result<(), Error> {
    run(law, session, flight)
}

pub fn mixer(session: RoleSession, law: GuardedMixer, flight: &Flight) -> Result<(), Error> {
    run(law, session, flight)
}

/// Flies a stage until the plant closes the run; the mixer wakes the plant in lockstep, which otherwise keeps to the clock.
pub fn run<S: Stage>(stage: S, session: RoleSession, flight: &Flight) -> Result<(), Error> {
    // These are dropped in the reverse order: real time, which `armed` holds, the ports, the wake-up event, whose alarm
    // may fire until then, and the role's lock last.
    let mut session = session;
    let (wire, rt, replica) = (session.wire(), *session.rt(), session.replica);
    let loop_cpus = rt.loop_cpus;
    let is_first = is_first(S::ROLE, loop_cpus);
    // The last stage on a processor has time for the second call when its message is out.
    let event = if S::ROLE as usize + loop_cpus >= STAGES.len() && !is_first && !flight.lockstep {
        wire.wake_event_with_alarm(replica)
    } else {
        wire.wake_event(replica)
    }?;
    let wakes = wakes(wire, replica, &rt, flight.lockstep)?;
    session.await_recorder()?;
    let mut stage = StageLoop::new(wire, stage, wakes, flight)?;
    let armed = session.join(|wire, expected, epoch| {
        if let Some(continuity) = &mut stage.continuity {
            continuity.arm(wire, replica, &rt, expected.run_id)?;
        }
        stage.arm(wire, expected, epoch)
    })?;
    if let Some(continuity) = &mut stage.continuity {
        let (first_tick, took_off) = (armed.first_tick, armed.is_from_take_off);
        continuity.begin(&mut stage.stage, first_tick, took_off, &mut stage.law_state);
        session.status.resumed_at = continuity.resumed_at;
    }
    let ticks = armed.first_tick..armed.last_tick.saturating_add(1);
    let mut pacer = Pacer::new(armed.pace, S::ROLE, ticks);
    if loop_cpus > 1 {
        pacer.poll(is_first);
    }
    if let Pace::Realtime(grid) = armed.pace {
        pacer.end_before_lead(lead::left_by(replica.channel, &rt, grid.period_ns));
    }
    let meter = UsageMeter::start();
    let flown = fly(&mut stage, &event, &mut session, &armed, &mut pacer);
    let finished = stage.finish(pacer.next_tick);
    // A flight with several channels goes on without this process.
    if flown.is_err() && rt.channels == 1 {
        session.status.wants_end = EndReason::Failed as u64;
    }
    session.land(&meter);
    if flown.is_ok() {
        log_landing(S::ROLE, &armed.run.get());
    }
    flown.and(finished)
}

fn fly<S: Stage>(
    stage: &mut StageLoop<S>,
    event: &WakeEvent,
    session: &mut RoleSession,
    armed: &Armed,
    pacer: &mut Pacer,
) -> Result<(), Error> {
    let role = S::ROLE;
    let mut previous_busy_ns = 0;
    let mut plant = PlantWatch {
        heard_ns: now_ns(),
        checked_ns: 0,
    };
    loop {
        let (tick, receive_ns) = match pacer.wait(event, |clock| stage.take(clock))? {
            WakeReason::Work { tick, receive_ns } => (tick, receive_ns),
            WakeReason::Rehearsal { tick } => {
                let is_rehearsed = stage.rehearse(tick)?;
                session.status.rehearsals += u64::from(is_rehearsed && tick > 0);
                continue;
            }
            WakeReason::Skipped => {
                // A stage below the plant may run in no tick while it waits: it does not hang.
                session.status.ticks_skipped = pacer.skipped;
                session.publish_status();
                continue;
            }
            WakeReason::Silence { tick, receive_ns } => {
                if let Some(next) = armed.run.successor() {
                    return Err(Error::failed(format!(
                        "another run has begun: a new plant (process {}) has replaced the one that this {role} \
                         process flew with; start `ironbird {role}` again",
                        next.plant_pid
                    )));
                }
                if armed.run.get().phase() == RunPhase::Closed {
                    return Ok(());
                }
                if plant.check_is_due(receive_ns) && !session.plant_lives() {
                    return Err(Error::failed("the plant died in flight"));
                }
                if armed.pace == Pace::Lockstep {
                    // The plant notices a stage that has died, and closes the run.
                    session.pass_on_stop();
                    continue;
                }
                if tick > armed.last_tick {
                    continue;
                }
                (tick, receive_ns)
            }
        };
        let context = TickContext {
            tick,
            receive_ns,
            previous_busy_ns,
        };
        let fresh = stage.tick(&context, |reason| session.request_end(reason))?;
        if fresh {
            plant.heard_ns = receive_ns;
        }
        let status = &mut session.status;
        status.ticks_run += 1;
        status.ticks_stale += u64::from(!fresh);
        status.ticks_skipped = pacer.skipped;
        status.rejections = stage.inputs.rejections();
        if let Some(continuity) = &stage.continuity {
            status.resumed_at = continuity.resumed_at;
            status.is_saved = u64::from(continuity.is_saved);
        }
        session.pass_on_stop();
        previous_busy_ns = now_ns() - receive_ns;
    }
}

/// After this long without a message that goes back to the plant, a stage checks whether the plant's process lives [ns].
const PLANT_SILENT_NS: u64 = NS_PER_S;
/// And then how often [ns]: a check opens a file, which is too slow for every tick.
const PLANT_CHECK_NS: u64 = NS_PER_S / 10;

#[derive(Clone, Copy, Debug, Default)]
struct PlantWatch {
    heard_ns: u64,
    checked_ns: u64,
}

impl PlantWatch {
    const fn check_is_due(&mut self, now_ns: u64) -> bool {
        let is_due =
            now_ns > self.heard_ns + PLANT_SILENT_NS && now_ns >= self.checked_ns + PLANT_CHECK_NS;
        if is_due {
            self.checked_ns = now_ns;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silent_plant_is_checked_ten_times_a_second() {
        let mut plant = PlantWatch::default();
        let checks = |plant: &mut PlantWatch, mut ms: std::ops::Range<u64>| {
            ms.by_ref()
                .filter(|ms| plant.check_is_due(ms * 1_000_000))
                .count()
        };
        assert_eq!(checks(&mut plant, 0..1001), 0);
        assert_eq!(checks(&mut plant, 1001..3001), 20);
        plant.heard_ns = 3_001_000_000;
        assert_eq!(checks(&mut plant, 3001..4002), 0);
    }
}
