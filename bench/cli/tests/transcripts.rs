//! Transcripts: what commands and flights print, as the pages in `transcripts/` show it.
//!
//! README.md of this directory describes the steps. `IRONBIRD_SCENARIOS=clean,export` chooses scenarios by the beginning of their titles.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crate::c_laws::{library, root};
use crate::python::python_with;
use crate::rig::unprivileged::unprivileged;
use crate::rig::{
    BUILT_WITH_TESTS, Ended, Rig, Running, SKY, can_mount, in_parallel, lacks_feature, lacks_tool,
    not_tested, rounds, send, signal_of, squeezed, stop_for, wait_until,
};
use process::rt::fifo_refusal;
use rustix::process::geteuid;
use serde_json::Value;

struct Scenario<'a> {
    title: String,
    text: &'a str,
    /// Cells of its row, by their columns.
    values: BTreeMap<&'a str, &'a str>,
}

fn page(name: &str) -> String {
    let path = format!("{}/tests/transcripts/{name}.md", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(path).unwrap()
}

/// The scenarios of a page. Where it has a table with a column `outcome`, each row plays the scenario that it names; those
/// after the first of an outcome are long.
fn scenarios(page: &str) -> Vec<Scenario<'_>> {
    fn cells(line: &str) -> Vec<&str> {
        line.split(" |").map(str::trim).collect()
    }
    let sections = page.split("\n## ").skip(1);
    let sections = sections.map(|text| text.split_once('\n').unwrap());
    let mut lines = page.lines().filter_map(|line| line.strip_prefix("| "));
    let columns = lines.next().map(cells).unwrap_or_default();
    if !columns.contains(&"outcome") {
        let scenario = |(title, text): (&str, _)| Scenario {
            title: title.into(),
            text,
            values: BTreeMap::new(),
        };
        return sections.map(scenario).collect();
    }
    let sections: BTreeMap<&str, &str> = sections.collect();
    let mut seen = BTreeSet::new();
    let scenario = |line| {
        let values: BTreeMap<_, _> = columns.iter().copied().zip(cells(line)).collect();
        let long = match seen.insert(values["outcome"]) {
            true => "",
            false => " (long)",
        };
        Scenario {
            title: format!("{}{long}", values["row"]),
            text: sections[values["outcome"]],
            values,
        }
    };
    lines.map(scenario).collect()
}

/// Plays the scenarios of a page, those whose title ends with `(long)` or the others.
fn play(page: &str, long: bool) {
    let page = self::page(page);
    let chosen = std::env::var("IRONBIRD_SCENARIOS").unwrap_or_default();
    let is_chosen = |it: &Scenario| {
        let begins = |begin| it.title.starts_with(begin);
        it.title.ends_with("(long)") == long && chosen.split(',').any(begins)
    };
    in_parallel(scenarios(&page).into_iter().filter(is_chosen), |it| {
        it.play(0);
    });
}

/// Plays the rows of the drill that `IRONBIRD_SCENARIOS` names, each `IRONBIRD_ROUNDS` times.
#[test]
#[ignore = "bench/drill/run plays it"]
fn drill() {
    let pages = ["drill", "fault_matrix"].map(page);
    let chosen = std::env::var("IRONBIRD_SCENARIOS").unwrap_or_default();
    let names: Vec<&str> = chosen.split(',').collect();
    for scenario in pages.iter().flat_map(|it| scenarios(it)) {
        let name = scenario.title.split(' ').next().unwrap();
        if names.contains(&name) {
            for round in 0..rounds() {
                if scenario.play(round) {
                    println!("TRIAL {name} {{}}");
                }
            }
        }
    }
}

macro_rules! pages {
    ($($page:ident)*) => {
        $(#[test]
        fn $page() {
            play(stringify!($page), false);
        })*

        /// The long scenarios of each page.
        mod long {
            $(#[test]
            #[ignore = "long: part of the gate"]
            fn $page() {
                super::play(stringify!($page), true);
            })*
        }
    };
}

pages! { airframes campaigns causes channels directories engines export fault_matrix flights gates ground_station harms laws law_files machines processes reports runs studies watch }

struct Stage {
    rig: Rig,
    values: BTreeMap<String, String>,
    /// Processes in the background, by their command.
    running: BTreeMap<String, Running>,
    ended: Option<Ended>,
    /// No step has checked its exit code yet.
    is_open: bool,
    /// This user may not do what a step needs.
    is_refused: bool,
}

