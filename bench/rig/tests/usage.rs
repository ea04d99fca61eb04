//! What users get wrong, and what the machine refuses.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{IRONBIRD, Rig, in_own_mounts, not_tested};
use clap::CommandFactory as _;
use ironbird::cli::Cli;
use serde_json::json;

#[test]
fn every_command_explains_itself() {
    let rig = Rig::new("help");
    let run = |args: &[&str]| {
        let mut command = Command::new(IRONBIRD);
        command.args(args).env("IRONBIRD_ROOT", rig.root());
        rig.launch(command).end()
    };
    let overview = run(&["--help"]).expect(0);
    let shown = Cli::command();
    let shown: Vec<&str> = shown.get_subcommands().filter(|it| !it.is_hide_set()).map(|it| it.get_name()).collect();
    assert!(shown.len() > 15, "{shown:?}");
    for command in shown {
        assert!(
            overview.stdout.lines().any(|line| line.trim_start().starts_with(&format!("{command} "))),
            "{overview}"
        );
        let help = run(&[command, "--help"]).expect(0);
        let first = help.stdout.lines().next().unwrap();
        assert!(first.len() > 10 && help.stdout.contains(&format!("Usage: ironbird {command}")), "{help}");
        let hidden = help.stdout.contains("--launcher") || help.stdout.contains("--run-dir");
        assert!(!hidden, "what launcher and roles tell each other is no flag for users: {help}");
    }
    run(&[]).expect(2).complains("Usage: ironbird");
    run(&["hover"]).expect(2).complains("unrecognized subcommand 'hover'");
    rig.assert_nothing_started();
}

