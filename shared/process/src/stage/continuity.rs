//! The state of a stage beyond its process: published after each tick, and continued from by another process.
//!
//! With one channel, a process that replaces another one continues from its last state. With several, the processes of a
//! role in all channels have the same state after the same tick, as long as each works every tick with fresh inputs. One that
//! missed a tick, or that joins, takes the state of another channel over:
//!
//! | the state of another channel, made from fresh inputs | what is done in tick k |
//! |---|---|
//! | of tick k or later | taken over; nothing is sent |
//! | of tick k-1, and the own inputs are fresh | taken over; tick k is worked from it |
//! | of an earlier tick, but newer than the own state | taken over; tick k is worked from it |
//! | none of these, or two that differ | tick k is worked from the own state; a process that joins waits for a state of another channel first |

use control_api::SavedState;
use ipc::error::Error;
use ipc::{Blackboard, BlackboardReader, Wire};
use messages::blackboards::StageState;
use messages::realtime::RealtimeSettings;
use messages::role::{Channel, Replica};

use super::work::Stage;
use crate::session::state_board;

/// Ticks for which a process that joins waits for a state of another channel that it can continue from.
const JOINING_TICKS: u32 = 20;

pub(super) struct Continuity {
    own: Blackboard<StageState>,
    saved: SavedState,
    state: StageState,
    /// What the process before this one left.
    left: Option<StageState>,
    twins: Vec<(Channel, BlackboardReader<StageState>)>,
    /// The tick that the own state is ready for; nothing in a process that joins and has no state yet.
    next: Option<u64>,
    channel: Channel,
    /// Whether the own state may differ from that of other channels.
    is_doubtful: bool,
    waited: u32,
    /// See [`messages::blackboards::Status`].
    pub(super) resumed_at: u64,
    pub(super) is_saved: bool,
}

/// A channel works as long as its last state is no older.
const WORKS_TICKS: u64 = 3;

/// What to do with a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TickPlan {
    Work,
    /// Another channel has worked it; the state was taken over.
    Skip,
}

impl Continuity {
    pub(super) fn new(wire: &Wire, replica: Replica) -> Result<Self, Error> {
        let name = state_board(replica);
        let left = wire.blackboard_reader::<StageState>(&name)?;
        Ok(Self {
            left: left.map(|board| board.get()),
            own: wire.blackboard(&name)?,
            saved: SavedState::new(),
            state: StageState::default(),
            twins: Vec::new(),
            next: None,
            channel: replica.channel,
            is_doubtful: false,
            waited: 0,
            resumed_at: 0,
            is_saved: false,
        })
    }

    /// Opens the states of the other channels with the same laws.
    pub(super) fn arm(
        &mut self,
        wire: &Wire,
        replica: Replica,
        rt: &RealtimeSettings,
        run_id: u64,
    ) -> Result<(), Error> {
        self.state.run_id = run_id;
        self.twins.clear();
        let group = rt.groups[replica.channel as usize];
        let is_twin = |it: &Channel| *it != replica.channel && rt.groups[*it as usize] == group;
        for channel in Channel::first(rt.channels).filter(is_twin) {
            let twin = Replica::new(replica.role, channel);
            let board = wire.blackboard_reader(&state_board(twin))?;
            self.twins.extend(board.map(|board| (channel, board)));
        }
        Ok(())
    }

    /// Before the first tick: a process that joins a flight with one channel continues from what was left. One that took part
    /// in the take-off begins with its initial state, even if it is late.
    pub(super) fn begin<S: Stage>(&mut self, stage: &mut S, first_tick: u64, took_off: bool) {
        self.is_saved = stage.save(&mut self.saved);
        if took_off {
            (self.next, self.is_doubtful) = (Some(first_tick), first_tick > 0);
        } else if self.twins.is_empty() {
            self.resume(stage, first_tick);
        }
    }

    /// Continues from the newest state there is, or from the initial one.
    fn resume<S: Stage>(&mut self, stage: &mut S, tick: u64) {
        let run_id = self.state.run_id;
        let twins = self.twins.iter().map(|(_, board)| board.get());
        let states = twins.chain(self.left.take());
        let newest = states
            .filter(|it| it.run_id == run_id && it.length > 0 && it.tick < tick)
            .max_by_key(|it| it.tick);
        if let Some(state) = newest.filter(|it| stage.load(it.bytes())) {
            self.resumed_at = state.tick + 1;
        }
        self.next = Some(tick);
    }

    /// Decides on a tick, whose inputs are fresh or not, and takes over the state that it is worked from.
    pub(super) fn plan<S: Stage>(&mut self, stage: &mut S, tick: u64, is_fresh: bool) -> TickPlan {
        if self.twins.is_empty() || (self.next == Some(tick) && is_fresh && !self.is_doubtful) {
            return TickPlan::Work;
        }
        let run_id = self.state.run_id;
        let least = if is_fresh {
            tick.saturating_sub(1)
        } else {
            tick
        };
        let twins = self.twins.iter().map(|(_, board)| board.get());
        let is_ahead = |it: &StageState| self.next.is_some_and(|next| it.tick >= next);
        let is_sound = |it: &StageState| it.run_id == run_id && it.is_fresh == 1;
        let sound = twins.filter(|it| is_sound(it) && (it.tick >= least || is_ahead(it)));
        let mut newest: Option<StageState> = None;
        for state in sound {
            match &newest {
                Some(other) if other.tick > state.tick => {}
                // One of them is wrong.
                Some(other) if other.tick == state.tick && other.bytes() != state.bytes() => {
                    newest = None;
                    break;
                }
                _ => newest = Some(state),
            }
        }
        if let Some(state) = newest {
            if !stage.load(state.bytes()) {
                // It would not the next time either.
                self.twins.clear();
                return TickPlan::Work;
            }
            if self.next.is_none() {
                self.resumed_at = state.tick + 1;
            }
            self.next = Some(state.tick + 1);
            let is_worked = state.tick >= tick;
            self.is_doubtful = !is_worked && !is_fresh;
            return if is_worked {
                TickPlan::Skip
            } else {
                TickPlan::Work
            };
        }
        if self.next.is_none() {
            self.waited += 1;
            if self.waited <= JOINING_TICKS {
                return TickPlan::Skip;
            }
            self.resume(stage, tick);
        }
        // If all channels were disturbed, the others continue from the first that works.
        self.is_doubtful = !(is_fresh && self.is_doubtful && self.is_first(tick));
        TickPlan::Work
    }

    /// Whether no channel before this one works its ticks.
    fn is_first(&self, tick: u64) -> bool {
        let run_id = self.state.run_id;
        let works = |board: &BlackboardReader<StageState>| {
            let state = board.get();
            state.run_id == run_id && state.tick + WORKS_TICKS >= tick
        };
        let mut before = self.twins.iter().filter(|(it, _)| *it < self.channel);
        !before.any(|(_, board)| works(board))
    }

    /// Publishes the state after a tick that was worked.
    pub(super) fn publish<S: Stage>(&mut self, stage: &mut S, tick: u64, is_fresh: bool) {
        self.next = Some(tick + 1);
        if !self.is_saved || !stage.save(&mut self.saved) {
            return;
        }
        let state = &mut self.state;
        state.bytes[..self.saved.len()].copy_from_slice(&self.saved);
        state.length = self.saved.len() as u64;
        (state.tick, state.is_fresh) = (tick, u64::from(is_fresh && !self.is_doubtful));
        self.own.put(*state);
    }
}
