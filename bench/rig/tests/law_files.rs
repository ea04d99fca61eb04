//! Laws of shared libraries: they fly, are logged and replayed; what is wrong with a file is named, and nothing starts.

use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use crate::c_laws::{cascade, library, mixer, other_cascade, root};
use crate::rig::unprivileged::unprivileged;
use crate::rig::{Ended, Rig, copy_executable, not_tested, table};

/// Root mean square of the position error that `simulate` prints [m].
fn rms_m(flown: &Ended) -> f64 {
    let (_, rest) = flown.stdout.split_once("position error rms ").unwrap();
    rest.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn the_example_is_built_by_its_own_command_and_flies_as_well_as_the_fixed_law() {
    let rig = Rig::new("example");
    let source = fs::read_to_string(root().join("examples/law_c/cascade.c")).unwrap();
    assert!(source.lines().count() <= 100, "{}", source.lines().count());
    let mut commands = source
        .lines()
        .filter_map(|line| line.strip_prefix("//     cc "));
    let output = format!("-o {}", rig.file("libcascade.so"));
    let command = commands
        .next()
        .unwrap()
        .replace("-o libcascade.so", &output);
    let mut gcc = Command::new("gcc");
    gcc.args(["-Wall", "-Wextra", "-Werror"])
        .args(command.split(' '));
    assert!(
        gcc.current_dir(root()).status().unwrap().success(),
        "{command}"
    );
    let fly = |law: &str| rms_m(&rig.ok(&format!("simulate --trajectory lissajous --inner {law}")));
    let (ours, fixed) = (fly("./libcascade.so"), fly("fixed"));
    assert!(ours <= fixed, "{ours} m, and `fixed` {fixed} m");
}

#[test]
fn compilers_of_c_and_of_cpp_accept_the_header() {
    let header = root().join("shared/ironbird_law/include/ironbird_law.h");
    for (program, language) in [("gcc", "-xc -std=c11"), ("g++", "-xc++ -std=c++17")] {
        let flags = format!("{language} -Wall -Wextra -Wpedantic -Werror -fsyntax-only -include");
        let mut command = Command::new(program);
        command.args(flags.split(' ')).arg(&header).arg("/dev/null");
        match command.status() {
            Ok(status) => assert!(status.success(), "{program}"),
            Err(e) => {
                assert_eq!((program, e.kind()), ("g++", ErrorKind::NotFound));
                not_tested("g++ is not installed");
            }
        }
    }
}

#[test]
fn a_library_flies_in_processes_as_in_simulation_and_its_log_is_replayed() {
    let rig = Rig::new("library");
    let law = cascade(&rig);
    let flight = format!("--inner {law} --duration 600ms");
    rig.ok(&format!("fly {flight} --pace lockstep"));
    let flown = rig.report()["run"]["laws"]["inner"].clone();
    for (key, value) in [("name", "cascade"), ("version", "1"), ("file", &law)] {
        assert_eq!(flown[key], value);
    }
    let sha256 = flown["sha256"].as_str().unwrap();
    assert_eq!(sha256.len(), 64);
    rig.ok("report --full")
        .says("laws outer pd, inner cascade (libcascade.so), mixer priority");
    let outputs = rig.ok(&format!("simulate {flight}")).result()["outputs"].clone();
    let identical = format!("identical; outputs {outputs}\n");
    rig.ok("replay --verify").says(&identical);

    let moved = rig.file("moved.so");
    fs::rename(&law, &moved).unwrap();
    rig.refused("replay --verify")
        .complains("cannot read the law")
        .complains("libcascade.so: No such file")
        .complains("--inner | --mixer FILE");
    rig.ok(&format!("replay --verify --inner {moved}"))
        .says(&identical);
    let other = other_cascade(&rig);
    rig.refused(&format!("replay --verify --inner {other}"))
        .complains("other.so: its SHA-256 is")
        .complains(&format!(
            "but the settings were made for {law} with {sha256}"
        ));
    rig.refused(&format!("replay --outer {other}"))
        .complains("the flight flew the outer law `pd`, which is built in");
}

#[test]
fn every_role_flies_a_library_and_one_without_copies_is_not_rehearsed() {
    let rig = Rig::new("roles");
    let source = "bench/rig/tests/laws_c/others.c";
    let outer = library(&rig, "outer.so", source, &["-DROLE=IRONBIRD_OUTER"]);
    let (inner, mixer) = (cascade(&rig), mixer(&rig, "mixer.so", &[]));
    let flight = format!("--outer {outer} --inner {inner} --mixer {mixer} --duration 1s");
    let simulated = rig.ok(&format!("simulate {flight}"));
    assert!(rms_m(&simulated) < 0.05, "{simulated}");
    rig.ok(&format!("fly {flight} --pace lockstep"));
    let outputs = &simulated.result()["outputs"];
    rig.ok("replay --verify")
        .says(&format!("identical; outputs {outputs}\n"));
    let laws = &rig.report()["run"]["laws"];
    assert_eq!(
        (&laws["outer"]["name"], &laws["mixer"]["name"]),
        (&"follow".into(), &"mix".into())
    );
    rig.refused(&format!("simulate --outer {mixer}"))
        .complains("`mix` is a law of the role mixer, and not of outer")
        .complains("fly it with --mixer");
    let slow = rig.settings("[flight]\nslowdown = 10\nduration_s = 0.05\n");
    rig.ok(&format!(
        "fly --rt off --config {slow} --lead 4000 --mixer {mixer}"
    ));
    let lead = &rig.report()["lead"];
    // Outer and inner loop are rehearsed, and the mixer cannot be.
    assert!(lead["rehearsal_us"].as_f64() > Some(0.0), "{lead}");
    assert_eq!(lead["rehearsals"], 0, "{lead}");
}

#[test]
fn a_path_is_relative_to_the_settings_and_the_content_is_the_same_for_all_roles() {
    let rig = Rig::new("beside");
    let law = cascade(&rig);
    let config = rig.settings("[inner]\nlaw = \"libcascade.so\"\nrate_1_s = 150\n");
    let printed = rig.ok(&format!("fly --config {config} --print-config"));
    let printed = printed
        .says(&format!("law = \"{law}\"\nsha256 = \""))
        .says("rate_1_s = 150");
    let mut elsewhere = rig.command("simulate", format!("--config {config} --duration 100ms"));
    assert!(
        elsewhere
            .current_dir("/")
            .output()
            .unwrap()
            .status
            .success()
    );
    let kept = rig.settings(&printed.stdout);
    library(&rig, "libcascade.so", "examples/law_c/cascade.c", &["-O1"]);
    for command in ["fly", "simulate", "plant", "inner", "record"] {
        rig.refused(&format!("{command} --config {kept}"))
            .complains("its SHA-256 is ")
            .complains("take inner.sha256 out of the settings");
    }
    rig.assert_nothing_started();
}

#[test]
fn settings_and_presets_of_a_library_are_checked_like_those_of_a_built_in_law() {
    let rig = Rig::new("settings");
    cascade(&rig);
    for (text, error) in [
        (
            "rate_1_s = 1000",
            "inner.rate_1_s = 1000.0 is out of range: allowed is 1 to 900 1/s",
        ),
        (
            "rate_1_s = \"high\"",
            "inner.rate_1_s = \"high\": expected a number",
        ),
        ("rat_1_s = 100", "unknown key `inner.rat_1_s` of the law"),
        (
            "rate_1_s = 5",
            "refuses its settings: attitude_1_s = 8 is above rate_1_s = 5",
        ),
    ] {
        let config = rig.settings(&format!("[inner]\nlaw = \"./libcascade.so\"\n{text}\n"));
        for command in ["fly", "simulate", "inner"] {
            rig.refused(&format!("{command} --config {config}"))
                .complains(error);
        }
    }
    rig.refused("fly --inner ./libcascade.so --preset gentle")
        .complains(
            "unknown preset `gentle` of the chosen laws [possible values: flight, paper, soft]",
        );
    rig.ok("laws ./libcascade.so")
        .says("cascade: attitude P on Euler angles and rate PI")
        .says("rate_1_s = 200.0 [1/s]")
        .says("interface  version 1")
        .says("rehearsal  yes");
    rig.assert_nothing_started();
}

#[test]
fn two_files_are_not_confused() {
    let rig = Rig::new("another");
    let (law, other) = (cascade(&rig), other_cascade(&rig));
    rig.refused(&format!(
        "compare --inner {law} --inner {other} --duration 100ms"
    ))
    .complains(&format!(
        "{law} and {other} have one name: both would be called"
    ))
    .complains("give one of the two laws another name");
    rig.ok(&format!(
        "compare --inner {law} --inner pid --duration 100ms"
    ))
    .says("pd + cascade");
    let printed =
        |flags: &str| rig.settings(&rig.ok(&format!("fly {flags} --print-config")).stdout);
    let config = printed(&format!("--inner {law}"));
    rig.refused(&format!("simulate --config {config} --inner {other}"))
        .complains(&format!(
            "its section [inner] is of the law `{law}`, and would go before those of --inner {other}"
        ));
    rig.ok(&format!(
        "simulate --config {config} --inner ./libcascade.so --duration 100ms"
    ));
    // Without settings of its own there is nothing to confuse, and the checksum belongs to its file.
    let config = printed(&format!("--mixer {}", mixer(&rig, "one.so", &[])));
    for flag in ["priority", &mixer(&rig, "two.so", &["-O1"])] {
        rig.ok(&format!(
            "simulate --config {config} --mixer {flag} --duration 100ms"
        ));
    }
}

#[test]
fn a_file_without_a_law_is_named_and_nothing_starts() {
    let rig = Rig::new("no-law");
    let law = cascade(&rig);
    let whole = fs::read(&law).unwrap();
    let changed = |at: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        bytes
    };
    let is_x86 = std::env::consts::ARCH == "x86_64";
    for (file, bytes) in [
        ("text.so", b"#!/bin/sh\n".to_vec()),
        ("empty.so", Vec::new()),
        ("cut.so", whole[..whole.len() / 2].to_vec()),
        ("foreign.so", changed(18, if is_x86 { 183 } else { 62 })),
        ("object.so", changed(16, 1)),
        ("plain.c", b"int nothing;\n".to_vec()),
        ("data.c", b"int ironbird_law = 1;\n".to_vec()),
    ] {
        fs::write(rig.file(file), bytes).unwrap();
    }
    fs::create_dir(rig.file("folder.so")).unwrap();
    for name in ["plain", "data"] {
        let [output, source] = ["so", "c"].map(|kind| rig.file(&format!("{name}.{kind}")));
        let mut gcc = Command::new("gcc");
        gcc.args(["-shared", "-fPIC", "-o", &output, &source]);
        assert!(gcc.status().unwrap().success());
    }
    for [file, error, remedy] in table(include_str!("law_file_refusals.md")) {
        for command in ["fly", "simulate", "mixer"] {
            rig.refused(&format!("{command} --inner ./{file}"))
                .complains(&format!("./{file}"))
                .complains(error)
                .complains(remedy);
        }
        rig.refused(&format!("laws ./{file}")).complains(error);
    }
    rig.assert_nothing_started();
    fs::set_permissions(&law, fs::Permissions::from_mode(0o000)).unwrap();
    if let Some(command) = unprivileged(&rig, "simulate", format!("--inner {law}")) {
        let refused = rig.launch(command).end().expect(2);
        refused
            .complains("cannot read the law")
            .complains("Permission denied");
    }
}

