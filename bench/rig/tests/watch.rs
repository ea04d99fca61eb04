//! `ironbird watch` on real flights, in a terminal and as plain text.

use crate::rig::{IRONBIRD, Rig, Running, is_gone, lacks_feature, read_log, send, wait_until};
use flight_log::entry::LogEntry;
use rustix::process::Signal;
use serde_json::json;
use std::fs;
use terminal::Screen;

mod terminal {
    //! A terminal that a test reads and types into: a tmux server of its own.

    use std::process::{Command, Output};

    use crate::rig::{Rig, lacks_tool, wait_until};

    pub struct Screen {
        tmux: String,
        socket: String,
    }

    impl Screen {
        /// A shell script in a terminal; none if there is no tmux.
        pub fn open(rig: &Rig, (width, height): (u16, u16), script: &str) -> Option<Self> {
            let named = std::env::var("IRONBIRD_TMUX").unwrap_or_default();
            let tmux = if named.is_empty() { "tmux" } else { &named };
            let version = Command::new(tmux).arg("-V").output();
            if !version.is_ok_and(|output| output.status.success()) {
                assert!(named.is_empty(), "IRONBIRD_TMUX: {tmux} does not run");
                lacks_tool(&format!("the dashboard in a terminal: there is no {tmux}"));
                return None;
            }
            let screen = Self {
                tmux: tmux.to_owned(),
                socket: rig.file(&format!("tmux-{width}x{height}")),
            };
            // The shell stays, so that the test can read what the script left on the screen.
            let root = rig.root();
            let script = format!(
                "export IRONBIRD_ROOT='{}'; {script}; exec sleep 600",
                root.display()
            );
            let session = format!("-f /dev/null new-session -d -x {width} -y {height}");
            let args: Vec<&str> = session.split(' ').chain([script.as_str()]).collect();
            screen.tmux(&args);
            Some(screen)
        }

        fn tmux(&self, args: &[&str]) -> String {
            let mut command = Command::new(&self.tmux);
            command
                .arg("-S")
                .arg(&self.socket)
                .args(args)
                .env_remove("TMUX");
            let output: Output = command.output().unwrap();
            assert!(output.status.success(), "{output:?}");
            String::from_utf8(output.stdout).unwrap()
        }

        /// Types keys, separated by blanks.
        pub fn press(&self, keys: &str) {
            let keys: Vec<&str> = keys.split(' ').collect();
            self.tmux(&[&["send-keys"], &keys[..]].concat());
        }

        pub fn text(&self) -> String {
            self.tmux(&["capture-pane", "-p"])
        }

        /// Whether an escape sets a colour of the foreground.
        pub fn has_colour(&self) -> bool {
            let screen = self.tmux(&["capture-pane", "-p", "-e"]);
            let escapes = screen.split("\x1b[").filter_map(|it| it.split('m').next());
            let mut codes = escapes.flat_map(|codes| codes.split(';'));
            codes.any(|code| matches!(code.parse(), Ok(30..=38 | 90..=97)))
        }

        /// Waits until words are on the screen; returns it.
        #[track_caller]
        pub fn await_words(&self, words: &str) -> String {
            wait_until(&format!("`{words}` on the screen"), || {
                Some(self.text()).filter(|text| text.contains(words))
            })
        }

        /// Whether the terminal shows its cursor and its normal screen.
        pub fn is_restored(&self) -> bool {
            self.tmux(&["display-message", "-p", "#{cursor_flag} #{alternate_on}"]) == "1 0\n"
        }
    }

    impl Drop for Screen {
        fn drop(&mut self) {
            let mut command = Command::new(&self.tmux);
            let _ = command
                .arg("-S")
                .arg(&self.socket)
                .arg("kill-server")
                .output();
        }
    }
}

/// `ironbird COMMAND` in a shell that prints its exit code, and whether the terminal is in its normal mode.
fn script(rig: &Rig, command: &str) -> String {
    let instance = &rig.instance;
    format!(
        "echo before; {IRONBIRD} {command} --instance {instance}; echo ended with $?; stty -a | grep -o ' icanon'; echo shell is back"
    )
}

fn fly_script(rig: &Rig, duration: &str) -> String {
    let out = rig.out();
    script(
        rig,
        &format!(
            "fly --watch --rt off --duration {duration} --out {}",
            out.display()
        ),
    )
}

