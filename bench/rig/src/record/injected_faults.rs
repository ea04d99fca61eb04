//! Faults that were injected into the running flight, as the plant publishes them.

use faults::live::{LIVE, LiveBlackboard, LiveFault};
use flight_log::facts::Record;
use ipc::error::Error;
use ipc::{BlackboardReader, Wire};

use faults::grammar::planned_again;

#[derive(Default)]
pub struct InjectedFaults {
    blackboard: Option<BlackboardReader<LiveBlackboard>>,
    pub faults: Vec<LiveFault>,
}

impl InjectedFaults {
    pub fn open(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            blackboard: wire.blackboard_reader(LIVE)?,
            faults: Vec::new(),
        })
    }

    /// Reads the blackboard; returns all faults of the flight if there are new ones.
    pub fn update(&mut self) -> Option<&[LiveFault]> {
        let published = self.blackboard.as_mut()?.news()?;
        self.faults = published.iter().collect();
        Some(&self.faults)
    }
}

/// The faults by number, each as the text that would plan it.
pub fn injected_record(faults: &[LiveFault]) -> Record {
    (1..)
        .zip(planned_again(faults))
        .map(|(n, fault)| (format!("{n}"), fault.to_string()))
        .collect()
}
