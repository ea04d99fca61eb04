//! The timing of a recorded flight: which stage worked which tick, with inputs of which ticks, in which order.
//!
//! Outages, skipped ticks, stale inputs, commands that came late: all of it shows in what was sent when, and in the ticks
//! of the inputs that each message names. A simulation that works in the same order with inputs of the same ticks
//! suffers the same, whatever its laws, airframe and trajectory are.

use std::path::Path;

use flight_log::entry::LogEntry;
use flight_log::reader::{End, LogReader};
use model::envelope::Envelope;
use model::grid::Pace;
use model::role::Role;
use report::tally::is_last_word;
use sha2::{Digest as _, Sha256};

use crate::replay::survey::{check_whole, first_of};
use crate::settings::Settings;
use failure::Failure;

/// The timing of a flight.
#[derive(Clone, Debug)]
pub struct Timing {
    /// What happened, in the order of the clock.
    pub events: Vec<Event>,
    /// Tick of the newest state.
    pub last_tick: u64,
    sample_time_ns: u64,
}

/// A message that was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// When [ns].
    pub sent_ns: u64,
    /// The tick that it was made for.
    pub tick: u64,
    /// When its sender had been started: another one begins with its priors.
    pub epoch: u64,
    /// What it was made from.
    pub made: Made,
}

/// What a message was made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Made {
    /// A state.
    State {
        /// Rotor commands that the plant had taken.
        taken: u64,
        /// Tick of the newest of them.
        taken_tick: u64,
    },
    /// A set-point, from the state of a tick.
    Setpoint {
        /// That tick.
        state: u64,
    },
    /// A wrench.
    Wrench {
        /// Tick of the state.
        state: u64,
        /// Tick of the set-point.
        setpoint: u64,
    },
    /// Rotor speeds.
    RotorSpeeds {
        /// Tick of the wrench.
        wrench: u64,
        /// Tick from which on the plant may use them.
        acts_from: u64,
    },
}

impl Timing {
    /// Reads the timing of a flight from its log.
    ///
    /// # Errors
    /// [`Failure`] where the log cannot be read, or does not hold every message.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let mut reader = LogReader::open(path)?;
        let mut events = Vec::new();
        let mut last_tick = 0;
        let first = first_of(&mut reader)?;
        reader.check_version()?;
        check_whole(&reader, path)?;
        let (pace, sample_time_ns) = (reader.pace()?, reader.number("sample_time_ns")?);
        if pace == Pace::Lockstep {
            return Err(Failure::failed(format!(
                "{} was flown in lockstep, which waits for everybody: it has no timing",
                path.display()
            ))
            .help("name a flight in real time: `ironbird fly --log all --pace realtime`"));
        }
        let mut take = |entry: &LogEntry| {
            let event = |envelope: &Envelope, role: Role, made| {
                let Envelope { tick, epoch, .. } = *envelope;
                Event { sent_ns: envelope.stamps_of(role).send_ns, tick, epoch, made }
            };
            match entry {
                LogEntry::State(message) => {
                    let (taken, taken_tick) = (message.content.commands_taken, message.content.command_taken_tick);
                    last_tick = message.envelope.tick;
                    events.push(event(&message.envelope, Role::Plant, Made::State { taken, taken_tick }));
                }
                LogEntry::Setpoint(message) => {
                    let state = message.envelope.input_tick[0];
                    events.push(event(&message.envelope, Role::Outer, Made::Setpoint { state }));
                }
                LogEntry::Wrench(message) => {
                    let [state, setpoint, _] = message.envelope.input_tick;
                    events.push(event(&message.envelope, Role::Inner, Made::Wrench { state, setpoint }));
                }
                LogEntry::RotorSpeeds(message) if !is_last_word(message) => {
                    let (envelope, wrench) = (&message.envelope, message.envelope.input_tick[2]);
                    let acts_from = pace.effective_tick(envelope.tick, envelope.stamps_of(Role::Mixer).send_ns);
                    events.push(event(envelope, Role::Mixer, Made::RotorSpeeds { wrench, acts_from }));
                }
                LogEntry::RotorSpeeds(_) | LogEntry::Swap(_) | LogEntry::Theorem(_) => {}
            }
        };
        take(&first);
        while let Some(entry) = reader.next_entry()? {
            take(entry);
        }
        if reader.end() != End::Complete {
            return Err(Failure::failed(format!("{} is truncated: its end is missing", path.display()))
                .help("the flight is still in the air, or its recorder died; name another flight"));
        }
        events.sort_by_key(|event| event.sent_ns);
        Ok(Self { events, last_tick, sample_time_ns })
    }

    /// The same for the same timing, wherever its recording lies: instants count by their order alone.
    #[must_use]
    pub fn sum(&self) -> String {
        let mut sum = Sha256::new();
        let mut add = |numbers: &[u64]| numbers.iter().for_each(|number| sum.update(number.to_le_bytes()));
        add(&[self.sample_time_ns, self.last_tick]);
        for Event { sent_ns: _, tick, epoch, made } in &self.events {
            match made {
                Made::State { taken, taken_tick } => add(&[0, *tick, *epoch, *taken, *taken_tick]),
                Made::Setpoint { state } => add(&[1, *tick, *epoch, *state]),
                Made::Wrench { state, setpoint } => add(&[2, *tick, *epoch, *state, *setpoint]),
                Made::RotorSpeeds { wrench, acts_from } => add(&[3, *tick, *epoch, *wrench, *acts_from]),
            }
        }
        sum.finalize().iter().take(16).map(|byte| format!("{byte:02x}")).collect()
    }

    /// Refuses a flight that cannot have this timing, which the user asked for by `key`.
    ///
    /// # Errors
    /// A usage [`Failure`] says why it cannot.
    pub fn check(&self, settings: &Settings, key: &str) -> Result<(), Failure> {
        let (here, there) = (settings.sample_time_ns(), self.sample_time_ns);
        if here != there {
            return Err(Failure::usage(format!(
                "{key}: the recorded flight has ticks of {there} ns, this one of {here} ns"
            ))
            .help("fly with the recorded period: `flight.period_s` in the file"));
        }
        if settings.last_tick() > self.last_tick {
            let recorded_s = self.last_tick as f64 * settings.flight.period_s;
            return Err(Failure::usage(format!(
                "{key}: the recorded flight ends at tick {}, this one at tick {}",
                self.last_tick,
                settings.last_tick()
            ))
            .help(format!("fly no longer than it, {recorded_s} s: --duration, or `flight.duration_s` in the file")));
        }
        if !settings.planned()?.spares_the_loop() {
            return Err(Failure::usage(format!("{key}: faults of messages and stages have a timing of their own"))
                .help("leave them out, or fly them without a recorded timing; faults of parameters may stay"));
        }
        Ok(())
    }
}