#[test]
fn every_wrong_argument_is_named_with_what_is_allowed_and_nothing_starts() {
    let rig = Rig::new("arguments");
    for (command, args, words) in [
        (
            "fly",
            &["--trajectory", "loop"][..],
            "invalid value 'loop' for '--trajectory <TRAJECTORY>' [possible values: hover, step, helix, lissajous, fast]",
        ),
        ("fly", &["--preset", "race"], "[possible values: flight, paper, soft]"),
        (
            "fly",
            &["--inner", "adaptiv"],
            "there is no inner law of that name; there are adaptive, indi, geometric, pid, fixed",
        ),
        ("simulate", &["--outer", "pid"], "outer.law = \"pid\": there is no outer law of that name; there are pd"),
        ("mixer", &["--mixer", "least"], "there is no mixer law of that name; there are priority"),
        ("fly", &["--inner", "fixed", "--gate", "theorem"], "the inner law `fixed` has no theorem with these settings"),
        ("laws", &["fixt"], "no law is named `fixt`; there are fixed, "),
        ("fly", &["--duration", "3parsecs"], "invalid value '3parsecs' for '--duration <DURATION>': unknown time unit"),
        ("fly", &["--duration", "0s"], "flight.duration_s = 0 is out of range: allowed are 0.001 to 2592000"),
        ("fly", &["--duration", "31d"], "flight.duration_s = 2678400 is out of range: allowed are 0.001 to 2592000"),
        ("fly", &["--log", "misses"], "[possible values: all, around-misses, off]"),
        ("record", &["--log", "none"], "[possible values: all, around-misses, off]"),
        ("fly", &["--rt", "maybe"], "[possible values: require, prefer, off]"),
        ("fly", &["--cpu", "9999"], "rt.cpu = 9999: allowed are a processor's number and \"auto\""),
        ("fly", &["--cpu", "1023"], "rt.cpu = 1023: this process may use the processors 0"),
        ("fly", &["--cpu", "1023"], "name one of them with --cpu N"),
        ("inner", &["--cpu", "1023"], "rt.cpu = 1023: this process may use the processors 0"),
        ("fly", &["--config", "/dev/zero"], "cannot read the settings file /dev/zero: it is not a regular file"),
        ("fly", &["--states", "/"], "--states: cannot write /: Is a directory"),
        ("fly", &["--every", "0"], "invalid value '0' for '--every <N>': write a whole number from 1 to 1000000000"),
        (
            "fly",
            &["--max-miss-rate", "few"],
            "invalid value 'few' for '--max-miss-rate <PPM>': write a number of 0 or more",
        ),
        ("fly", &["--max-loop-p999", "nan"], "invalid value 'nan' for '--max-loop-p999 <US>': write a number of 0 or"),
        (
            "fly",
            &["--duration", "3"],
            "time unit needed, for example 3sec or 3ms; write a number of 0 or more and its unit",
        ),
        ("fly", &["--duration", "-3s"], "for '--duration <DURATION>': a time is not negative; write a number"),
        ("fly", &["--duration", "0s"], "`ironbird fly --print-config` explains every setting"),
        ("fly", &["--floor", "-3s"], "for '--floor <DURATION>': a time is not negative; write a number"),
        (
            "fly",
            &["--lead", "soon"],
            "invalid value 'soon' for '--lead <US>': write whole microseconds, as in 150, or auto",
        ),
        ("fly", &["--lead", "-1"], "for '--lead <US>': write whole microseconds"),
        (
            "fly",
            &["--lead", "501"],
            "rt.lead_us = 501: allowed are \"auto\" and whole microseconds from 0 (at the tick) to 500: half a period",
        ),
        (
            "plant",
            &["--rehearse", "maybe"],
            "invalid value 'maybe' for '--rehearse <BOOL>' [possible values: true, false]",
        ),
        ("fly", &["--cpu", "auto"], "for '--cpu <N>': no processor has this number; write 0, 1 and so on"),
        ("fly", &["--config", "nofile"], "cannot read the settings file nofile: No such file or directory"),
        ("fly", &["--config", "nofile"], "`ironbird fly --print-config` writes one to begin with"),
        (
            "fly",
            &["--states", "/nowhere/s.csv"],
            "help: name a file in a directory that is there and that you can write",
        ),
        ("fly", &["--fault", "nope=1@1s"], "unknown parameter `nope` (`ironbird params` lists names"),
        ("fly", &["--fault", "nope=1@1s"], "`ironbird params` lists names, units and ranges"),
        (
            "fly",
            &["--fault", "rotor_efficiency_1=7@1s"],
            "rotor_efficiency_1 = 7 is out of range: allowed are 0.0 to 1.0 (`ironbird params`",
        ),
        ("simulate", &["--plot", "/nowhere/a.svg"], "--plot: cannot write /nowhere/a.svg: No such file or directory"),
        ("simulate", &["--plot", "/nowhere/a.svg"], "help: name a file in a directory that is there"),
        ("simulate", &["--plot", "a.png"], "--plot a.png: only SVG is drawn"),
        ("simulate", &["--plot", "a.png"], "help: name a file that ends in .svg"),
        ("inject", &["mass_kg=0.6", "--in", "-1s"], "for '--in <TIME>': a time is not negative; write a number"),
        (
            "fly",
            &["--config", "/nowhere/s.toml"],
            "cannot read the settings file /nowhere/s.toml: No such file or directory",
        ),
        ("fly", &["--states", "/nowhere/s.csv"], "--states: cannot write /nowhere/s.csv: No such file or directory"),
        ("fly", &["--instance", "Left Rig"], "instance name `Left Rig` is not allowed: 1 to 32 of the characters a-z"),
        (
            "fly",
            &["--fault", "mass_kg=0.6"],
            "`mass_kg=0.6` has no time: write it behind, as in mass_kg=0.6@8s or mass_kg=0.6@tick8000",
        ),
        ("fly", &["--fault", "mass_kg=0.6@soon"], "`soon` is no instant: write @8s, @500ms or @tick8000"),
        ("fly", &["--fault", "mas_kg=0.6@1s"], "unknown parameter `mas_kg`; did you mean `mass_kg`?"),
        ("fly", &["--fault", "mass_kg=60@1s"], "mass_kg = 60 is out of range: allowed are 0.05 to 5.0 kg"),
        ("fly", &["--fault", "mass_kg=nan@1s"], "mass_kg = NaN is out of range: allowed are 0.05 to 5.0 kg"),
        (
            "fly",
            &["--duration", "1s", "--fault", "mass_kg=0.6@2s"],
            "a fault at tick 2000 never strikes: the flight ends at tick 1000",
        ),
        ("fly", &["--launcher", "1"], "unexpected argument '--launcher' found"),
        ("simulate", &["--fault", "mass_kg@1s"], "`mass_kg` is not an assignment: write NAME=VALUE"),
        (
            "simulate",
            &["--states", "/nowhere/s.csv"],
            "--states: cannot write /nowhere/s.csv: No such file or directory",
        ),
        ("plant", &["--preset", "race"], "[possible values: flight, paper, soft]"),
        ("mixer", &["--instance", ""], "instance name `` is not allowed"),
        ("record", &["--states", "/nowhere/s.csv"], "--states: cannot write /nowhere/s.csv: No such file or directory"),
        ("inject", &[], "required arguments were not provided: <WHAT[=VALUE]>..."),
        ("inject", &["mass_kg"], "`mass_kg` is not an assignment: write NAME=VALUE, as in rotational_drag_nm_s=0.525"),
        ("inject", &["mass_kg=heavy"], "mass_kg = `heavy` is not a number"),
        ("inject", &["mass_kg=-1"], "mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg"),
        (
            "inject",
            &["mass_kg=0.6", "--at-tick", "5", "--in", "1s"],
            "'--at-tick <N>' cannot be used with '--in <TIME>'",
        ),
        ("inject", &["mass_kg=0.6", "--instance", "../up"], "instance name `../up` is not allowed"),
        ("report", &["monday"], "no flight at monday or"),
        ("replay", &["/monday"], "no flight at /monday;"),
        ("report", &["--format", "xml"], "[possible values: text, json, html]"),
        (
            "report",
            &["--section", "all"],
            "[possible values: head, deadlines, outages, deaths, latencies, floors, processes,",
        ),
        ("report", &["--section", "head", "--full"], "'--section <NAME>' cannot be used with '--full'"),
        ("report", &["--full", "--format", "json"], "'--full' cannot be used with '--format <FORMAT>'"),
        ("report", &["--junit", "/nowhere/j.xml"], "--junit: cannot write /nowhere/j.xml: No such file or directory"),
        ("fly", &["--junit", "/nowhere/j.xml"], "--junit: cannot write /nowhere/j.xml: No such file or directory"),
        ("fly", &["--max-skip-rate", "-1"], "invalid value '-1' for '--max-skip-rate <PPM>': write a number of 0 or"),
        ("fly", &["--max-stale-rate", "x"], "invalid value 'x' for '--max-stale-rate <PPM>': write a number of 0 or"),
        ("fly", &["--max-wake-p999", "inf"], "invalid value 'inf' for '--max-wake-p999 <US>': write a number of 0 or"),
        ("fly", &["--max-tracking-error", "1cm"], "invalid value '1cm' for '--max-tracking-error <M>': write a number"),
        ("fly", &["--max-steal", "1%"], "invalid value '1%' for '--max-steal <PERCENT>': write a number of 0 or more"),
    ] {
        rig.run(command, args).expect(2).complains(words);
        rig.assert_nothing_started();
    }
}

