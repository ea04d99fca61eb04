//! The dashboard's picture and keys, from made-up messages.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use failure::Failure;
use ironbird::inject::Applied;
use ironbird::observe::ObservedMessage;
use ironbird::watch::draw::{SMALLEST, draw};
use ironbird::watch::keys::Action;
use ironbird::watch::model::{Model, Tab, WatchedFlight};
use model::boards::{Ending, InForce, Run, RunPhase, Status};
use model::envelope::{Envelope, Message, Stamps};
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Truth, Wrench};
use model::monitor::{Cause, Monitor};
use model::parameters::{Airframe, Parameter, SPECS};
use model::role::ROLES;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::Color;

const PERIOD_NS: u64 = 1_000_000;
const T0_NS: u64 = 5_000_000_000;

fn run() -> Run {
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
fn envelope(tick: u64) -> Envelope {
    let sample_ns = T0_NS + tick * PERIOD_NS + 5_000;
    let stage =
        |number: u64| Stamps { receive_ns: sample_ns + number * 8_000, send_ns: sample_ns + number * 8_000 + 6_000 };
    Envelope {
        run_id: 7,
        epoch: 1,
        seq: tick,
        tick,
        sample_ns,
        input_tick: [tick; 3],
        previous_busy_ns: 9_000,
        stamps: [stage(0), stage(1), stage(2), stage(3)],
        ..Envelope::new()
    }
}

fn take_tick(flight: &mut WatchedFlight, tick: u64) {
    let envelope = envelope(tick);
    let state = State {
        position_w_m: [1.0, -1.0, 1.5],
        attitude_rad: [0.1, -0.2, 1.0],
        deadlines_missed: 4,
        truth: Truth { parameter: *Airframe::nominal().values(), ..Truth::default() },
        ..State::default()
    };
    let setpoint =
        Setpoint { reference_position_w_m: [1.0, -1.0, 1.0], attitude_rad: [0.1, 0.0, 1.0], ..Setpoint::default() };
    let mut monitor =
        Monitor { ticks_checked: 100, is_live: 1, v: 0.25, v_th: 0.125, v_th_start: 1.0, ..Monitor::default() };
    monitor.violations[Cause::GyroNoise as usize] = 12;
    let wrench = Wrench { thrust_n: 5.0, estimate: [3.3e-5, 0.1, 0.2], ..Wrench::default() };
    let speeds = RotorSpeeds { speed_rad_s: [200.0; 4], thrust_n: 5.0, ..RotorSpeeds::default() };
    flight.take(ObservedMessage::State(&Message { envelope, content: state }));
    flight.take(ObservedMessage::Setpoint(&Message { envelope, content: setpoint }));
    flight.take(ObservedMessage::Wrench(&Message { envelope, content: wrench }));
    flight.take(ObservedMessage::RotorSpeeds(&Message { envelope, content: speeds }));
    flight.take(ObservedMessage::Theorem(&Message { envelope, content: monitor }));
}

/// A dashboard that has seen a second of a flight, from its 100th tick on.
fn model() -> Model {
    let mut model = Model::new("left", false, true);
    // Its reference is (1, -1, 1) m from tick 0 on.
    let settings =
        [("flight.trajectory", "step"), ("flight.tracking_error_max_m", "0.1"), ("flight.ground_z_m", "-0.25")];
    let settings = settings.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    model.join(&run(), settings).unwrap();
    let flight = model.flight.as_mut().unwrap();
    (100..1100).for_each(|tick| take_tick(flight, tick));
    flight.run = Run { tick: 1099, ticks_run: 1096, ticks_skipped: 3, deadlines_missed: 4, ..run() };
    flight.in_force = InForce { tick: 0, parameter_epoch: 0, value: *Airframe::nominal().values() };
    flight.crew = ROLES.iter().map(|role| (*role, Status { pid: 4242, phase: 3, ..Status::default() })).collect();
    model
}

fn screen(model: &Model, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(model, frame)).unwrap();
    let buffer = terminal.backend().buffer().clone();
    buffer
        .content
        .chunks(usize::from(width))
        .map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>().trim_end().to_owned())
        .collect()
}

#[track_caller]
fn shows(screen: &[String], words: &str) {
    assert!(screen.iter().any(|line| line.contains(words)), "no `{words}` in\n{}", screen.join("\n"));
}

#[track_caller]
fn hides(screen: &[String], words: &str) {
    assert!(!screen.iter().any(|line| line.contains(words)), "`{words}` in\n{}", screen.join("\n"));
}

