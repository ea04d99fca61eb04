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
use messages::content::TakenCommand;
use messages::grid::Pace;
use messages::role::Role;
use sha2::{Digest as _, Sha256};

use crate::expected_messages::ExpectedMessages;
use config::Settings;
use errors::Failure;

#[derive(Clone, Debug)]
pub struct Timing {
    /// Events in the order in which they happened.
    pub events: Vec<Event>,
    pub last_tick: u64,
    sample_time_ns: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    pub tick: u64,
    /// Start of the sending process; a new process starts with initial estimates.
    pub epoch: u64,
    pub source: Source,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    State,
    /// The plant took the command of a tick, before its next state.
    Taken {
        command: u64,
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
        let settings = recorded_settings(&reader)?;
        let channels = settings.rt.channels;
        if channels > 1 {
            return Err(Failure::failed(format!(
                "{} was flown with {channels} channels, of which a simulation has one: their timing cannot be repeated",
                path.display()
            ))
            .help("name a flight with one channel"));
        }
        let mut expected = ExpectedMessages::new(&reader, &settings)?;
        let (pace, sample_time_ns) = (reader.pace()?, reader.number("sample_time_ns")?);
        if pace == Pace::Lockstep {
            return Err(Failure::failed(format!(
                "{} was flown in lockstep and has no timing",
                path.display()
            ))
            .help("name a flight in real time: `ironbird fly --log all --pace realtime`"));
        }
        let mut next = Some(first);
        while let Some(entry) = next {
            expected.check(&entry)?;
            let (position, header) = (reader.position(), entry.envelope());
            let (tick, epoch) = (header.tick, header.epoch);
            each_source(&entry, pace, |source| {
                if source == Source::State {
                    last_tick = tick;
                }
                let event = Event {
                    tick,
                    epoch,
                    source,
                };
                events.push((position, event));
            });
            next = reader.next_entry()?.copied();
        }
        if reader.end() != End::Complete {
            return Err(Failure::failed(format!(
                "{} is truncated: its end is missing",
                path.display()
            ))
            .help("the flight is still running, or its recorder died; name another flight"));
        }
        expected.check_landing(&reader)?;
        events.sort_by_key(|(position, _)| *position);
        Ok(Self {
            events: events.into_iter().map(|(_, event)| event).collect(),
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
                Source::State => add(&[0, tick, epoch]),
                Source::Taken { command } => add(&[4, tick, command]),
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

/// Calls `event` with what stages did according to a message, in its order.
fn each_source(entry: &LogEntry, pace: Pace, mut event: impl FnMut(Source)) {
    let header = entry.envelope();
    let mut taken = |command: &TakenCommand| {
        if command.is_offered == 1 {
            event(Source::Taken {
                command: command.of_tick,
            });
        }
    };
    match entry {
        LogEntry::Decisions(message) => message.content.commands().iter().for_each(taken),
        LogEntry::State(message) => {
            if message.content.decision.count == 1 {
                taken(&message.content.decision.command);
            }
            event(Source::State);
        }
        LogEntry::Setpoint(_) => {
            let state = header.input_tick[0];
            event(Source::Setpoint { state });
        }
        LogEntry::Wrench(_) => {
            let [state, setpoint, _] = header.input_tick;
            event(Source::Wrench { state, setpoint });
        }
        LogEntry::RotorSpeeds(message) if !is_final_command(message) => {
            let sent_ns = header.stamps_of(Role::Mixer).send_ns;
            event(Source::RotorSpeeds {
                wrench: header.input_tick[2],
                acts_from: pace.effective_tick(header.tick, sent_ns),
            });
        }
        _ => {}
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
    Settings::recorded(text).map_err(|e| reader.damaged(&format!("its settings: {e}")))
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
