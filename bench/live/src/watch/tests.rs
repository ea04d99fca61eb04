//! The dashboard's screens and keys, from made-up messages.

use std::time::Duration;

use analysis::schema::{Explained, FlightVerdict, StabilityVerdict, TimingVerdict, Verdicts};
use errors::Failure;
use flight_log::entry::LogEntry;
use messages::blackboards::{EndReason, Run, Status, Subject};
use messages::content::{Loss, Measured, Reference, RotorSpeeds, Setpoint, State, SwapRecord};
use messages::content::{Truth, Wrench};
use messages::header::Message;
use messages::monitor::{Cause, Monitor};
use messages::parameters::{Airframe, Parameter};
use messages::role::{Channel, ROLES, Replica, Role};
use messages::telemetry::Telemetry;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::Color;

use super::dashboard_model::{Action, Judged, Model, Tab, WatchedFlight};
use super::line;
use super::screen::{SMALLEST, draw};
use crate::made_up::{flight, joined, message, run, take_command};

const NORMAL: (u16, u16) = (80, 24);

fn take_state(flight: &mut WatchedFlight, tick: u64, position_w_m: [f64; 3]) {
    let state = State {
        measured: Measured {
            position_w_m,
            attitude_rad: [0.1, -0.2, 1.0],
            ..Measured::default()
        },
        deadlines_missed: 4,
        truth: Truth {
            position_w_m,
            parameter: *Airframe::nominal().values(),
            ..Truth::default()
        },
        ..State::default()
    };
    flight.take(&LogEntry::State(message(tick, state)));
}

fn take_wrench(flight: &mut WatchedFlight, tick: u64, telemetry: Telemetry) {
    let wrench = Wrench {
        thrust_n: 5.0,
        telemetry,
        ..Wrench::default()
    };
    flight.take(&LogEntry::Wrench(message(tick, wrench)));
}

fn take_tick(flight: &mut WatchedFlight, tick: u64) {
    take_state(flight, tick, [1.0, -1.0, 1.5]);
    let setpoint = Setpoint {
        reference: Reference {
            position_w_m: [1.0, -1.0, 1.0],
            ..Reference::default()
        },
        attitude_rad: [0.1, 0.0, 1.0],
        ..Setpoint::default()
    };
    flight.take(&LogEntry::Setpoint(message(tick, setpoint)));
    let mut telemetry = Telemetry::default();
    telemetry.value[3..6].copy_from_slice(&[3.3e-5, 0.1, 0.2]);
    take_wrench(flight, tick, telemetry);
    let speeds = RotorSpeeds {
        speed_rad_s: [200.0; 4],
        thrust_n: 5.0,
        ..RotorSpeeds::default()
    };
    flight.take(&LogEntry::RotorSpeeds(message(tick, speeds)));
    let mut monitor = Monitor {
        ticks_checked: 100,
        is_live: 1,
        v: 0.25,
        v_th: 0.125,
        v_th_start: 1.0,
        ..Monitor::default()
    };
    monitor.violations[Cause::GyroNoise as usize] = 12;
    flight.take(&LogEntry::Theorem(message(tick, monitor)));
}

/// A dashboard that has seen ticks of a flight. Its reference is (1, -1, 1) m from tick 0 on.
fn seen(settings: &[(&str, &str)], ticks: std::ops::Range<u64>) -> Model {
    let mut model = joined(&run(), settings);
    ticks.for_each(|tick| take_tick(flight(&mut model), tick));
    model
}

/// A dashboard that has seen a second of a flight, from its 100th tick on.
fn model() -> Model {
    let mut model = seen(&[], 100..1100);
    let flight = flight(&mut model);
    flight.run = Run {
        tick: 1099,
        ticks_run: 1096,
        ticks_skipped: 3,
        deadlines_missed: 4,
        ..run()
    };
    let status = Status {
        pid: 4242,
        phase: 3,
        ..Status::default()
    };
    flight.statuses = ROLES.map(|role| (role.into(), status)).into();
    let recorder = flight.statuses.get_mut(&Role::Record.into()).unwrap();
    (recorder.commands_missed, recorder.commands_stale) = (2, 5);
    model
}