fn press(model: &mut Model, keys: &[KeyCode]) -> Action {
    let mut action = Action::None;
    for key in keys {
        action = model.key(KeyEvent::new(*key, KeyModifiers::NONE));
    }
    action
}

fn typed(text: &str) -> Vec<KeyCode> {
    text.chars().map(KeyCode::Char).collect()
}

#[test]
fn without_a_flight_it_says_what_it_waits_for_and_how_to_start_one() {
    let screen = screen(&Model::new("left", false, true), 80, 24);
    assert!(screen[0].starts_with(" left   waits for a flight"), "{screen:?}");
    shows(&screen, "Waits for instance `left` to fly.");
    shows(&screen, "ironbird fly --instance left");
}

#[test]
fn the_page_of_the_flight_has_position_attitude_and_error() {
    let screen = screen(&model(), 80, 24);
    assert_eq!(screen[0], " left   flying   1.1 of 30.0 s   missed 4   skipped 3   tick 1099   step, gains");
    assert_eq!(screen[1], " off track   timing late   theorem not applicable");
    assert_eq!(screen[2], " 1  Flight  2  Latency  3  Theorem  4  Plant  5  Real time");
    shows(&screen, "position       1.000    -1.000     1.500 m");
    shows(&screen, "error          0.000     0.000     0.500 m");
    shows(&screen, "attitude        5.73    -11.46     57.30 deg");
    shows(&screen, "error     0.5000 m   rms 0.5000   max 0.5000");
    shows(&screen, "position error, last 8 s; full height 0.5000 m");
    assert!(screen.iter().filter(|line| line.ends_with('█')).count() >= 4, "{}", screen.join("\n"));
}

#[test]
fn the_error_goes_on_where_nobody_publishes_a_set_point() {
    let mut model = model();
    let flight = model.flight.as_mut().unwrap();
    let content = State { position_w_m: [1.0, -1.0, 9.0], ..State::default() };
    flight.take(ObservedMessage::State(&Message { envelope: envelope(1100), content }));
    shows(&screen(&model, 80, 24), "error     8.0000 m");
    shows(&screen(&model, 80, 24), "max 8.0000");
}

#[test]
fn the_page_of_latencies_counts_from_the_stamps() {
    let mut model = model();
    press(&mut model, &typed("2"));
    let screen = screen(&model, 80, 24);
    shows(&screen, "deadlines missed 4 (3639.7 per million ticks), ticks skipped 3");
    // The chain's 30 us, the margin to the deadline, which the next state judges, and no miss of what came before the
    // dashboard.
    shows(&screen, "loop                   1000      30.0      30.0      30.0         -      30.0");
    shows(&screen, "slack                   999     965.1     965.1     965.1         -     965.1");
    shows(&screen, "late                      -");
    shows(&screen, "wake.plant             1000       5.0");
    shows(&screen, "since you watch: 0 late by their stamps, at most 0 in a row");
    shows(&screen, "loop [us], counts on a logarithmic scale");
    shows(&screen, "|10 us");
}

#[test]
fn the_selected_latency_stays_in_sight_and_has_the_histogram() {
    let mut model = model();
    press(&mut model, &typed("2"));
    press(&mut model, &[KeyCode::End]);
    shows(&screen(&model, 80, 24), "period.mixer            999    1000.4");
    shows(&screen(&model, 80, 24), "period.mixer [us], counts");
    press(&mut model, &[KeyCode::Home, KeyCode::Down, KeyCode::Up, KeyCode::Up]);
    shows(&screen(&model, 80, 24), "loop [us], counts");
}

#[test]
fn the_page_of_the_theorem_has_v_estimates_and_causes() {
    let mut model = model();
    press(&mut model, &typed("3"));
    for (width, height) in [(80, 24), (120, 40)] {
        let screen = screen(&model, width, height);
        shows(&screen, "theorem holds: 100 steps, 0 unexplained");
        shows(&screen, "V      2.500e-1");
        shows(&screen, "rotational_drag_nm_s         1.0000e-1    1.0500e-1");
        shows(&screen, "gyro_noise                          12            0");
        shows(&screen, "V_th, last");
    }
    hides(&screen(&model, 80, 24), "motor_lag");
    shows(&screen(&model, 120, 40), "(18) held");
}

