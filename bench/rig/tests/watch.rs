//! `ironbird watch` on real flights, in a terminal and as plain text.

use crate::rig::{IRONBIRD, Rig, Running, is_gone, lacks_feature, read_log, send, wait_until};
use flight_log::entry::LogEntry;
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use terminal::Screen;

mod terminal {
    //! A terminal that a test sees and types into: a tmux server of its own.

    use std::process::{Command, Output};

    use crate::rig::{Rig, lacks_tool, wait_until};

    pub struct Screen {
        tmux: String,
        socket: String,
    }

    /// The tmux to use; none where it is left out.
    pub fn tmux() -> Option<String> {
        let named = std::env::var("IRONBIRD_TMUX")
            .ok()
            .filter(|tmux| !tmux.is_empty());
        let tmux = named.clone().unwrap_or_else(|| "tmux".into());
        if Command::new(&tmux)
            .arg("-V")
            .output()
            .is_ok_and(|output| output.status.success())
        {
            return Some(tmux);
        }
        assert!(named.is_none(), "IRONBIRD_TMUX: {tmux} does not run");
        lacks_tool(&format!(
            "the dashboard is not driven in a terminal: there is no {tmux}"
        ));
        None
    }

    impl Screen {
        /// A shell script in a terminal of `width` x `height`; none where there is no tmux.
        pub fn open(rig: &Rig, (width, height): (u16, u16), script: &str) -> Option<Self> {
            let screen = Self {
                tmux: tmux()?,
                socket: rig.file(&format!("tmux-{width}x{height}")),
            };
            // The shell stays, so that what is left behind can be looked at.
            let script = format!(
                "export IRONBIRD_ROOT='{}'; {script}; exec sleep 600",
                rig.root().display()
            );
            let (width, height) = (width.to_string(), height.to_string());
            let output = screen.tell(&[
                "-f",
                "/dev/null",
                "new-session",
                "-d",
                "-x",
                &width,
                "-y",
                &height,
                &script,
            ]);
            assert!(output.status.success(), "{output:?}");
            Some(screen)
        }

        fn tell(&self, args: &[&str]) -> Output {
            Command::new(&self.tmux)
                .arg("-S")
                .arg(&self.socket)
                .args(args)
                .env_remove("TMUX")
                .output()
                .unwrap()
        }

        pub fn type_keys(&self, keys: &[&str]) {
            let output = self.tell(&[&["send-keys"], keys].concat());
            assert!(output.status.success(), "{output:?}");
        }

        /// What is on the screen, with the escapes of colours where they are wanted.
        pub fn look(&self, with_colours: bool) -> String {
            let args: &[&str] = if with_colours {
                &["capture-pane", "-p", "-e"]
            } else {
                &["capture-pane", "-p"]
            };
            String::from_utf8(self.tell(args).stdout).unwrap()
        }

        /// Waits until words are on the screen; gives it.
        #[track_caller]
        pub fn await_words(&self, words: &str) -> String {
            let mut screen = String::new();
            let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                wait_until(&format!("`{words}` on the screen"), || {
                    screen = self.look(false);
                    screen.contains(words).then_some(())
                });
            }));
            assert!(found.is_ok(), "no `{words}` on the screen:\n{screen}");
            screen
        }

        /// Whether a terminal shows its cursor, and its own screen rather than another one.
        pub fn is_restored(&self) -> bool {
            let output = self.tell(&["display-message", "-p", "#{cursor_flag} #{alternate_on}"]);
            String::from_utf8(output.stdout).unwrap().trim() == "1 0"
        }
    }

    impl Drop for Screen {
        fn drop(&mut self) {
            let _ = self.tell(&["kill-server"]);
        }
    }
}

/// `ironbird watch` in a shell that tells how it ended, and what became of the terminal.
fn watch_script(rig: &Rig) -> String {
    format!(
        "echo before; {IRONBIRD} watch --instance {}; echo left with $?; stty -a | grep -o ' icanon'; echo after",
        rig.instance
    )
}

/// A flight that lasts until it is told to end.
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

fn in_force(rig: &Rig, name: &str) -> f64 {
    let params = rig.run("params", "--json").json();
    let row = params
        .as_array()
        .unwrap()
        .iter()
        .find(|row| row["name"] == name)
        .unwrap();
    row["in_force"].as_f64().unwrap()
}

/// The tick of the flight now, from the plant's answer to a swap that changes nothing.
fn present_tick(rig: &Rig) -> u64 {
    let answer = rig.ok("inject gravity_m_s2=9.8");
    answer.stdout.split(' ').nth(3).unwrap().parse().unwrap()
}