impl Scenario<'_> {
    fn needs(&self, name: &str) -> bool {
        self.title.contains(&format!("({name})"))
    }

    /// Whether this machine and this user can play it. Says why not.
    fn can_play(&self) -> bool {
        if self.needs("fifo") && fifo_refusal(80).is_some() {
            not_tested(&format!("{}: SCHED_FIFO is refused", self.title));
            return false;
        }
        let mounts = [
            ("mounts", "mount -t tmpfs tmpfs /mnt", "true"),
            (
                "tracefs",
                "mount -t tracefs nodev /sys/kernel/tracing",
                "mkdir /sys/kernel/tracing/instances/t$$ && rmdir /sys/kernel/tracing/instances/t$$",
            ),
            (
                "unprivileged",
                "true",
                "setpriv --reuid=65534 --regid=65534 --clear-groups true",
            ),
        ];
        let mut mounts = mounts.into_iter().filter(|it| self.needs(it.0));
        if mounts.any(|(_, mount, probe)| !can_mount(mount, probe)) {
            return false;
        }
        let features = [
            ("foxglove", cfg!(feature = "foxglove")),
            ("instrumented", cfg!(feature = "instrumented")),
        ];
        if let Some((name, _)) = features.iter().find(|it| self.needs(it.0) && !it.1) {
            lacks_feature(&self.title, name);
            return false;
        }
        let exists = |path| Path::new(path).exists();
        let programs = [
            ("strace", exists("/usr/bin/strace")),
            ("stress-ng", exists("/usr/bin/stress-ng")),
            ("nm", exists("/usr/bin/nm")),
            (
                "slurm",
                exists("/usr/sbin/slurmctld") && geteuid().is_root(),
            ),
            ("tmux", exists("/usr/bin/tmux")),
        ];
        if let Some((program, _)) = programs.iter().find(|it| self.needs(it.0) && !it.1) {
            lacks_tool(&format!("{}: there is no {program}", self.title));
            return false;
        }
        true
    }

    /// A rig with the scenario's files.
    fn stage(&self, round: u64) -> Stage {
        let rig = match () {
            () if self.needs("foxglove") || self.needs("instrumented") => {
                Rig::with_features("page")
            }
            // A mount over /dev/shm must not hide the rig.
            () if self.needs("mounts") => Rig::below("/tmp", "page"),
            () => Rig::new("page"),
        };
        let sky = format!("{SKY}trajectory = \"hover\"\n");
        std::fs::write(rig.path("sky.toml"), sky).unwrap();
        for fence in self.text.split("\n```").skip(1).step_by(2) {
            let (head, text) = fence.split_once('\n').unwrap();
            let (_, name) = head.split_once(' ').unwrap();
            std::fs::write(rig.path(name), format!("{text}\n")).unwrap();
        }
        // No two rounds alike, and each the same whenever it is played.
        let random = (round + 1).wrapping_mul(2_654_435_761) % 1000;
        let values = [
            ("dir", rig.file("")),
            ("out", rig.out().display().to_string()),
            ("latest", rig.out().join("latest").display().to_string()),
            ("instance", rig.instance.clone()),
            ("repository", root().display().to_string()),
            ("ironbird", rig.executable().to_owned()),
            ("built", BUILT_WITH_TESTS.to_owned()),
            ("round", round.to_string()),
            ("random", format!("{random:03}")),
        ];
        let cells = self
            .values
            .iter()
            .map(|(name, cell)| (*name, (*cell).to_owned()));
        Stage {
            values: values
                .into_iter()
                .chain(cells)
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
            rig,
            running: BTreeMap::new(),
            ended: None,
            is_open: false,
            is_refused: false,
        }
    }

    /// Returns whether this machine and this user could play it.
    fn play(&self, round: u64) -> bool {
        if !self.can_play() {
            return false;
        }
        let mut stage = self.stage(round);
        let outside = self.text.split("\n```").step_by(2);
        let steps = outside.flat_map(|text| text.lines().filter_map(|it| it.strip_prefix("    ")));
        for step in steps.chain(["close"]) {
            if stage.is_refused {
                return false;
            }
            let played = catch_unwind(AssertUnwindSafe(|| stage.step(step)));
            if let Err(panic) = played {
                // The harness shows what a test that fails has printed.
                println!("FAILED: {}: {step}", self.title);
                resume_unwind(panic);
            }
        }
        true
    }
}

impl Stage {
    fn step(&mut self, step: &str) {
        let mut step = step.to_owned();
        for (name, value) in &self.values {
            step = step.replace(&format!("{{{name}}}"), value);
        }
        let (verb, rest) = step.split_once(' ').unwrap_or((&step, ""));
        let rest = rest.trim_end();
        let is_known = self.runs(verb, rest) || self.checks(verb, rest) || self.acts(verb, rest);
        assert!(is_known, "no step {step}");
    }

