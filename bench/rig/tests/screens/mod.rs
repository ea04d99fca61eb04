//! The dashboard's picture and keys, from made-up messages.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod flight;

use std::time::Duration;

use failure::Failure;
use ironbird::inject::Applied;
use ironbird::observe::ObservedMessage;
use ironbird::watch::draw::{SMALLEST, draw};
use ironbird::watch::keys::Action;
use ironbird::watch::model::{Model, Tab};
use model::boards::Ending;
use model::envelope::{Envelope, Message};
use model::messages::{Change, State, SwapRecord, Truth, Wrench};
use model::parameters::{Parameter, SPECS};
use model::telemetry::Telemetry;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::Color;

use flight::{envelope, hides, model, press, run, screen, shows, take_tick, typed};

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
    assert_eq!(screen[2], " 1  Flight  2  Latency  3  Theorem  4  Plant  5  Real time  6  Laws");
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
    let truth = Truth { position_w_m: [1.0, -1.0, 9.0], ..Truth::default() };
    let content = State { truth, ..State::default() };
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

/// A dashboard that has seen a tick of a flight with these laws.
fn flown_by(outer: &str, inner: &str) -> Model {
    let mut model = Model::new("left", false, true);
    let settings =
        [("flight.trajectory", "step"), ("outer.law", outer), ("inner.law", inner), ("mixer.law", "priority")];
    model.join(&run(), settings.map(|(key, value)| (key.to_owned(), value.to_owned())).into()).unwrap();
    take_tick(model.flight.as_mut().unwrap(), 100);
    model
}

#[test]
fn the_page_of_the_laws_follows_those_that_fly() {
    let mut model = flown_by("estimating", "indi");
    press(&mut model, &typed("6"));
    let indi = screen(&model, 80, 24);
    shows(&indi, "outer estimating                       now     smallest      largest");
    shows(&indi, "  mass_kg                         0.0000e0     0.0000e0     0.0000e0 kg");
    shows(&indi, "inner indi");
    shows(&indi, "  torque_x_nm                    3.3000e-5    3.3000e-5    3.3000e-5 N m");
    shows(&indi, "mixer priority");
    hides(&indi, "rotational_drag_nm_s");
    let small = screen(&model, 40, 12);
    shows(&small, "  acceleration_x_rad_s2        0.0000e0");
    shows(&small, " and 10 more: enlarge the terminal");
}

#[test]
fn a_number_that_a_law_never_knew_is_no_zero() {
    let mut model = Model::new("left", false, true);
    let settings = [("flight.trajectory", "step"), ("inner.law", "pid")];
    model.join(&run(), settings.map(|(key, value)| (key.to_owned(), value.to_owned())).into()).unwrap();
    let content = Wrench { telemetry: Telemetry::unsaid(7), ..Wrench::default() };
    let flight = model.flight.as_mut().unwrap();
    flight.take(ObservedMessage::Wrench(&Message { envelope: envelope(100), content }));
    press(&mut model, &typed("6"));
    shows(&screen(&model, 80, 24), "  integral_x_rad_s2                      -            -            - rad/s^2");
}

#[test]
fn a_law_without_a_theorem_is_named_where_the_theorem_would_be() {
    for inner in ["geometric", "fixed"] {
        let mut model = flown_by("pd", inner);
        press(&mut model, &typed("3"));
        for (width, height) in [(80, 24), (40, 12)] {
            let screen = screen(&model, width, height);
            shows(&screen, "The theorem is not applicable:");
            hides(&screen, "V_th");
            hides(&screen, "rotational_drag_nm_s");
        }
        shows(&screen(&model, 80, 24), &format!("not applicable: the inner law `{inner}` has no theorem."));
        shows(&screen(&model, 80, 24), "theorem not applicable");
    }
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
    assert_eq!(press(&mut model, &keys), Action::Inject(vec!["mass_kg=0.6".parse().unwrap()], None));
    shows(&screen(&model, 80, 24), "waits for the plant's answer");
    assert_eq!(press(&mut model, &[KeyCode::Enter]), Action::None, "one at a time");
    let applied = |steps| {
        let changes = vec![Change { parameter: Parameter::Mass, old: 0.52, new: 0.6, steps }];
        Applied { tick: 1200, past_tick: None, time_s: 1.2, parameter_epoch: 1, sample_time_ns: 1_000_000, changes }
    };
    model.answer(Ok(applied(1).to_string()));
    shows(&screen(&model, 80, 24), "applied at tick 1200 (1.200 s), parameter epoch 1 mass_kg 0.52 -> 0.6 kg");
    let keys = [vec![KeyCode::Enter], typed("0.6~2s500ms"), vec![KeyCode::Enter]].concat();
    assert_eq!(press(&mut model, &keys), Action::Inject(vec!["mass_kg=0.6~2s500ms".parse().unwrap()], None));
    model.answer(Ok(applied(2500).to_string()));
    shows(&screen(&model, 120, 24), "parameter epoch 1 mass_kg 0.52 -> 0.6 kg over 2.5 s");
    model.answer(Err(Failure::failed("the plant refused: too many swaps wait for their ticks; ask again later")));
    shows(&screen(&model, 80, 24), "the plant refused: too many swaps");
}

