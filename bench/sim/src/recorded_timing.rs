//! The timing of a recorded flight: which stage ran which tick, with inputs of which ticks, in which order.
//!
//! Outages, skipped ticks, stale inputs and late commands all show in the send times and in the input ticks of the messages.
//! A simulation that runs in the same order with inputs of the same ticks therefore has the same timing, whatever its laws,
//! airframe and trajectory are.

use std::path::Path;

use analysis::phrase::count;
use analysis::states::is_final_command;
use flight_log::entry::LogEntry;
use flight_log::facts::SETTINGS;
use flight_log::reader::{End, LogReader};
use messages::grid::Pace;
use messages::header::Message;
use messages::role::Role;
use sha2::{Digest as _, Sha256};

use crate::expected_messages::ExpectedMessages;
use config::Settings;
use errors::Failure;

#[derive(Clone, Debug)]
pub struct Timing {
    /// Events in the order of the clock.
    pub events: Vec<Event>,
    pub last_tick: u64,
    sample_time_ns: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    pub sent_ns: u64,
    pub tick: u64,
    /// Start of the sending process; a new process starts with initial estimates.
    pub epoch: u64,
    pub source: Source,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    State {
        /// Number of rotor commands that the plant had taken.
        taken: u64,
        /// Tick of the newest of them.
        taken_tick: u64,
    },
    /// A setpoint, from the state of a tick.
    Setpoint {
        state: u64,
    },
    Wrench {
        state: u64,
        setpoint: u64,
    },
    RotorSpeeds {
        wrench: u64,
        /// First tick in which the plant may use it.
        acts_from: u64,
    },
}

