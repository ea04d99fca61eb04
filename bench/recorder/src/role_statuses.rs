//! The status blackboards of all processes, as the recorder and observers read them.

use std::collections::BTreeMap;

use ipc::error::Error;
use ipc::{BlackboardReader, Wire};
use messages::blackboards::Status;
use messages::role::{ROLES, Role, STAGES};
use process::session::status_board;

use analysis::schema::RoleSection;
use analysis::sections::role_section;

#[derive(Default)]
pub struct RoleStatuses(BTreeMap<Role, BlackboardReader<Status>>);

impl RoleStatuses {
    /// Opens the existing blackboards.
    pub fn open(wire: &Wire) -> Result<Self, Error> {
        let mut boards = BTreeMap::new();
        for role in ROLES {
            if let Some(board) = wire.blackboard_reader(&status_board(role))? {
                boards.insert(role, board);
            }
        }
        Ok(Self(boards))
    }

    pub fn statuses(&self) -> BTreeMap<Role, Status> {
        let statuses = self.0.iter().map(|(role, board)| (*role, board.get()));
        statuses.collect()
    }

    /// The status that the process with this number has written.
    pub fn of_process(&self, role: Role, pid: u32) -> Option<Status> {
        let status = self.0.get(&role)?.get();
        (status.pid == u64::from(pid)).then_some(status)
    }

    /// The statuses of the control loop's processes; the default for a process without a blackboard.
    pub fn loops(&self) -> [Status; STAGES.len()] {
        let status = |role| Some(self.0.get(&role)?.get());
        STAGES.map(|role| status(role).unwrap_or_default())
    }

    /// Warm-up runs of the mixer, the last stage of the chain.
    pub fn rehearsals(&self) -> u64 {
        self.0
            .get(&Role::Mixer)
            .map_or(0, |board| board.get().rehearsals)
    }

    /// Each process's section of the report, by name.
    pub fn sections(&self) -> BTreeMap<String, RoleSection> {
        self.0
            .iter()
            .map(|(role, board)| (role.name().to_owned(), role_section(&board.get())))
            .collect()
    }
}
