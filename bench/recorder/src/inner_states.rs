//! States with the faults of the inner loop's input, planned or injected, for the Lyapunov monitor.

use faults::Port;
use faults::filter::FaultFilter;
use faults::live::{LiveBlackboard, LoopFaults};
use ipc::BlackboardReader;
use messages::content::State;
use messages::header::Message;

pub struct InnerStates {
    planned: LoopFaults,
    injected: Option<BlackboardReader<LiveBlackboard>>,
    filter: FaultFilter<State>,
    newest: Option<State>,
}

impl InnerStates {
    pub fn new(planned: LoopFaults, injected: Option<BlackboardReader<LiveBlackboard>>) -> Self {
        Self {
            filter: FaultFilter::changing(&planned.messages, Port::InnerState),
            planned,
            injected,
            newest: None,
        }
    }

    /// Applies the faults to the measurement, not to the truth.
    ///
    /// The plant publishes an injected fault before the first state that it acts on.
    pub fn with_faults(&mut self, message: &Message<State>) -> Message<State> {
        let news = self.injected.as_mut().and_then(BlackboardReader::news);
        if let Some(injected) = news {
            let messages = self.planned.with(&injected).messages;
            self.filter.change(&messages, Port::InnerState, self.newest);
        }
        let mut faulty = *message;
        if self.filter.has_faults()
            && let Some(passed) = self.filter.pass(message.envelope.tick, &message.content)
        {
            faulty.content.measured = passed.content.measured;
        }
        self.newest = Some(message.content);
        faulty
    }
}