    /// Steps that start or end a command; false for others.
    fn runs(&mut self, verb: &str, rest: &str) -> bool {
        let mut verbs = "$ & unprivileged sh python bg end close".split(' ');
        if !verbs.any(|it| it == verb) {
            return false;
        }
        self.close();
        let (name, last) = rest.split_once(' ').unwrap_or((rest, ""));
        match verb {
            "$" => {
                let process = self.start(rest);
                self.end(process);
            }
            "&" => {
                let process = self.start(rest);
                let command = rest.split(' ').find(|word| !word.contains('='));
                self.running.insert(command.unwrap().to_owned(), process);
            }
            "unprivileged" => match unprivileged(&self.rig, name, last) {
                Some(command) => self.end(self.rig.launch(command)),
                None => self.is_refused = true,
            },
            "sh" => {
                let process = self.shell(rest);
                self.end(process);
            }
            "python" => {
                let (packages, script) = rest.split_once(": ").unwrap();
                match python_with(packages, &format!("not run: {script}")) {
                    Some(python) => self.end(self.shell(&format!("{python} {script}"))),
                    None => self.is_refused = true,
                }
            }
            "bg" => {
                let process = self.shell(last);
                self.running.insert(name.to_owned(), process);
            }
            "end" => {
                let process = self.running.remove(name).unwrap();
                self.end(process);
            }
            _ => {
                assert!(
                    self.running.is_empty(),
                    "a process in the background has no `end`"
                );
                self.rig.assert_nothing_left();
            }
        }
        true
    }

    /// Steps that check what the last command has printed or written; false for others.
    fn checks(&mut self, verb: &str, rest: &str) -> bool {
        match verb {
            "?" => {
                let ended = self.ended();
                // `-` is the end by a signal.
                let code = |text| (text != "-").then(|| str::parse(text).unwrap());
                let mut codes = rest.split(' ').map(code);
                assert!(codes.any(|code| code == ended.code), "{ended}");
                self.is_open = false;
            }
            ">" | "!" => {
                let ended = self.ended.take().expect("a command before this step");
                self.ended = Some(match verb {
                    ">" => ended.tells(rest),
                    _ => ended.complains(rest),
                });
            }
            "not>" | "not!" => {
                let ended = self.ended();
                let text = match verb {
                    "not>" => &ended.stdout,
                    _ => &ended.stderr,
                };
                assert!(
                    !squeezed(text).contains(&squeezed(rest)),
                    "{rest} in {ended}"
                );
            }
            "result" => {
                let (key, value) = rest.split_once(" = ").unwrap();
                assert_eq!(self.ended().result()[key], value, "{}", self.ended());
            }
            "report" => compare(&self.rig.report(), rest),
            "json" => compare(&self.ended().json(), rest),
            "has" | "lacks" => {
                let (file, words) = rest.split_once(": ").unwrap();
                let text = std::fs::read(self.rig.path(&file.replace("latest/", "out/latest/")));
                let text = String::from_utf8_lossy(&text.unwrap()).into_owned();
                assert_eq!(
                    text.contains(words),
                    verb == "has",
                    "{words} in {file}:\n{text}"
                );
            }
            "brief" => assert_brief(&self.rig, self.ended()),
            "replays" => self.rig.assert_replayed(),
            "nothing" => self.rig.assert_nothing_started(),
            _ => return false,
        }
        true
    }

    /// Steps that wait for a state, act on processes, or prepare what later steps use; false for others.
    fn acts(&mut self, verb: &str, rest: &str) -> bool {
        let (name, last) = rest.split_once(' ').unwrap_or((rest, ""));
        match verb {
            "let" => {
                let value = match last.trim_start_matches("= ").split_once(' ') {
                    Some(("result", key)) => self.ended().result()[key].clone(),
                    Some(("report", path)) => text(at(&self.rig.report(), path)),
                    Some(("json", path)) => text(at(&self.ended().json(), path)),
                    _ if last == "= run" => self.rig.run_directories().pop().unwrap(),
                    _ if last == "= stdout" => self.ended().stdout.trim().to_owned(),
                    other => panic!("no value {other:?}"),
                };
                self.values.insert(name.to_owned(), value);
            }
            "law" => {
                let mut words = last.split(' ');
                let source = words.next().unwrap();
                drop(library(&self.rig, name, source, &words.collect::<Vec<_>>()));
            }
            "unless-stalled" => {
                if !self.rig.has_stalled() {
                    self.step(rest);
                }
            }
            "flies" => self.rig.await_flight(),
            "tick" => drop(self.rig.await_tick(rest.parse().unwrap())),
            "reported" => self.rig.await_report(),
            "await" => self.running[name].await_words(last),
            "stop" => {
                let time = Duration::from_millis(last.parse().unwrap());
                stop_for(self.rig.processes_of(name)[0], time);
            }
            "signal" => {
                let pid = match self.running.get(name) {
                    Some(process) => process.pid(),
                    None => self.rig.processes_of(name)[0],
                };
                send(pid, signal_of(last));
            }
            "kill" => self.rig.kill_all(),
            "present" => {
                let look = || self.rig.processes_of(rest).first().copied();
                wait_until(&format!("a process of {rest}"), look);
            }
            // Without a command: all processes of the instance, and their locks.
            "gone" if rest.is_empty() => wait_until("the end of all processes", || {
                (self.rig.living().is_empty() && !self.rig.known().is_alive()).then_some(())
            }),
            "gone" => wait_until(&format!("the end of {rest}"), || {
                let mut commands = rest.split_whitespace();
                commands
                    .all(|it| self.rig.processes_of(it).is_empty())
                    .then_some(())
            }),
            // A fault that the flags have planned.
            "-" | "planned" => {}
            _ => return false,
        }
        true
    }