#[test]
fn settings_without_end_are_refused_and_so_is_a_processor_that_the_doctor_may_not_use() {
    let rig = Rig::new("endless");
    let pipe = rig.file("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    // Nobody ever writes into it.
    rig.run("fly", &["--config", &pipe]).expect(2).complains(&format!("{pipe}: it is not a regular file"));
    let long = rig.settings(&"# long\n".repeat(200_000));
    rig.run("fly", &["--config", &long]).expect(2).complains(&format!("{long}: it is longer than 1 MiB"));
    rig.assert_nothing_started();
    let mut doctor = Command::new(IRONBIRD);
    doctor.args(["doctor", "--cpu", "1023", "--seconds", "0.1"]).env("IRONBIRD_ROOT", rig.root());
    rig.launch(doctor).end().expect(2).complains("--cpu 1023: this process may use the processors 0");
}

#[test]
fn asking_whether_a_file_can_be_written_does_not_make_it() {
    let rig = Rig::new("untouched");
    let states = rig.file("states.csv");
    rig.run("fly", &["--states", &states, "--instance", "Left Rig"]).expect(2);
    assert!(!fs::exists(&states).unwrap());
    fs::write(&states, "kept").unwrap();
    rig.run("fly", &["--states", &states, "--instance", "Left Rig"]).expect(2);
    assert_eq!(fs::read_to_string(&states).unwrap(), "kept");
}

#[test]
fn a_report_with_numbers_of_no_flight_is_refused() {
    let rig = Rig::new("crafted");
    rig.run("fly", &["--rt", "off", "--config", &rig.slow(5), "--duration", "50ms"]).expect(0);
    let path = rig.out().join("latest/report.json");
    let whole = rig.report();
    for (place, value, words) in [
        ("/series/0/max_us", json!(1e308), "series[0].max_us = 1e+308 is no number of a flight"),
        // Sums of such counts do not fit.
        ("/ticks/skipped", json!(u64::MAX), "ticks.skipped = 18446744073709551615 is no count of a flight"),
    ] {
        let mut report = whole.clone();
        *report.pointer_mut(place).unwrap() = value;
        fs::write(&path, report.to_string()).unwrap();
        for format in ["html", "text"] {
            rig.run("report", &["--format", format]).expect(1).complains(words).complains("report.json");
        }
    }
}

#[test]
fn every_wrong_setting_is_named_with_file_value_and_what_is_allowed() {
    let rig = Rig::new("settings");
    for (text, words) in [
        ("[flihgt]\n", "unknown section [flihgt]; did you mean `flight`?"),
        ("[flight]\nslowdwon = 3\n", "unknown key `flight.slowdwon`; did you mean `slowdown`?"),
        ("[flight]\nslowdown = 0\n", "flight.slowdown = 0 is out of range: allowed are 1 to 1000"),
        ("[flight]\nslowdown = \"slow\"\n", "flight.slowdown = \"slow\": expected a whole number, as in 1"),
        ("[flight]\ntrajectory = \"loop\"\n", "unknown variant `loop`, expected one of"),
        ("[flight]\ntrajectory = \"loop\"\n", "in `flight.trajectory`"),
        ("[flight]\npreset = \"race\"\n", "flight.preset: unknown preset `race`"),
        ("[plant]\nmass_kg = 50\n", "plant.mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg"),
        ("[model]\nwingspan_m = 2\n", "unknown key `model.wingspan_m`"),
        ("[inner]\nattitude_1_s = [8, 8]\n", "inner.attitude_1_s = [8, 8]: expected a list of 3 numbers"),
        ("[inner]\nalpha_1_s = 2000\n", "inner.alpha_1_s = 2000 cannot fly"),
        ("[inner]\nlaw = \"adaptiv\"\n", "inner.law = \"adaptiv\": there is no inner law of that name"),
        (
            "[inner]\nlaw = \"fixed\"\nestimate_min = [0, 0, 0]\n",
            "unknown key `inner.estimate_min` of the law \"fixed\"",
        ),
        ("[inner]\nadaptation = \"maybe\"\n", "allowed is \"on\" or \"off\""),
        ("[inner]\nadaptation = \"off\"\n[recorder]\ngate_theorem = true\n", "`adaptive` has no theorem with these"),
        ("[gains]\nalpha_1_s = 100\n", "`gains.alpha_1_s` is `inner.alpha_1_s`"),
        ("[limits]\ntilt_max_rad = 0.3\n", "`limits.tilt_max_rad` is `outer.tilt_max_rad`"),
        ("[recorder]\nmax_steal_percent = nan\n", "recorder.max_steal_percent = NaN: allowed are 0 to 100, and"),
        ("[recorder]\nmax_steal_percent = 150\n", "recorder.max_steal_percent = 150: allowed are 0 to 100, and"),
        ("[recorder]\nmax_wake_p999_us = inf\n", "recorder.max_wake_p999_us = inf: allowed are 0 and more, and"),
        ("[recorder]\nlog = \"some\"\n", "unknown variant `some`, expected one of `all`, `around-misses`, `off`"),
        ("[rt]\nlead_us = 10.5\n", "rt.lead_us = 10.5: expected a whole number or a string, as in \"auto\""),
        ("[rt]\nlead_us = -1\n", "rt.lead_us = -1: allowed are \"auto\" and whole microseconds from 0"),
        ("[flight]\npace = \"lockstep\"\n[rt]\nlead_us = 501\n", "rt.lead_us = 501: allowed are"),
        ("[recorder]\nlog = 1\n", "recorder.log = 1: expected a string, as in \"all\""),
        ("[recorder]\nlog_around_s = 11\n", "recorder.log_around_s = 11 is out of range: allowed are 0 to 10"),
        ("[recorder]\nlog_file_mb = 0\n", "recorder.log_file_mb = 0 is out of range: allowed are 1 to 1000000"),
        (
            "[recorder]\nlog_files = 1\n",
            "recorder.log_files = 1 is out of range: allowed are 0, for all, and 2 or more",
        ),
        ("[recorder]\nlog_files = -2\n", "recorder.log_files"),
        ("[recorder]\nhlog_every_s = 0\n", "recorder.hlog_every_s = 0 is out of range: allowed are 1 to 3600"),
        ("[rt]\npriority = 99\n", "rt.priority = 99 is out of range: allowed are 1 to 95"),
        ("[rt]\npriority = 99\n", "help: `ironbird fly --print-config` explains every setting"),
        ("[flight\n", "TOML parse error at line 1"),
    ] {
        let path = rig.settings(text);
        for command in ["fly", "simulate", "inner"] {
            let ended = rig.run(command, &["--config", &path]).expect(2).complains(words);
            let named = ended.complains(&path);
            assert!(named.stdout.is_empty(), "{named}");
        }
        rig.assert_nothing_started();
    }
}

#[test]
fn directories_that_cannot_be_used_are_named_with_the_remedy() {
    let rig = Rig::new("places");
    let with_root = |root: &str| {
        let mut command = rig.command("fly", &["--rt", "off"]);
        command.env("IRONBIRD_ROOT", root);
        rig.launch(command).end().expect(2)
    };
    with_root("/proc/nope").complains("cannot use /proc/nope/").complains("another one in IRONBIRD_ROOT");
    let long = format!("/tmp/{}", "x".repeat(60));
    with_root(&long).complains("is 65 characters long; iceoryx2's paths below it need it to be at most 64");
    assert!(!fs::exists(long).unwrap());
    rig.assert_nothing_started();
    let ended = rig.run("fly", &["--rt", "off", "--out", "/proc/nope"]).expect(2);
    ended.complains("cannot record into /proc/nope: No such file or directory").complains("--out DIR");
    assert!(!rig.root().join(&rig.instance).exists(), "what was made for the flight is gone");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn without_privilege_real_time_is_refused_when_required_and_reported_when_preferred() {
    let rig = Rig::new("nobody");
    let slow = rig.slow(5);
    let args = |mode| ["--rt", mode, "--config", &slow, "--duration", "50ms"];
    let Some(required) = fly_unprivileged(&rig, &args("require")) else { return };
    if required.code == Some(0) {
        not_tested("this user is granted real time");
        return;
    }
    required
        .expect(4)
        .complains("real time was required and not granted to the")
        .complains("Scheduler (Operation not permitted (os error 1))")
        .complains("raise the rtprio limit")
        .complains("raise the memlock limit")
        .complains("or fly with what is granted: --rt prefer; without root the same laws fly in lockstep");
    rig.assert_nothing_left();
    let preferred = fly_unprivileged(&rig, &args("prefer")).unwrap().expect(0);
    assert_eq!(preferred.result()["rt"], "other", "{preferred}");
    // Once for all loops, with what he can do.
    let preferred = preferred.says("\nRefused   ").tells("scheduler to all loops: Operation not permitted");
    preferred.tells("those that need no root are --pace lockstep, flight.slowdown (slow motion)");
    rig.run("report", &["--section", "processes"]).expect(0).says("REFUSED (Operation not permitted (os error 1))");
    rig.assert_nothing_left();
}

#[test]
fn a_file_that_a_user_may_not_write_is_named_with_what_to_do() {
    let rig = Rig::new("forbidden");
    let closed = rig.path("closed");
    fs::create_dir(&closed).unwrap();
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o500)).unwrap();
    let states = closed.join("states.csv").display().to_string();
    let Some(ended) = fly_unprivileged(&rig, &["--states", &states]) else { return };
    let ended = ended.expect(2).complains(&format!("--states: cannot write {states}: Permission denied"));
    ended.complains("help: name a file in a directory that is there and that you can write");
    rig.assert_nothing_left();
}

