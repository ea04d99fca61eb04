//! Logs of flights that never were in the air: the laws in one process, on a made-up clock, with made-up faults.
//!
//! A test says which stage is silent or late in a tick; plant, command hold and laws are the real ones, and receive and
//! publish as their processes do.

use control_api::{GuardedInner, GuardedMixer, GuardedOuter, SavedState};
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use analysis::host::Host;
use config::Settings;
use controller::flight_monitor::FlightMonitor;
use flight_log::causal_order::CausalOrder;
use flight_log::entry::LogEntry;
use flight_log::facts::{Facts, record};
use flight_log::writer::{CHUNK_NS, FlightLog};
use messages::blackboards::Run;
use messages::content::{
    DECISIONS, Decision, Decisions, NO_TICK, RotorSpeeds, Setpoint, Stamped, State, SwapRecord,
    TakenCommand, Wrench,
};
use messages::grid::{Grid, Pace};
use messages::header::{Header, Message, Stamps};
use messages::history::LawState;
use messages::monitor::Monitor;
use messages::role::{Channel, Role};
use messages::settings_text::fingerprint;
use messages::topic::Topic;
use plant::Plant;
use plant::command_hold::pending_commands;

pub const GRID: Grid = Grid {
    t0_ns: 5_000_000_000,
    period_ns: 1_000_000,
};
const EPOCH: u64 = 1_000_000;

#[derive(Clone, Copy, Debug, Default)]
pub struct TickFaults {
    pub silent: [bool; 4],
    /// The plant wakes only when the others have given up waiting.
    pub plant_is_late: bool,
    /// The mixer's command comes later by this [ns].
    pub mixer_late_ns: u64,
    /// A new process of the inner loop begins with this tick.
    pub inner_restarts: bool,
    /// A new process of the inner loop begins with this tick, from the state before the last one: the process before it was
    /// killed between sending and saving.
    pub inner_resumes: bool,
}

#[derive(Clone, Debug, Default)]
pub struct Published {
    pub states: Vec<Message<State>>,
    pub setpoints: Vec<Message<Setpoint>>,
    pub wrenches: Vec<Message<Wrench>>,
    pub rotor_speeds: Vec<Message<RotorSpeeds>>,
    pub swaps: Vec<Message<SwapRecord>>,
    pub decisions: Vec<Message<Decisions>>,
    pub theorem: Vec<Message<Monitor>>,
}

/// Settings with these lines of a settings file.
pub fn settings(text: &str) -> Settings {
    let file = tempfile::NamedTempFile::new_in("/dev/shm").unwrap();
    std::fs::write(file.path(), text).unwrap();
    Settings::resolve(Some(file.path()), &Vec::new()).unwrap()
}

fn newest<C: Topic>(published: &[Message<C>]) -> (Stamped<C>, Header) {
    let (tick, content, header) = match published.last() {
        Some(message) => (message.envelope.tick, message.content, message.envelope),
        None => (NO_TICK, C::default(), Header::new()),
    };
    (Stamped { tick, content }, header)
}

/// Flies, with the faults of each tick. Not inlined: plant and laws would take the stack that the test's replay needs.
#[inline(never)]
pub fn fly(settings: &Settings, faults: impl Fn(u64) -> TickFaults) -> Published {
    let mut plant = Plant::new(&settings.plant().unwrap());
    for swap in settings.planned().unwrap().swaps {
        plant.schedule(swap).unwrap();
    }
    let mut flight = Flight {
        settings,
        fingerprint: fingerprint(&settings.shared_text().unwrap()),
        plant,
        outer: settings.outer_stage().unwrap(),
        inner: settings.inner_stage().unwrap(),
        inner_epoch: EPOCH,
        inner_seq: 0,
        inner_before: (SavedState::new(), LawState::INITIAL),
        mixer: settings.mixer_stage().unwrap(),
        theorem: FlightMonitor::new(settings.theorem().unwrap()),
        law_states: [LawState::INITIAL; 3],
        published: Published::default(),
        sent: VecDeque::new(),
        last_sent_ns: 0,
    };
    for tick in 0..=settings.last_tick() {
        let faults = faults(tick);
        let is_silent = faults.silent[Role::Plant as usize];
        let is_in_time = !is_silent && !faults.plant_is_late;
        if is_in_time {
            flight.plant(tick, 30_000);
        }
        flight.others(tick, &faults, if is_in_time { 50_000 } else { 900_000 });
        if faults.plant_is_late && !is_silent {
            flight.plant(tick, 950_000);
        }
    }
    let landed = settings.last_tick() + 1;
    flight.take_commands(landed, GRID.begin_of(landed));
    let idle = flight.mixer.idle();
    flight.send(landed, Header::new(), 0, GRID.begin_of(landed), idle);
    flight.published
}

