//! Logs of flights that never were in the air: the laws in one process, on a made-up clock, with made-up trouble.
//!
//! Who sleeps when, and what is late, is up to the test; plant, latch and laws are the real ones, and take and send
//! as their processes do.
#![allow(dead_code, reason = "each test file uses its part")]

pub mod rewritten;

use control_api::{GuardedInner, GuardedMixer, GuardedOuter};
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use flight_log::entry::LogEntry;
use flight_log::facts::{Facts, record};
use flight_log::writer::{CHUNK_NS, Fate, FlightLog};
use ironbird::settings::Settings;
use ironbird::theorem::FlightMonitor;
use messages::blackboards::Run;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, SwapRecord, Wrench};
use messages::grid::{Grid, Pace};
use messages::header::{Header, Message, Stamps};
use messages::monitor::Monitor;
use messages::role::Role;
use messages::settings_text::fingerprint;
use messages::topic::Topic;
use plant::Plant;
use plant::command_hold::PENDING_COMMANDS;
use plant::parameter_server::swap_record;
use report::host::Host;

pub const GRID: Grid = Grid {
    t0_ns: 5_000_000_000,
    period_ns: 1_000_000,
};
const EPOCH: u64 = 1_000_000;

/// What goes wrong in a tick.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultKind {
    pub plant_sleeps: bool,
    /// The plant wakes only when the others have given up waiting.
    pub plant_is_late: bool,
    pub outer_sleeps: bool,
    pub inner_sleeps: bool,
    pub mixer_sleeps: bool,
    /// The mixer's command comes later by this [ns].
    pub mixer_late_ns: u64,
    /// A new process of the inner loop begins with this tick.
    pub inner_restarts: bool,
}

/// Everything that was published, by topic.
#[derive(Clone, Debug, Default)]
pub struct Published {
    pub states: Vec<Message<State>>,
    pub setpoints: Vec<Message<Setpoint>>,
    pub wrenches: Vec<Message<Wrench>>,
    pub rotor_speeds: Vec<Message<RotorSpeeds>>,
    pub swaps: Vec<Message<SwapRecord>>,
    pub theorem: Vec<Message<Monitor>>,
}

/// Settings with these lines of a settings file.
pub fn settings(text: &str) -> Settings {
    let file = tempfile::NamedTempFile::new_in("/dev/shm").unwrap();
    std::fs::write(file.path(), text).unwrap();
    Settings::resolve(Some(file.path()), &Vec::new()).unwrap()
}

fn newest<C: Topic>(published: &[Message<C>]) -> (Stamped<C>, Header) {
    match published.last() {
        Some(message) => (
            Stamped {
                tick: message.envelope.tick,
                content: message.content,
            },
            message.envelope,
        ),
        None => (
            Stamped {
                tick: NO_TICK,
                content: C::default(),
            },
            Header::new(),
        ),
    }
}

/// Flies, with the trouble that each tick has.
pub fn fly(settings: &Settings, trouble: impl Fn(u64) -> FaultKind) -> Published {
    let mut flight = Flight::new(settings);
    for tick in 0..=settings.last_tick() {
        let trouble = trouble(tick);
        let wakes_in_time = !trouble.plant_sleeps && !trouble.plant_is_late;
        if wakes_in_time {
            flight.plant(tick, 30_000);
        }
        flight.others(tick, &trouble, if wakes_in_time { 50_000 } else { 900_000 });
        if trouble.plant_is_late && !trouble.plant_sleeps {
            flight.plant(tick, 950_000);
        }
    }
    flight.land(settings.last_tick() + 1);
    flight.published
}

struct Flight<'a> {
    settings: &'a Settings,
    fingerprint: u64,
    plant: Plant,
    outer: GuardedOuter,
    inner: GuardedInner,
    inner_epoch: u64,
    inner_seq: u64,
    mixer: GuardedMixer,
    theorem: FlightMonitor,
    published: Published,
    /// Commands that the plant has not taken yet.
    on_the_way: VecDeque<Message<RotorSpeeds>>,
    last_sent_ns: u64,
}