#[test]
fn a_law_in_python_is_passed_to_the_adapter_and_without_one_the_error_says_how_to_build_it() {
    let rig = Rig::new("adapter");
    let adapter = library(&rig, "adapter.so", "bench/rig/tests/laws_c/adapter.c", &[]);
    for (file, text) in [
        ("hover_law.py", "# 1.0\n"),
        ("weak_law.py", "# 0.5\n"),
        ("wrong.py", "import os\n"),
    ] {
        fs::write(rig.file(file), text).unwrap();
    }
    let run = |adapter: &str, line: &str| {
        let (command, args) = line.split_once(' ').unwrap();
        let mut command = rig.command(command, args);
        command.env("IRONBIRD_PYTHON_ADAPTER", adapter);
        rig.launch(command).end()
    };
    let flight = "--inner ./hover_law.py --trajectory hover --duration 500ms";
    let simulated = run(&adapter, &format!("simulate {flight}")).expect(0);
    run(&adapter, &format!("fly {flight} --pace lockstep")).expect(0);
    assert_eq!(rig.report()["run"]["laws"]["inner"]["not_real_time"], true);
    for (line, code, words) in [
        (
            "report --full",
            0,
            "inner hover_law (hover_law.py, not real-time)",
        ),
        ("replay --verify", 0, simulated.result()["outputs"].as_str()),
        (
            "replay --inner ./weak_law.py",
            2,
            "weak_law.py: its SHA-256 is",
        ),
        (
            "laws ./hover_law.py",
            0,
            "not real-time: it promises nothing about its time",
        ),
        ("laws ./hover_law.py", 0, "rehearsal  no"),
        (
            "simulate --inner ./wrong.py",
            2,
            "wrong.py: line 1: expected `# FACTOR`",
        ),
    ] {
        let ended = run(&adapter, line).expect(code);
        let text = format!("{}{}", ended.stdout, ended.stderr);
        assert!(text.contains(words), "no `{words}` in {ended}");
    }
    // There is no adapter next to a copy of the executable.
    let copy = rig.path("alone");
    copy_executable(&copy);
    let mut alone = Command::new(&copy);
    alone.args(["simulate", "--inner", &rig.file("hover_law.py")]);
    alone.env("IRONBIRD_ROOT", rig.root());
    let refused = rig.launch(alone).end().expect(2);
    refused
        .complains("hover_law.py: a law in Python needs libironbird_python.so")
        .complains(
            "build it: python/build (docs/python.md); or name it with IRONBIRD_PYTHON_ADAPTER",
        );
    let adapter = "error: the adapter for laws in Python, ";
    let absent = "error: IRONBIRD_PYTHON_ADAPTER names /nope, and there is no such file";
    let no_function = "it exports no function `ironbird_law_open`";
    for (file, error, why, remedy) in [
        (
            cascade(&rig),
            adapter,
            no_function,
            "IRONBIRD_PYTHON_ADAPTER",
        ),
        (
            rig.file("weak_law.py"),
            adapter,
            "it cannot be loaded: ",
            "python/build",
        ),
        ("/nope".into(), absent, absent, "python/build"),
    ] {
        let refused = run(&file, "simulate --inner ./hover_law.py").expect(2);
        assert!(!refused.stderr.contains("cc ... -lm"), "{refused}");
        refused.complains(error).complains(why).complains(remedy);
    }
}
