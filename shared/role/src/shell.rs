//! The process shell of a law: its inputs, its output, and their envelopes.
//!
//! One shell serves the outer loop, the inner loop and the mixer. A [`Job`] says what differs: the role, its inputs and
//! its output. The first input is the one that wakes the stage. The envelope passes from the input to the output.

use law::{InnerLaw, MixerLaw, OuterLaw};
use model::boards::Ending;
use model::envelope::{Envelope, Stamps};
use model::inspection::{Expected, Rejections};
use model::messages::{Dated, RotorSpeeds, Setpoint, State, Wrench};
use model::role::Role;
use model::topic::Topic;
use wire::clock::Horizon;
use wire::error::Error;
use wire::{LATEST, Receiver, Sender, Wire};

use crate::stage::{self, Stage, TickOutcome, Turn};
use crate::station::Station;

/// What a stage makes of its inputs at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Made<C> {
    /// What is published; nothing where there is nothing new to say.
    pub output: Option<C>,
    /// The stage wants the run to end.
    pub wants_end: Option<Ending>,
}

/// A law with its place in the chain.
pub trait Job: Clone {
    /// Its role.
    const ROLE: Role;
    /// Where it comes from.
    type Inputs: Inputs;
    /// What it becomes.
    type Output: Topic;

    /// Works a tick with the newest inputs, of whatever tick.
    fn work(&mut self, tick: u64, inputs: &<Self::Inputs as Inputs>::Dated) -> Made<Self::Output>;

    /// The last message to the next stage when the run is over.
    fn last_word(&self) -> Option<Self::Output> {
        None
    }
}

/// The receivers of a stage; the first one's messages wake it.
pub trait Inputs: Sized {
    /// What the law is given of them: contents, each with its tick.
    type Dated;

    /// Makes the ports.
    ///
    /// # Errors
    /// Those of the ports.
    fn new(wire: &Wire) -> Result<Self, Error>;

    /// Connects them for a run.
    ///
    /// # Errors
    /// Those of the ports.
    fn arm(&mut self, expected: Expected) -> Result<(), Error>;

    /// Takes what has come; the tick of the newest that wakes.
    ///
    /// # Errors
    /// Those of the ports.
    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error>;

    /// The newest of each.
    fn dated(&self) -> Self::Dated;

    /// The newest of each, as if they were of this tick.
    fn dated_as_of(&self, tick: u64) -> Self::Dated;

    /// Whether all are of this tick.
    fn fresh(&self, tick: u64) -> bool;

    /// The history that an output of this tick goes back to, with the tick of each input.
    fn history(&self, tick: u64) -> Envelope;

    /// Messages that did not pass inspection.
    fn rejections(&self) -> Rejections;
}

impl<A: Topic> Inputs for Receiver<A> {
    type Dated = Dated<A>;

    fn new(wire: &Wire) -> Result<Self, Error> {
        wire.receiver(LATEST)
    }

    fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.arm(expected)
    }

    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        self.take(horizon)
    }

    fn dated(&self) -> Dated<A> {
        self.dated()
    }

    fn dated_as_of(&self, tick: u64) -> Dated<A> {
        Dated { tick, ..self.dated() }
    }

    fn fresh(&self, tick: u64) -> bool {
        self.newest().envelope.tick == tick
    }

    fn history(&self, _tick: u64) -> Envelope {
        let newest = self.newest().envelope;
        newest.made_from(A::SENDER, newest.tick)
    }

    fn rejections(&self) -> Rejections {
        *self.rejections()
    }
}

impl<A: Topic, B: Topic> Inputs for (Receiver<A>, Receiver<B>) {
    type Dated = (Dated<A>, Dated<B>);

    fn new(wire: &Wire) -> Result<Self, Error> {
        Ok((wire.receiver(LATEST)?, wire.receiver(LATEST)?))
    }

    fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.1.arm(expected)?;
        self.0.arm(expected)
    }

    /// The second input of a tick was there before the first was made from it.
    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        let tick = self.0.take(horizon)?;
        self.1.take(horizon)?;
        Ok(tick)
    }

    fn dated(&self) -> Self::Dated {
        (self.0.dated(), self.1.dated())
    }

    fn dated_as_of(&self, tick: u64) -> Self::Dated {
        (self.0.dated_as_of(tick), self.1.dated_as_of(tick))
    }

    fn fresh(&self, tick: u64) -> bool {
        self.0.fresh(tick) && self.1.fresh(tick)
    }

    /// The history that reaches further: that of the first input, or that of the second if the first is stale.
    fn history(&self, tick: u64) -> Envelope {
        let (first, second) = (self.0.newest().envelope, self.1.newest().envelope);
        let newest = if first.tick == tick { first } else { second };
        newest.made_from(A::SENDER, first.tick).made_from(B::SENDER, second.tick)
    }

    fn rejections(&self) -> Rejections {
        self.0.rejections().and(self.1.rejections())
    }
}

/// A job with its ports.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Shell<J: Job> {
    job: J,
    inputs: J::Inputs,
    output: Sender<J::Output>,
}

impl<J: Job> Shell<J> {
    /// Makes the ports. `wakes` is the role that waits for the output; none if the receiver keeps to the clock.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire, job: J, wakes: Option<Role>) -> Result<Self, Error> {
        let bell = wakes.map(|role| wire.bell(role)).transpose()?;
        Ok(Self { job, inputs: J::Inputs::new(wire)?, output: wire.sender(bell)? })
    }
}

