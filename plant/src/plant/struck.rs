//! The gate of the plant's commands: faults of them, planned or injected.

use messages::content::RotorSpeeds;
use messages::fault::gate::Gate;
use messages::fault::{MessageFaults, Port};
use messages::inspection::Rejections;

use super::Plant;

impl Plant {
    /// Puts faults of the commands that it is handed before it.
    pub fn gate(&mut self, gate: Option<Gate<RotorSpeeds>>) {
        self.is_struck = gate.is_some();
        self.gate = gate.map(Box::new);
    }

    /// The same of faults that may change in flight.
    pub fn gate_by(&mut self, faults: &MessageFaults) {
        self.gate(Some(Gate::changing(faults, Port::PlantRotorSpeeds)));
        self.is_struck = faults.of(Port::PlantRotorSpeeds).next().is_some();
    }

    /// Takes the faults of its commands as they are from now on, without an allocation; `newest` came last.
    pub fn change_faults(&mut self, faults: &MessageFaults, newest: Option<RotorSpeeds>) {
        if let Some(gate) = &mut self.gate {
            gate.change(faults, Port::PlantRotorSpeeds, newest);
            self.is_struck |= faults.of(Port::PlantRotorSpeeds).next().is_some();
        }
    }

    /// Commands that were refused for what a fault had made of them.
    pub fn rejections(&self) -> Rejections {
        self.gate
            .as_ref()
            .map(|gate| *gate.rejections())
            .unwrap_or_default()
    }
}
