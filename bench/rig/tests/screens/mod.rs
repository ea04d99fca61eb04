//! The dashboard's picture and keys, from made-up messages.

mod flight;

use std::time::Duration;

use errors::Failure;
use ironbird::inject::Applied;
use ironbird::observation::ObservedMessage;
use ironbird::watch::dashboard_model::{Model, Tab};
use ironbird::watch::keys::Action;
use ironbird::watch::screen::{SMALLEST, draw};
use messages::blackboards::EndReason;
use messages::content::{Change, State, SwapRecord, Truth, Wrench};
use messages::header::{Header, Message};
use messages::parameters::{Parameter, SPECS};
use messages::telemetry::Telemetry;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::Color;

use flight::{
    envelope, hides, model, not_on_screen, on_screen, press, run, screen, shows, take_tick, typed,
};

/// Compares a screen with its snapshot: `INSTA_UPDATE=always cargo test -p ironbird --test rig screens` accepts a change.
fn snapshot(name: &str, model: &Model, (width, height): (u16, u16)) {
    insta::assert_snapshot!(name, screen(model, width, height).join("\n"));
}

#[test]
fn each_page_is_its_snapshot() {
    const SMALL: (u16, u16) = (80, 24);
    snapshot("waiting", &Model::new("left", false, true), SMALL);
    for (name, keys) in [
        ("flight", "1"),
        ("latency", "2"),
        ("theorem", "3"),
        ("parameters", "4"),
        ("real_time", "5"),
        ("help", "?"),
    ] {
        let mut model = model();
        press(&mut model, &typed(keys));
        snapshot(name, &model, SMALL);
    }
    let mut large = model();
    press(&mut large, &typed("3"));
    snapshot("theorem_large", &large, (120, 40));
    large.flight.as_mut().unwrap().recorder_lives = false;
    snapshot("theorem_without_recorder", &large, SMALL);
    let mut laws = flown_by("estimating", "indi");
    press(&mut laws, &typed("6"));
    snapshot("laws", &laws, SMALL);
    snapshot("laws_small", &laws, SMALLEST);
    let mut no_theorem = flown_by("pd", "geometric");
    press(&mut no_theorem, &typed("3"));
    snapshot("theorem_not_applicable", &no_theorem, SMALL);
    // A number that the law has never set is no zero.
    let content = Wrench {
        telemetry: Telemetry::unknown(7),
        ..Wrench::default()
    };
    let mut unset = flown_by("pd", "pid");
    let flight = unset.flight.as_mut().unwrap();
    flight.take(ObservedMessage::Wrench(&Message {
        envelope: envelope(101),
        content,
    }));
    press(&mut unset, &typed("6"));
    snapshot("laws_unset", &unset, SMALL);
}

#[test]
fn the_error_goes_on_where_nobody_publishes_a_set_point() {
    let mut model = model();
    let flight = model.flight.as_mut().unwrap();
    let truth = Truth {
        position_w_m: [1.0, -1.0, 9.0],
        ..Truth::default()
    };
    let content = State {
        truth,
        ..State::default()
    };
    flight.take(ObservedMessage::State(&Message {
        envelope: envelope(1100),
        content,
    }));
    on_screen(&model, "error     8.0000 m");
    on_screen(&model, "max 8.0000");
}

#[test]
fn the_selected_latency_stays_in_sight_and_has_the_histogram() {
    let mut model = model();
    press(&mut model, &typed("2"));
    press(&mut model, &[KeyCode::End]);
    on_screen(&model, "period.mixer            999    1000.4");
    on_screen(&model, "period.mixer [us], counts");
    press(
        &mut model,
        &[KeyCode::Home, KeyCode::Down, KeyCode::Up, KeyCode::Up],
    );
    on_screen(&model, "loop [us], counts");
}

/// A dashboard that has seen a tick of a flight with these laws.
fn flown_by(outer: &str, inner: &str) -> Model {
    let mut model = Model::new("left", false, true);
    let settings = [
        ("flight.trajectory", "step"),
        ("outer.law", outer),
        ("inner.law", inner),
        ("mixer.law", "priority"),
    ];
    model
        .join(
            &run(),
            settings
                .map(|(key, value)| (key.to_owned(), value.to_owned()))
                .into(),
        )
        .unwrap();
    take_tick(model.flight.as_mut().unwrap(), 100);
    model
}