#[test]
fn a_parameter_is_edited_checked_and_injected() {
    let mut model = model();
    press(&mut model, &typed("4"));
    shows(&screen(&model, 80, 24), "mass_kg                       0.52   kg           0.52     0.05        5");
    // Beyond its range: refused in the plant's words, and still there to be corrected.
    assert_eq!(press(&mut model, &[vec![KeyCode::Enter], typed("50"), vec![KeyCode::Enter]].concat()), Action::None);
    shows(&screen(&model, 80, 24), "mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg");
    shows(&screen(&model, 80, 24), "mass_kg [kg], 0.05 to 5.0: 50_");
    let keys = [vec![KeyCode::Backspace, KeyCode::Backspace], typed("q0.6"), vec![KeyCode::Enter]].concat();
    assert_eq!(press(&mut model, &keys), Action::Inject(Parameter::Mass, 0.6));
    shows(&screen(&model, 80, 24), "waits for the plant's answer");
    assert_eq!(press(&mut model, &[KeyCode::Enter]), Action::None, "one at a time");
    let changes = vec![(Parameter::Mass, 0.52, 0.6)];
    model.answer(Ok(Applied { tick: 1200, past_tick: None, time_s: 1.2, parameter_epoch: 1, changes }));
    shows(&screen(&model, 80, 24), "applied at tick 1200 (1.200 s), parameter epoch 1 mass_kg 0.52 -> 0.6 kg");
    model.answer(Err(Failure::failed("the plant refused: too many swaps wait for their ticks; ask again later")));
    shows(&screen(&model, 80, 24), "the plant refused: too many swaps");
}

#[test]
fn what_is_not_nominal_is_marked_and_what_is_no_number_is_refused() {
    let mut model = model();
    model.flight.as_mut().unwrap().in_force.value[Parameter::GyroNoise as usize] = 0.01;
    press(&mut model, &typed("4"));
    press(&mut model, &[KeyCode::End]);
    shows(&screen(&model, 80, 24), "gyro_noise_rad_s              0.01*  rad/s");
    press(&mut model, &[vec![KeyCode::Enter], typed("1e-e"), vec![KeyCode::Enter]].concat());
    shows(&screen(&model, 80, 24), "gyro_noise_rad_s = `1e-e` is not a number");
    // Esc leaves the value, not the dashboard; then the dashboard.
    assert_eq!(press(&mut model, &[KeyCode::Esc]), Action::None);
    hides(&screen(&model, 80, 24), "1e-e_");
    assert_eq!(press(&mut model, &[KeyCode::Esc]), Action::Quit);
}

#[test]
fn every_parameter_has_its_row() {
    let mut model = model();
    press(&mut model, &typed("4"));
    let screen = screen(&model, 80, 24);
    let seen = SPECS.iter().filter(|spec| screen.iter().any(|line| line.contains(spec.name))).count();
    assert!(seen >= 16, "{seen} of {} rows\n{}", SPECS.len(), screen.join("\n"));
    for spec in &SPECS {
        shows(&self::screen(&model, 120, 40), spec.name);
    }
}

#[test]
fn the_page_of_real_time_has_a_column_per_role() {
    let mut model = model();
    press(&mut model, &typed("5"));
    let screen = screen(&model, 80, 24);
    shows(&screen, "plant       outer       inner       mixer       record");
    shows(&screen, "process       4242        4242        4242        4242        4242");
    shows(&screen, "memory_lock   -           -");
}

#[test]
fn tabs_go_round_and_help_opens_and_closes() {
    let mut model = model();
    for (key, tab) in [
        (KeyCode::Tab, Tab::Latency),
        (KeyCode::BackTab, Tab::Flight),
        (KeyCode::BackTab, Tab::RealTime),
        (KeyCode::Tab, Tab::Flight),
        (KeyCode::Char('4'), Tab::Plant),
    ] {
        press(&mut model, &[key]);
        assert_eq!(model.tab, tab);
    }
    press(&mut model, &typed("?"));
    shows(&screen(&model, 80, 24), "leave; it flies on");
    press(&mut model, &typed("1"));
    hides(&screen(&model, 80, 24), "leave; it flies on");
    assert_eq!(model.tab, Tab::Plant, "the key that closes help does nothing else");
}

#[test]
fn leaving_is_one_thing_and_ending_the_flight_another() {
    let ctrl_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    assert_eq!(model().key(ctrl_c), Action::Quit);
    assert_eq!(press(&mut model(), &typed("q")), Action::Quit);
    let mut launched = Model { launched: true, ..model() };
    assert_eq!(launched.key(ctrl_c), Action::EndFlight);
    assert_eq!(press(&mut launched, &typed("q")), Action::Quit);
    assert_eq!(press(&mut launched, &typed("r")), Action::Reset);
}

