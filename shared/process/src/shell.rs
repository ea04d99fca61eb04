//! The process shell of a stage: its inputs, its output, and their envelopes.
//!
//! One shell serves the outer loop, the inner loop and the mixer. A [`Job`] says what differs: the role, its inputs and
//! its output. The first input is the one that wakes the stage. The envelope passes from the input to the output.

mod inputs;
mod troubles;

use control_api::{GuardedInner, GuardedMixer, GuardedOuter};
use faults::live::LoopFaults;
use ipc::clock::{Horizon, busy_wait};
use ipc::error::Error;
use ipc::{Sender, Wire};
use messages::blackboards::EndReason;
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::{Header, Stamps};
use messages::inspection::{Expected, Rejections};
use messages::role::Role;
use messages::topic::Topic;

pub use self::inputs::{Input, Inputs};
pub use self::troubles::ActiveFaults;
use crate::session::RoleSession;
use crate::stage::{self, Stage, TickContext, TickOutcome};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Made<C> {
    /// What is published; nothing where there is nothing new to say.
    pub output: Option<C>,
    pub wants_end: Option<EndReason>,
}

pub trait Job {
    const ROLE: Role;
    type Inputs: Inputs;
    type Output: Topic;

    /// Works a tick with the newest inputs, of whatever tick.
    fn work(&mut self, tick: u64, inputs: &<Self::Inputs as Inputs>::Stamped)
    -> Made<Self::Output>;

    /// What [`Self::work`] would publish; nothing where the law cannot be copied. It changes nothing.
    fn rehearse(
        &mut self,
        tick: u64,
        inputs: &<Self::Inputs as Inputs>::Stamped,
    ) -> Option<Self::Output>;

    /// As [`Stage::estimates`].
    fn estimates(&self) -> Option<[f64; 3]> {
        None
    }

    /// As [`Stage::resume`].
    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        let _ = estimates;
        false
    }

    fn last_word(&self) -> Option<Self::Output> {
        None
    }
}

pub struct Shell<J: Job> {
    job: J,
    inputs: J::Inputs,
    output: Sender<J::Output>,
    /// Whether the next stage is told of a tick without an output: in lockstep nothing else tells it.
    tells_silence: bool,
    troubles: ActiveFaults,
    slowdown: u64,
}

impl<J: Job> Shell<J> {
    /// Makes the ports. `wakes` is the role that waits for the output; none if the receiver keeps to the clock.
    pub fn new(wire: &Wire, job: J, wakes: Option<Role>) -> Result<Self, Error> {
        Self::of_flight(
            wire,
            job,
            wakes,
            &Flight {
                lockstep: false,
                slowdown: 1,
                faults: LoopFaults::none(0),
            },
        )
    }

    /// The same in a flight whose messages may have faults.
    pub fn of_flight(
        wire: &Wire,
        job: J,
        wakes: Option<Role>,
        flight: &Flight,
    ) -> Result<Self, Error> {
        let bell = wakes.map(|role| wire.bell(role)).transpose()?;
        let inputs = J::Inputs::new(wire, J::ROLE, &flight.faults.messages)?;
        let (tells_silence, output) = (flight.lockstep, wire.sender(bell)?);
        let troubles = ActiveFaults::planned(J::ROLE, flight.faults);
        Ok(Self {
            job,
            inputs,
            output,
            tells_silence,
            troubles,
            slowdown: flight.slowdown,
        })
    }

    fn be_late(&self, tick: u64) {
        let late_ns = self.troubles.late_ns(tick);
        if late_ns > 0 {
            busy_wait(self.slowdown.saturating_mul(late_ns));
        }
    }
}

impl<J: Job> Stage for Shell<J> {
    const ROLE: Role = J::ROLE;

    fn arm(&mut self, wire: &Wire, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.troubles.arm(wire)?;
        self.inputs.arm(expected)?;
        self.output.arm(expected, epoch)
    }

    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        let tick = self.inputs.take(horizon, &mut self.troubles)?;
        // Also where nothing has come: a stage may be late in a tick without a message.
        self.troubles.version();
        Ok(tick)
    }

    fn tick(
        &mut self,
        turn: &TickContext,
        end: &mut dyn FnMut(EndReason),
    ) -> Result<TickOutcome, Error> {
        self.inputs.settle(turn.tick);
        let stale = !self.inputs.fresh(turn.tick);
        let Made { output, wants_end } = self.job.work(turn.tick, &self.inputs.dated());
        self.be_late(turn.tick);
        wants_end.into_iter().for_each(end);
        if let Some(output) = output {
            let mut history = self.inputs.history(turn.tick);
            history.previous_busy_ns = turn.previous_busy_ns;
            history.stamps[J::ROLE as usize] = Stamps {
                receive_ns: turn.receive_ns,
                send_ns: 0,
            };
            self.output.send(turn.tick, &history, output)?;
        } else if self.tells_silence {
            self.output.pass(turn.tick)?;
        }
        Ok(TickOutcome { stale })
    }

    fn rehearse(&mut self, tick: u64) -> Result<bool, Error> {
        let Some(output) = self.job.rehearse(tick, &self.inputs.dated_as_of(tick)) else {
            return Ok(false);
        };
        self.output
            .rehearse(tick, &self.inputs.history(tick), output)
            .map(|()| true)
    }

    fn finish(&mut self, tick: u64) -> Result<(), Error> {
        self.job
            .last_word()
            .map_or(Ok(()), |last| self.output.send(tick, &Header::new(), last))
    }

    fn rejections(&self) -> Rejections {
        self.inputs.rejections()
    }

    fn estimates(&self) -> Option<[f64; 3]> {
        self.job.estimates()
    }

    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        self.job.resume(estimates)
    }
}

