//! Everybody's status boards, as the recorder and observers look at them.

use std::collections::BTreeMap;

use model::boards::Status;
use model::role::{ROLES, Role, STAGES};
use role::station::status_board;
use wire::error::Error;
use wire::{BoardReader, Wire};

use report::schema::RoleSection;
use report::sections::role_section;

/// The boards of the roles that were there when it was made.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
#[derive(Default)]
pub struct Crew(BTreeMap<Role, BoardReader<Status>>);

impl Crew {
    /// Opens the boards that there are.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn open(wire: &Wire) -> Result<Self, Error> {
        let mut boards = BTreeMap::new();
        for role in ROLES {
            if let Some(board) = wire.board_reader(&status_board(role))? {
                boards.insert(role, board);
            }
        }
        Ok(Self(boards))
    }

    /// What everybody's board says.
    #[must_use]
    pub fn statuses(&self) -> BTreeMap<Role, Status> {
        self.0.iter().map(|(role, board)| (*role, board.get())).collect()
    }

    /// What the loops' boards say; nothing of one that is not there.
    #[must_use]
    pub fn loops(&self) -> [Status; STAGES.len()] {
        STAGES.map(|role| self.0.get(&role).map(BoardReader::get).unwrap_or_default())
    }

    /// Ticks that the mixer rehearsed, which is the last of the chain.
    #[must_use]
    pub fn rehearsals(&self) -> u64 {
        self.0.get(&Role::Mixer).map_or(0, |board| board.get().rehearsals)
    }

    /// Everybody's section of the report, by name.
    #[must_use]
    pub fn sections(&self) -> BTreeMap<String, RoleSection> {
        self.0.iter().map(|(role, board)| (role.name().to_owned(), role_section(&board.get()))).collect()
    }
}
