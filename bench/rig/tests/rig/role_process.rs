//! A process that a test has started: while it runs, and when it has ended.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::Instant;

use rustix::process::Signal;
use serde_json::Value;

use super::system::{LOOK_EVERY, PATIENCE, children, command_line, send, wait_until};

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

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// What it has said on standard error so far.
    pub fn stderr(&self) -> String {
        fs::read_to_string(&self.stderr).unwrap()
    }

    /// Waits until it says something on standard error.
    pub fn await_words(&self, words: &str) {
        wait_until(&format!("{} to say `{words}`", self.what), || {
            self.stderr().contains(words).then_some(())
        });
    }

    /// What it has said on standard output so far.
    pub fn stdout(&self) -> String {
        fs::read_to_string(&self.stdout).unwrap()
    }

    /// Waits until it says something on standard output.
    pub fn await_output(&self, words: &str) {
        wait_until(&format!("{} to print `{words}`", self.what), || {
            self.stdout().contains(words).then_some(())
        });
    }

    pub fn end(mut self) -> Ended {
        let until = Instant::now() + PATIENCE;
        let code = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status.code();
            }
            assert!(
                Instant::now() < until,
                "{} does not end; {}; it said:\n{}",
                self.what,
                self.place(),
                self.stderr()
            );
            sleep(LOOK_EVERY);
        };
        let stdout = fs::read_to_string(&self.stdout).unwrap();
        Ended {
            what: self.what.clone(),
            code,
            stdout,
            stderr: self.stderr(),
        }
    }

    /// Where the threads of a process are that does not go on, as far as the system tells.
    fn place(&self) -> String {
        let of = |file: &str| {
            fs::read_to_string(format!("/proc/{}/{file}", self.pid())).unwrap_or_default()
        };
        let status = of("status");
        let state = status
            .lines()
            .find(|line| line.starts_with("State:"))
            .unwrap_or_default();
        let args = [
            "-p",
            &self.pid().to_string(),
            "-batch",
            "-ex",
            "thread apply all bt 20",
        ];
        let stack = Command::new("gdb")
            .args(args)
            .output()
            .map(|gdb| String::from_utf8_lossy(&gdb.stdout).into_owned());
        format!(
            "{state}, waits in {}, system call {}\n{}",
            of("wchan"),
            of("syscall"),
            stack.unwrap_or_default()
        )
    }

    /// The five roles that a launcher has started: process numbers by name.
    pub fn roles(&self) -> BTreeMap<String, u32> {
        wait_until("the launcher to start five roles", || {
            let roles: BTreeMap<_, _> = children(self.pid())
                .into_iter()
                .filter_map(|pid| Some((command_line(pid).get(1)?.clone(), pid)))
                .filter(|(role, _)| role != "fly")
                .collect();
            (roles.len() == 5).then_some(roles)
        })
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
        assert!(
            squeezed(&self.stderr).contains(&squeezed(words)),
            "no `{words}` on standard error of {self}"
        );
        let help = self
            .stderr
            .lines()
            .find(|line| line.trim_start().starts_with("help: ") && line.trim().contains("  "));
        assert_eq!(help, None, "a run of blanks in {self}");
        self
    }

    /// Demands words on standard output, however the lines were broken.
    pub fn tells(self, words: &str) -> Self {
        assert!(
            squeezed(&self.stdout).contains(&squeezed(words)),
            "no `{words}` on standard output of {self}"
        );
        self
    }

    pub fn says(self, words: &str) -> Self {
        assert!(
            self.stdout.contains(words),
            "no `{words}` on standard output of {self}"
        );
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
        write!(
            f,
            "{}\n--- stdout\n{}\n--- stderr\n{}",
            self.what, self.stdout, self.stderr
        )
    }
}

/// Messages are broken into lines at the terminal's width: compare without blanks and margin.
fn squeezed(text: &str) -> String {
    text.chars()
        .filter(|c| !c.is_whitespace() && *c != '│')
        .collect()
}