/// A dashboard of a flight with two channels, of which b took over when a's inner stage was killed.
fn handed_over() -> Model {
    let faults = r#"["a.inner.kill@tick1050", "state.drop=0.1@tick1060..tick3100", "outer.late=1ms@tick1090..2s"]"#;
    let mut model = model();
    let channels = Run {
        channels: 2,
        ..flight(&mut model).run
    };
    let statuses = flight(&mut model).statuses.clone();
    model = joined(&channels, &[("flight.faults", faults)]);
    let seen = flight(&mut model);
    let all = Replica::all(2).map(|replica| (replica, statuses[&replica.role.into()]));
    seen.statuses = all.collect();
    for (tick, channel) in [(1048, Channel::A), (1049, Channel::A), (1050, Channel::B)] {
        take_command(seen, tick, channel);
    }
    (seen.supervision.failed, seen.supervision.restarted) = (1, 1);
    let killed = "the inner process of channel a was killed by the fault a.inner.kill of tick 1050; it is started again";
    seen.supervision.add(1052, Subject::Process, killed);
    model
}

/// A dashboard that has seen a tick of a flight with these laws.
fn flown_by(outer: &str, inner: &str) -> Model {
    let [outer, inner] = [outer, inner].map(|law| format!("{law:?}"));
    seen(&[("outer.law", &outer), ("inner.law", &inner)], 100..101)
}

/// Types keys, some of them by name, as in `4<Enter>50<Enter>`; returns the last one's action.
fn press(model: &mut Model, keys: &str) -> Action {
    let mut action = Action::None;
    for (i, part) in keys.split(['<', '>']).enumerate() {
        let named = match part {
            _ if i % 2 == 0 => {
                for letter in part.chars() {
                    action = model.key(KeyCode::Char(letter).into());
                }
                continue;
            }
            "Enter" => KeyCode::Enter,
            "Esc" => KeyCode::Esc,
            "Tab" => KeyCode::Tab,
            "BackTab" => KeyCode::BackTab,
            "Home" => KeyCode::Home,
            "End" => KeyCode::End,
            "Up" => KeyCode::Up,
            "Down" => KeyCode::Down,
            "Backspace" => KeyCode::Backspace,
            control => KeyCode::Char(control.chars().last().unwrap()),
        };
        let modifiers = match part.starts_with("Ctrl-") {
            true => KeyModifiers::CONTROL,
            false => KeyModifiers::NONE,
        };
        action = model.key(KeyEvent::new(named, modifiers));
    }
    action
}

fn buffer(model: &Model, (width, height): (u16, u16)) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(model, frame)).unwrap();
    terminal.backend().buffer().clone()
}

fn screen(model: &Model, size: (u16, u16)) -> String {
    let buffer = buffer(model, size);
    let rows = buffer.content.chunks(usize::from(size.0));
    let row = |row: &[ratatui::buffer::Cell]| -> String {
        let cells: String = row.iter().map(|cell| cell.symbol()).collect();
        cells.trim_end().to_owned()
    };
    rows.map(row).collect::<Vec<_>>().join("\n")
}

#[track_caller]
fn shows(model: &Model, words: &str) {
    let screen = screen(model, NORMAL);
    assert!(screen.contains(words), "no `{words}` in\n{screen}");
}

#[test]
fn an_interrupted_flight_is_cut_short() {
    let mut model = model();
    let flight = flight(&mut model);
    for (ending, how) in [
        (EndReason::Interrupted, "interrupted after "),
        (EndReason::Failed, "aborted after "),
    ] {
        flight.ending = Some(ending);
        let (verdicts, _) = flight.verdicts();
        let whys = [verdicts.flight.why, verdicts.timing.why];
        assert!(whys.iter().all(|why| why.starts_with(how)), "{whys:?}");
    }
}

