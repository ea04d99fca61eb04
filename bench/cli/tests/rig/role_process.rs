//! A process that a test has started: while it runs, and when it has ended.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::Child;
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;

use super::system::{LOOK_EVERY, PATIENCE, send, wait_until};

/// A process that the test has started, and kills if it still runs at the end.
pub struct Running {
    pub(super) what: String,
    pub(super) child: Child,
    pub(super) stdout: PathBuf,
    pub(super) stderr: PathBuf,
}

impl Running {
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, signal: Signal) {
        send(self.pid(), signal);
    }

    pub fn stderr(&self) -> String {
        fs::read_to_string(&self.stderr).unwrap()
    }

    /// On standard output or standard error.
    pub fn await_words(&self, words: &str) {
        wait_until(&format!("{} to say `{words}`", self.what), || {
            let said = [self.stdout(), self.stderr()];
            said.iter().any(|it| it.contains(words)).then_some(())
        });
    }

    pub fn stdout(&self) -> String {
        fs::read_to_string(&self.stdout).unwrap()
    }

    pub fn end(mut self) -> Ended {
        let until = Instant::now() + PATIENCE;
        // Many commands end within a few milliseconds.
        let mut pause = Duration::from_millis(1);
        let code = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status.code();
            }
            let status = fs::read_to_string(format!("/proc/{}/status", self.pid()));
            assert!(
                Instant::now() < until,
                "{} does not end; it said:\n{}\n{}",
                self.what,
                self.stderr(),
                status.unwrap_or_default()
            );
            sleep(pause);
            pause = (2 * pause).min(LOOK_EVERY);
        };
        let stdout = fs::read_to_string(&self.stdout).unwrap();
        Ended {
            what: self.what.clone(),
            code,
            stdout,
            stderr: self.stderr(),
        }
    }

    pub fn interrupt(self) -> Ended {
        self.signal(Signal::INT);
        self.end()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[derive(Debug)]
pub struct Ended {
    pub what: String,
    /// Exit code; none when a signal ended it.
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Ended {
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "exit code of {self}");
        self
    }

    /// Demands words on standard error, however the lines were broken.
    pub fn complains(self, words: &str) -> Self {
        let is_there = squeezed(&self.stderr).contains(&squeezed(words));
        assert!(is_there, "no `{words}` on standard error of {self}");
        let is_help = |line: &str| line.trim_start().starts_with("help: ");
        let mut help = self.stderr.lines().filter(|line| is_help(line));
        let has_blanks = help.any(|line| line.trim().contains("  "));
        assert!(!has_blanks, "a run of blanks in {self}");
        self
    }

    /// Demands words on standard output, however the lines were broken.
    pub fn tells(self, words: &str) -> Self {
        let is_there = squeezed(&self.stdout).contains(&squeezed(words));
        assert!(is_there, "no `{words}` on standard output of {self}");
        self
    }

    pub fn says(self, words: &str) -> Self {
        let is_there = self.stdout.contains(words);
        assert!(is_there, "no `{words}` on standard output of {self}");
        self
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {self}"))
    }

    /// The last line, which must be that of the result, as its `key=value` pairs.
    pub fn result(&self) -> BTreeMap<String, String> {
        let line = self.stdout.lines().last().unwrap_or_default();
        let pairs = line
            .strip_prefix("RESULT ")
            .unwrap_or_else(|| panic!("the last line is no result: {self}"));
        pairs
            .split(' ')
            .filter_map(|pair| pair.split_once('='))
            .map(|(k, v)| (k.into(), v.into()))
            .collect()
    }
}

impl std::fmt::Display for Ended {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (what, stdout, stderr) = (&self.what, &self.stdout, &self.stderr);
        write!(f, "{what}\n--- stdout\n{stdout}\n--- stderr\n{stderr}")
    }
}

/// Messages are broken into lines at the terminal's width: compare without blanks and margin.
/// A text without blanks, line breaks and borders.
pub fn squeezed(text: &str) -> String {
    text.chars()
        .filter(|c| !c.is_whitespace() && *c != '│')
        .collect()
}