impl<'a> Flight<'a> {
    fn new(settings: &'a Settings) -> Self {
        let mut plant = Plant::new(&settings.plant().unwrap());
        for fault in settings.planned().unwrap().swaps {
            plant.schedule(fault).unwrap();
        }
        Self {
            settings,
            fingerprint: fingerprint(&settings.shared_text().unwrap()),
            plant,
            outer: settings.outer_stage().unwrap(),
            inner: settings.inner_stage().unwrap(),
            inner_epoch: EPOCH,
            inner_seq: 0,
            mixer: settings.mixer_stage().unwrap(),
            theorem: FlightMonitor::new(settings.theorem().unwrap()),
            published: Published::default(),
            on_the_way: VecDeque::new(),
            last_sent_ns: 0,
        }
    }

    fn message<C: Topic>(
        &self,
        tick: u64,
        epoch: u64,
        seq: usize,
        history: Header,
        content: C,
    ) -> Message<C> {
        let (settings, seq) = (self.fingerprint, seq as u64);
        Message {
            envelope: Header {
                run_id: 7,
                settings,
                epoch,
                seq,
                tick,
                ..history
            },
            content,
        }
    }

    fn plant(&mut self, tick: u64, offset_ns: u64) {
        let wake_ns = GRID.begin_of(tick) + offset_ns;
        let sent = |message: &Message<RotorSpeeds>| message.envelope.stamps_of(Role::Mixer).send_ns;
        let mut there: Vec<_> = Vec::new();
        while let Some(message) = self
            .on_the_way
            .pop_front_if(|message| sent(message) <= wake_ns)
        {
            there.push(message);
        }
        // What does not fit the plant's port has been overwritten.
        for message in &there[there.len().saturating_sub(PENDING_COMMANDS)..] {
            let effective =
                Pace::Realtime(GRID).effective_tick(message.envelope.tick, sent(message));
            self.plant.offer(
                &Stamped {
                    tick: message.envelope.tick,
                    content: message.content,
                },
                effective,
            );
        }
        let state = self.plant.begin(tick);
        let mut history = Header {
            sample_ns: wake_ns,
            parameter_epoch: state.parameter_epoch,
            ..Header::new()
        };
        history.stamps[Role::Plant as usize] = Stamps {
            receive_ns: wake_ns,
            send_ns: wake_ns + 2_000,
        };
        let message = self.message(tick, EPOCH, self.published.states.len(), history, state);
        self.published.states.push(message);
        for applied in self.plant.applied() {
            let seq = self.published.swaps.len();
            let message = self.message(
                applied.tick,
                EPOCH,
                seq,
                Header::new(),
                swap_record(applied),
            );
            self.published.swaps.push(message);
        }
        self.plant.finish();
    }

    fn others(&mut self, tick: u64, trouble: &FaultKind, offset_ns: u64) {
        let begin_ns = GRID.begin_of(tick) + offset_ns;
        let (state, state_envelope) = newest(&self.published.states);
        if !trouble.outer_sleeps
            && let Some(setpoint) = self.outer.tick(tick, &state)
        {
            let mut history = state_envelope;
            history.input_tick[0] = state.tick;
            history.stamps[Role::Outer as usize] = Stamps {
                receive_ns: begin_ns,
                send_ns: begin_ns + 1_000,
            };
            let message = self.message(
                tick,
                EPOCH,
                self.published.setpoints.len(),
                history,
                setpoint,
            );
            self.published.setpoints.push(message);
        }
        if trouble.inner_restarts {
            self.inner = self.settings.inner_stage().unwrap();
            (self.inner_epoch, self.inner_seq) = (begin_ns, 0);
        }
        if !trouble.inner_sleeps {
            let (setpoint, _) = newest(&self.published.setpoints);
            let wrench = self.inner.tick(tick, &state, &setpoint);
            let mut history = state_envelope;
            history.input_tick = [state.tick, setpoint.tick, NO_TICK];
            history.stamps[Role::Inner as usize] = Stamps {
                receive_ns: begin_ns,
                send_ns: begin_ns + 2_000,
            };
            let message = self.message(
                tick,
                self.inner_epoch,
                self.inner_seq as usize,
                history,
                wrench,
            );
            self.inner_seq += 1;
            self.published.wrenches.push(message);
            self.published
                .theorem
                .push(self.theorem.watch(&message, Some(&state)).unwrap());
        }
        if !trouble.mixer_sleeps {
            let (wrench, mut history) = newest(&self.published.wrenches);
            let speeds = self.mixer.tick(tick, &wrench);
            history.input_tick[2] = wrench.tick;
            self.send(
                tick,
                history,
                begin_ns,
                begin_ns + 3_000 + trouble.mixer_late_ns,
                speeds,
            );
        }
    }

