//! The state of a stage beyond its process: published after each tick, and continued from by another process.
//!
//! With one channel, a process that replaces another one continues from its last state. With several, the state of another
//! channel is taken over where it is better than the own one. Histories ([`messages::history`]) say which is:
//!
//! | own state before tick k, and inputs | state of another channel | what is done in tick k |
//! |---|---|---|
//! | undisturbed, fresh inputs | is not read | tick k is worked |
//! | undisturbed, stale inputs | undisturbed, of tick k or later | taken over; nothing is sent |
//! | disturbed, or none yet | undisturbed, of tick k-1 or later, or ahead of the own one | taken over; tick k is worked, unless it has been |
//! | disturbed, or none yet | with fresh inputs for longer, or for as long and of an earlier channel | the same |
//! | any other | | tick k is worked; a process that joins waits for a state first |
//!
//! A state has had fresh inputs since the first tick from which every tick was worked with them. So a channel does not
//! continue from a state that was computed without inputs, and channels that one event disturbed agree on the first of them.
//!
//! Every message names the state that its tick was worked from.

use control_api::SavedState;
use ipc::error::Error;
use ipc::{Blackboard, BlackboardReader, Wire};
use messages::blackboards::StageState;
use messages::content::NO_TICK;
use messages::history::{LawState, UNDISTURBED};
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
    channel: Channel,
    /// Whether the process joins a flight and has no state yet.
    is_joining: bool,
    waited: u32,
    /// See [`messages::blackboards::Status`].
    pub(super) resumed_at: u64,
    pub(super) is_saved: bool,
}

