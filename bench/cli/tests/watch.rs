//! `ironbird watch` in a terminal, which is a tmux server of the test. `transcripts/watch.md` has its plain text.

use crate::rig::{Rig, ironbird, is_gone, lacks_tool, wait_until};
use rustix::process::Signal;
use std::process::Command;

struct Screen {
    tmux: String,
    socket: String,
}

impl Screen {
    /// `ironbird COMMAND` in a shell that prints its exit code, and whether the terminal is in its normal mode; none if
    /// there is no tmux.
    fn open(rig: &Rig, (width, height): (u16, u16), command: &str) -> Option<Self> {
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
            socket: rig.file("tmux"),
        };
        // The shell stays, so that the test can read what the script left on the screen.
        let script = format!(
            "export IRONBIRD_ROOT='{}'; echo before; {} {command} --instance {}; echo ended with $?; \
             stty -a | grep -o ' icanon'; echo shell is back; exec sleep 600",
            rig.root().display(),
            ironbird(),
            rig.instance
        );
        let session = format!("-f /dev/null new-session -d -x {width} -y {height}");
        let args: Vec<&str> = session.split(' ').chain([script.as_str()]).collect();
        screen.tmux(&args);
        Some(screen)
    }

    fn tmux(&self, args: &[&str]) -> String {
        let mut command = Command::new(&self.tmux);
        command.args(["-S", &self.socket]).args(args);
        let output = command.env_remove("TMUX").output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Types keys, separated by blanks.
    fn press(&self, keys: &str) {
        let keys: Vec<&str> = keys.split(' ').collect();
        self.tmux(&[&["send-keys"], &keys[..]].concat());
    }

    /// Waits until words are on the screen; returns it.
    #[track_caller]
    fn await_words(&self, words: &str) -> String {
        wait_until(&format!("`{words}` on the screen"), || {
            Some(self.tmux(&["capture-pane", "-p"])).filter(|text| text.contains(words))
        })
    }

    /// Whether the terminal shows its cursor and its normal screen.
    fn is_restored(&self) -> bool {
        self.tmux(&["display-message", "-p", "#{cursor_flag} #{alternate_on}"]) == "1 0\n"
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let mut command = Command::new(&self.tmux);
        let _ = command.args(["-S", &self.socket, "kill-server"]).output();
    }
}

/// It waits for a flight; every page by its key, a change of a parameter, a reset; and the flight continues.
#[test]
fn pages_and_parameters_work_in_a_terminal_and_leaving_lets_the_flight_continue() {
    let rig = Rig::new("pages");
    let Some(screen) = Screen::open(&rig, (120, 40), "watch") else {
        return;
    };
    screen.await_words(&format!("ironbird fly --instance {}", rig.instance));
    assert!(!rig.root().exists(), "waiting creates nothing");
    let flight = rig.take_off("--rt off --duration 600s");
    screen.await_words("flying");
    for row in "1: position error, last
        2: loop [us], counts
        Tab: I_R kg m^2
        5: memory_lock
        6: inner adaptive
        ?: leave; it flies on
        x 4 Down Down Down Enter 0 . 5 2 5 Enter: rotational_drag_nm_s 0.105 -> 0.525 N m s
        Enter 7 Enter: rotational_drag_nm_s = 7 is out of range: allowed are 0.0 to 1.0"
        .lines()
    {
        let (keys, words) = row.trim().split_once(": ").unwrap();
        screen.press(keys);
        let shown = screen.await_words(words);
        let is_wide = |line: &str| line.chars().count() > 120;
        assert!(!shown.lines().any(is_wide), "{shown}");
    }
    let params = rig.run("params", "--json").json();
    let mut rows = params.as_array().unwrap().iter();
    let drag = rows.find(|row| row["name"] == "rotational_drag_nm_s");
    assert_eq!(drag.unwrap()["in_force"], 0.525);
    screen.press("Escape");
    // Together, the two keys would be another one.
    screen.await_words("? help");
    screen.press("2");
    let count = || -> u64 {
        let shown = screen.await_words("wake.plant");
        let (_, row) = shown.split_once("wake.plant").unwrap();
        let row = row.lines().next().unwrap();
        let count = row.split_whitespace().last().unwrap();
        count.parse().unwrap_or(0)
    };
    let long = wait_until("a second of statistics", || {
        Some(count()).filter(|n| *n > 1000)
    });
    screen.press("r");
    wait_until("statistics to restart", || (count() < long).then_some(()));
    screen.press("q");
    let left = screen.await_words("shell is back");
    let restored = "before\nended with 0\n icanon\nshell is back";
    assert!(left.contains(restored) && screen.is_restored(), "{left}");
    // The plant still answers.
    rig.ok("inject gravity_m_s2=9.8");
    flight.interrupt().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn ctrl_c_in_the_dashboard_of_fly_and_a_killed_supervisor_end_the_flight() {
    for ends_by_key in [true, false] {
        let rig = Rig::new("flyend");
        let out = rig.out();
        let fly = format!(
            "fly --watch --rt off --duration 600s --out {}",
            out.display()
        );
        let Some(screen) = Screen::open(&rig, (200, 60), &fly) else {
            return;
        };
        screen.await_words("position error, last");
        let plant = rig.processes_of("plant");
        match ends_by_key {
            true => screen.press("C-c"),
            false => crate::rig::send(rig.processes_of("fly")[0], Signal::KILL),
        }
        // What the shell prints after a killed supervisor is lost when the dashboard restores the screen.
        let ended = ends_by_key.then(|| screen.await_words("shell is back"));
        wait_until("all to end", || {
            let roles = ["watch", "plant", "outer", "inner", "mixer", "record"];
            let mut left = roles.iter().flat_map(|role| rig.processes_of(role));
            (left.next().is_none() && screen.is_restored()).then_some(())
        });
        assert!(!plant.is_empty() && plant.into_iter().all(is_gone));
        if let Some(ended) = ended {
            assert!(ended.contains("RESULT status=INTERRUPTED"), "{ended}");
            assert!(ended.contains("ended with 130"), "{ended}");
        } else {
            rig.ok("clean");
        }
        rig.assert_nothing_left();
    }
}
