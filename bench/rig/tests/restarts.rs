//! Processes that die and are started again: by the supervisor, by somebody else, after everybody was killed.

use crate::rig::{self, Ended, Rig, Running, in_own_mounts, rounds, send, wait_until};
use controller::laws::adaptive::estimate;
use flight_log::entry::LogEntry;
use flight_log::reader::End;
use ipc::Wire;
use ipc::clock::{now_ns, sleep_until};
use messages::blackboards::{RUN, RolePhase, Run, Status};
use messages::grid::Pace;
use messages::role::Role;
use process::session::status_board;
use report::schema::Report;
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeMap;
use std::fs;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// What every flight here is flown with.
pub(crate) const RESTART: [&str; 4] = ["--on-death", "restart", "--trajectory", "hover"];

/// Settings of slow motion without a ground: whoever hovers at its height falls through it while a stage is missing.
pub(crate) fn in_the_air(rig: &Rig, slowdown: u64) -> String {
    rig.settings(&format!(
        "[flight]\nslowdown = {slowdown}\nground_z_m = -100.0\n"
    ))
}

/// A flight in the air, and what its plant says of it.
pub(crate) fn take_off(rig: &Rig, slowdown: u64, args: &[&str]) -> (Running, Run) {
    let config = in_the_air(rig, slowdown);
    let flight = rig.start("fly", [&RESTART[..], &["--config", &config], args].concat());
    (flight, rig.await_tick(0))
}

/// Sends a signal to a role at a tick; its process.
pub(crate) fn strike(rig: &Rig, run: &Run, tick: u64, role: Role, signal: Signal) -> u32 {
    let Pace::Realtime(grid) = run.pace() else {
        panic!("a flight in lockstep has no clock")
    };
    while now_ns() < grid.begin_of(tick) {
        sleep_until(grid.begin_of(tick));
    }
    let pid = rig.known().pid_of(role).unwrap();
    let process = Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
    kill_process(process, signal).unwrap();
    pid
}

/// Waits until another process than this one flies in a role.
pub(crate) fn await_successor(rig: &Rig, role: Role, dead: u32) -> u32 {
    let wire = Wire::open(&rig.known()).unwrap();
    let pid = wait_until(&format!("another {role} process to fly"), || {
        let status = wire
            .blackboard_reader::<Status>(&status_board(role))
            .unwrap()?
            .get();
        (status.phase() == RolePhase::Flying
            && status.pid != u64::from(dead)
            && status.ticks_run > 0)
            .then_some(status.pid)
    });
    u32::try_from(pid).unwrap()
}

pub(crate) fn report(rig: &Rig) -> Report {
    Report::read(&rig.out().join("latest/report.json")).unwrap()
}

/// The replay has every bit of the record.
pub(crate) fn assert_replayed(rig: &Rig) {
    rig.ok("replay --verify").says("identical");
}

/// The estimates of all wrenches of a flight's log, with the epoch of each.
fn estimates(rig: &Rig) -> Vec<(u64, [f64; 3])> {
    let (entries, _) = rig::read_log(&rig.out().join("latest/flight.mcap"));
    let wrench = |entry: &LogEntry| match entry {
        LogEntry::Wrench(message) => {
            Some((message.envelope.epoch, estimate(&message.content.telemetry)))
        }
        _ => None,
    };
    entries.iter().filter_map(wrench).collect()
}

#[test]
#[ignore = "long: part of the gate"]
fn an_inner_loop_begins_at_its_priors_or_where_its_predecessor_was() {
    for resumes in [false, true] {
        let rig = Rig::new("resumes");
        let flags = [
            "--rt",
            "off",
            "--duration",
            "4s",
            "--trajectory",
            "lissajous",
            "--resume-estimates",
        ];
        let flight = rig.start(
            "fly",
            [&RESTART[..2], &flags[..if resumes { 7 } else { 6 }]].concat(),
        );
        let run = rig.await_tick(0);
        strike(&rig, &run, 2500, Role::Inner, Signal::KILL);
        flight.end().expect(0);
        let estimates = estimates(&rig);
        let begin = estimates
            .windows(2)
            .position(|pair| pair[0].0 != pair[1].0)
            .unwrap()
            + 1;
        let (before, first) = (&estimates[begin - 2..begin], estimates[begin].1);
        let (prior, is_taken_over) = (
            estimates[0].1,
            before.iter().any(|(_, last)| *last == first),
        );
        assert_eq!(
            (is_taken_over, first == prior),
            (resumes, !resumes),
            "{before:?} -> {first:?}"
        );
        let said = fs::read_to_string(rig.out().join("latest/inner.log")).unwrap();
        assert_eq!(
            said.contains("begins with the last estimates"),
            resumes,
            "{said}"
        );
        assert_replayed(&rig);
    }
}