#[test]
fn every_page_is_reached_by_keys_and_leaving_lets_the_flight_fly_on() {
    let rig = Rig::new("pages");
    let flight = take_off(&rig);
    let Some(screen) = Screen::open(&rig, (80, 24), &watch_script(&rig)) else {
        return land(&rig, flight);
    };
    screen.await_words("flying");
    for (keys, words) in [
        (
            &["1"][..],
            &[
                "flying",
                "position",
                "attitude",
                "rad/s",
                "position error, last",
            ][..],
        ),
        (
            &["2"],
            &[
                "deadlines missed",
                "loop ",
                "wake.plant",
                "p99.9",
                "loop [us], counts",
            ],
        ),
        (
            &["Tab"],
            &[
                "theorem holds",
                "V_th",
                "rotor_inertia_kg_m2",
                "unexplained",
            ],
        ),
        (
            &["4"],
            &["mass_kg", "0.05", "in force", "rotor_efficiency_3"],
        ),
        (
            &["Tab"],
            &["scheduling", "memory_lock", "mixer", "rejected"],
        ),
        (&["BTab"], &["mass_kg"]),
        (&["?"], &["leave; it flies on"]),
        (&["x", "1"], &["position error, last"]),
    ] {
        screen.type_keys(keys);
        words
            .iter()
            .for_each(|words| drop(screen.await_words(words)));
        let shown = screen.look(false);
        assert!(
            shown.lines().all(|line| line.chars().count() <= 80),
            "{shown}"
        );
    }
    let before = present_tick(&rig);
    screen.type_keys(&["q"]);
    let left = screen.await_words("after");
    assert!(
        left.contains("before\nleft with 0\n icanon\nafter"),
        "{left}"
    );
    assert!(screen.is_restored());
    assert!(present_tick(&rig) > before);
    land(&rig, flight);
}

#[test]
#[ignore = "long: part of the gate"]
fn a_parameter_is_swapped_from_the_dashboard() {
    let rig = Rig::new("desk");
    let flight = take_off(&rig);
    let Some(screen) = Screen::open(&rig, (120, 40), &watch_script(&rig)) else {
        return land(&rig, flight);
    };
    screen.await_words("lissajous, gains flight");
    screen.type_keys(&[
        "4", "Down", "Down", "Down", "Enter", "0", ".", "5", "2", "5", "Enter",
    ]);
    screen.await_words("rotational_drag_nm_s 0.105 -> 0.525 N m s");
    screen.await_words("0.525*");
    assert_eq!(in_force(&rig, "rotational_drag_nm_s"), 0.525);
    screen.type_keys(&["Enter", "7", "Enter"]);
    screen.await_words("rotational_drag_nm_s = 7 is out of range: allowed are 0.0 to 1.0 N m s");
    assert_eq!(in_force(&rig, "rotational_drag_nm_s"), 0.525);
    screen.type_keys(&["Escape"]);
    screen.await_words("? help");
    // Statistics begin anew: few ticks are counted, and the flight is older than that.
    screen.type_keys(&["2"]);
    let count = |screen: &str| -> u64 {
        let row = screen
            .lines()
            .find(|line| line.trim_start().starts_with("wake.plant"))
            .unwrap();
        row.split_whitespace()
            .nth(1)
            .and_then(|count| count.parse().ok())
            .unwrap_or(0)
    };
    let long = wait_until("a second of statistics", || {
        Some(count(&screen.await_words("wake.plant"))).filter(|n| *n > 1000)
    });
    screen.type_keys(&["r"]);
    wait_until("statistics from the begin", || {
        (count(&screen.await_words("wake.plant")) < long).then_some(())
    });
    screen.type_keys(&["Escape"]);
    screen.await_words("left with 0");
    land(&rig, flight);
}

