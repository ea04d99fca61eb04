//! The messages of a flight as its stages get them: the recorder filters them as the inputs of the stages do, by the same
//! faults, planned or injected.

use faults::Port;
use faults::filter::{FaultFilter, Passed};
use faults::live::{LiveBlackboard, LoopFaults, MessageFaults};
use ipc::BlackboardReader;
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::fields::Faulty;
use messages::header::Message;
use messages::role::Role;

pub struct FaultyInputs {
    planned: LoopFaults,
    injected: Option<BlackboardReader<LiveBlackboard>>,
    outer_states: FaultyPort<State>,
    inner_states: FaultyPort<State>,
    pub setpoints: FaultyPort<Setpoint>,
    pub wrenches: FaultyPort<Wrench>,
    pub rotor_speeds: FaultyPort<RotorSpeeds>,
}

pub struct FaultyPort<C> {
    port: Port,
    filter: FaultFilter<C>,
    newest: Option<C>,
}

impl<C: Faulty> FaultyPort<C> {
    fn new(planned: &LoopFaults, port: Port) -> Self {
        Self {
            port,
            filter: FaultFilter::changing(&planned.messages, port),
            newest: None,
        }
    }

    fn change(&mut self, faults: &MessageFaults) {
        self.filter.change(faults, self.port, self.newest);
    }

    /// The content that the stage had; none without a fault, or where the fault dropped the message. `withheld` gets the stage
    /// if it did not have the message in the message's tick.
    pub fn pass(&mut self, message: &Message<C>, mut withheld: impl FnMut(Role)) -> Option<C> {
        self.newest = Some(message.content);
        if !self.filter.has_faults() {
            return None;
        }
        let passed = self.filter.pass(message.envelope.tick, &message.content);
        if passed.is_none_or(|Passed { delay, .. }| delay > 0) {
            withheld(self.port.role());
        }
        passed.map(|passed| passed.content)
    }
}

impl FaultyInputs {
    pub fn new(planned: LoopFaults, injected: Option<BlackboardReader<LiveBlackboard>>) -> Self {
        // A recorder may join a flight into which faults were injected already.
        let live = injected.as_ref().map(BlackboardReader::get);
        let now = live.map_or(planned, |live| planned.with(&live));
        Self {
            outer_states: FaultyPort::new(&now, Port::OuterState),
            inner_states: FaultyPort::new(&now, Port::InnerState),
            setpoints: FaultyPort::new(&now, Port::InnerSetpoint),
            wrenches: FaultyPort::new(&now, Port::MixerWrench),
            rotor_speeds: FaultyPort::new(&now, Port::PlantRotorSpeeds),
            planned,
            injected,
        }
    }

    /// The state as the inner loop had it: faults change the measurement, not the truth.
    ///
    /// The plant publishes an injected fault before the first state that it acts on.
    pub fn state(
        &mut self,
        message: &Message<State>,
        mut withheld: impl FnMut(Role),
    ) -> Message<State> {
        let news = self.injected.as_mut().and_then(BlackboardReader::news);
        if let Some(injected) = news {
            let messages = self.planned.with(&injected).messages;
            self.outer_states.change(&messages);
            self.inner_states.change(&messages);
            self.setpoints.change(&messages);
            self.wrenches.change(&messages);
            self.rotor_speeds.change(&messages);
        }
        self.outer_states.pass(message, &mut withheld);
        let mut faulty = *message;
        if let Some(passed) = self.inner_states.pass(message, &mut withheld) {
            faulty.content.measured = passed.measured;
        }
        faulty
    }
}
