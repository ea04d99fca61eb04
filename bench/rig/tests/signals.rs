//! A process that was started with blocked or ignored signals flies and ends as any other.
//!
//! What blocks them before it becomes `ironbird` is a line of Python; where there is no `python3` this says so.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::process::{Command, Stdio};

use crate::rig::{Rig, lacks_tool};
use rustix::process::Signal;

/// Blocks what a daemon may block, ignores what a shell may ignore, and becomes its arguments.
const DEAF: &str = "
import os, signal, sys
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
signal.signal(signal.SIGINT, signal.SIG_IGN)
blocked = [signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD]
signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
os.execv(sys.argv[1], sys.argv[1:])
";

/// The command, started deaf to signals; none where there is no Python.
fn deaf(command: &Command) -> Option<Command> {
    let is_there = Command::new("python3").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if !is_there.is_ok_and(|status| status.success()) {
        lacks_tool("there is no python3 to block signals");
        return None;
    }
    let mut python = Command::new("python3");
    python.args(["-c", DEAF]).arg(command.get_program()).args(command.get_args());
    python.envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))));
    Some(python)
}

#[test]
fn a_flight_whose_signals_were_blocked_or_ignored_passes_and_ends() {
    let rig = Rig::new("deaf");
    let Some(fly) = deaf(&rig.command("fly", &["--rt", "off", "--duration", "1s"])) else { return };
    let result = rig.launch(fly).end().expect(0).result();
    assert_eq!(result["status"], "PASS", "{result:?}");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_signal_ends_a_flight_that_was_started_with_it_blocked() {
    for signal in [Signal::TERM, Signal::INT] {
        let rig = Rig::new("deaf-end");
        let slow = rig.slow(20);
        let args = ["--rt", "off", "--config", slow.as_str(), "--duration", "60s"];
        let Some(fly) = deaf(&rig.command("fly", &args)) else { return };
        let flight = rig.launch(fly);
        rig.await_flight();
        flight.signal(signal);
        assert_eq!(flight.end().expect(130).result()["status"], "INTERRUPTED");
        rig.assert_nothing_left();
    }
}

#[test]
fn a_mixer_that_was_started_deaf_ends_when_it_is_told_to() {
    let rig = Rig::new("deaf-mixer");
    let Some(mixer) = deaf(&rig.command("mixer", &["--rt", "off"])) else { return };
    let mixer = rig.launch(mixer);
    mixer.await_words("waiting for the plant");
    mixer.signal(Signal::TERM);
    mixer.end().expect(130);
    rig.assert_nothing_left();
}