struct Flight<'a> {
    settings: &'a Settings,
    fingerprint: u64,
    plant: Plant,
    outer: GuardedOuter,
    inner: GuardedInner,
    inner_epoch: u64,
    inner_seq: usize,
    /// State of the inner loop before its last tick.
    inner_before: (SavedState, LawState),
    mixer: GuardedMixer,
    theorem: FlightMonitor,
    /// Of outer loop, inner loop and mixer.
    law_states: [LawState; 3],
    published: Published,
    /// Commands that the plant has not received yet.
    sent: VecDeque<Message<RotorSpeeds>>,
    last_sent_ns: u64,
}

fn stamped(mut header: Header, role: Role, receive_ns: u64, send_ns: u64) -> Header {
    header.stamps[role as usize] = Stamps {
        receive_ns,
        send_ns,
    };
    header
}

impl Flight<'_> {
    fn message<C: Topic>(
        &self,
        tick: u64,
        epoch: u64,
        seq: usize,
        history: Header,
        content: C,
    ) -> Message<C> {
        let envelope = Header {
            run_id: 7,
            settings: self.fingerprint,
            epoch,
            seq: seq as u64,
            tick,
            ..history
        };
        Message { envelope, content }
    }

    /// Takes the commands that were sent until `wake_ns`, and records the decisions before the state of a tick.
    fn take_commands(&mut self, tick: u64, wake_ns: u64) -> Decision {
        let sent_ns = |it: &Message<RotorSpeeds>| it.envelope.stamps_of(Role::Mixer).send_ns;
        let there = self.sent.partition_point(|it| sent_ns(it) <= wake_ns);
        let there: Vec<_> = self.sent.drain(..there).collect();
        // Commands that do not fit the plant's port have been overwritten.
        let kept = there.len().saturating_sub(pending_commands(1e-3));
        let mut decided = Vec::new();
        for message in &there[kept..] {
            let (tick, content) = (message.envelope.tick, message.content);
            let effective = Pace::Realtime(GRID).effective_tick(tick, sent_ns(message));
            decided.push(TakenCommand {
                of_tick: tick,
                seq: message.envelope.seq,
                acts_from: self.plant.offer(&Stamped { tick, content }, effective),
                is_offered: 1,
                channel: 0,
            });
        }
        if decided.len() > 1 || tick > self.settings.last_tick() {
            let none: &[TakenCommand] = &[];
            let is_none = decided.is_empty();
            for part in decided.chunks(DECISIONS).chain(is_none.then_some(none)) {
                let mut content = Decisions {
                    count: part.len() as u64,
                    ..Decisions::default()
                };
                content.command[..part.len()].copy_from_slice(part);
                let history = stamped(Header::new(), Role::Plant, 0, wake_ns + 1_500);
                let seq = self.published.decisions.len();
                let message = self.message(tick, EPOCH, seq, history, content);
                self.published.decisions.push(message);
            }
        }
        let command = match decided[..] {
            [command] => command,
            _ => TakenCommand::default(),
        };
        Decision {
            count: decided.len() as u64,
            refused: 0,
            command,
            group: 0,
        }
    }

    fn plant(&mut self, tick: u64, offset_ns: u64) {
        let wake_ns = GRID.begin_of(tick) + offset_ns;
        let decision = self.take_commands(tick, wake_ns);
        let mut state = self.plant.begin(tick);
        state.decision = Decision {
            refused: state.decision.refused,
            ..decision
        };
        let history = Header {
            sample_ns: wake_ns,
            parameter_epoch: state.parameter_epoch,
            ..Header::new()
        };
        let history = stamped(history, Role::Plant, wake_ns, wake_ns + 2_000);
        let message = self.message(tick, EPOCH, self.published.states.len(), history, state);
        self.published.states.push(message);
        for applied in self.plant.applied() {
            let (seq, record) = (self.published.swaps.len(), applied.record());
            let history = stamped(Header::new(), Role::Plant, 0, wake_ns + 1_000);
            let message = self.message(applied.tick, EPOCH, seq, history, record);
            self.published.swaps.push(message);
        }
        self.plant.finish();
    }

    /// The state that a stage continues from in a tick with these inputs; its state is then that after the tick.
    fn law_state(&mut self, stage: usize, tick: u64, inputs: &[&Header]) -> LawState {
        let state = &mut self.law_states[stage];
        let histories = inputs.iter().map(|it| (it.tick, it.law_state.after));
        state.advance(tick, histories);
        let continued = *state;
        *state = LawState::after(tick, Channel::A, continued.after);
        continued
    }

    fn others(&mut self, tick: u64, faults: &TickFaults, offset_ns: u64) {
        let begin_ns = GRID.begin_of(tick) + offset_ns;
        let [_, outer_is_silent, inner_is_silent, mixer_is_silent] = faults.silent;
        let (state, of_state) = newest(&self.published.states);
        if !outer_is_silent && let Some(setpoint) = self.outer.tick(tick, &state) {
            let mut history = stamped(of_state, Role::Outer, begin_ns, begin_ns + 1_000);
            history.input_tick[0] = state.tick;
            history.law_state = self.law_state(0, tick, &[&of_state]);
            let seq = self.published.setpoints.len();
            let message = self.message(tick, EPOCH, seq, history, setpoint);
            self.published.setpoints.push(message);
        }
        if faults.inner_restarts {
            self.inner = self.settings.inner_stage().unwrap();
            self.law_states[1] = LawState::INITIAL;
            (self.inner_epoch, self.inner_seq) = (begin_ns, 0);
        }
        if faults.inner_resumes {
            self.inner = self.settings.inner_stage().unwrap();
            assert!(self.inner.load(&self.inner_before.0));
            self.law_states[1] = self.inner_before.1;
            (self.inner_epoch, self.inner_seq) = (begin_ns, 0);
        }
        if !inner_is_silent {
            assert!(self.inner.save(&mut self.inner_before.0));
            self.inner_before.1 = self.law_states[1];
            let (setpoint, of_setpoint) = newest(&self.published.setpoints);
            let wrench = self.inner.tick(tick, &state, &setpoint);
            let mut history = stamped(of_state, Role::Inner, begin_ns, begin_ns + 2_000);
            history.input_tick = [state.tick, setpoint.tick, NO_TICK];
            history.law_state = self.law_state(1, tick, &[&of_setpoint, &of_state]);
            let message = self.message(tick, self.inner_epoch, self.inner_seq, history, wrench);
            self.inner_seq += 1;
            self.published.wrenches.push(message);
            let monitored = self.theorem.watch(&message, Some(&state), Some(&setpoint));
            self.published.theorem.extend(monitored);
        }
        if !mixer_is_silent {
            let (wrench, mut history) = newest(&self.published.wrenches);
            let speeds = self.mixer.tick(tick, &wrench);
            self.theorem.command(tick, &speeds);
            let of_wrench = history;
            history.input_tick[2] = wrench.tick;
            history.law_state = self.law_state(2, tick, &[&of_wrench]);
            let send_ns = begin_ns + 3_000 + faults.mixer_late_ns;
            self.send(tick, history, begin_ns, send_ns, speeds);
        }
    }

    fn send(
        &mut self,
        tick: u64,
        history: Header,
        receive_ns: u64,
        send_ns: u64,
        speeds: RotorSpeeds,
    ) {
        self.last_sent_ns = send_ns.max(self.last_sent_ns + 1_000);
        let history = stamped(history, Role::Mixer, receive_ns, self.last_sent_ns);
        let seq = self.published.rotor_speeds.len();
        let message = self.message(tick, EPOCH, seq, history, speeds);
        self.published.rotor_speeds.push(message);
        self.sent.push_back(message);
    }
}

