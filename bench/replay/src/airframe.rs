//! Replays the plant: it takes the commands that the log says it took, and integrates to the next recorded state.

use std::collections::VecDeque;

use faults::filter::FaultFilter;
use faults::{MessageFaults, Port};
use messages::content::{
    Change, Decision, Decisions, NO_TICK, RotorSpeeds, Stamped, State, SwapRecord, TakenCommand,
};
use messages::grid::Pace;
use messages::header::{Header, Message};
use messages::role::{Channel, Role};
use plant::{Plant, Swap, Target};
use redundancy::Arrangement;

use crate::comparison::ReplayComparison;
use errors::Failure;
use sim::expected_messages::gap;

/// The plant between two recorded states.
#[derive(Clone, Debug)]
pub struct AirframeReplay {
    plant: Box<Plant>,
    /// The newest state.
    state: State,
    arrangement: Arrangement,
    pace: Pace,
    /// Swaps that were read and are not applied yet.
    swaps: VecDeque<Message<SwapRecord>>,
    /// Decisions of the next state that were read, and its tick as they say.
    decided: Vec<TakenCommand>,
    decided_for: Option<u64>,
}

impl AirframeReplay {
    pub fn new(
        settings: &plant::PlantSettings,
        arrangement: Arrangement,
        pace: Pace,
        faults: &MessageFaults,
    ) -> Self {
        let mut plant = Box::new(Plant::new(settings));
        plant.set_fault_filter(FaultFilter::new(faults, Port::PlantRotorSpeeds));
        Self {
            plant,
            state: State::default(),
            arrangement,
            pace,
            swaps: VecDeque::new(),
            decided: Vec::new(),
            decided_for: None,
        }
    }

    pub fn push_swap(&mut self, swap: &Message<SwapRecord>) {
        self.swaps.push_back(*swap);
    }

    pub fn push_decisions(&mut self, message: &Message<Decisions>) {
        self.decided.extend(message.content.commands());
        self.decided_for = Some(message.envelope.tick);
    }

    /// Integrates to a recorded state with the commands that were taken for it, and compares it and the swaps applied on
    /// the way. `command` gives the rotor command of a tick of a channel.
    pub fn step<'a>(
        &mut self,
        message: &Message<State>,
        command: impl Fn(Channel, u64) -> Option<&'a (Header, Stamped<RotorSpeeds>)>,
        comparison: &mut ReplayComparison,
    ) -> Result<&State, Failure> {
        let (tick, recorded) = (message.envelope.tick, &message.content);
        let due = self.schedule_until(tick)?;
        let decision = recorded.decision;
        if decision.count == 1 {
            self.decided.push(decision.command);
        }
        let of_tick = self.decided_for.take().unwrap_or(tick);
        if self.decided.len() as u64 != decision.count || of_tick != tick {
            return Err(gap(&format!(
                "the state of tick {tick} was made after {} decisions, and it has {} for tick {of_tick}",
                decision.count,
                self.decided.len()
            )));
        }
        self.take_commands(tick, command, comparison)?;
        if self.plant.target().is_some_and(|it| *it != recorded.target) {
            self.plant.aim(recorded.target);
        }
        let replayed = &mut self.state;
        self.plant.begin_into(tick, replayed);
        replayed.decision = Decision {
            count: decision.count,
            command: decision.command,
            ..replayed.decision
        };
        comparison.compare(tick, recorded, replayed);
        let mut applied = self.plant.applied().iter().map(plant::AppliedSwap::record);
        for swap in due {
            let replayed = applied.next().unwrap_or_default();
            comparison.compare(swap.envelope.tick, &swap.content, &replayed);
        }
        self.plant.finish();
        Ok(&self.state)
    }

    /// Judges the command of the last tick, with the decisions after it. Returns all missed deadlines of the flight.
    pub fn end<'a>(
        &mut self,
        last_tick: u64,
        command: impl Fn(Channel, u64) -> Option<&'a (Header, Stamped<RotorSpeeds>)>,
        comparison: &mut ReplayComparison,
    ) -> Result<u64, Failure> {
        self.take_commands(last_tick + 1, command, comparison)?;
        Ok(self.plant.end(last_tick).deadlines_missed)
    }

    fn take_commands<'a>(
        &mut self,
        tick: u64,
        command: impl Fn(Channel, u64) -> Option<&'a (Header, Stamped<RotorSpeeds>)>,
        comparison: &mut ReplayComparison,
    ) -> Result<(), Failure> {
        for taken in self.decided.drain(..) {
            let channel = Channel::from_wire(taken.channel);
            let message = channel.and_then(|it| Some((it, command(it, taken.of_tick)?)));
            let message = message.filter(|(_, (header, _))| header.seq == taken.seq);
            let Some((of, (header, command))) = message else {
                return Err(gap(&format!(
                    "before tick {tick} the plant took message {} of topic `rotor_speeds` of channel {} (tick {}), which \
                     is not in it",
                    taken.seq,
                    channel.map_or("?", Channel::name),
                    taken.of_tick
                )));
            };
            if taken.is_offered == 0 {
                self.plant.refuse();
                continue;
            }
            let sent_ns = header.stamps_of(Role::Mixer).send_ns;
            let acts_from = self.pace.effective_tick(header.tick, sent_ns);
            let acts_from = self
                .plant
                .offer_of(self.arrangement.group(of), command, acts_from);
            if acts_from != taken.acts_from {
                let of_tick = |tick: u64| match tick {
                    NO_TICK => "never".to_owned(),
                    tick => format!("tick {tick}"),
                };
                let acts = [taken.acts_from, acts_from].map(of_tick);
                comparison.differs::<State>(tick, "decision.command.acts_from", acts);
            }
        }
        Ok(())
    }

    /// Schedules and returns the swaps up to this tick.
    fn schedule_until(&mut self, tick: u64) -> Result<Vec<Message<SwapRecord>>, Failure> {
        let mut due = Vec::new();
        while let Some(swap) = self.swaps.pop_front_if(|swap| swap.envelope.tick <= tick) {
            let order = swap_of(&swap)?;
            let held_from = self.plant.schedule(order).map_err(|e| refused(&swap, &e))?;
            if held_from != swap.envelope.tick {
                let past = format!(
                    "it was applied at tick {}, which is past",
                    swap.envelope.tick
                );
                return Err(refused(&swap, &past));
            }
            due.push(swap);
        }
        Ok(due)
    }
}

/// The parameter change of a record.
pub fn swap_of(record: &Message<SwapRecord>) -> Result<Swap, Failure> {
    let target = |change: Change| Target {
        parameter: change.parameter,
        value: change.new,
        steps: change.steps,
    };
    let targets: Vec<Target> = record.content.changes().map(target).collect();
    Swap::to(record.envelope.tick, &targets).map_err(|e| refused(record, &e))
}

fn refused(record: &Message<SwapRecord>, why: &dyn std::fmt::Display) -> Failure {
    let epoch = record.content.parameter_epoch;
    Failure::failed(format!(
        "parameter change {epoch} of the log cannot be applied: {why}"
    ))
}
