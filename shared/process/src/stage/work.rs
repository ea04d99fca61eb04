//! What one stage does differently from another.

use super::inputs::Inputs;
use control_api::SavedState;
use ipc::TopicPorts;
use messages::blackboards::EndReason;
use messages::role::Role;

/// The newest inputs of a stage, each with its tick.
pub type StageInputs<S> = <<S as Stage>::Inputs as Inputs>::Stamped;

pub trait Stage {
    const ROLE: Role;
    type Inputs: Inputs;
    type Output: TopicPorts;

    /// Computes a tick with the newest inputs, of whatever tick; nothing if there is nothing new to publish.
    fn work(&mut self, tick: u64, inputs: &StageInputs<Self>) -> Option<Self::Output>;

    /// The reason for which this output ends the run. It is on the status blackboard before the output is published.
    fn end(&self, _output: &Self::Output, _inputs: &StageInputs<Self>) -> Option<EndReason> {
        None
    }

    /// What [`Self::work`] would publish; nothing if the law cannot be copied. It changes nothing.
    fn rehearse(&mut self, _tick: u64, _inputs: &StageInputs<Self>) -> Option<Self::Output> {
        None
    }

    /// Saves what the stage remembers between ticks; false if its law cannot be saved.
    fn save(&mut self, _state: &mut SavedState) -> bool {
        false
    }

    /// Continues from a saved state; false, and nothing is changed, if it is not one of this stage and law.
    fn load(&mut self, _state: &[u8]) -> bool {
        false
    }

    /// The message that the next stage gets after the run.
    fn last_output(&self) -> Option<Self::Output> {
        None
    }
}
