//! What goes wrong with a stage: what was planned, and what the plant's board has had since.

use faults::MessageFaults;
use faults::live::{LIVE, LiveBlackboard, LoopFaults};
use ipc::error::Error;
use ipc::{BlackboardReader, Wire};
use messages::role::Role;

pub struct ActiveFaults {
    role: Role,
    planned: LoopFaults,
    now: LoopFaults,
    version: u64,
    is_late: bool,
    live: Option<BlackboardReader<LiveBlackboard>>,
}

impl ActiveFaults {
    pub(super) fn planned(role: Role, planned: LoopFaults) -> Self {
        let is_late = !planned.late.of_role(role).is_empty();
        Self {
            role,
            planned,
            now: planned,
            version: 0,
            is_late,
            live: None,
        }
    }

    /// Finds the plant's board, with what was injected before a process came that joins a flight.
    pub(super) fn arm(&mut self, wire: &Wire) -> Result<(), Error> {
        self.live = wire.blackboard_reader(LIVE)?;
        if let Some(live) = self.live.as_ref().map(BlackboardReader::get) {
            self.take(&live);
        }
        Ok(())
    }

    /// Looks at the board; says how often the faults have changed.
    pub(super) fn version(&mut self) -> u64 {
        if let Some(news) = self.live.as_mut().and_then(BlackboardReader::news) {
            self.take(&news);
        }
        self.version
    }

    pub(super) const fn messages(&self) -> &MessageFaults {
        &self.now.messages
    }

    /// How much longer the stage computes at a tick [ns], as of the last look.
    pub(super) fn late_ns(&self, tick: u64) -> u64 {
        if self.is_late {
            self.now.late.late_ns(self.role, tick)
        } else {
            0
        }
    }

    #[cold]
    fn take(&mut self, live: &LiveBlackboard) {
        self.now = self.planned.with(live);
        self.is_late = !self.now.late.of_role(self.role).is_empty();
        self.version += 1;
    }
}
