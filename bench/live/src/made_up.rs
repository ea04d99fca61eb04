//! Flights of tests, which are fed with made-up messages.

use std::collections::BTreeMap;

use flight_log::entry::LogEntry;
use messages::blackboards::{ActiveParameters, Run, RunPhase};
use messages::content::{State, TakenCommand};
use messages::header::{Header, Message, Stamps};
use messages::parameters::Airframe;
use messages::role::Channel;

use crate::watch::dashboard_model::{Model, WatchedFlight};

const PERIOD_NS: u64 = 1_000_000;

pub fn run() -> Run {
    Run {
        phase: RunPhase::Flying as u64,
        run_id: 7,
        t0_ns: 5_000_000_000,
        period_ns: PERIOD_NS,
        sample_time_ns: PERIOD_NS,
        last_tick: 30_000,
        ..Run::default()
    }
}

/// A message of a tick whose chain took 30 us.
pub fn message<C>(tick: u64, content: C) -> Message<C> {
    let sample_ns = run().t0_ns + tick * PERIOD_NS + 5_000;
    let stage = |number: u64| Stamps {
        receive_ns: sample_ns + number * 8_000,
        send_ns: sample_ns + number * 8_000 + 6_000,
    };
    let envelope = Header {
        run_id: 7,
        epoch: 1,
        seq: tick,
        tick,
        sample_ns,
        input_tick: [tick; 3],
        previous_busy_ns: 9_000,
        stamps: [0, 1, 2, 3].map(stage),
        ..Header::new()
    };
    Message { envelope, content }
}

/// A dashboard that has joined a flight along a step, unless the settings name another trajectory.
pub fn joined(run: &Run, settings: &[(&str, &str)]) -> Model {
    let mut model = Model::new("left", false, true);
    let all = [
        ("flight.trajectory", "\"step\""),
        ("flight.preset", "\"\""),
        ("mixer.law", "\"roll_pitch_first\""),
    ];
    let all: BTreeMap<&str, &str> = all.iter().chain(settings).copied().collect();
    let lines = all.iter().map(|(key, value)| format!("{key} = {value}\n"));
    model.join(run, &lines.collect::<String>()).unwrap();
    flight(&mut model).active = ActiveParameters {
        value: *Airframe::nominal().values(),
        ..ActiveParameters::default()
    };
    model
}

/// Lets the plant take the command of a tick from a channel.
pub fn take_command(flight: &mut WatchedFlight, of_tick: u64, channel: Channel) {
    let mut state = State::default();
    state.decision.count = 1;
    state.decision.command = TakenCommand {
        of_tick,
        channel: channel as u64,
        acts_from: of_tick + 1,
        is_offered: 1,
        ..TakenCommand::default()
    };
    flight.take(&LogEntry::State(message(of_tick + 1, state)));
}

pub fn flight(model: &mut Model) -> &mut WatchedFlight {
    model.flight.as_mut().unwrap()
}