pub fn facts(settings: &Settings, channel: Option<Channel>) -> Facts {
    let run = Run {
        run_id: 7,
        settings: fingerprint(&settings.shared_text().unwrap()),
        t0_ns: GRID.t0_ns,
        t0_wall_ns: 1_700_000_000_000_000_000,
        period_ns: GRID.period_ns,
        sample_time_ns: GRID.period_ns,
        last_tick: settings.last_tick(),
        ..Run::default()
    };
    let (host, roles) = (Host::default(), BTreeMap::new());
    recorder::log_metadata::metadata(&run, settings, channel, "none", &host, &roles).unwrap()
}

/// Writes a flight as the recorder does.
pub fn write(path: &Path, settings: &Settings, published: &Published) {
    fn take<C: Topic>(
        order: &mut CausalOrder,
        messages: &[Message<C>],
        entry: fn(Message<C>) -> LogEntry,
    ) {
        let entries = messages.iter().map(|it| entry(*it));
        entries.for_each(|entry| order.take(Channel::A, &entry));
    }
    let mut order = CausalOrder::default();
    take(&mut order, &published.states, LogEntry::State);
    take(&mut order, &published.setpoints, LogEntry::Setpoint);
    take(&mut order, &published.wrenches, LogEntry::Wrench);
    take(&mut order, &published.rotor_speeds, LogEntry::RotorSpeeds);
    take(&mut order, &published.swaps, LogEntry::Swap);
    take(&mut order, &published.decisions, LogEntry::Decisions);
    take(&mut order, &published.theorem, LogEntry::Theorem);
    let mut log = FlightLog::create(path, &facts(settings, None)).unwrap();
    let mut position = 0;
    order.release(u64::MAX, |_, entry| {
        position += 1;
        log.take(entry, position);
        log.keep(position * CHUNK_NS / 50).unwrap();
    });
    log.finish(record(&[("ending", "completed")])).unwrap();
}