#[test]
fn a_parameter_is_edited_checked_and_injected() {
    let mut model = model();
    press(&mut model, &typed("4"));
    on_screen(
        &model,
        "mass_kg                       0.52   kg           0.52     0.05        5",
    );
    // Beyond its range: refused in the plant's words, and still there to be corrected.
    assert_eq!(
        press(
            &mut model,
            &[vec![KeyCode::Enter], typed("50"), vec![KeyCode::Enter]].concat()
        ),
        Action::None
    );
    on_screen(
        &model,
        "mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg",
    );
    on_screen(&model, "mass_kg [kg], 0.05 to 5.0: 50_");
    let keys = [
        vec![KeyCode::Backspace, KeyCode::Backspace],
        typed("q0.6"),
        vec![KeyCode::Enter],
    ]
    .concat();
    assert_eq!(
        press(&mut model, &keys),
        Action::Inject(vec!["mass_kg=0.6".parse().unwrap()], None)
    );
    on_screen(&model, "waits for the plant's answer");
    assert_eq!(
        press(&mut model, &[KeyCode::Enter]),
        Action::None,
        "one at a time"
    );
    let applied = |steps| {
        let changes = vec![Change {
            parameter: Parameter::Mass,
            old: 0.52,
            new: 0.6,
            steps,
        }];
        Applied {
            tick: 1200,
            past_tick: None,
            time_s: 1.2,
            parameter_epoch: 1,
            sample_time_ns: 1_000_000,
            changes,
        }
    };
    model.answer(Ok(applied(1).to_string()));
    on_screen(
        &model,
        "applied at tick 1200 (1.200 s), parameter epoch 1 mass_kg 0.52 -> 0.6 kg",
    );
    let keys = [
        vec![KeyCode::Enter],
        typed("0.6~2s500ms"),
        vec![KeyCode::Enter],
    ]
    .concat();
    assert_eq!(
        press(&mut model, &keys),
        Action::Inject(vec!["mass_kg=0.6~2s500ms".parse().unwrap()], None)
    );
    model.answer(Ok(applied(2500).to_string()));
    shows(
        &screen(&model, 120, 24),
        "parameter epoch 1 mass_kg 0.52 -> 0.6 kg over 2.5 s",
    );
    model.answer(Err(Failure::failed(
        "the plant refused: too many swaps wait for their ticks; ask again later",
    )));
    on_screen(&model, "the plant refused: too many swaps");
}

#[test]
fn a_fault_is_typed_read_and_injected() {
    let mut model = model();
    press(&mut model, &typed("4f"));
    on_screen(&model, "fault, as in state.drop=0.1 for 1s: _");
    assert_eq!(
        press(
            &mut model,
            &[typed("state.dorp=1"), vec![KeyCode::Enter]].concat()
        ),
        Action::None
    );
    on_screen(
        &model,
        "unknown fault `state.dorp`; did you mean `state.drop`?",
    );
    on_screen(&model, "state.dorp=1_");
    let again = [
        vec![KeyCode::Esc],
        typed("fstate.drop=0.1,inner.late=1ms for soon"),
        vec![KeyCode::Enter],
    ]
    .concat();
    assert_eq!(press(&mut model, &again), Action::None);
    let again = [
        vec![KeyCode::Backspace; 4],
        typed("2s"),
        vec![KeyCode::Enter],
    ]
    .concat();
    let changes = ["state.drop=0.1", "inner.late=1ms"].map(|text| text.parse().unwrap());
    assert_eq!(
        press(&mut model, &again),
        Action::Inject(changes.into(), Some(Duration::from_secs(2)))
    );
    on_screen(&model, "waits for the plant's answer");
    model.answer(Ok(
        "state.drop=0.1 from tick 2000 (2.000 s) to tick 4000 (4.000 s), injected in flight\n"
            .into(),
    ));
    shows(
        &screen(&model, 120, 24),
        "state.drop=0.1 from tick 2000 (2.000 s)",
    );
}

#[test]
fn what_is_not_nominal_is_marked_and_what_is_no_number_is_refused() {
    let mut model = model();
    model.flight.as_mut().unwrap().in_force.value[Parameter::GyroNoise as usize] = 0.01;
    press(&mut model, &typed("4"));
    press(&mut model, &[KeyCode::End]);
    on_screen(&model, "gyro_noise_rad_s              0.01*  rad/s");
    press(
        &mut model,
        &[vec![KeyCode::Enter], typed("1e-e"), vec![KeyCode::Enter]].concat(),
    );
    on_screen(&model, "gyro_noise_rad_s = `1e-e` is not a number");
    // Esc leaves the value, not the dashboard; then the dashboard.
    assert_eq!(press(&mut model, &[KeyCode::Esc]), Action::None);
    not_on_screen(&model, "1e-e_");
    assert_eq!(press(&mut model, &[KeyCode::Esc]), Action::Quit);
}

#[test]
fn every_parameter_has_its_row() {
    let mut model = model();
    press(&mut model, &typed("4"));
    let screen = screen(&model, 80, 24);
    let seen = SPECS
        .iter()
        .filter(|spec| screen.iter().any(|line| line.contains(spec.name)))
        .count();
    assert!(
        seen >= 16,
        "{seen} of {} rows\n{}",
        SPECS.len(),
        screen.join("\n")
    );
    for spec in &SPECS {
        shows(&self::screen(&model, 120, 40), spec.name);
    }
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
    on_screen(&model, "leave; it flies on");
    press(&mut model, &typed("1"));
    not_on_screen(&model, "leave; it flies on");
    assert_eq!(
        model.tab,
        Tab::Plant,
        "the key that closes help does nothing else"
    );
}

