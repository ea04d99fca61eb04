//! The status blackboards of all processes, as the recorder and observers read them.

use std::collections::BTreeMap;

use ipc::error::Error;
use ipc::{BlackboardReader, Wire};
use messages::blackboards::Status;
use messages::role::{Channel, MOST_CHANNELS, Replica, Role, STAGES};
use process::session::status_board;

use analysis::schema::RoleSection;
use analysis::sections::role_section;

#[derive(Default)]
pub struct RoleStatuses(BTreeMap<Replica, BlackboardReader<Status>>);

impl RoleStatuses {
    pub fn open(wire: &Wire) -> Result<Self, Error> {
        let mut boards = BTreeMap::new();
        for replica in Replica::all(MOST_CHANNELS) {
            if let Some(board) = wire.blackboard_reader(&status_board(replica))? {
                boards.insert(replica, board);
            }
        }
        Ok(Self(boards))
    }

    pub fn statuses(&self) -> BTreeMap<Replica, Status> {
        let statuses = self
            .0
            .iter()
            .map(|(replica, board)| (*replica, board.get()));
        statuses.collect()
    }

    /// The status that the process with this number has written.
    pub fn of_process(&self, replica: Replica, pid: u32) -> Option<Status> {
        let status = self.0.get(&replica)?.get();
        (status.pid == u64::from(pid)).then_some(status)
    }

    /// The statuses of the plant and of a channel; the default for a process without a blackboard.
    pub fn loops(&self, channel: Channel) -> [Status; STAGES.len()] {
        let replica = |role| match role {
            Role::Plant => role.into(),
            _ => Replica::new(role, channel),
        };
        let status = |role| Some(self.0.get(&replica(role))?.get());
        STAGES.map(|role| status(role).unwrap_or_default())
    }

    /// Each process's section of the report, by name, in a flight whose first tick began at `t0_ns`.
    pub fn sections(&self, t0_ns: u64) -> BTreeMap<String, RoleSection> {
        let section = |(replica, board): (&Replica, &BlackboardReader<Status>)| {
            let status = board.get();
            let section = RoleSection {
                is_successor: status.epoch > t0_ns,
                ..role_section(&status)
            };
            (replica.to_string(), section)
        };
        self.0.iter().map(section).collect()
    }
}