/// The outer loop's job: a set-point from a state of this tick, and an end to a flight that is lost.
pub struct OuterJob {
    pub stage: GuardedOuter,
    /// Distance from the reference beyond which the flight ends [m].
    pub position_error_max_m: f64,
}

impl Job for OuterJob {
    const ROLE: Role = Role::Outer;
    type Inputs = Input<State>;
    type Output = Setpoint;

    fn work(&mut self, tick: u64, state: &Stamped<State>) -> Made<Setpoint> {
        let output = self.stage.tick(tick, state);
        let is_lost = |setpoint: Setpoint| {
            setpoint.position_error_m(&state.content) > self.position_error_max_m
        };
        Made {
            output,
            wants_end: output.is_some_and(is_lost).then_some(EndReason::Position),
        }
    }

    fn rehearse(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        self.stage.rehearse(tick, state)
    }
}

impl Job for GuardedInner {
    const ROLE: Role = Role::Inner;
    type Inputs = (Input<Setpoint>, Input<State>);
    type Output = Wrench;

    fn work(
        &mut self,
        tick: u64,
        (setpoint, state): &(Stamped<Setpoint>, Stamped<State>),
    ) -> Made<Wrench> {
        Made {
            output: Some(self.tick(tick, state, setpoint)),
            wants_end: None,
        }
    }

    fn rehearse(
        &mut self,
        tick: u64,
        (setpoint, state): &(Stamped<Setpoint>, Stamped<State>),
    ) -> Option<Wrench> {
        Self::rehearse(self, tick, state, setpoint)
    }

    fn estimates(&self) -> Option<[f64; 3]> {
        Self::estimates(self)
    }

    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        Self::resume(self, estimates)
    }
}

impl Job for GuardedMixer {
    const ROLE: Role = Role::Mixer;
    type Inputs = Input<Wrench>;
    type Output = RotorSpeeds;

    fn work(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> Made<RotorSpeeds> {
        Made {
            output: Some(self.tick(tick, wrench)),
            wants_end: None,
        }
    }

    fn rehearse(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> Option<RotorSpeeds> {
        Self::rehearse(self, tick, wrench)
    }

    fn last_word(&self) -> Option<RotorSpeeds> {
        Some(self.idle())
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Flight {
    /// Whether the ticks are not tied to the clock.
    pub lockstep: bool,
    /// How much longer than in flight a tick takes on the clock.
    pub slowdown: u64,
    pub faults: LoopFaults,
}

pub fn outer(
    station: RoleSession,
    outer: GuardedOuter,
    position_error_max_m: f64,
    flight: &Flight,
) -> Result<(), Error> {
    let doorbell = station.wire().doorbell(Role::Outer)?;
    let job = OuterJob {
        stage: outer,
        position_error_max_m,
    };
    let shell = Shell::of_flight(station.wire(), job, Some(Role::Inner), flight)?;
    stage::run(shell, doorbell, station)
}

pub fn inner(station: RoleSession, inner: GuardedInner, flight: &Flight) -> Result<(), Error> {
    let doorbell = station.wire().doorbell(Role::Inner)?;
    let shell = Shell::of_flight(station.wire(), inner, Some(Role::Mixer), flight)?;
    stage::run(shell, doorbell, station)
}

/// Flies a mixer until the plant closes the run; it wakes the plant in lockstep, which otherwise wakes by itself.
pub fn mixer(station: RoleSession, mixer: GuardedMixer, flight: &Flight) -> Result<(), Error> {
    let (wire, lockstep) = (station.wire(), flight.lockstep);
    // The last stage of the chain has time for the second call when its command is out.
    let doorbell = if lockstep {
        wire.doorbell(Role::Mixer)
    } else {
        wire.doorbell_with_alarm(Role::Mixer)
    }?;
    let shell = Shell::of_flight(wire, mixer, lockstep.then_some(Role::Plant), flight)?;
    stage::run(shell, doorbell, station)
}