impl Timing {
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let mut reader = LogReader::open(path)?;
        let mut events = Vec::new();
        let mut last_tick = 0;
        let first = first_of(&mut reader)?;
        reader.check_version()?;
        check_whole(&reader, path)?;
        let mut expected = ExpectedMessages::new(&reader, &recorded_settings(&reader)?)?;
        let (pace, sample_time_ns) = (reader.pace()?, reader.number("sample_time_ns")?);
        if pace == Pace::Lockstep {
            return Err(Failure::failed(format!(
                "{} was flown in lockstep and has no timing",
                path.display()
            ))
            .help("name a flight in real time: `ironbird fly --log all --pace realtime`"));
        }
        let mut take = |entry: &LogEntry| {
            let (envelope, role, source) = match entry {
                LogEntry::State(Message { envelope, content }) => {
                    last_tick = envelope.tick;
                    let source = Source::State {
                        taken: content.commands_taken,
                        taken_tick: content.command_taken_tick,
                    };
                    (envelope, Role::Plant, source)
                }
                LogEntry::Setpoint(Message { envelope, .. }) => {
                    let state = envelope.input_tick[0];
                    (envelope, Role::Outer, Source::Setpoint { state })
                }
                LogEntry::Wrench(Message { envelope, .. }) => {
                    let [state, setpoint, _] = envelope.input_tick;
                    (envelope, Role::Inner, Source::Wrench { state, setpoint })
                }
                LogEntry::RotorSpeeds(message) if !is_final_command(message) => {
                    let envelope = &message.envelope;
                    let sent_ns = envelope.stamps_of(Role::Mixer).send_ns;
                    let source = Source::RotorSpeeds {
                        wrench: envelope.input_tick[2],
                        acts_from: pace.effective_tick(envelope.tick, sent_ns),
                    };
                    (envelope, Role::Mixer, source)
                }
                LogEntry::RotorSpeeds(_) | LogEntry::Swap(_) | LogEntry::Theorem(_) => return,
            };
            events.push(Event {
                sent_ns: envelope.stamps_of(role).send_ns,
                tick: envelope.tick,
                epoch: envelope.epoch,
                source,
            });
        };
        expected.check(&first)?;
        take(&first);
        while let Some(entry) = reader.next_entry()? {
            expected.check(entry)?;
            take(entry);
        }
        if reader.end() != End::Complete {
            return Err(Failure::failed(format!(
                "{} is truncated: its end is missing",
                path.display()
            ))
            .help("the flight is still running, or its recorder died; name another flight"));
        }
        expected.check_landing(&reader)?;
        events.sort_by_key(|event| event.sent_ns);
        Ok(Self {
            events,
            last_tick,
            sample_time_ns,
        })
    }

    /// A checksum over the order of events, independent of the file and of absolute times.
    pub fn sum(&self) -> String {
        let mut sum = Sha256::new();
        let mut add = |numbers: &[u64]| {
            for number in numbers {
                sum.update(number.to_le_bytes());
            }
        };
        add(&[self.sample_time_ns, self.last_tick]);
        for event in &self.events {
            let (tick, epoch) = (event.tick, event.epoch);
            match event.source {
                Source::State { taken, taken_tick } => add(&[0, tick, epoch, taken, taken_tick]),
                Source::Setpoint { state } => add(&[1, tick, epoch, state]),
                Source::Wrench { state, setpoint } => add(&[2, tick, epoch, state, setpoint]),
                Source::RotorSpeeds { wrench, acts_from } => {
                    add(&[3, tick, epoch, wrench, acts_from]);
                }
            }
        }
        sum.finalize()
            .iter()
            .take(16)
            .map(|byte| format!("{byte:02x}"))
            .collect()
    }

    /// Refuses a flight that cannot have this timing, requested by `key`.
    pub fn check(&self, settings: &Settings, key: &str) -> Result<(), Failure> {
        let (here, there) = (settings.sample_time_ns(), self.sample_time_ns);
        if here != there {
            return Err(Failure::usage(format!(
                "{key}: the recorded flight has ticks of {there} ns, this one of {here} ns"
            ))
            .help("use the recorded period: `flight.period_s` in the settings file"));
        }
        if settings.last_tick() > self.last_tick {
            let recorded_s = (self.last_tick * self.sample_time_ns) as f64 / 1e9;
            return Err(Failure::usage(format!(
                "{key}: the recorded flight ends at tick {}, this one at tick {}",
                self.last_tick,
                settings.last_tick()
            ))
            .help(format!("fly at most {recorded_s} s: --duration, or `flight.duration_s` in the settings file")));
        }
        if !settings.planned()?.has_no_loop_faults() {
            return Err(Failure::usage(format!(
                "{key}: message and stage faults cannot be combined with recorded timing"
            ))
            .help("remove these faults (--set 'flight.faults=[]' removes all, --fault names those that may stay: parameter changes) or the recorded timing"));
        }
        Ok(())
    }
}

/// The first message of a log; everything about the flight stands before it.
pub fn first_of(reader: &mut LogReader) -> Result<LogEntry, Failure> {
    if let Some(first) = reader.next_entry()? {
        return Ok(*first);
    }
    let path = reader.path().display();
    Err(match reader.end() {
        End::Complete => Failure::failed(format!("{path} holds no message: nothing was flown")),
        End::Truncated => Failure::failed(format!("{path} is truncated before its first message"))
            .help("nothing can be replayed or exported from it; name another flight"),
    })
}

/// The settings of a recorded flight, unchecked.
pub fn recorded_settings(reader: &LogReader) -> Result<Settings, Failure> {
    let text = reader.fact(SETTINGS, "settings.toml")?;
    toml::from_str(text).map_err(|e| reader.damaged(&format!("its settings: {e}")))
}

/// Refuses partial logs, whose initial state is unknown.
pub fn check_whole(reader: &LogReader, path: &Path) -> Result<(), Failure> {
    let kept = reader.kept()?;
    let files_before = kept.files_before;
    let what = match kept.around_ticks {
        Some(ticks) => format!(
            "it keeps excerpts, {} before and after each event",
            count(ticks, "tick")
        ),
        None if files_before > 0 => {
            format!("it is not the log's first file; missing before it: {files_before}")
        }
        None => return Ok(()),
    };
    Err(Failure::failed(format!("{} cannot be replayed: {what}", path.display())).help(
        "a state depends on everything before it, so that only a whole log can be flown again: `fly --log all`, with \
         `recorder.log_files = 0`; `ironbird export` gives what is there",
    ))
}