/// Kills stages in turns at random phases of their ticks; a flight in slow motion, so that none is lost of it.
fn kills_in_a_row(kills: u64) {
    const TICK_MS: u64 = 4;
    // Of each role one in 2.1 s: five in ten seconds are borne.
    const APART_TICKS: u64 = 700 / TICK_MS;
    let rig = Rig::new("row");
    let seconds = (kills * APART_TICKS + 500).div_ceil(1000);
    let (flight, mut run) = take_off(
        &rig,
        TICK_MS,
        &["--rt", "off", "--duration", &format!("{seconds}s")],
    );
    let t0_ns = run.t0_ns;
    for kill in 0..kills {
        let role = [Role::Inner, Role::Mixer, Role::Outer][kill as usize % 3];
        // Within the tick, everywhere in the course of the kills.
        run.t0_ns = t0_ns + kill.wrapping_mul(2_654_435_761) % run.period_ns;
        let dead = strike(&rig, &run, 100 + kill * APART_TICKS, role, Signal::KILL);
        await_successor(&rig, role, dead);
    }
    flight.end().expect(0);
    let report = report(&rig);
    assert_eq!(report.deaths.len() as u64, kills, "{:?}", report.deaths);
    for death in &report.deaths {
        assert!(
            death.how == "signal: 9 (SIGKILL)" && death.back_after_ms.is_some(),
            "{death:?}"
        );
    }
    assert_eq!(report.run.ending, "completed");
    assert_replayed(&rig);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn twenty_kills_at_random_phases_are_survived_and_replayed() {
    kills_in_a_row(20 * rounds());
}

#[test]
#[ignore = "long: part of the gate"]
fn a_sixth_death_within_ten_seconds_ends_the_flight() {
    let rig = Rig::new("often");
    let (flight, run) = take_off(&rig, 5, &["--rt", "off", "--duration", "60s"]);
    let mut dead = strike(&rig, &run, 0, Role::Inner, Signal::KILL);
    for _ in 0..5 {
        let next = await_successor(&rig, Role::Inner, dead);
        send(next, Signal::KILL);
        dead = next;
    }
    let ended = flight.end().expect(1);
    assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
    let ended = ended.tells("it has been started again 5 times within 10 s, which is the most");
    let report = report(&rig);
    assert_eq!(report.deaths.len(), 6, "{ended}");
    let last = report.deaths.last().unwrap();
    assert!(
        last.back_after_ms.is_none() && last.ticks_lost.is_some(),
        "{last:?}"
    );
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_goes_on_without_its_recorder_and_another_one_records_the_rest() {
    let rig = Rig::new("recorder");
    let (flight, run) = take_off(&rig, 1, &["--rt", "off", "--duration", "6s"]);
    rig.await_report();
    strike(&rig, &run, 2000, Role::Record, Signal::KILL);
    let ended = flight.end().expect(0);
    assert_eq!(ended.result()["status"], "INCOMPLETE", "{ended}");
    let [first, second] = <[String; 2]>::try_from(rig.run_directories()).unwrap();
    let rest = report(&rig);
    assert_eq!(rest.ticks.run + rest.ticks.skipped, 6001);
    let [death] = &rest.deaths[..] else {
        panic!("{:?}", rest.deaths)
    };
    assert_eq!(
        (death.role.as_str(), death.how.as_str()),
        ("record", "signal: 9 (SIGKILL)")
    );
    assert!((1900..4000).contains(&death.tick), "{death:?}");
    rig.ok(&format!("report {first} --section head"))
        .tells(&format!(
            "the recorder died; the flight went on, and another recorder wrote {second}"
        ));
    let (kept, end) = rig::read_log(&rig.out().join(&first).join("flight.mcap"));
    assert!(
        end == End::Truncated && kept.len() > 1000,
        "{} messages, {end:?}",
        kept.len()
    );
    rig.assert_nothing_left();
}

/// The five roles as systemd would have them: each is started again 100 ms after it has failed.
#[test]
#[ignore = "long: part of the gate"]
fn roles_that_somebody_else_starts_again_are_reported_and_replayed_alike() {
    let rig = Rig::new("unit");
    let config = in_the_air(&rig, 2);
    let options = format!("--rt off --config {config} --trajectory hover --duration 2s");
    // What examples/systemd/ironbird@.service says: Restart=on-failure, RestartSec=100ms, SuccessExitStatus=130 3.
    let kept = |role: &str| {
        let command = rig.command(role, &options);
        let mut keeper = Command::new("sh");
        let forever = "until \"$@\" || case $? in 3|130) ;; *) false ;; esac; do sleep 0.1; done";
        keeper.args(["-c", forever, "sh"]);
        keeper
            .arg(command.get_program())
            .args(command.get_args())
            .env("IRONBIRD_ROOT", rig.root());
        rig.launch(keeper)
    };
    let keepers = ["outer", "inner", "mixer", "record", "plant"].map(kept);
    rig.await_flight();
    let wire = Wire::open(&rig.known()).unwrap();
    let run = wire.blackboard_reader::<Run>(RUN).unwrap().unwrap().get();
    drop(wire);
    for (role, tick) in [(Role::Inner, 400), (Role::Outer, 800), (Role::Mixer, 1200)] {
        let dead = strike(&rig, &run, tick, role, Signal::KILL);
        await_successor(&rig, role, dead);
    }
    keepers
        .into_iter()
        .for_each(|keeper| drop(keeper.end().expect(0)));
    let report = report(&rig);
    let roles: Vec<&str> = report
        .deaths
        .iter()
        .map(|death| death.role.as_str())
        .collect();
    assert_eq!(roles, ["inner", "outer", "mixer"], "{:?}", report.deaths);
    for death in &report.deaths {
        assert!(
            death.how.is_empty() && death.noticed_after_ms.is_none(),
            "nobody told: {death:?}"
        );
        // So long its keeper sleeps alone.
        assert!(death.back_after_ms.unwrap() > 100.0, "{death:?}");
    }
    assert_replayed(&rig);
    sleep(Duration::from_millis(100));
    rig.assert_nothing_left();
}

const OTHERS: [&str; 4] = ["outer", "inner", "mixer", "record"];
/// Longest that a role may take to end when its plant is gone; a rig that hangs waits for ever.
const BOUND: Duration = Duration::from_secs(30);

/// What roles are started with by hand: a flight in slow motion that nobody outlives.
fn by_hand(rig: &Rig) -> Vec<String> {
    [
        "--rt",
        "off",
        "--config",
        &rig.slow(20),
        "--duration",
        "10s",
    ]
    .map(str::to_owned)
    .into()
}

fn start(rig: &Rig, role: &str, args: &[String]) -> Running {
    rig.start(role, args.iter().map(String::as_str).collect::<Vec<_>>())
}

/// All five roles, in the air.
fn crew_in_the_air(rig: &Rig, args: &[String]) -> (Running, BTreeMap<&'static str, Running>) {
    let others = OTHERS.map(|role| (role, start(rig, role, args))).into();
    let plant = start(rig, "plant", args);
    rig.await_flight();
    (plant, others)
}

/// Ends of processes within the bound; those that hang are none.
fn ends(mut running: BTreeMap<&'static str, Running>) -> BTreeMap<&'static str, Option<Ended>> {
    let until = Instant::now() + BOUND;
    while Instant::now() < until && running.values_mut().any(Running::is_running) {
        sleep(Duration::from_millis(20));
    }
    running
        .into_iter()
        .map(|(role, mut it)| (role, (!it.is_running()).then(|| it.end())))
        .collect()
}

/// Waits until the plant knows that everybody of the run before is gone.
fn await_waiting_for_all(plant: &Running) {
    plant.await_words("waiting for outer, inner, mixer, record");
}

/// Kills the plant in flight and starts it again: the others must end, and say why; the new one flies with a new crew.
fn restart_the_plant(after: Duration) -> BTreeMap<&'static str, String> {
    let rig = Rig::new("again");
    let args = by_hand(&rig);
    let (plant, others) = crew_in_the_air(&rig, &args);
    plant.signal(Signal::KILL);
    plant.end();
    sleep(after);
    let mut plant = start(&rig, "plant", &args);
    let mut outcomes = BTreeMap::new();
    for (role, ended) in ends(others) {
        let ended = ended.unwrap_or_else(|| {
            panic!("{role} hangs when the plant is started again after {after:?}")
        });
        assert_eq!(ended.code, Some(1), "{role}, after {after:?}: {ended}");
        outcomes.insert(role, ended.stderr);
    }
    await_waiting_for_all(&plant);
    assert!(plant.is_running());
    let crew: BTreeMap<_, _> = OTHERS.map(|role| (role, start(&rig, role, &args))).into();
    rig.await_flight();
    plant.signal(Signal::INT);
    plant.end().expect(0);
    for (role, ended) in ends(crew) {
        let expected = if role == "record" { 130 } else { 0 };
        ended
            .unwrap_or_else(|| panic!("{role} does not land"))
            .expect(expected);
    }
    rig.assert_nothing_left();
    outcomes
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_is_killed_and_started_again_leaves_no_role_behind() {
    for after_ms in [0, 10, 100, 500, 1200, 3000] {
        for (role, said) in restart_the_plant(Duration::from_millis(after_ms)) {
            let told = ["another run has begun", "the plant died in flight"]
                .iter()
                .any(|why| said.contains(why));
            assert!(
                told || role == "record",
                "after {after_ms} ms {role} said: {said}"
            );
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_is_killed_before_the_flight_is_waited_for_and_its_successor_flies() {
    let rig = Rig::new("early");
    let args = by_hand(&rig);
    let plant = start(&rig, "plant", &args);
    plant.await_words("waiting for outer");
    // All but one: they wait for the plant to open the run.
    let mut others: BTreeMap<_, _> = ["inner", "mixer", "record"]
        .map(|role| (role, start(&rig, role, &args)))
        .into();
    plant.await_words("waiting for outer (each");
    plant.signal(Signal::KILL);
    plant.end();
    others.insert("outer", start(&rig, "outer", &args));
    others["outer"].await_words("waiting for the plant (`ironbird plant`)");
    let plant = start(&rig, "plant", &args);
    rig.await_flight();
    plant.signal(Signal::INT);
    plant.end().expect(0);
    assert!(ends(others).values().all(Option::is_some));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_role_that_is_started_while_the_plant_flies_joins_it_and_its_successor_has_its_place() {
    let rig = Rig::new("joiner");
    let args = by_hand(&rig);
    let (plant, mut others) = crew_in_the_air(&rig, &args);
    for signal in [Signal::KILL, Signal::KILL] {
        let inner = others.remove("inner").unwrap();
        inner.signal(signal);
        inner.end();
        let before = rig.ok("params --json").json()[0]["in_force"].clone();
        assert!(!before.is_null());
        others.insert("inner", start(&rig, "inner", &args));
        // It works ticks of the present, and so the flight goes on: nobody asks for its end.
        sleep(Duration::from_millis(500));
        assert!(
            others.values_mut().all(Running::is_running),
            "{}",
            others["inner"].stderr()
        );
    }
    plant.signal(Signal::INT);
    plant.end().expect(0);
    for (role, ended) in ends(others) {
        ended
            .unwrap_or_else(|| panic!("{role} does not land"))
            .expect(if role == "record" { 130 } else { 0 });
    }
    let inner = &rig.report()["roles"]["inner"];
    assert!(
        inner["landed"] == true && inner["ticks_run"].as_u64().unwrap() > 10,
        "{inner}"
    );
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_cannot_be_joined_late_and_says_so() {
    let rig = Rig::new("late");
    let args: Vec<String> = ["--pace", "lockstep", "--duration", "10h"]
        .map(str::to_owned)
        .into();
    let (plant, mut others) = crew_in_the_air(&rig, &args);
    let inner = others.remove("inner").unwrap();
    inner.signal(Signal::KILL);
    inner.end();
    let late = start(&rig, "inner", &args).end().expect(1);
    late.complains(
        "the flight in lockstep has begun without this inner process, and cannot be joined late",
    );
    plant.end().expect(1).complains("a stage hangs or has died");
    assert!(ends(others).values().all(Option::is_some));
}

#[test]
fn a_role_that_dies_as_the_run_opens_is_missed_by_name() {
    let rig = Rig::new("missed");
    let args = by_hand(&rig);
    let plant = start(&rig, "plant", &args);
    let mut others: BTreeMap<_, _> = ["outer", "inner", "record"]
        .map(|role| (role, start(&rig, role, &args)))
        .into();
    plant.await_words("waiting for mixer (each");
    // Ready, and stopped before the run can open: it never arms.
    let inner = others.remove("inner").unwrap();
    inner.signal(Signal::STOP);
    others.insert("mixer", start(&rig, "mixer", &args));
    plant.await_words("waiting for inner to arm");
    inner.signal(Signal::KILL);
    inner.end();
    let said = plant.stderr().len();
    wait_until("the plant to say who is missing", || {
        plant.stderr()[said..]
            .contains("waiting for inner (each")
            .then_some(())
    });
    others.insert("inner", start(&rig, "inner", &args));
    rig.await_flight();
    plant.signal(Signal::INT);
    plant.end().expect(0);
    for (role, ended) in ends(others) {
        assert!(ended.is_some(), "{role} hangs when the flight is over");
    }
    rig.assert_nothing_left();
}

/// Kills a launcher, starts another one after a while, and says how that one ended.
fn relaunch(rig: &Rig, after: Duration) -> String {
    let slow = rig.slow(5);
    let args = format!("--rt off --config {slow} --duration 100ms");
    let first = rig.take_off(format!("--rt off --config {slow} --duration 60s"));
    let roles = first.roles();
    first.signal(Signal::KILL);
    first.end();
    sleep(after);
    let mut second: BTreeMap<_, _> = [("fly", rig.start("fly", &args))].into();
    let until = Instant::now() + BOUND;
    while second.values_mut().any(Running::is_running) && Instant::now() < until {
        sleep(Duration::from_millis(20));
    }
    let mut second = second.remove("fly").unwrap();
    if second.is_running() {
        return "HANGS".into();
    }
    let ended = second.end();
    for pid in roles.into_values() {
        wait_until(&format!("process {pid} to end"), || {
            rig::is_gone(pid).then_some(())
        });
    }
    match ended.code {
        Some(0) => ended.result()["status"].clone(),
        Some(5) => {
            assert!(ended.stderr.contains("already has a running"), "{ended}");
            "code 5, an old role still leaves".into()
        }
        code => {
            let why = ended
                .stderr
                .lines()
                .find(|line| line.contains('×'))
                .unwrap_or(&ended.stderr)
                .trim()
                .to_owned();
            format!("code {code:?}: {why}")
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_launcher_that_is_killed_and_started_again_flies_or_says_who_is_in_its_place() {
    for after_ms in [0, 20, 50, 100, 200, 300] {
        let outcome = relaunch(&Rig::new("relaunch"), Duration::from_millis(after_ms));
        assert!(
            outcome == "PASS" || outcome.starts_with("code 5"),
            "after {after_ms} ms: {outcome}"
        );
    }
}

/// Children of a process, also those that have yet to become what they shall be.
fn children(pid: u32) -> Vec<u32> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task"))
        .unwrap()
        .map(|task| task.unwrap().path());
    let lists = tasks.map(|task| fs::read_to_string(task.join("children")).unwrap_or_default());
    lists
        .flat_map(|list| {
            list.split_whitespace()
                .map(|pid| pid.parse().unwrap())
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Kills a flight with all its processes at once, wherever they are.
fn kill_all(flight: Running) {
    flight.signal(Signal::STOP);
    let roles = children(flight.pid());
    roles.iter().for_each(|pid| send(*pid, Signal::KILL));
    flight.signal(Signal::KILL);
    flight.end();
}

/// Starts flights, kills each with all its processes within its first 0.2 s, starts again at once; says how each
/// second start went that was no flight.
fn start_over(rounds: u64) -> BTreeMap<String, u64> {
    let rig = Rig::new("over");
    let mut failures = BTreeMap::new();
    let slow = rig.slow(5);
    for round in 0..rounds {
        let flight = rig.start("fly", "--rt off --duration 1s");
        // Somewhere in the first 0.2 s, and everywhere in the course of the rounds.
        let instant_us = round
            .wrapping_mul(6_364_136_223_846_793_005)
            .rotate_left(32)
            % 200_000;
        sleep(Duration::from_micros(instant_us));
        kill_all(flight);
        let next = rig.run("fly", format!("--rt off --config {slow} --duration 100ms"));
        if next.code != Some(0) {
            let said = format!(
                "code {:?}: {}",
                next.code,
                next.stderr.split_whitespace().collect::<Vec<_>>().join(" ")
            );
            eprintln!("killed after {instant_us} us: {said}");
            *failures.entry(said).or_default() += 1;
        }
    }
    rig.assert_nothing_left();
    failures
}

#[test]
#[ignore = "long: part of the gate"]
fn a_start_after_a_start_that_was_killed_flies() {
    assert_eq!(start_over(10), BTreeMap::new());
}

#[test]
#[ignore = "long: part of the gate"]
fn five_roles_that_start_at_the_same_time_after_killed_ones_fly() {
    let rig = Rig::new("together");
    let slow = rig.slow(5);
    for round in 0..5 {
        let flight = rig.start("fly", "--rt off --duration 1s");
        sleep(Duration::from_millis(30 + 40 * round));
        kill_all(flight);
        let args = format!("--rt off --config {slow} --duration 100ms");
        let roles =
            ["plant", "outer", "inner", "mixer", "record"].map(|role| rig.start(role, &args));
        for role in roles {
            role.end().expect(0);
        }
        rig.assert_nothing_left();
    }
}

/// Starts the roles one after the other as by hand, each when the one before waits, where /dev/shm has 64 MiB.
const BY_HAND: &str = r#"
for role in plant outer inner mixer; do
    "$0" $role "$@" 2> $role.err &
    pids="$pids $!"
    until grep -q "waiting for" $role.err; do
        kill -0 $! || { cat $role.err; exit 98; }
        sleep 0.05
    done
done
"$0" inner "$@" 2> second.err
echo "second inner $?"
cat second.err
"$0" record "$@" || exit 97
for pid in $pids; do wait $pid || exit 96; done
"#;

#[test]
#[ignore = "long: part of the gate"]
fn five_roles_by_hand_fly_in_the_shared_memory_of_a_container() {
    let rig = Rig::new("container");
    let Some(mut roles) = in_own_mounts("mount -t tmpfs -o size=64m tmpfs /dev/shm", "true", "sh")
    else {
        return;
    };
    roles.args(["-c", BY_HAND, rig::IRONBIRD]);
    roles.args(rig.own_args(
        "plant",
        format!("--config {} --duration 100ms", rig.slow(5)),
    ));
    roles.env("IRONBIRD_ROOT", rig.root());
    let ended = rig.launch(roles).end().expect(0).says("second inner 5\n");
    ended
        .says("already has a running inner")
        .says("RESULT status=PASS");
}

#[test]
fn too_few_inodes_are_named_with_the_remedy() {
    let rig = Rig::new("inodes");
    for inodes in [2, 3, 4, 6, 9, 12] {
        let mount = format!("mount -t tmpfs -o size=256m,nr_inodes={inodes} tmpfs /dev/shm");
        let Some(mut plant) = in_own_mounts(&mount, "true", rig::IRONBIRD) else {
            return;
        };
        plant.arg("plant").args(rig.own_args("plant", "--rt off"));
        plant.env("IRONBIRD_ROOT", rig.root());
        let plant = rig.launch(plant).end();
        assert!(
            matches!(plant.code, Some(1 | 2)),
            "{inodes} inodes: {plant}"
        );
        assert!(
            !plant.stderr.contains("ironbird clean"),
            "{inodes} inodes: {plant}"
        );
        plant.complains("/dev/shm");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn too_few_files_are_named_with_the_remedy() {
    let mut refused = 0;
    for files in [20, 40, 56, 64, 72, 76, 80, 84, 100] {
        let rig = Rig::new("files");
        let slow = rig.slow(5);
        let args = format!("--rt off --config {slow} --duration 100ms");
        let mut plant = Command::new("sh");
        plant.args([
            "-c",
            "ulimit -n $1; shift; exec \"$@\"",
            "sh",
            &files.to_string(),
            rig::IRONBIRD,
            "plant",
        ]);
        plant
            .args(rig.own_args("plant", &args))
            .env("IRONBIRD_ROOT", rig.root());
        let others = ["outer", "inner", "mixer"].map(|role| rig.start(role, &args));
        let record = rig.start("record", &args);
        let plant = rig.launch(plant).end();
        if plant.code != Some(0) {
            refused += 1;
            assert!(matches!(plant.code, Some(1 | 2)), "{files} files: {plant}");
            let plant = plant.complains("ulimit -n 1024");
            // The system's own words begin with a capital.
            assert!(
                plant.stderr.to_lowercase().contains("too many open files"),
                "{files} files: {plant}"
            );
            assert!(
                !plant.stderr.contains("ironbird clean"),
                "{files} files: {plant}"
            );
        }
        // Without a plant they wait; with one, they end with it.
        for mut role in others.into_iter().chain([record]) {
            if role.is_running() {
                role.signal(Signal::TERM);
            }
            role.end();
        }
    }
    assert!(
        refused > 0,
        "no limit was too low: the test has lost its subject"
    );
}