#[test]
fn a_fault_is_typed_read_and_injected() {
    let mut model = model();
    press(&mut model, &typed("4f"));
    shows(&screen(&model, 80, 24), "fault, as in state.drop=0.1 for 1s: _");
    assert_eq!(press(&mut model, &[typed("state.dorp=1"), vec![KeyCode::Enter]].concat()), Action::None);
    shows(&screen(&model, 80, 24), "unknown fault `state.dorp`; did you mean `state.drop`?");
    shows(&screen(&model, 80, 24), "state.dorp=1_");
    let again = [vec![KeyCode::Esc], typed("fstate.drop=0.1,inner.late=1ms for soon"), vec![KeyCode::Enter]].concat();
    assert_eq!(press(&mut model, &again), Action::None);
    let again = [vec![KeyCode::Backspace; 4], typed("2s"), vec![KeyCode::Enter]].concat();
    let changes = ["state.drop=0.1", "inner.late=1ms"].map(|text| text.parse().unwrap());
    assert_eq!(press(&mut model, &again), Action::Inject(changes.into(), Some(Duration::from_secs(2))));
    shows(&screen(&model, 80, 24), "waits for the plant's answer");
    model.answer(Ok("state.drop=0.1 from tick 2000 (2.000 s) to tick 4000 (4.000 s), injected in flight\n".into()));
    shows(&screen(&model, 120, 24), "state.drop=0.1 from tick 2000 (2.000 s)");
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
        (KeyCode::BackTab, Tab::Laws),
        (KeyCode::BackTab, Tab::RealTime),
        (KeyCode::Tab, Tab::Laws),
        (KeyCode::Tab, Tab::Flight),
        (KeyCode::Char('6'), Tab::Laws),
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
fn controls_are_no_letters_of_what_is_typed_and_one_empties_the_line() {
    let mut model = model();
    press(&mut model, &typed("4finner.sto"));
    let control = |letter| KeyEvent::new(KeyCode::Char(letter), KeyModifiers::CONTROL);
    assert_eq!(model.key(control('p')), Action::None);
    shows(&screen(&model, 80, 24), "inner.sto");
    hides(&screen(&model, 80, 24), "inner.stop");
    assert_eq!(model.key(control('u')), Action::None);
    hides(&screen(&model, 80, 24), "inner.sto");
    press(&mut model, &typed("outer.kill"));
    shows(&screen(&model, 80, 24), "outer.kill");
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
    assert_eq!(screen(&model, 80, 24)[1], " up to tick 1099: off track   timing late   theorem not applicable");
    press(&mut model, &typed("3"));
    shows(&screen(&model, 80, 24), "theorem held up to tick 1099; unchecked since: the recorder has gone");
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
    let mut content = SwapRecord { count: 1, ..SwapRecord::default() };
    (content.old[0], content.new[0], content.steps[0]) = (0.52, 0.676, 2000);
    let swap = Message { envelope: Envelope { seq: 4, ..envelope(8000) }, content };
    model.flight.as_mut().unwrap().take(ObservedMessage::Swap(&swap));
    press(&mut model, &typed("4"));
    shows(&screen(&model, 110, 40), "swaps so far 0; the last: mass_kg 0.52 -> 0.676 over 2 s from tick 8000");
}