#[test]
fn leaving_is_one_thing_and_ending_the_flight_another() {
    let ctrl_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    assert_eq!(model().key(ctrl_c), Action::Quit);
    assert_eq!(press(&mut model(), &typed("q")), Action::Quit);
    let mut launched = Model {
        launched: true,
        ..model()
    };
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
    on_screen(&model, "inner.sto");
    not_on_screen(&model, "inner.stop");
    assert_eq!(model.key(control('u')), Action::None);
    not_on_screen(&model, "inner.sto");
    press(&mut model, &typed("outer.kill"));
    on_screen(&model, "outer.kill");
}

#[test]
fn a_reset_begins_statistics_anew_and_forgets_no_loss() {
    let mut model = model();
    let flight = model.flight.as_mut().unwrap();
    take_tick(flight, 1110);
    assert_eq!(flight.lost(), 50, "ten ticks of five topics");
    model.reset().unwrap();
    press(&mut model, &typed("2"));
    on_screen(&model, "loop                      -");
    shows(&screen(&model, 100, 24), "lost 50 messages");
    press(&mut model, &typed("3"));
    on_screen(&model, "theorem holds: 100 steps");
    take_tick(model.flight.as_mut().unwrap(), 2000);
    assert_eq!(
        model.flight.as_ref().unwrap().lost(),
        50,
        "what was before the reset is not lost again"
    );
}

#[test]
fn a_flight_that_ended_stays_on_the_screen() {
    let mut model = model();
    model.flight.as_mut().unwrap().ending = Some(EndReason::Completed);
    let screen_ = screen(&model, 80, 24);
    shows(&screen_, "left   landed: completed");
    shows(&screen_, "position       1.000");
    hides(&screen_, "it flies on");
    press(&mut model, &typed("4"));
    press(&mut model, &[KeyCode::Enter]);
    on_screen(&model, "nobody flies: nothing to inject into");
    model.flight.as_mut().unwrap().ending = Some(EndReason::Position);
    on_screen(&model, "left the envelope");
}

#[test]
fn every_page_fits_every_terminal() {
    let mut model = model();
    for tab in Tab::ALL {
        model.tab = tab;
        for (width, height) in (1..=130)
            .step_by(3)
            .flat_map(|width| (1..=50).map(move |height| (width, height)))
        {
            let screen = screen(&model, width, height);
            if width >= SMALLEST.0 && height >= SMALLEST.1 {
                assert!(
                    screen[0].starts_with(" left   flying"),
                    "{width} x {height}: {screen:?}"
                );
            }
        }
        model.help = true;
        shows(&screen(&model, 40, 12), "leave; it flies on");
        model.help = false;
    }
    shows(
        &screen(&model, 60, 9),
        "60 x 9 is too small: ironbird watch needs 40 x 12",
    );
}

#[test]
fn colours_can_be_left_out_and_none_of_them_is_white_or_black() {
    let mut model = model();
    let colours = |model: &Model| {
        let mut terminal = Terminal::new(TestBackend::new(80, 24)).unwrap();
        terminal.draw(|frame| draw(model, frame)).unwrap();
        let cells = terminal.backend().buffer().content.clone();
        cells
            .iter()
            .flat_map(|cell| [cell.fg, cell.bg])
            .filter(|colour| *colour != Color::Reset)
            .collect::<Vec<_>>()
    };
    for tab in Tab::ALL {
        model.tab = tab;
        let allowed = [Color::Red, Color::Green, Color::Blue, Color::Magenta];
        assert!(
            colours(&model)
                .iter()
                .all(|colour| allowed.contains(colour)),
            "{tab:?}"
        );
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
    let line = ironbird::watch::line_output::line(model().flight.as_ref().unwrap());
    assert_eq!(
        line,
        "tick 1099   1.1 s   error 0.5000 m   loop p50 30.0 p99 30.0 us   missed 4   V 2.500e-1 rad^2/s^2   \
         violations 12 (0 unexplained)"
    );
}

#[test]
fn swaps_do_not_disturb() {
    let mut model = model();
    let swap = Message {
        envelope: Header {
            seq: 3,
            ..envelope(500)
        },
        content: SwapRecord::default(),
    };
    model
        .flight
        .as_mut()
        .unwrap()
        .take(ObservedMessage::Swap(&swap));
    assert_eq!(
        model.flight.as_ref().unwrap().lost(),
        0,
        "swaps from before are not missing"
    );
    let mut content = SwapRecord {
        count: 1,
        ..SwapRecord::default()
    };
    (content.old[0], content.new[0], content.steps[0]) = (0.52, 0.676, 2000);
    let swap = Message {
        envelope: Header {
            seq: 4,
            ..envelope(8000)
        },
        content,
    };
    model
        .flight
        .as_mut()
        .unwrap()
        .take(ObservedMessage::Swap(&swap));
    press(&mut model, &typed("4"));
    shows(
        &screen(&model, 110, 40),
        "swaps so far 0; the last: mass_kg 0.52 -> 0.676 over 2 s from tick 8000",
    );
}