/// Screens as in `snapshots/`: `INSTA_UPDATE=always cargo test -p live` accepts a change.
#[test]
fn each_page_is_its_snapshot() {
    let waiting = Model::new("left", false, true);
    let laws = flown_by("estimating", "indi");
    let mut unwatched = model();
    flight(&mut unwatched).recorder_lives = false;
    // A number that the law has never set is no zero.
    let mut unset = flown_by("pd", "pid");
    take_wrench(flight(&mut unset), 101, Telemetry::unknown(7));
    let mut noisy = model();
    flight(&mut noisy).active.value[Parameter::GyroNoise as usize] = 0.01;
    let mut ended = model();
    flight(&mut ended).ending = Some(EndReason::Completed);
    let starting = Model::new("left", true, true);
    let not_applicable = flown_by("pd", "geometric");
    for (name, mut model, keys) in [
        ("waiting", waiting, ""),
        ("starting", starting, ""),
        ("handed_over", handed_over(), "1"),
        ("handed_over_last_rows", handed_over(), "1<End>"),
        ("real_time_channels", handed_over(), "5"),
        ("real_time_channels_last_rows", handed_over(), "5<End>"),
        ("flight", model(), "1"),
        ("latency", model(), "2"),
        ("latency_last", model(), "2<End>"),
        ("theorem", model(), "3"),
        ("theorem_without_recorder", unwatched, "3"),
        ("theorem_not_applicable", not_applicable, "3"),
        ("parameters", model(), "4"),
        ("parameters_changed", noisy, "4<End>"),
        // The plant's words; the text stays for correction.
        ("parameters_refused", model(), "4<Enter>50<Enter>"),
        ("fault_refused", model(), "4fstate.dorp=1<Enter>"),
        ("real_time", model(), "5"),
        ("laws", laws, "6"),
        ("laws_unset", unset, "6"),
        ("help", model(), "?"),
        ("ended", ended, "4<Enter>"),
    ] {
        press(&mut model, keys);
        insta::assert_snapshot!(name, screen(&model, NORMAL));
    }
    insta::assert_snapshot!("too_small", screen(&model(), (60, 9)));
}

#[test]
fn the_error_continues_without_setpoints() {
    let mut model = model();
    take_state(flight(&mut model), 1100, [1.0, -1.0, 9.0]);
    shows(&model, "|error| [m]     8.0000");
    shows(&model, "max 8.0000");
}

#[test]
fn a_parameter_or_a_fault_is_typed_corrected_and_injected() {
    let mut model = model();
    let now = |change: &str| Action::Inject(vec![change.parse().unwrap()], None);
    press(&mut model, "4<Enter>50<Enter>");
    assert_eq!(
        press(&mut model, "<Backspace><Backspace>q0.6<Enter>"),
        now("mass_kg=0.6")
    );
    shows(&model, "waits for the plant's answer");
    assert_eq!(press(&mut model, "<Enter>"), Action::None, "one at a time");
    let answer = "applied at tick 1200 (1.200 s), parameter epoch 1\n  mass_kg 0.52 -> 0.6 kg\n";
    model.answer(Ok(answer.into()));
    shows(
        &model,
        "applied at tick 1200 (1.200 s), parameter epoch 1 mass_kg 0.52 -> 0.6 kg",
    );
    let ramp = "mass_kg=0.6~2s500ms";
    assert_eq!(press(&mut model, "<Enter>0.6~2s500ms<Enter>"), now(ramp));
    model.answer(Err(Failure::failed(
        "the plant refused: too many parameter changes",
    )));
    shows(&model, "the plant refused: too many parameter changes");
    press(&mut model, "<Enter>1e-e<Enter>");
    shows(&model, "mass_kg = `1e-e` is not a number");
    // Esc leaves the value, not the dashboard; then the dashboard.
    assert_eq!(press(&mut model, "<Esc>"), Action::None);
    assert!(!screen(&model, NORMAL).contains("1e-e_"));
    press(&mut model, "fstate.drop=0.1,inner.late=1ms for soon<Enter>");
    let faults = ["state.drop=0.1", "inner.late=1ms"].map(|text| text.parse().unwrap());
    let backspaces = "<Backspace>".repeat(4);
    assert_eq!(
        press(&mut model, &(backspaces + "2s<Enter>")),
        Action::Inject(faults.into(), Some(Duration::from_secs(2)))
    );
    model.answer(Ok(String::new()));
    assert_eq!(press(&mut model, "<Esc>"), Action::Quit);
}

