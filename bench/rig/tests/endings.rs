//! How flights end: signals, closed terminals, dead supervisors, leftovers, limits; and what processes hold when they end.

use crate::rig::{
    IRONBIRD, Rig, Running, copy_executable, is_gone, lacks_tool, not_tested, send, wait_until,
};
use ipc::Wire;
use messages::blackboards::{RUN, Run, RunPhase};
use process::rt::fifo_refusal;
use rustix::process::Signal;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A long flight in slow motion, in the air; nothing in these tests depends on its deadlines.
fn in_the_air(rig: &Rig) -> Running {
    rig.take_off(format!("--rt off --config {} --duration 60s", rig.slow(20)))
}

fn await_gone(pids: impl IntoIterator<Item = u32>) {
    for pid in pids {
        wait_until(&format!("process {pid} to end"), || {
            is_gone(pid).then_some(())
        });
    }
}

#[test]
fn a_second_signal_ends_at_once_what_the_first_one_cannot() {
    let rig = Rig::new("stubborn");
    let mut flight = in_the_air(&rig);
    // The recorder's first report is there, so that there is something to print.
    rig.await_report();
    let roles = flight.roles();
    send(roles["record"], Signal::STOP);
    flight.signal(Signal::INT);
    await_gone(["plant", "outer", "inner", "mixer"].map(|role| roles[role]));
    assert!(
        flight.is_running(),
        "it waits for the recorder, which is stopped"
    );
    let second = Instant::now();
    flight.signal(Signal::INT);
    let ended = flight.end().expect(130);
    assert!(
        second.elapsed() < Duration::from_secs(4),
        "the launcher's own patience is 5 s: {:?}",
        second.elapsed()
    );
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    let report = rig.report();
    assert_eq!(
        (&report["verdict"]["status"], &report["run"]["in_flight"]),
        (&"INTERRUPTED".into(), &false.into())
    );
    assert!(is_gone(roles["record"]));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_is_over_before_the_recorder_looks_is_reported_whole() {
    let rig = Rig::new("over");
    let flight = rig.start(
        "fly",
        format!("--rt off --config {} --duration 50ms", rig.slow(5)),
    );
    let roles = flight.roles();
    let wire = Wire::open(&rig.known()).unwrap();
    // From then on nobody waits for the recorder, which has armed.
    wait_until("the plant to keep to its t_0", || {
        let board = wire.blackboard_reader::<Run>(RUN).unwrap()?;
        (board.get().phase() == RunPhase::Flying).then_some(())
    });
    send(roles["record"], Signal::STOP);
    await_gone(["plant", "outer", "inner", "mixer"].map(|role| roles[role]));
    drop(wire);
    send(roles["record"], Signal::CONT);
    flight.end().expect(0);
    let report = rig.report();
    for role in ["plant", "outer", "inner", "mixer"] {
        let said = &report["roles"][role];
        assert!(
            said["landed"] == true && said["ticks_run"].as_u64().unwrap() > 0,
            "{role}: {report}"
        );
    }
    assert_eq!(report["ticks"]["identity_holds"], true, "{report}");
    rig.assert_nothing_left();
}

/// Kills a flight with all its processes, none of which can say a last word.
fn kill_all(flight: Running) {
    let roles = flight.roles();
    // A stopped process does not act on its launcher's death.
    roles.values().for_each(|pid| send(*pid, Signal::STOP));
    flight.signal(Signal::KILL);
    flight.end();
    roles.values().for_each(|pid| send(*pid, Signal::KILL));
    await_gone(roles.into_values());
}

#[test]
fn clean_removes_and_names_what_killed_processes_left() {
    let rig = Rig::new("leftovers");
    kill_all(in_the_air(&rig));
    let left = rig.segments();
    assert!(!left.is_empty(), "killed processes cannot clean up");
    let other = Rig::new("bystander");
    let bystander = other.start("plant", "--rt off");
    bystander.await_words("waiting for");
    let directory = rig.root().join(&rig.instance);
    let allow =
        |mode: u32| fs::set_permissions(&directory, fs::Permissions::from_mode(mode)).unwrap();
    allow(0o770);
    let kept = format!(
        "kept the shared memory of instance `{}`: {} is not used",
        rig.instance,
        directory.display()
    );
    rig.ok("clean").says(&kept);
    allow(0o700);
    let mut clean = rig.ok("clean");
    for segment in left {
        clean = clean.says(&format!("removed /dev/shm/{segment}\n"));
    }
    clean.says(&format!("removed {}\n", directory.display()));
    rig.assert_nothing_left();
    assert!(
        !other.segments().is_empty(),
        "another instance keeps its own"
    );
    bystander.signal(Signal::TERM);
    bystander.end().expect(130);
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_after_killed_processes_needs_no_cleaning() {
    let rig = Rig::new("phoenix");
    kill_all(in_the_air(&rig));
    assert!(!rig.segments().is_empty());
    let next = rig.ok(&format!(
        "fly --rt off --config {} --duration 100ms",
        rig.slow(5)
    ));
    assert_eq!(next.result()["status"], "PASS");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn cleaning_beside_a_flight_leaves_it_alone() {
    let rig = Rig::new("cleaned");
    let flight = rig.take_off(format!(
        "--rt off --config {} --duration 100ms",
        rig.slow(20)
    ));
    rig.ok("clean")
        .says(&format!("instance `{}` is alive", rig.instance));
    let result = flight.end().expect(0).result();
    assert_eq!(result["status"], "PASS");
    rig.assert_nothing_left();
}

const ROLES: [&str; 5] = ["plant", "outer", "inner", "mixer", "record"];
/// A flight that lasts until it is ended; nothing in these tests depends on its deadlines.
const LONG: [&str; 4] = ["--rt", "off", "--duration", "600s"];

/// The flight ended in order: a final report in all its forms, a whole log, nothing left.
fn assert_interrupted_whole(rig: &Rig, what: &str) {
    let report = rig.report();
    assert_eq!(
        report["verdict"]["status"], "INTERRUPTED",
        "{what}: {}",
        report["verdict"]
    );
    assert_eq!(report["run"]["in_flight"], false, "{what}");
    for file in ["report.html", "report.txt", "flight.svg"] {
        assert!(
            rig.out().join("latest").join(file).exists(),
            "{what}: no {file}"
        );
    }
    let replayed = rig.ok("replay --verify");
    assert!(!replayed.stderr.contains("truncated"), "{what}: {replayed}");
    rig.assert_nothing_left();
}

/// A flight in a terminal of its own, as `command` runs it there; none where there is no python3.
fn in_a_terminal(rig: &Rig, command: &[&str]) -> Option<Running> {
    if !Command::new("python3")
        .arg("--version")
        .output()
        .is_ok_and(|output| output.status.success())
    {
        lacks_tool("no terminal is closed: there is no python3");
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rig/closed_terminal.py");
    let mut terminal = Command::new("python3");
    terminal
        .arg(script)
        .args(command)
        .env("IRONBIRD_ROOT", rig.root());
    Some(rig.launch(terminal))
}

/// `ironbird fly` with the rig's own arguments.
fn fly(rig: &Rig, args: &[&str]) -> Vec<String> {
    [IRONBIRD, "fly"]
        .map(str::to_owned)
        .into_iter()
        .chain(rig.own_args("fly", args))
        .collect()
}

#[test]
fn a_role_takes_its_launchers_death_for_one_however_often_it_is_told() {
    let rig = Rig::new("told");
    let flight = rig.take_off(LONG);
    for pid in flight.roles().into_values() {
        for _ in 0..3 {
            send(pid, Signal::TERM);
        }
    }
    flight.end().expect(130);
    assert_interrupted_whole(&rig, "each role was told three times");
}

#[test]
fn nohup_is_respected() {
    let rig = Rig::new("nohup");
    let mut command = Command::new("env");
    command
        .arg("--ignore-signal=HUP")
        .args(fly(&rig, &["--rt", "off", "--duration", "2s"]));
    command.env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(command);
    rig.await_flight();
    flight.signal(Signal::HUP);
    let result = flight.end().expect(0).result();
    assert_eq!(
        (result["status"].as_str(), result["ticks"].is_empty()),
        ("PASS", false)
    );
    assert_eq!(rig.report()["run"]["ending"], "completed");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_launcher_that_may_not_hear_of_its_childrens_ends_hears_of_them() {
    let rig = Rig::new("deaf");
    let mut command = Command::new("env");
    command
        .arg("--ignore-signal=CHLD")
        .args(fly(&rig, &["--rt", "off", "--duration", "1s"]));
    command.env("IRONBIRD_ROOT", rig.root());
    assert_eq!(
        rig.launch(command).end().expect(0).result()["status"],
        "PASS"
    );
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_closed_terminal_ends_the_flight_in_order() {
    for (shell, watch) in [(false, false), (true, false), (false, true)] {
        let rig = Rig::new("hangup");
        let mut args = LONG.to_vec();
        args.extend(watch.then_some("--watch"));
        let flight = fly(&rig, &args);
        let line = format!("{}; true", flight.join(" "));
        let mut command: Vec<&str> = if shell {
            vec!["sh", "-c", &line]
        } else {
            vec![]
        };
        command.extend(flight.iter().filter(|_| !shell).map(String::as_str));
        let Some(terminal) = in_a_terminal(&rig, &command) else {
            return;
        };
        rig.await_flight();
        if watch {
            terminal.await_output("position error, last");
        }
        let processes: Vec<u32> = ROLES
            .iter()
            .chain(&["fly", "watch"])
            .flat_map(|command| rig.processes_of(command))
            .collect();
        assert_eq!(processes.len(), if watch { 7 } else { 6 }, "{processes:?}");
        terminal.signal(Signal::USR1);
        let ended = terminal.end();
        if !shell {
            assert!(ended.stdout.contains("\nended 130 "), "{ended}");
        }
        await_gone(processes);
        assert_interrupted_whole(&rig, &format!("shell {shell}, watch {watch}"));
    }
}

#[test]
fn a_dashboard_whose_terminal_is_closed_ends_though_it_hears_of_no_hangup() {
    for ignored in ["--ignore-signal=HUP", "--default-signal=HUP"] {
        let rig = Rig::new("gone");
        let command = [
            "env",
            ignored,
            IRONBIRD,
            "watch",
            "--instance",
            &rig.instance,
        ];
        let Some(terminal) = in_a_terminal(&rig, &command) else {
            return;
        };
        terminal.await_output("\u{1b}[?1049h");
        let [watcher] = rig.processes_of("watch")[..] else {
            panic!("one dashboard")
        };
        terminal.signal(Signal::USR1);
        let ended = terminal.end();
        assert!(ended.stdout.contains("\nended 130 "), "{ignored}: {ended}");
        await_gone(vec![watcher]);
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_dashboard_leaves_a_sane_terminal() {
    for told in [Signal::KILL, Signal::HUP, Signal::QUIT] {
        let rig = Rig::new("sane");
        // A busy machine may let it fall: not to a ground.
        let config = crate::restarts::in_the_air(&rig, 1);
        let flight = [
            "--rt",
            "off",
            "--duration",
            "6s",
            "--trajectory",
            "hover",
            "--watch",
            "--config",
            &config,
        ];
        let command = fly(&rig, &flight);
        let Some(terminal) = in_a_terminal(
            &rig,
            &command.iter().map(String::as_str).collect::<Vec<_>>(),
        ) else {
            return;
        };
        terminal.await_output("position error, last");
        let [watcher] = rig.processes_of("watch")[..] else {
            panic!("one dashboard")
        };
        send(watcher, told);
        // The launcher has its terminal back, with its own line.
        terminal.await_output(" of 6.0 s   missed");
        let ended = terminal.end();
        assert!(
            ended.stdout.contains("\nended 0 icanon True\n"),
            "{told:?}: {ended}"
        );
        let (left, entered) = (
            ended.stdout.rfind("\u{1b}[?1049l"),
            ended.stdout.rfind("\u{1b}[?1049h"),
        );
        assert!(
            entered.is_some() && left > entered,
            "{told:?}: the alternate screen is left: {ended}"
        );
        assert!(
            ended.stdout.rfind("\u{1b}[?25h") > entered,
            "{told:?}: the cursor is shown again"
        );
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_launcher_that_waits_for_a_process_says_where_to_look() {
    // Stopped, so that nobody takes off without it; where it stands is up to the instant, and the plant may need it.
    let unready = |_| {
        let rig = Rig::new("unready");
        let flight = rig.start("fly", LONG);
        let outer = flight.roles()["outer"];
        send(outer, Signal::STOP);
        sleep(Duration::from_secs(1));
        let log = fs::read_to_string(rig.out().join(&rig.run_directories()[0]).join("plant.log"))
            .unwrap();
        let last = log.lines().last().unwrap_or_default().to_owned();
        if last.contains("waiting for outer") {
            return Some((rig, flight, outer));
        }
        flight.signal(Signal::INT);
        send(outer, Signal::CONT);
        flight.end();
        None
    };
    let (rig, flight, outer) = (0..20).find_map(unready).unwrap();
    flight.await_words("still waiting for all processes to be ready; plant.log says for which");
    flight.signal(Signal::INT);
    send(outer, Signal::CONT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn roles_started_by_hand_say_how_the_flight_ended() {
    let rig = Rig::new("by-hand");
    for (duration, signal, words) in [
        ("200ms", None, "completed after 0.2 s"),
        ("600s", Some(Signal::HUP), "interrupted"),
    ] {
        let roles = ROLES.map(|role| {
            (
                role,
                rig.start(role, format!("--rt off --duration {duration}")),
            )
        });
        wait_until("the flight", || {
            (rig.run_directories().len() == 1).then_some(())
        });
        if let Some(signal) = signal {
            rig.await_flight();
            sleep(Duration::from_millis(200));
            roles[1].1.signal(signal);
        }
        for (role, process) in roles {
            let ended = process.end();
            if role != "record" {
                ended
                    .expect(0)
                    .complains(&format!("{role}: flight {words}"));
            }
        }
        rig.assert_nothing_left();
        fs::remove_dir_all(rig.out()).unwrap();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_floor_that_fails_costs_no_report() {
    let rig = Rig::new("floorless");
    let executable = rig.path("ironbird");
    fs::hard_link(IRONBIRD, &executable)
        .or_else(|_| fs::copy(IRONBIRD, &executable).map(drop))
        .unwrap();
    let mut command = Command::new(&executable);
    command
        .arg("fly")
        .args(rig.own_args("fly", "--rt off --duration 2s --floor 1s"))
        .env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(command);
    rig.await_flight();
    // The processes of the floor's ring are started from it.
    fs::remove_file(&executable).unwrap();
    let ended = flight
        .end()
        .expect(1)
        .says("\nGates     PASS")
        .complains("cannot start a process of the ring");
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    assert!(rig.report()["beside"].is_null());
}

/// What the kernel lets the flight of another user have.
fn unprivileged(rig: &Rig, limit: &str) -> Option<Command> {
    let is_root = rustix::process::geteuid().is_root();
    let may = Command::new("setpriv")
        .args(["--reuid", "65534", "true"])
        .status()
        .is_ok_and(|it| it.success());
    if !is_root || !may {
        not_tested("no limit on processes: this needs root and setpriv");
        return None;
    }
    let copy: PathBuf = rig.path("ironbird");
    copy_executable(&copy);
    for directory in [rig.path("."), rig.root(), rig.out()] {
        fs::create_dir_all(&directory).unwrap();
        std::os::unix::fs::chown(&directory, Some(65534), Some(65534)).unwrap();
    }
    let mut command = Command::new("setpriv");
    command
        .args([
            "--reuid",
            "65534",
            "--regid",
            "65534",
            "--clear-groups",
            "prlimit",
            limit,
        ])
        .arg(copy);
    command
        .arg("fly")
        .args(rig.own_args("fly", "--rt off --duration 1s"))
        .env("IRONBIRD_ROOT", rig.root());
    Some(command)
}

#[test]
fn limits_that_leave_no_room_for_a_flight_are_named() {
    let limited = |rig: &Rig, limit: &str| {
        let mut command = Command::new("prlimit");
        command
            .arg(limit)
            .args(fly(rig, &["--rt", "off", "--duration", "1s"]))
            .env("IRONBIRD_ROOT", rig.root());
        rig.launch(command).end()
    };
    let rig = Rig::new("limits");
    limited(&rig, "--stack=65536")
        .expect(1)
        .complains("the stack is limited to 64 KiB")
        .complains("ulimit -s");
    limited(&rig, "--fsize=2048")
        .expect(1)
        .complains(".json: File too large");
    rig.assert_nothing_left();
    // Enough for the directory, and not for shared memory. Whichever part is first to find that ends first.
    let ended = limited(&rig, "--fsize=8192")
        .expect(1)
        .complains(" ended before the flight began");
    let ended = ended
        .complains("may have 8 KiB in this process (ulimit -f)")
        .complains("ulimit -f unlimited");
    assert!(!ended.stderr.contains("ironbird clean"), "{ended}");
    rig.assert_nothing_left();
    let ended = limited(&rig, "--as=60000000")
        .expect(1)
        .complains("the address space is limited to 58593 KiB");
    ended.complains("ulimit -v unlimited");
    let rig = Rig::new("nproc");
    let Some(command) = unprivileged(&rig, "--nproc=1") else {
        return;
    };
    let ended = rig.launch(command).end().expect(1);
    let ended = ended.complains("cannot start the plant process: Resource temporarily unavailable");
    ended.complains("ulimit -u");
}

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
    let is_there = Command::new("python3")
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    if !is_there.is_ok_and(|status| status.success()) {
        lacks_tool("there is no python3 to block signals");
        return None;
    }
    let mut python = Command::new("python3");
    python
        .args(["-c", DEAF])
        .arg(command.get_program())
        .args(command.get_args());
    python.envs(
        command
            .get_envs()
            .filter_map(|(name, value)| Some((name, value?))),
    );
    Some(python)
}

#[test]
fn a_flight_whose_signals_were_blocked_or_ignored_passes_and_ends() {
    let rig = Rig::new("deaf");
    let Some(fly) = deaf(&rig.command("fly", "--rt off --duration 1s")) else {
        return;
    };
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
        let args = format!("--rt off --config {} --duration 60s", slow);
        let Some(fly) = deaf(&rig.command("fly", &args)) else {
            return;
        };
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
    let Some(mixer) = deaf(&rig.command("mixer", "--rt off")) else {
        return;
    };
    let mixer = rig.launch(mixer);
    mixer.await_words("waiting for the plant");
    mixer.signal(Signal::TERM);
    mixer.end().expect(130);
    rig.assert_nothing_left();
}

const STAGES: [&str; 4] = ["plant", "outer", "inner", "mixer"];

/// Whether SCHED_FIFO can be had here; says so where it cannot.
fn fifo_is_granted() -> bool {
    let refusal = fifo_refusal(90);
    if let Some(refusal) = &refusal {
        not_tested(&format!("SCHED_FIFO is refused here: {refusal}"));
    }
    refusal.is_none()
}

/// Scheduling policy of a process that lives, or that nobody has waited for: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy(pid: u32) -> u32 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.rsplit_once(')')
        .unwrap()
        .1
        .split_whitespace()
        .nth(38)
        .unwrap()
        .parse()
        .unwrap()
}

/// Waits until it has ended; gives the policy that it ended under.
fn last_policy(process: &Running) -> u32 {
    wait_until("the process to end", || {
        is_gone(process.pid()).then_some(())
    });
    policy(process.pid())
}

/// A role that waits for the others, in real time.
fn waiting(rig: &Rig, role: &str) -> Running {
    let process = rig.start(role, "--rt prefer");
    process.await_words("waiting for");
    assert_eq!(policy(process.pid()), 1, "{role} has real time");
    process
}

#[test]
fn a_role_that_is_told_to_end_ends_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    for role in STAGES {
        let rig = Rig::new("told");
        let process = waiting(&rig, role);
        process.signal(Signal::TERM);
        assert_eq!(last_policy(&process), 0, "{role}");
        process.end().expect(130);
        rig.assert_nothing_left();
    }
}

#[test]
fn a_role_that_a_second_signal_ends_at_once_ends_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    for role in STAGES {
        let rig = Rig::new("at-once");
        let process = waiting(&rig, role);
        // Both are there when it goes on: it has no time to end in order.
        [Signal::STOP, Signal::INT, Signal::TERM, Signal::CONT]
            .iter()
            .for_each(|signal| process.signal(*signal));
        assert_eq!(last_policy(&process), 0, "{role}");
        process.end().expect(130);
        rig.run("clean", "");
    }
}

#[test]
fn roles_that_have_flown_end_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    let rig = Rig::new("flown");
    let slow = rig.slow(5);
    let args = format!("--rt prefer --config {slow} --duration 50ms");
    let roles =
        ["record", "mixer", "inner", "outer", "plant"].map(|role| (role, rig.start(role, &args)));
    for (role, process) in &roles {
        assert_eq!(last_policy(process), 0, "{role}");
    }
    for (_, process) in roles {
        process.end().expect(0);
    }
    rig.assert_nothing_left();
}