    /// A command line, with variables of its environment before it.
    fn start(&self, line: &str) -> Running {
        let is_variable = |word: &&str| word.contains('=') && !word.starts_with('-');
        let variables: Vec<&str> = line.split(' ').take_while(is_variable).collect();
        let mut words = line.split(' ').skip(variables.len());
        let command = words.next().unwrap();
        let mut process = self
            .rig
            .command(command, words.collect::<Vec<_>>().join(" "));
        process.envs(variables.iter().filter_map(|it| it.split_once('=')));
        self.rig.launch(process)
    }

    fn shell(&self, script: &str) -> Running {
        let mut shell = Command::new("sh");
        shell
            .args(["-ec", script])
            .env("IRONBIRD_ROOT", self.rig.root());
        self.rig.launch(shell)
    }

    fn end(&mut self, process: Running) {
        self.ended = Some(process.end());
        self.is_open = true;
    }

    fn ended(&self) -> &Ended {
        self.ended.as_ref().expect("a command before this step")
    }

    /// A command whose exit code no step names must have succeeded.
    fn close(&mut self) {
        if std::mem::take(&mut self.is_open) {
            assert_eq!(self.ended().code, Some(0), "{}", self.ended());
        }
    }
}

/// Asserts the format of a flight's summary, and that `ironbird report` prints the same.
pub(crate) fn assert_brief(rig: &Rig, ended: &Ended) {
    let lines: Vec<&str> = ended.stdout.lines().collect();
    let (result, text) = lines.split_last().unwrap();
    assert!(result.starts_with("RESULT status="), "{ended}");
    let is_brief = |text: &[&str]| text.iter().all(|line| line.chars().count() <= 80);
    assert!(lines.len() <= 30 && is_brief(text), "{ended}");
    let count = |begin: &str| text.iter().filter(|it| it.starts_with(begin)).count();
    for head in ["Gates ", "Flown ", "Latencies [us] ", "More "] {
        assert_eq!(count(head), 1, "`{head}` in {ended}");
    }
    for head in ["Flight", "Timing", "Theorem"] {
        let verdict = ended.result()[&head.to_lowercase()].replace('-', " ");
        let line = format!("{head:<9} {}: ", verdict.to_uppercase());
        assert_eq!(
            (count(&line), count(&format!("{head} "))),
            (1, 1),
            "{ended}"
        );
    }
    assert_eq!(rig.ok("report").stdout, text.join("\n") + "\n");
}

/// The value at a path: keys, numbers of elements, and `key=value` for the element that has this value. Null if the last
/// part is not there; all others must be.
fn at<'a>(value: &'a Value, path: &str) -> &'a Value {
    path.split('/').fold(value, |value, part| {
        let is_container = value.is_array() || value.is_object();
        assert!(is_container, "{path}: there is nothing before `{part}`");
        let found = match (value, part.split_once('=')) {
            (Value::Array(all), Some((key, name))) => all.iter().find(|it| text(&it[key]) == name),
            (Value::Array(all), None) => all.get(part.parse::<usize>().unwrap()),
            _ => value.get(part),
        };
        found.unwrap_or(&Value::Null)
    })
}

fn text(value: &Value) -> String {
    value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_owned)
}

/// `PATH = VALUE`, or `!=`, `>`, `<`.
fn compare(whole: &Value, line: &str) {
    let operators = [" = ", " != ", " > ", " < "];
    let operator = operators
        .into_iter()
        .find(|it| line.contains(it))
        .expect(line);
    let (path, expected) = line.split_once(operator).unwrap();
    let found = at(whole, path);
    let number = |text: &str| text.parse::<f64>().unwrap_or(f64::NAN);
    let (a, b) = (number(&text(found)), number(expected));
    let holds = match operator {
        " = " => text(found) == expected,
        " != " => text(found) != expected && (expected == "null" || !found.is_null()),
        " > " => a > b,
        _ => a < b,
    };
    assert!(holds, "{line}: it is {found} in\n{whole}");
}