    fn send(
        &mut self,
        tick: u64,
        mut history: Header,
        receive_ns: u64,
        send_ns: u64,
        speeds: RotorSpeeds,
    ) {
        self.last_sent_ns = send_ns.max(self.last_sent_ns + 1_000);
        history.stamps[Role::Mixer as usize] = Stamps {
            receive_ns,
            send_ns: self.last_sent_ns,
        };
        let message = self.message(
            tick,
            EPOCH,
            self.published.rotor_speeds.len(),
            history,
            speeds,
        );
        self.published.rotor_speeds.push(message);
        self.on_the_way.push_back(message);
    }

    fn land(&mut self, tick: u64) {
        let idle = self.mixer.idle();
        self.send(tick, Header::new(), 0, GRID.begin_of(tick), idle);
    }
}

pub fn facts(settings: &Settings) -> Facts {
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
    ironbird::record::log_metadata::metadata(
        &run,
        settings,
        "none",
        &Host::default(),
        &BTreeMap::new(),
    )
    .unwrap()
}

/// Writes a flight as the recorder does: ten ticks at a time, topic after topic, swaps later than their ticks.
pub fn write(path: &Path, settings: &Settings, published: &Published) -> Fate {
    const SWAPS_LATER: u64 = 25;
    let mut log = FlightLog::create(path, &facts(settings)).unwrap();
    let end = settings.last_tick() + 1 + SWAPS_LATER;
    for from in (0..=end).step_by(10) {
        let now = |tick: u64| (from..from + 10).contains(&tick);
        for message in published
            .states
            .iter()
            .filter(|message| now(message.envelope.tick))
        {
            log.take(LogEntry::State(*message));
        }
        for message in published
            .setpoints
            .iter()
            .filter(|message| now(message.envelope.tick))
        {
            log.take(LogEntry::Setpoint(*message));
        }
        for message in published
            .wrenches
            .iter()
            .filter(|message| now(message.envelope.tick))
        {
            log.take(LogEntry::Wrench(*message));
        }
        for message in published
            .rotor_speeds
            .iter()
            .filter(|message| now(message.envelope.tick))
        {
            log.take(LogEntry::RotorSpeeds(*message));
        }
        for message in published
            .theorem
            .iter()
            .filter(|message| now(message.envelope.tick))
        {
            log.take(LogEntry::Theorem(*message));
        }
        for message in published
            .swaps
            .iter()
            .filter(|message| now(message.envelope.tick + SWAPS_LATER))
        {
            log.take(LogEntry::Swap(*message));
        }
        log.keep(GRID.begin_of(0) + from * CHUNK_NS).unwrap();
    }
    log.finish(record(&[("ending", "completed")])).unwrap()
}

/// Numbers that look random and are not.
#[derive(Clone, Copy, Debug)]
pub struct Dice(pub u64);

impl Dice {
    pub fn roll(&mut self, below: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % below
    }
}
