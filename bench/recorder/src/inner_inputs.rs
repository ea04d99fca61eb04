//! States and setpoints with the faults of the inner loop's inputs, planned or injected, for the Lyapunov monitor.

use faults::Port;
use faults::filter::FaultFilter;
use faults::live::{LiveBlackboard, LoopFaults};
use ipc::BlackboardReader;
use messages::content::{Setpoint, State};
use messages::fields::Faulty;
use messages::header::Message;

pub struct InnerInputs {
    planned: LoopFaults,
    injected: Option<BlackboardReader<LiveBlackboard>>,
    states: FaultyPort<State>,
    setpoints: FaultyPort<Setpoint>,
}

struct FaultyPort<C> {
    filter: FaultFilter<C>,
    newest: Option<C>,
}

impl<C: Faulty> FaultyPort<C> {
    fn new(planned: &LoopFaults, port: Port) -> Self {
        Self {
            filter: FaultFilter::changing(&planned.messages, port),
            newest: None,
        }
    }

    /// The content that the loop had; none without a fault, or where the fault dropped the message.
    fn pass(&mut self, message: &Message<C>) -> Option<C> {
        self.newest = Some(message.content);
        if !self.filter.has_faults() {
            return None;
        }
        let passed = self.filter.pass(message.envelope.tick, &message.content);
        passed.map(|passed| passed.content)
    }
}

impl InnerInputs {
    pub fn new(planned: LoopFaults, injected: Option<BlackboardReader<LiveBlackboard>>) -> Self {
        Self {
            states: FaultyPort::new(&planned, Port::InnerState),
            setpoints: FaultyPort::new(&planned, Port::InnerSetpoint),
            planned,
            injected,
        }
    }

    /// Applies the faults to the measurement, not to the truth.
    ///
    /// The plant publishes an injected fault before the first state that it acts on.
    pub fn state(&mut self, message: &Message<State>) -> Message<State> {
        let news = self.injected.as_mut().and_then(BlackboardReader::news);
        if let Some(injected) = news {
            let messages = self.planned.with(&injected).messages;
            let (states, setpoints) = (&mut self.states, &mut self.setpoints);
            let newest = (states.newest, setpoints.newest);
            states.filter.change(&messages, Port::InnerState, newest.0);
            setpoints
                .filter
                .change(&messages, Port::InnerSetpoint, newest.1);
        }
        let mut faulty = *message;
        if let Some(passed) = self.states.pass(message) {
            faulty.content.measured = passed.measured;
        }
        faulty
    }

    pub fn setpoint(&mut self, message: &Message<Setpoint>) -> Message<Setpoint> {
        let content = self.setpoints.pass(message).unwrap_or(message.content);
        Message {
            content,
            ..*message
        }
    }
}