/// A flight that lasts until a signal ends it.
fn take_off(rig: &Rig) -> Running {
    rig.take_off("--rt off --duration 600s")
}

fn land(rig: &Rig, flight: Running) {
    // Those in terminals that were closed.
    wait_until("all watchers to leave", || {
        rig.processes_of("watch").is_empty().then_some(())
    });
    flight.signal(Signal::INT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}

/// Every page by its key, a change of a parameter, a reset; and the flight continues.
#[test]
fn pages_and_parameters_work_in_a_terminal_and_leaving_lets_the_flight_continue() {
    let rig = Rig::new("pages");
    let flight = take_off(&rig);
    let Some(screen) = Screen::open(&rig, (120, 40), &script(&rig, "watch")) else {
        return land(&rig, flight);
    };
    screen.await_words("flying");
    for (keys, words) in [
        ("1", "position error, last"),
        ("2", "loop [us], counts"),
        ("Tab", "I_R kg m^2"),
        ("5", "memory_lock"),
        ("6", "inner adaptive"),
        ("?", "leave; it flies on"),
        (
            "x 4 Down Down Down Enter 0 . 5 2 5 Enter",
            "rotational_drag_nm_s 0.105 -> 0.525 N m s",
        ),
        (
            "Enter 7 Enter",
            "rotational_drag_nm_s = 7 is out of range: allowed are 0.0 to 1.0",
        ),
    ] {
        screen.press(keys);
        screen.await_words(words);
        let shown = screen.text();
        assert!(
            shown.lines().all(|line| line.chars().count() <= 120),
            "{shown}"
        );
    }
    let active = |name: &str| {
        let params = rig.run("params", "--json").json();
        let mut rows = params.as_array().unwrap().iter();
        rows.find(|row| row["name"] == name).unwrap()["in_force"].clone()
    };
    assert_eq!(active("rotational_drag_nm_s"), 0.525);
    screen.press("Escape");
    // Together, the two keys would be another one.
    screen.await_words("? help");
    screen.press("2");
    let count = || -> u64 {
        let shown = screen.await_words("wake.plant");
        let (_, row) = shown.split_once("wake.plant").unwrap();
        let count = row.split_whitespace().next().unwrap();
        count.parse().unwrap_or(0)
    };
    let long = wait_until("a second of statistics", || {
        Some(count()).filter(|n| *n > 1000)
    });
    screen.press("r");
    wait_until("statistics to restart", || (count() < long).then_some(()));
    screen.press("q");
    let left = screen.await_words("shell is back");
    assert!(
        left.contains("before\nended with 0\n icanon\nshell is back"),
        "{left}"
    );
    assert!(screen.is_restored());
    // The plant still answers.
    rig.ok("inject gravity_m_s2=9.8");
    land(&rig, flight);
}

#[test]
#[ignore = "long: part of the gate"]
fn it_waits_for_a_flight_shows_its_end_and_joins_the_next() {
    let rig = Rig::new("next");
    let Some(screen) = Screen::open(&rig, (80, 24), &script(&rig, "watch")) else {
        return;
    };
    screen.await_words(&format!("ironbird fly --instance {}", rig.instance));
    assert!(!rig.root().exists(), "waiting creates nothing");
    for _ in 0..2 {
        rig.run("fly", "--rt off --duration 2s");
        screen.await_words("landed: completed");
        screen.await_words("leave  ?");
        let flight = take_off(&rig);
        screen.await_words("flying");
        flight.signal(Signal::INT);
        flight.end().expect(130);
        screen.await_words("landed: interrupted");
    }
    screen.press("C-c");
    screen.await_words("ended with 0");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_signal_restores_a_small_terminal_and_no_color_is_respected() {
    let rig = Rig::new("small");
    let flight = take_off(&rig);
    let watch = script(&rig, "watch");
    if let Some(screen) = Screen::open(&rig, (40, 12), &watch) {
        screen.await_words("flying");
        let watcher = rig.processes_of("watch");
        assert_eq!(watcher.len(), 1, "{watcher:?}");
        send(watcher[0], Signal::TERM);
        screen.await_words("ended with 130");
        assert!(screen.await_words("shell is back").contains(" icanon") && screen.is_restored());
    }
    for (height, no_color, has_colour) in [(30, "export NO_COLOR=1; ", false), (31, "", true)] {
        if let Some(screen) = Screen::open(&rig, (100, height), &format!("{no_color}{watch}")) {
            screen.await_words("position error");
            assert_eq!(screen.has_colour(), has_colour);
        }
    }
    land(&rig, flight);
}

#[test]
#[ignore = "long: part of the gate"]
fn killed_watchers_use_nothing_up_and_too_many_are_refused() {
    let rig = Rig::with_features("crowd");
    let flight = take_off(&rig);
    for _ in 0..10 {
        let watcher = rig.start("watch", "--plain");
        watcher.await_output("error");
        watcher.signal(Signal::KILL);
        watcher.end();
    }
    let crowd = [(); 4].map(|()| rig.start("watch", ""));
    for watcher in &crowd {
        watcher.await_output("error");
    }
    rig.run("watch", "")
        .expect(5)
        .complains("has 4 observers already, and that is the most")
        .complains("end one of the others");
    flight.signal(Signal::INT);
    for watcher in crowd {
        watcher.end().expect(0).says("interrupted\n");
    }
    flight.end().expect(130);
    let report = rig.report();
    assert_eq!(report["recorder"]["unwritten"], json!({}));
    assert_eq!(report["verdict"]["status"], "INTERRUPTED");
    // A subscriber that joined a loop's own topic would cost its sender dozens of allocations each time.
    for role in ["plant", "outer", "inner", "mixer"] {
        let role = &report["roles"][role];
        let ticks = role["ticks_run"].as_u64().unwrap();
        let allocations = role["usage"]["allocations"].as_u64();
        assert_eq!(allocations.is_some(), cfg!(feature = "instrumented"));
        let Some(allocations) = allocations else {
            lacks_feature("allocations of loops that are watched", "instrumented");
            break;
        };
        assert!(ticks > 0 && allocations <= ticks + 5, "{role}");
    }
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn plain_text_is_a_line_a_second_until_the_flight_ends() {
    let rig = Rig::new("plain");
    let watcher = rig.start("watch", "");
    watcher.await_words(&format!("waiting for instance `{}` to fly", rig.instance));
    rig.run("fly", "--rt off --duration 3s");
    let ended = watcher.end().expect(0);
    let lines: Vec<&str> = ended.stdout.lines().collect();
    assert!(lines.len() >= 3, "{ended}");
    for line in &lines {
        assert!(line.starts_with("tick "), "{ended}");
        assert!(
            line.contains(" m   loop p50 ") && line.contains("rad^2/s^2"),
            "{ended}"
        );
    }
    // The plant skips the last tick, too, if it is late by then.
    let log = read_log(&rig.out().join("latest/flight.mcap")).0;
    let states = log.iter().filter(|it| matches!(it, LogEntry::State(_)));
    let last_tick = states.map(|entry| entry.envelope().tick).max().unwrap();
    let last = lines.last().unwrap();
    assert!(
        last.starts_with(&format!("tick {last_tick}   3.0 s")),
        "{ended}"
    );
    assert!(last.ends_with("completed"), "{ended}");
    rig.assert_nothing_left();
}

#[test]
fn a_signal_ends_plain_text() {
    let rig = Rig::new("signal");
    let watcher = rig.start("watch", "--plain");
    watcher.await_words("waiting");
    watcher.signal(Signal::INT);
    watcher.end().expect(130);
    rig.assert_nothing_started();
    rig.refused("watch --instance Left")
        .complains("instance name `Left` is not allowed");
}

#[test]
fn without_a_terminal_fly_watch_prints_text() {
    let rig = Rig::new("flytext");
    let flown = rig.run("fly", "--rt off --duration 2s --watch");
    assert!(flown.stdout.starts_with("tick "), "{flown}");
    assert!(flown.stdout.contains("   completed\n"), "{flown}");
    assert!(flown.result().contains_key("status"));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn fly_watch_opens_the_dashboard_and_prints_its_report_after_it() {
    let rig = Rig::new("flywatch");
    let Some(screen) = Screen::open(&rig, (200, 60), &fly_script(&rig, "6s")) else {
        return;
    };
    screen.await_words("position error, last");
    screen.press("q");
    // The supervisor has its terminal back, with its own status line.
    let line = screen.await_words(" of 6.0 s   missed");
    assert!(!line.contains("position error, last"), "{line}");
    let ended = screen.await_words("shell is back");
    assert!(
        ended.contains("RESULT status=") && ended.contains(" icanon"),
        "{ended}"
    );
    rig.assert_nothing_left();
}

#[test]
fn ctrl_c_in_the_dashboard_of_fly_ends_the_flight() {
    let rig = Rig::new("flyend");
    let Some(screen) = Screen::open(&rig, (200, 60), &fly_script(&rig, "600s")) else {
        return;
    };
    screen.await_words("position error, last");
    let plant = rig.processes_of("plant");
    screen.press("C-c");
    let ended = screen.await_words("shell is back");
    assert!(ended.contains("RESULT status=INTERRUPTED"), "{ended}");
    assert!(ended.contains("ended with 130"), "{ended}");
    assert!(screen.is_restored());
    assert!(!plant.is_empty() && plant.into_iter().all(is_gone));
    rig.assert_nothing_left();
}

#[test]
fn a_supervisor_that_dies_takes_its_dashboard_along() {
    let rig = Rig::new("flykill");
    let Some(screen) = Screen::open(&rig, (100, 30), &fly_script(&rig, "600s")) else {
        return;
    };
    screen.await_words("position error, last");
    let supervisor = rig.processes_of("fly");
    assert_eq!(supervisor.len(), 1, "{supervisor:?}");
    send(supervisor[0], Signal::KILL);
    wait_until("the dashboard and the roles to end", || {
        let roles = ["watch", "plant", "outer", "inner", "mixer", "record"];
        let mut left = roles.iter().flat_map(|role| rig.processes_of(role));
        left.next().is_none().then_some(())
    });
    wait_until("the terminal to be restored", || {
        screen.is_restored().then_some(())
    });
    rig.ok("clean");
    rig.assert_nothing_left();
}

#[test]
fn without_its_recorder_a_flight_is_shown_as_of_the_last_message() {
    let rig = Rig::new("unrecorded");
    let args = format!("--rt off --config {} --duration 1h", rig.slow(10));
    let roles = ["record", "plant", "outer", "inner", "mixer"].map(|role| rig.start(role, &args));
    rig.await_flight();
    let watch = rig.start("watch", "--plain");
    watch.await_output("   violations ");
    assert!(
        !watch.stdout().contains("no recorder"),
        "{}",
        watch.stdout()
    );
    let [recorder, plant, ..] = &roles;
    recorder.signal(Signal::KILL);
    wait_until("a line about the loss", || {
        let lines = watch.stdout();
        let last = lines.lines().last()?;
        let tick = last.strip_prefix("tick ")?.split(' ').next()?;
        let loss = format!("   no recorder: as of tick {tick}, not watched since");
        last.contains(&loss).then_some(())
    });
    plant.signal(Signal::INT);
    let ended = watch.end().expect(0);
    ended.says("not watched since   interrupted\n");
    roles.into_iter().for_each(|role| drop(role.end()));
    rig.run("clean", "");
}

#[test]
fn a_trajectory_file_that_has_changed_ends_a_watch_with_a_remedy() {
    let rig = Rig::new("moved-points");
    let file = rig.file("climb.csv");
    let points = "t,x,y,z,yaw\n0,0,0,0,0\n5,0.5,0,0.5,0\n";
    fs::write(&file, points).unwrap();
    let config = rig.slow(10);
    let flight = rig.take_off(format!(
        "--rt off --config {config} --duration 1h --trajectory {file}"
    ));
    let refused = |words: &str| {
        let ended = rig.run("watch", "--plain").expect(1).complains(words);
        ended
            .complains("help: restore the file with SHA-256 ")
            .complains("and start watch again; the flight itself continues");
    };
    fs::write(&file, points.replace("0.5,0,0.5", "0.6,0,0.5")).unwrap();
    refused("climb.csv has changed since the flight began");
    fs::remove_file(&file).unwrap();
    refused("the trajectory of the flight cannot be shown: ");
    flight.signal(Signal::INT);
    flight.end().expect(130);
}