/// Since when a state of a tick has had fresh inputs if `tick` is worked from it; each tick that it lacks makes it later.
const fn fresh_since(state_tick: u64, since: u64, tick: u64) -> u64 {
    match tick.saturating_sub(state_tick.wrapping_add(1)) {
        0 => since,
        lacking => tick + lacking,
    }
}

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
            channel: replica.channel,
            is_joining: false,
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
    pub(super) fn begin<S: Stage>(
        &mut self,
        stage: &mut S,
        first_tick: u64,
        took_off: bool,
        own: &mut LawState,
    ) {
        self.is_saved = stage.save(&mut self.saved);
        self.is_joining = !took_off;
        if self.is_joining && self.twins.is_empty() {
            self.resume(stage, first_tick, own);
        }
    }

    /// Continues from the newest state there is, or from the initial one.
    fn resume<S: Stage>(&mut self, stage: &mut S, tick: u64, own: &mut LawState) {
        let run_id = self.state.run_id;
        let left = self.left.take().map(|state| (self.channel, state));
        let states = self.states().chain(left);
        let newest = states
            .filter(|(_, it)| it.run_id == run_id && it.tick < tick)
            .max_by_key(|(_, it)| it.tick);
        if let Some((channel, state)) = newest {
            self.take_over(stage, channel, &state, own);
        }
        self.is_joining = false;
    }

    /// Continues from a state; false if the law does not take it.
    fn take_over<S: Stage>(
        &mut self,
        stage: &mut S,
        channel: Channel,
        state: &StageState,
        own: &mut LawState,
    ) -> bool {
        if !stage.load(state.bytes()) {
            return false;
        }
        if self.is_joining {
            (self.is_joining, self.resumed_at) = (false, state.tick + 1);
        }
        *own = LawState::after(state.tick, channel, state.law_state.after);
        self.state.fresh_since = state.fresh_since;
        true
    }

    fn states(&self) -> impl Iterator<Item = (Channel, StageState)> {
        let states = self
            .twins
            .iter()
            .map(|(channel, board)| (*channel, board.get()));
        states.filter(|(_, state)| state.run_id == self.state.run_id && state.length > 0)
    }

    /// Decides on a tick, whose inputs are fresh or not, and takes over the state that it is worked from.
    pub(super) fn plan<S: Stage>(
        &mut self,
        stage: &mut S,
        tick: u64,
        is_fresh: bool,
        own: &mut LawState,
    ) -> TickPlan {
        let is_undisturbed = !self.is_joining && own.is_undisturbed_before(tick);
        if self.twins.is_empty() || (is_undisturbed && is_fresh) {
            return TickPlan::Work;
        }
        if let Some((channel, state)) = self.better(tick, is_fresh, is_undisturbed, own) {
            if !self.take_over(stage, channel, &state, own) {
                // It would not the next time either.
                self.twins.clear();
                return TickPlan::Work;
            }
            return if state.tick >= tick {
                TickPlan::Skip
            } else {
                TickPlan::Work
            };
        }
        if self.is_joining {
            self.waited += 1;
            if self.waited <= JOINING_TICKS {
                return TickPlan::Skip;
            }
            self.resume(stage, tick, own);
        }
        TickPlan::Work
    }

    /// A state of another channel to continue from instead of the own one.
    fn better(
        &self,
        tick: u64,
        is_fresh: bool,
        is_undisturbed: bool,
        own: &LawState,
    ) -> Option<(Channel, StageState)> {
        let least = tick.saturating_sub(u64::from(is_fresh));
        let is_behind = |it: &StageState| {
            !self.is_joining && (own.from_tick == NO_TICK || own.from_tick < it.tick)
        };
        let usable = |(_, it): &(Channel, StageState)| it.tick >= least || is_behind(it);
        let sound = |(_, it): &(Channel, StageState)| it.law_state.after == UNDISTURBED;
        let mut newest: Option<(Channel, StageState)> = None;
        for it in self.states().filter(usable).filter(sound) {
            match &newest {
                Some((_, other)) if other.tick > it.1.tick => {}
                // One of them is wrong.
                Some((_, other)) if other.tick == it.1.tick && other.bytes() != it.1.bytes() => {
                    return None;
                }
                _ => newest = Some(it),
            }
        }
        if newest.is_some() || is_undisturbed {
            return newest;
        }
        let is_own = |it: &StageState| {
            let continued = &it.law_state;
            [
                (it.tick, continued.after),
                (continued.from_tick, continued.before),
            ]
            .contains(&(own.from_tick, own.before))
        };
        let rank = |(channel, it): &(Channel, StageState)| {
            (fresh_since(it.tick, it.fresh_since, tick), *channel)
        };
        let own_since = match is_fresh {
            true => fresh_since(own.from_tick, self.state.fresh_since, tick),
            false => fresh_since(own.from_tick, tick + 1, tick),
        };
        let best = self.states().filter(usable).min_by_key(rank)?;
        let is_better = rank(&best) < (own_since, self.channel) && !is_own(&best.1);
        (self.is_joining || is_better).then_some(best)
    }

    /// Publishes the state after a tick whose message was sent.
    pub(super) fn publish<S: Stage>(
        &mut self,
        stage: &mut S,
        tick: u64,
        is_fresh: bool,
        law_state: &LawState,
    ) {
        self.state.fresh_since = match is_fresh {
            true => fresh_since(law_state.from_tick, self.state.fresh_since, tick).min(tick),
            false => tick + 1,
        };
        if !self.is_saved || !stage.save(&mut self.saved) {
            return;
        }
        let state = &mut self.state;
        state.bytes[..self.saved.len()].copy_from_slice(&self.saved);
        state.length = self.saved.len() as u64;
        (state.tick, state.law_state) = (tick, *law_state);
        self.own.put(*state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::Input;
    use messages::content::{Setpoint, Stamped, State};
    use messages::role::Role;

    /// A law whose state is how many ticks it has worked without fresh inputs.
    struct Starved(u8);

    impl Stage for Starved {
        const ROLE: Role = Role::Outer;
        type Inputs = Input<State>;
        type Output = Setpoint;

        fn work(&mut self, _tick: u64, _state: &Stamped<State>) -> Option<Setpoint> {
            None
        }

        fn save(&mut self, state: &mut SavedState) -> bool {
            state.clear();
            state.push(self.0).is_ok()
        }

        fn load(&mut self, state: &[u8]) -> bool {
            self.0 = state[0];
            true
        }
    }

    struct Twin {
        stage: Starved,
        continuity: Continuity,
        own: LawState,
        channel: Channel,
    }

    impl Twin {
        /// Works a tick, in which there is an input of `input_tick`; says whether it sent something.
        fn tick(&mut self, tick: u64, input_tick: u64) -> bool {
            let is_fresh = input_tick == tick;
            let plan = self
                .continuity
                .plan(&mut self.stage, tick, is_fresh, &mut self.own);
            if plan == TickPlan::Skip {
                return false;
            }
            self.stage.0 += u8::from(!is_fresh);
            self.own
                .advance(tick, [(input_tick, UNDISTURBED)].into_iter());
            self.continuity
                .publish(&mut self.stage, tick, is_fresh, &self.own);
            self.own = LawState::after(tick, self.channel, self.own.after);
            true
        }
    }

    /// Flies so many channels; `input` says which input channel and tick have, if the stage gets to run.
    fn fly(
        channels: usize,
        ticks: u64,
        input: impl Fn(Channel, u64) -> Option<u64>,
    ) -> Vec<(u8, u64, u64)> {
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        let instance = ipc::instance::Instance::under(root.path(), "continuity").unwrap();
        let wire = Wire::open(&instance).unwrap();
        let rt = RealtimeSettings {
            channels,
            ..RealtimeSettings::OFF
        };
        let replica = |channel| Replica::new(Role::Outer, channel);
        let twin = |channel| Twin {
            stage: Starved(0),
            continuity: Continuity::new(&wire, replica(channel)).unwrap(),
            own: LawState::INITIAL,
            channel,
        };
        let mut twins: Vec<_> = Channel::first(channels).map(twin).collect();
        for it in &mut twins {
            let replica = replica(it.channel);
            it.continuity.arm(&wire, replica, &rt, 1).unwrap();
            it.continuity.begin(&mut it.stage, 0, true, &mut it.own);
        }
        for tick in 0..ticks {
            for it in &mut twins {
                input(it.channel, tick).map(|input| it.tick(tick, input));
            }
        }
        let ends = twins.iter();
        let ends = ends.map(|it| (it.stage.0, it.own.from_tick, it.own.before));
        let ends = ends.collect();
        drop(twins);
        drop(wire);
        instance.remove_leftovers().unwrap();
        ends
    }

    #[test]
    fn after_an_outage_of_all_a_channel_with_inputs_leads_one_without() {
        for starved in [Channel::A, Channel::B] {
            let ends = fly(2, 60, |channel, tick| match tick {
                // All miss an input.
                5 => Some(4),
                10..40 if channel == starved => Some(9),
                _ => Some(tick),
            });
            assert!(ends.iter().all(|it| it.0 <= 2), "{starved:?}: {ends:?}");
            assert_eq!(ends[0], ends[1], "{starved:?}");
        }
    }

    #[test]
    fn channels_that_were_disturbed_together_end_with_the_same_state() {
        let ends = fly(3, 20, |channel, tick| match (channel, tick) {
            (Channel::A, 5..=7) | (Channel::B, 5) | (Channel::C, 5..=6) => None,
            (_, 9) => Some(8),
            // Each misses another tick.
            (Channel::A, 11) | (Channel::B, 12) | (Channel::C, 13) => None,
            _ => Some(tick),
        });
        assert_ne!(ends[0].2, UNDISTURBED);
        assert_eq!(ends, [ends[0]; 3]);
    }
}