#[test]
fn too_little_shared_memory_is_said_before_anything_starts() {
    let rig = Rig::new("small-shm");
    for command in ["fly", "plant"] {
        let mount = "mount -t tmpfs -o size=4m tmpfs /dev/shm";
        let Some(mut small) = in_own_mounts(mount, "true", IRONBIRD) else { return };
        small.arg(command).args(rig.own_args(command, &["--rt", "off"]));
        small.env("IRONBIRD_ROOT", rig.root());
        rig.launch(small)
            .end()
            .expect(1)
            .complains("shared memory is too small: /dev/shm has 4 MiB free, this instance needs ")
            .complains("enlarge it: mount -o remount,size=256M /dev/shm");
        rig.assert_nothing_started();
    }
}

#[test]
fn a_trace_that_the_kernel_does_not_give_is_refused_before_anything_starts() {
    let rig = Rig::new("untraced");
    // An empty directory where the kernel would have its traces.
    for command in ["fly", "record"] {
        let Some(mut traced) = in_own_mounts("mount -t tmpfs tmpfs /sys/kernel/tracing", "true", IRONBIRD) else {
            return;
        };
        traced.args([command, "--trace"]).args(rig.own_args(command, &["--duration", "1s"]));
        traced.env("IRONBIRD_ROOT", rig.root());
        let refused = rig.launch(traced).end().expect(1);
        refused.complains("cannot trace the loops' processor").complains("without --trace");
        rig.assert_nothing_started();
    }
    rig.assert_nothing_left();
}