#[test]
fn control_keys_are_not_typed_and_ctrl_u_empties_the_line() {
    let mut model = model();
    assert_eq!(press(&mut model, "4finner.sto<Ctrl-p>"), Action::None);
    shows(&model, "1s: inner.sto_");
    assert_eq!(press(&mut model, "<Ctrl-u>"), Action::None);
    shows(&model, "1s: _");
    press(&mut model, "outer.kill");
    shows(&model, "1s: outer.kill_");
}

#[test]
fn pages_scroll_to_their_last_row_and_back() {
    let mut model = handed_over();
    press(&mut model, "5");
    let first = screen(&model, NORMAL);
    assert!(first.contains("rows 1 to 19 of 30"), "{first}");
    press(&mut model, "<End>");
    let last = screen(&model, NORMAL);
    assert!(last.contains("rows 12 to 30 of 30"), "{last}");
    press(&mut model, "<Down>");
    assert_eq!(screen(&model, NORMAL), last);
    press(&mut model, "<Up>");
    assert_ne!(
        screen(&model, NORMAL),
        last,
        "keys beyond the end are not counted"
    );
    press(&mut model, "<Home>");
    assert_eq!(screen(&model, NORMAL), first);
}

#[test]
fn keys_open_tabs_and_help_and_end_the_dashboard_or_the_flight() {
    let mut model = model();
    for (keys, tab) in [
        ("<Tab>", Tab::Latency),
        ("<BackTab>", Tab::Flight),
        ("<BackTab>", Tab::Laws),
        ("<Tab>", Tab::Flight),
        ("6", Tab::Laws),
        ("4", Tab::Plant),
        // The key that closes help does nothing else.
        ("?1", Tab::Plant),
    ] {
        press(&mut model, keys);
        assert_eq!((model.tab, model.help), (tab, false));
    }
    for (keys, alone, launched) in [
        ("<Ctrl-c>", Action::Quit, Action::EndFlight),
        ("q", Action::Quit, Action::Quit),
        ("?q", Action::Quit, Action::Quit),
        ("<Esc>", Action::Quit, Action::Quit),
        ("r", Action::Reset, Action::Reset),
    ] {
        model.launched = false;
        assert_eq!(press(&mut model, keys), alone);
        model.launched = true;
        assert_eq!(press(&mut model, keys), launched);
    }
}

#[test]
fn a_reset_restarts_statistics_and_keeps_the_number_of_lost_messages() {
    let mut model = model();
    let loss = Loss {
        messages: 50,
        before_tick: 1110,
        ..Loss::default()
    };
    let loss = Message::of_tick(1110, loss);
    flight(&mut model).take(&LogEntry::Loss(loss));
    take_tick(flight(&mut model), 1110);
    assert_eq!(flight(&mut model).lost(), 50);
    model.reset().unwrap();
    press(&mut model, "2");
    shows(&model, "loop                       -");
    assert!(screen(&model, (100, 24)).contains("lost 50 messages"));
    press(&mut model, "3");
    shows(&model, "theorem holds: 0 unexplained of 100 steps");
    take_tick(flight(&mut model), 2000);
    assert_eq!(flight(&mut model).lost(), 50);
}

#[test]
fn wrenches_that_the_recorder_could_not_judge_are_in_the_verdict() {
    let mut model = model();
    for ticks_checked in 101..=300 {
        let monitor = Monitor {
            ticks_checked,
            steps_adapted: ticks_checked,
            is_live: 1,
            ..Monitor::default()
        };
        let seen = LogEntry::Theorem(message(1000 + ticks_checked, monitor));
        flight(&mut model).take(&seen);
    }
    shows(&model, "theorem not judged");
    let recorder = flight(&mut model).statuses.get_mut(&Role::Record.into());
    recorder.unwrap().wrenches_unwatched = 7;
    // A wrench that was not watched is no evidence for those of which nothing was judged.
    shows(&model, "theorem not judged");
    let (verdicts, _) = flight(&mut model).verdicts();
    let why = &verdicts.theorem.why;
    assert!(why.contains("of 1207 ticks, 7 not watched"), "{why}");
}