#[test]
fn a_reset_begins_statistics_anew_and_forgets_no_loss() {
    let mut model = model();
    let flight = model.flight.as_mut().unwrap();
    take_tick(flight, 1110);
    assert_eq!(flight.lost(), 50, "ten ticks of five topics");
    model.reset().unwrap();
    press(&mut model, &typed("2"));
    shows(&screen(&model, 80, 24), "loop                      -");
    shows(&screen(&model, 100, 24), "lost 50 messages");
    press(&mut model, &typed("3"));
    shows(&screen(&model, 80, 24), "theorem holds: 100 steps");
    take_tick(model.flight.as_mut().unwrap(), 2000);
    assert_eq!(model.flight.as_ref().unwrap().lost(), 50, "what was before the reset is not lost again");
}

#[test]
fn a_flight_that_ended_stays_on_the_screen() {
    let mut model = model();
    model.flight.as_mut().unwrap().ending = Some(Ending::Completed);
    let screen_ = screen(&model, 80, 24);
    shows(&screen_, "left   landed: completed");
    shows(&screen_, "position       1.000");
    hides(&screen_, "it flies on");
    press(&mut model, &typed("4"));
    press(&mut model, &[KeyCode::Enter]);
    shows(&screen(&model, 80, 24), "nobody flies: nothing to inject into");
    model.flight.as_mut().unwrap().ending = Some(Ending::Position);
    shows(&screen(&model, 80, 24), "left the envelope");
}

#[test]
fn a_recorder_that_has_gone_is_told() {
    let mut model = model();
    model.flight.as_mut().unwrap().recorder_lives = false;
    shows(&screen(&model, 80, 24), "no recorder: no news");
}

#[test]
fn every_page_fits_every_terminal() {
    let mut model = model();
    for tab in Tab::ALL {
        model.tab = tab;
        for (width, height) in (1..=130).step_by(3).flat_map(|width| (1..=50).map(move |height| (width, height))) {
            let screen = screen(&model, width, height);
            if width >= SMALLEST.0 && height >= SMALLEST.1 {
                assert!(screen[0].starts_with(" left   flying"), "{width} x {height}: {screen:?}");
            }
        }
        model.help = true;
        shows(&screen(&model, 40, 12), "leave; it flies on");
        model.help = false;
    }
    shows(&screen(&model, 60, 9), "60 x 9 is too small: ironbird watch needs 40 x 12");
}

#[test]
fn colours_can_be_left_out_and_none_of_them_is_white_or_black() {
    let mut model = model();
    let colours = |model: &Model| {
        let mut terminal = Terminal::new(TestBackend::new(80, 24)).unwrap();
        terminal.draw(|frame| draw(model, frame)).unwrap();
        let cells = terminal.backend().buffer().content.clone();
        cells.iter().flat_map(|cell| [cell.fg, cell.bg]).filter(|colour| *colour != Color::Reset).collect::<Vec<_>>()
    };
    for tab in Tab::ALL {
        model.tab = tab;
        let allowed = [Color::Red, Color::Green, Color::Blue, Color::Magenta];
        assert!(colours(&model).iter().all(|colour| allowed.contains(colour)), "{tab:?}");
    }
    model.tab = Tab::Flight;
    assert!(!colours(&model).is_empty());
    model.colours = false;
    for tab in Tab::ALL {
        model.tab = tab;
        assert_eq!(colours(&model), [], "{tab:?}");
    }
}

#[test]
fn a_line_of_plain_text_has_what_matters() {
    let line = ironbird::watch::plain::line(model().flight.as_ref().unwrap());
    assert_eq!(
        line,
        "tick 1099   1.1 s   error 0.5000 m   loop p50 30.0 p99 30.0 us   missed 4   V 2.500e-1 rad^2/s^2   \
         violations 12 (0 unexplained)"
    );
}

#[test]
fn swaps_do_not_disturb() {
    let mut model = model();
    let swap = Message { envelope: Envelope { seq: 3, ..envelope(500) }, content: SwapRecord::default() };
    model.flight.as_mut().unwrap().take(ObservedMessage::Swap(&swap));
    assert_eq!(model.flight.as_ref().unwrap().lost(), 0, "swaps from before are not missing");
}
