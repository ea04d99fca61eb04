//! A flight that was never flown, and what is on the screen of it.

use ironbird::observation::ObservedMessage;
use ironbird::watch::dashboard_model::{Model, WatchedFlight};
use ironbird::watch::keys::Action;
use ironbird::watch::screen::draw;
use messages::blackboards::{ActiveParameters, Run, RunPhase, Status};
use messages::content::Measured;
use messages::content::Reference;
use messages::content::{RotorSpeeds, Setpoint, State, Truth, Wrench};
use messages::header::{Header, Message, Stamps};
use messages::monitor::{Cause, Monitor};
use messages::parameters::Airframe;
use messages::role::ROLES;
use messages::telemetry::Telemetry;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

pub const PERIOD_NS: u64 = 1_000_000;
pub const T0_NS: u64 = 5_000_000_000;

pub fn run() -> Run {
    Run {
        phase: RunPhase::Flying as u64,
        run_id: 7,
        t0_ns: T0_NS,
        period_ns: PERIOD_NS,
        sample_time_ns: PERIOD_NS,
        last_tick: 30_000,
        tick: 0,
        ..Run::default()
    }
}

/// The stamps of a tick whose chain took 30 us.
pub fn envelope(tick: u64) -> Header {
    let sample_ns = T0_NS + tick * PERIOD_NS + 5_000;
    let stage = |number: u64| Stamps {
        receive_ns: sample_ns + number * 8_000,
        send_ns: sample_ns + number * 8_000 + 6_000,
    };
    Header {
        run_id: 7,
        epoch: 1,
        seq: tick,
        tick,
        sample_ns,
        input_tick: [tick; 3],
        previous_busy_ns: 9_000,
        stamps: [stage(0), stage(1), stage(2), stage(3)],
        ..Header::new()
    }
}

pub fn take_tick(flight: &mut WatchedFlight, tick: u64) {
    let envelope = envelope(tick);
    let state = State {
        measured: Measured {
            position_w_m: [1.0, -1.0, 1.5],
            attitude_rad: [0.1, -0.2, 1.0],
            ..Measured::default()
        },
        deadlines_missed: 4,
        truth: Truth {
            position_w_m: [1.0, -1.0, 1.5],
            parameter: *Airframe::nominal().values(),
            ..Truth::default()
        },
        ..State::default()
    };
    let reference = Reference {
        position_w_m: [1.0, -1.0, 1.0],
        ..Reference::default()
    };
    let setpoint = Setpoint {
        reference,
        attitude_rad: [0.1, 0.0, 1.0],
        ..Setpoint::default()
    };
    let mut monitor = Monitor {
        ticks_checked: 100,
        is_live: 1,
        v: 0.25,
        v_th: 0.125,
        v_th_start: 1.0,
        ..Monitor::default()
    };
    monitor.violations[Cause::GyroNoise as usize] = 12;
    let mut telemetry = Telemetry::default();
    telemetry.value[3..6].copy_from_slice(&[3.3e-5, 0.1, 0.2]);
    let wrench = Wrench {
        thrust_n: 5.0,
        telemetry,
        ..Wrench::default()
    };
    let speeds = RotorSpeeds {
        speed_rad_s: [200.0; 4],
        thrust_n: 5.0,
        ..RotorSpeeds::default()
    };
    flight.take(ObservedMessage::State(&Message {
        envelope,
        content: state,
    }));
    flight.take(ObservedMessage::Setpoint(&Message {
        envelope,
        content: setpoint,
    }));
    flight.take(ObservedMessage::Wrench(&Message {
        envelope,
        content: wrench,
    }));
    flight.take(ObservedMessage::RotorSpeeds(&Message {
        envelope,
        content: speeds,
    }));
    flight.take(ObservedMessage::Theorem(&Message {
        envelope,
        content: monitor,
    }));
}

/// A dashboard that has seen a second of a flight, from its 100th tick on.
pub fn model() -> Model {
    let mut model = Model::new("left", false, true);
    // Its reference is (1, -1, 1) m from tick 0 on.
    let settings = [
        ("flight.trajectory", "step"),
        ("flight.tracking_error_max_m", "0.1"),
        ("flight.ground_z_m", "-0.25"),
    ];
    let settings = settings
        .map(|(key, value)| (key.to_owned(), value.to_owned()))
        .into();
    model.join(&run(), settings).unwrap();
    let flight = model.flight.as_mut().unwrap();
    (100..1100).for_each(|tick| take_tick(flight, tick));
    flight.run = Run {
        tick: 1099,
        ticks_run: 1096,
        ticks_skipped: 3,
        deadlines_missed: 4,
        ..run()
    };
    flight.in_force = ActiveParameters {
        tick: 0,
        parameter_epoch: 0,
        value: *Airframe::nominal().values(),
    };
    flight.crew = ROLES
        .iter()
        .map(|role| {
            (
                *role,
                Status {
                    pid: 4242,
                    phase: 3,
                    ..Status::default()
                },
            )
        })
        .collect();
    model
}

pub fn screen(model: &Model, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(model, frame)).unwrap();
    let buffer = terminal.backend().buffer().clone();
    buffer
        .content
        .chunks(usize::from(width))
        .map(|row| {
            row.iter()
                .map(|cell| cell.symbol())
                .collect::<String>()
                .trim_end()
                .to_owned()
        })
        .collect()
}

#[track_caller]
pub fn shows(screen: &[String], words: &str) {
    assert!(
        screen.iter().any(|line| line.contains(words)),
        "no `{words}` in\n{}",
        screen.join("\n")
    );
}

#[track_caller]
pub fn hides(screen: &[String], words: &str) {
    assert!(
        !screen.iter().any(|line| line.contains(words)),
        "`{words}` in\n{}",
        screen.join("\n")
    );
}

pub fn press(model: &mut Model, keys: &[KeyCode]) -> Action {
    let mut action = Action::None;
    for key in keys {
        action = model.key(KeyEvent::new(*key, KeyModifiers::NONE));
    }
    action
}

pub fn typed(text: &str) -> Vec<KeyCode> {
    text.chars().map(KeyCode::Char).collect()
}

#[track_caller]
pub fn on_screen(model: &Model, words: &str) {
    shows(&screen(model, 80, 24), words);
}

#[track_caller]
pub fn not_on_screen(model: &Model, words: &str) {
    hides(&screen(model, 80, 24), words);
}