impl<J: Job> Stage for Shell<J> {
    const ROLE: Role = J::ROLE;

    fn arm(&mut self, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.inputs.arm(expected)?;
        self.output.arm(expected, epoch)
    }

    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        self.inputs.take(horizon)
    }

    fn tick(&mut self, turn: &Turn) -> Result<TickOutcome, Error> {
        let stale = !self.inputs.fresh(turn.tick);
        let Made { output, wants_end } = self.job.work(turn.tick, &self.inputs.dated());
        if let Some(output) = output {
            let mut history = self.inputs.history(turn.tick);
            history.previous_busy_ns = turn.previous_busy_ns;
            history.stamps[J::ROLE as usize] = Stamps { receive_ns: turn.receive_ns, send_ns: 0 };
            self.output.send(turn.tick, &history, output)?;
        }
        Ok(TickOutcome { stale, wants_end })
    }

    fn rehearse(&mut self, tick: u64) -> Result<(), Error> {
        match self.job.clone().work(tick, &self.inputs.dated_as_of(tick)).output {
            Some(output) => self.output.rehearse(tick, &self.inputs.history(tick), output),
            None => Ok(()),
        }
    }

    fn finish(&mut self, tick: u64) -> Result<(), Error> {
        self.job.last_word().map_or(Ok(()), |last| self.output.send(tick, &Envelope::new(), last))
    }

    fn rejections(&self) -> Rejections {
        self.inputs.rejections()
    }
}

/// The outer loop's job: a set-point from a state of this tick, and an end to a flight that is lost.
#[derive(Clone, Debug)]
pub struct OuterJob<L> {
    /// Its law.
    pub law: L,
    /// Distance from the reference beyond which the flight ends [m].
    pub position_error_max_m: f64,
}

impl<L: OuterLaw> Job for OuterJob<L> {
    const ROLE: Role = Role::Outer;
    type Inputs = Receiver<State>;
    type Output = Setpoint;

    fn work(&mut self, tick: u64, state: &Dated<State>) -> Made<Setpoint> {
        let output = self.law.tick(tick, state);
        let is_lost = |setpoint: Setpoint| setpoint.position_error_m(&state.content) > self.position_error_max_m;
        Made { output, wants_end: output.is_some_and(is_lost).then_some(Ending::Position) }
    }
}

/// The inner loop's job: a wrench in every tick.
#[derive(Clone, Debug)]
pub struct InnerJob<L>(pub L);

impl<L: InnerLaw> Job for InnerJob<L> {
    const ROLE: Role = Role::Inner;
    type Inputs = (Receiver<Setpoint>, Receiver<State>);
    type Output = Wrench;

    fn work(&mut self, tick: u64, (setpoint, state): &(Dated<Setpoint>, Dated<State>)) -> Made<Wrench> {
        Made { output: Some(self.0.tick(tick, state, setpoint)), wants_end: None }
    }
}

/// The mixer's job: rotor speeds in every tick, and idle as the last word.
#[derive(Clone, Debug)]
pub struct MixerJob<L>(pub L);

impl<L: MixerLaw> Job for MixerJob<L> {
    const ROLE: Role = Role::Mixer;
    type Inputs = Receiver<Wrench>;
    type Output = RotorSpeeds;

    fn work(&mut self, tick: u64, wrench: &Dated<Wrench>) -> Made<RotorSpeeds> {
        Made { output: Some(self.0.tick(tick, wrench)), wants_end: None }
    }

    fn last_word(&self) -> Option<RotorSpeeds> {
        Some(self.0.idle())
    }
}

/// Flies an outer loop until the plant closes the run.
///
/// # Errors
/// Those of the station and of the ports.
pub fn outer<L: OuterLaw>(station: Station, law: L, position_error_max_m: f64) -> Result<(), Error> {
    let doorbell = station.wire().doorbell(Role::Outer)?;
    let job = OuterJob { law, position_error_max_m };
    let shell = Shell::new(station.wire(), job, Some(Role::Inner))?;
    stage::run(shell, doorbell, station)
}

/// Flies an inner loop until the plant closes the run.
///
/// # Errors
/// Those of the station and of the ports.
pub fn inner<L: InnerLaw>(station: Station, law: L) -> Result<(), Error> {
    let doorbell = station.wire().doorbell(Role::Inner)?;
    let shell = Shell::new(station.wire(), InnerJob(law), Some(Role::Mixer))?;
    stage::run(shell, doorbell, station)
}

/// Flies a mixer until the plant closes the run; it wakes the plant in lockstep, which otherwise wakes by itself.
///
/// # Errors
/// Those of the station and of the ports.
pub fn mixer<L: MixerLaw>(station: Station, law: L, lockstep: bool) -> Result<(), Error> {
    let wire = station.wire();
    // The last stage of the chain has time for the second call when its command is out.
    let doorbell = if lockstep { wire.doorbell(Role::Mixer) } else { wire.doorbell_with_alarm(Role::Mixer) }?;
    let shell = Shell::new(wire, MixerJob(law), lockstep.then_some(Role::Plant))?;
    stage::run(shell, doorbell, station)
}