#[test]
fn a_verdict_is_good_or_bad_or_neither() {
    fn of<W>(word: W) -> Explained<W> {
        Explained::new(word, String::new())
    }
    use FlightVerdict::{CutShort, Lost, NotSeen, OffTrack, Tracked};
    use StabilityVerdict::{Broken, Holds, NotApplicable, NotJudged, PartlyWatched};
    use TimingVerdict::{InTime, Late, NotMeasured};
    for (flight, timing, theorem, is_good) in [
        (Tracked, InTime, Holds, Some(true)),
        (OffTrack, Late, Broken, Some(false)),
        (Lost, Late, Broken, Some(false)),
        (NotSeen, NotMeasured, NotApplicable, None),
        (CutShort, TimingVerdict::CutShort, NotJudged, None),
        (CutShort, TimingVerdict::CutShort, PartlyWatched, None),
    ] {
        let verdicts = Verdicts {
            flight: of(flight),
            timing: of(timing),
            theorem: of(theorem),
        };
        let judged = Judged::all(&verdicts).map(|it| it.is_good);
        assert_eq!(judged, [is_good; 3], "{verdicts:?}");
    }
}

#[test]
fn every_page_fits_every_terminal_with_visible_colours_or_none() {
    let mut model = model();
    let colours = |model: &Model| {
        let cells = buffer(model, NORMAL).content;
        let colours = cells.into_iter().flat_map(|cell| [cell.fg, cell.bg]);
        let colours = colours.filter(|colour| *colour != Color::Reset);
        colours.collect::<Vec<_>>()
    };
    for (tab, name) in Tab::ALL {
        model.tab = tab;
        for (width, height) in (1..=130)
            .step_by(3)
            .flat_map(|width| [1, 11, 12, 13, 17, 24, 33, 50].map(|height| (width, height)))
        {
            let screen = screen(&model, (width, height));
            let fits = width >= SMALLEST.0 && height >= SMALLEST.1;
            assert_eq!(
                screen.starts_with(" left   flying"),
                fits,
                "{width} x {height}"
            );
        }
        model.help = true;
        assert!(screen(&model, SMALLEST).contains("leave; it flies on"));
        model.help = false;
        // Neither black nor white.
        let visible = [Color::Red, Color::Green, Color::Blue, Color::Magenta];
        assert!(
            colours(&model)
                .iter()
                .all(|colour| visible.contains(colour)),
            "{name}"
        );
        assert!(tab != Tab::Flight || !colours(&model).is_empty());
        model.colours = false;
        assert_eq!(colours(&model), [], "{name}");
        model.colours = true;
    }
}

#[test]
fn a_line_of_plain_text_has_the_main_figures() {
    assert_eq!(
        line(flight(&mut model())),
        "tick 1099   1.1 s   error 0.5000 m   loop p50 30.0 p99 30.0 us   10 ticks without a fresh command on time   V 2.500e-1 rad^2/s^2   \
         violations 12 (0 unexplained)"
    );
}

#[test]
fn earlier_swaps_do_not_count_as_lost_and_the_latest_is_shown() {
    let mut model = model();
    for (seq, tick) in [(3, 500), (4, 8000)] {
        let mut swap = SwapRecord {
            count: 1,
            ..SwapRecord::default()
        };
        (swap.old[0], swap.new[0], swap.steps[0]) = (0.52, 0.676, 2000);
        let mut swap = message(tick, swap);
        swap.envelope.seq = seq;
        flight(&mut model).take(&LogEntry::Swap(swap));
    }
    assert_eq!(flight(&mut model).lost(), 0);
    press(&mut model, "4");
    let last =
        "parameter changes so far 0; the last: mass_kg 0.52 -> 0.676 over 2 s from tick 8000";
    assert!(screen(&model, (110, 40)).contains(last));
}