#[test]
#[ignore = "long: part of the gate"]
fn it_waits_for_a_flight_shows_its_end_and_joins_the_next() {
    let rig = Rig::new("next");
    let Some(screen) = Screen::open(&rig, (80, 24), &watch_script(&rig)) else {
        return;
    };
    screen.await_words(&format!("ironbird fly --instance {}", rig.instance));
    assert!(!rig.root().exists(), "waiting touches nothing");
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
    screen.type_keys(&["C-c"]);
    screen.await_words("left with 0");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn small_terminals_signals_and_no_color_are_respected() {
    let rig = Rig::new("small");
    let flight = take_off(&rig);
    if let Some(screen) = Screen::open(&rig, (40, 12), &watch_script(&rig)) {
        screen.await_words("flying");
        for (key, words) in [
            ("1", "roll"),
            ("2", "p99"),
            ("3", "theorem"),
            ("4", "mass_kg"),
            ("5", "scheduling"),
        ] {
            screen.type_keys(&[key]);
            screen.await_words(words);
        }
        let watcher = rig.processes_of("watch");
        assert_eq!(watcher.len(), 1, "{watcher:?}");
        send(watcher[0], Signal::TERM);
        screen.await_words("left with 130");
        assert!(screen.await_words("after").contains(" icanon") && screen.is_restored());
    }
    if let Some(screen) = Screen::open(&rig, (30, 10), &watch_script(&rig)) {
        screen.await_words("too small");
    }
    if let Some(screen) = Screen::open(
        &rig,
        (100, 30),
        &format!("export NO_COLOR=1; {}", watch_script(&rig)),
    ) {
        screen.await_words("position error");
        assert!(!has_colour(&screen.look(true)));
    }
    if let Some(screen) = Screen::open(&rig, (100, 31), &watch_script(&rig)) {
        screen.await_words("position error");
        assert!(has_colour(&screen.look(true)));
    }
    land(&rig, flight);
}

/// Whether an escape sets a colour of the foreground.
fn has_colour(screen: &str) -> bool {
    screen.split("\x1b[").any(|escape| {
        let codes = escape.split('m').next().unwrap_or_default();
        codes
            .split(';')
            .any(|code| matches!(code.parse(), Ok(30..=38 | 90..=97)))
    })
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
    let crowd: Vec<Running> = (0..4).map(|_| rig.start("watch", "")).collect();
    crowd
        .iter()
        .for_each(|watcher| watcher.await_output("error"));
    rig.run("watch", "")
        .expect(5)
        .complains("has 4 observers already, and that is the most")
        .complains("end one of the others");
    flight.signal(Signal::INT);
    for watcher in crowd {
        let ended = watcher.end().expect(0);
        assert!(
            ended
                .stdout
                .lines()
                .last()
                .unwrap()
                .ends_with("interrupted"),
            "{ended}"
        );
    }
    flight.end().expect(130);
    let report = rig.report();
    assert_eq!(
        report["recorder"]["unwritten"],
        Value::Object(serde_json::Map::new())
    );
    assert_eq!(report["verdict"]["status"], "INTERRUPTED");
    // A subscriber that joined a loop's own topic would cost its sender dozens of allocations each time.
    for role in ["plant", "outer", "inner", "mixer"] {
        let loops = &report["roles"][role];
        let ticks = loops["ticks_run"].as_u64().unwrap();
        let allocations = loops["usage"]["allocations"].as_u64();
        assert_eq!(allocations.is_some(), cfg!(feature = "instrumented"));
        let Some(allocations) = allocations else {
            lacks_feature("allocations of loops that are watched", "instrumented");
            break;
        };
        assert!(
            ticks > 0 && allocations <= ticks + 5,
            "{role}: {allocations} allocations in {ticks} ticks"
        );
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
        assert!(
            line.starts_with("tick ")
                && line.contains(" m   loop p50 ")
                && line.contains("rad^2/s^2"),
            "{ended}"
        );
    }
    // The plant skips the last tick, too, where it is late by then.
    let log = read_log(&rig.out().join("latest/flight.mcap")).0;
    let states = log
        .iter()
        .filter(|entry| matches!(entry, LogEntry::State(_)));
    let last_tick = states.map(|entry| entry.envelope().tick).max().unwrap();
    assert!(
        lines
            .last()
            .unwrap()
            .starts_with(&format!("tick {last_tick}   3.0 s")),
        "{ended}"
    );
    assert!(lines.last().unwrap().ends_with("completed"), "{ended}");
    rig.assert_nothing_left();
}

#[test]
fn a_signal_ends_plain_text() {
    let rig = Rig::new("told");
    let watcher = rig.start("watch", "--plain");
    watcher.await_words("waiting");
    watcher.signal(Signal::INT);
    watcher.end().expect(130);
    rig.assert_nothing_started();
    rig.refused("watch --instance Left")
        .complains("instance name `Left` is not allowed");
}

#[test]
fn a_flight_that_is_not_in_a_terminal_is_watched_as_text() {
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
    let fly = format!(
        "{IRONBIRD} fly --watch --rt off --duration 6s --instance {} --out {}; echo ended with $?; stty -a | grep -o ' icanon'",
        rig.instance,
        rig.out().display()
    );
    let Some(screen) = Screen::open(&rig, (200, 60), &fly) else {
        return;
    };
    screen.await_words("position error, last");
    screen.type_keys(&["q"]);
    // The launcher has its terminal back, with its own line.
    let line = screen.await_words(" of 6.0 s   missed");
    assert!(!line.contains("position error, last"), "{line}");
    let ended = screen.await_words("ended with");
    assert!(
        ended.contains("RESULT status=") && screen.await_words(" icanon").contains("ended with"),
        "{ended}"
    );
    rig.assert_nothing_left();
}

#[test]
fn ctrl_c_in_the_dashboard_of_fly_ends_the_flight() {
    let rig = Rig::new("flyend");
    let fly = format!(
        "{IRONBIRD} fly --watch --rt off --duration 600s --instance {} --out {}; echo ended with $?",
        rig.instance,
        rig.out().display()
    );
    let Some(screen) = Screen::open(&rig, (200, 60), &fly) else {
        return;
    };
    screen.await_words("position error, last");
    let roles = rig.processes_of("plant");
    screen.type_keys(&["C-c"]);
    let ended = screen.await_words("ended with");
    assert!(
        ended.contains("RESULT status=INTERRUPTED") && ended.contains("ended with 130"),
        "{ended}"
    );
    assert!(screen.is_restored());
    assert!(!roles.is_empty() && roles.into_iter().all(is_gone));
    rig.assert_nothing_left();
}

#[test]
fn a_launcher_that_dies_takes_its_dashboard_along() {
    let rig = Rig::new("flykill");
    let fly = format!(
        "{IRONBIRD} fly --watch --rt off --instance {} --out {}; echo ended",
        rig.instance,
        rig.out().display()
    );
    let Some(screen) = Screen::open(&rig, (100, 30), &fly) else {
        return;
    };
    screen.await_words("position error, last");
    let launcher = rig.processes_of("fly");
    assert_eq!(launcher.len(), 1, "{launcher:?}");
    let watchers = rig.processes_of("watch");
    send(launcher[0], Signal::KILL);
    wait_until("the dashboard to end", || {
        watchers.iter().all(|pid| is_gone(*pid)).then_some(())
    });
    wait_until("the terminal to be restored", || {
        screen.is_restored().then_some(())
    });
    let roles = ["plant", "outer", "inner", "mixer", "record"];
    wait_until("the roles to end", || {
        roles
            .iter()
            .all(|role| rig.processes_of(role).is_empty())
            .then_some(())
    });
    rig.ok("clean");
    rig.assert_nothing_left();
}

#[test]
fn without_its_recorder_a_flight_is_told_as_of_when_it_was_seen_last() {
    let rig = Rig::new("unrecorded");
    let config = rig.slow(10);
    let args = format!("--rt off --config {} --duration 1h", config);
    let roles = ["record", "plant", "outer", "inner", "mixer"].map(|role| rig.start(role, &args));
    rig.await_flight();
    let watch = rig.start("watch", "--plain");
    wait_until("the theorem in a line", || {
        watch.stdout().contains("   violations ").then_some(())
    });
    assert!(
        !watch.stdout().contains("no recorder"),
        "{}",
        watch.stdout()
    );
    let [recorder, plant, ..] = &roles;
    recorder.signal(Signal::KILL);
    wait_until("a line of the loss", || {
        let told = watch.stdout();
        let last = told.lines().last().unwrap_or_default();
        let tick = last
            .strip_prefix("tick ")
            .and_then(|rest| rest.split(' ').next())
            .unwrap_or_default()
            .to_owned();
        last.contains(&format!(
            "   no recorder: as of tick {tick}, not watched since"
        ))
        .then_some(())
    });
    plant.signal(Signal::INT);
    watch
        .end()
        .expect(0)
        .says("not watched since   interrupted\n");
    roles.into_iter().for_each(|role| drop(role.end()));
    rig.run("clean", "");
}

#[test]
fn a_trajectory_file_that_has_changed_ends_a_watch_with_what_to_do() {
    let rig = Rig::new("moved-points");
    let file = rig.file("climb.csv");
    let points = "t,x,y,z,yaw\n0,0,0,0,0\n5,0.5,0,0.5,0\n";
    fs::write(&file, points).unwrap();
    let flight = rig.take_off(format!(
        "--rt off --config {} --duration 1h --trajectory {file}",
        rig.slow(10)
    ));
    fs::write(&file, points.replace("0.5,0,0.5", "0.6,0,0.5")).unwrap();
    let changed = rig.run("watch", "--plain").expect(1);
    changed
        .complains("climb.csv has changed since the flight began")
        .complains("help: restore the file with SHA-256 ")
        .complains("and start watch again; the flight itself continues");
    fs::remove_file(&file).unwrap();
    let gone = rig.run("watch", "--plain").expect(1);
    gone.complains("the trajectory of the flight cannot be shown: ")
        .complains("help: restore the file with SHA-256");
    flight.signal(Signal::INT);
    flight.end().expect(130);
}
