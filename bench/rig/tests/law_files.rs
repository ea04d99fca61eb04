//! Laws of shared libraries: they fly, are logged and replayed; what is wrong with a file is named, and nothing starts.

use crate::rig;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use crate::c_laws::{cascade, library, root};
use crate::rig::unprivileged::unprivileged;
use crate::rig::{Ended, Rig, copy_executable, table};

/// Root mean square of the position error that `simulate` tells [m].
fn rms_m(flown: &Ended) -> f64 {
    let (_, rest) = flown.stdout.split_once("position error rms ").unwrap();
    rest.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn the_example_is_built_by_the_line_in_it_and_flies_as_well_as_the_fixed_law() {
    let rig = Rig::new("example");
    let source = fs::read_to_string(root().join("examples/law_c/cascade.c")).unwrap();
    assert!(source.lines().count() <= 100, "{}", source.lines().count());
    let line = source
        .lines()
        .find_map(|line| line.strip_prefix("//     cc "))
        .unwrap();
    let line = line.replace(
        "-o libcascade.so",
        &format!("-o {}", rig.file("libcascade.so")),
    );
    let built = Command::new("gcc")
        .args(["-Wall", "-Wextra", "-Werror"])
        .args(line.split(' '))
        .current_dir(root())
        .status()
        .unwrap();
    assert!(built.success(), "{line}");
    let fly = |law: &str| rig.ok(&format!("simulate --trajectory lissajous --inner {law}"));
    let (ours, fixed) = (rms_m(&fly("./libcascade.so")), rms_m(&fly("fixed")));
    assert!(ours <= fixed, "{ours} m, and `fixed` {fixed} m");
}

#[test]
fn the_header_is_read_by_compilers_of_c_and_of_cpp() {
    let header = root().join("shared/ironbird_law/include/ironbird_law.h");
    for compiler in [["gcc", "-xc", "-std=c11"], ["g++", "-xc++", "-std=c++17"]] {
        let [program, flags @ ..] = compiler;
        let mut command = Command::new(program);
        command.args(flags).args([
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Werror",
            "-fsyntax-only",
            "-include",
        ]);
        match command.arg(&header).arg("/dev/null").status() {
            Ok(status) => assert!(status.success(), "{program}"),
            Err(e) => {
                assert_eq!((program, e.kind()), ("g++", std::io::ErrorKind::NotFound));
                rig::not_tested("g++ is not there");
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
    let flown = &rig.report()["run"]["laws"]["inner"];
    assert_eq!(
        (&flown["name"], &flown["version"], &flown["file"]),
        (&"cascade".into(), &"1".into(), &law.clone().into())
    );
    assert_eq!(flown["sha256"].as_str().unwrap().len(), 64);
    rig.ok("report --full")
        .says("laws outer pd, inner cascade (libcascade.so), mixer priority");
    let simulated = rig.run("simulate", &flight).expect(0).result();
    let identical = format!("identical; outputs {}\n", simulated["outputs"]);
    rig.ok("replay --verify").says(&identical);

    fs::rename(&law, rig.file("moved.so")).unwrap();
    let gone = rig.refused("replay --verify");
    gone.complains("cannot read the law")
        .complains("libcascade.so: No such file")
        .complains("--inner | --mixer FILE");
    rig.ok(&format!("replay --verify --inner {}", rig.file("moved.so")))
        .says(&identical);
    let other = library(&rig, "other.so", "examples/law_c/cascade.c", &["-O1"]);
    let refused = rig.refused(&format!("replay --verify --inner {other}"));
    let sums = format!(
        "but the settings were made for {law} with {}",
        flown["sha256"].as_str().unwrap()
    );
    refused
        .complains("other.so: its SHA-256 is")
        .complains(&sums);
    let built_in = rig.refused(&format!("replay --outer {other}"));
    built_in.complains("the flight flew the outer law `pd`, which is built in");
}

#[test]
fn every_role_flies_a_library() {
    let rig = Rig::new("roles");
    let law =
        |name: &str, role: &str| library(&rig, name, "bench/rig/tests/laws_c/others.c", &[role]);
    let (outer, mixer) = (
        law("outer.so", "-DROLE=IRONBIRD_OUTER"),
        law("mixer.so", "-DROLE=IRONBIRD_MIXER"),
    );
    let flight = format!(
        "--outer {outer} --inner {} --mixer {mixer} --duration 1s",
        cascade(&rig)
    );
    let simulated = rig.run("simulate", &flight).expect(0);
    assert!(rms_m(&simulated) < 0.05, "{simulated}");
    rig.ok(&format!("fly {flight} --pace lockstep"));
    let replayed = rig.ok("replay --verify");
    replayed.says(&format!(
        "identical; outputs {}\n",
        simulated.result()["outputs"]
    ));
    let laws = &rig.report()["run"]["laws"];
    assert_eq!(
        (&laws["outer"]["name"], &laws["mixer"]["name"]),
        (&"follow".into(), &"mix".into())
    );
    let swapped = rig.refused(&format!("simulate --outer {mixer}"));
    swapped
        .complains("`mix` is a law of the role mixer, and not of outer")
        .complains("fly it with --mixer");
}

#[test]
fn a_file_is_meant_beside_the_settings_that_name_it_and_all_roles_mean_the_same_content() {
    let rig = Rig::new("beside");
    cascade(&rig);
    let config = rig.settings("[inner]\nlaw = \"libcascade.so\"\nrate_1_s = 150\n");
    let printed = rig.ok(&format!("fly --config {config} --print-config"));
    let printed = printed
        .says(&format!(
            "law = \"{}\"\nsha256 = \"",
            rig.file("libcascade.so")
        ))
        .says("rate_1_s = 150");
    let mut elsewhere = rig.command("simulate", format!("--config {config} --duration 100ms"));
    elsewhere.current_dir("/");
    assert!(elsewhere.output().unwrap().status.success());
    let kept = rig.settings(&printed.stdout);
    library(&rig, "libcascade.so", "examples/law_c/cascade.c", &["-O1"]);
    for command in ["fly", "simulate", "plant", "inner", "record"] {
        let refused = rig.run(command, format!("--config {kept}")).expect(2);
        refused
            .complains("its SHA-256 is ")
            .complains("take inner.sha256 out of the settings");
    }
    rig.assert_nothing_started();
}

#[test]
fn settings_and_presets_of_a_library_are_checked_as_those_of_a_built_in_law() {
    let rig = Rig::new("settings");
    cascade(&rig);
    for (text, told) in [
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
            rig.run(command, format!("--config {config}"))
                .expect(2)
                .complains(told);
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
fn a_law_that_cannot_be_copied_is_not_told_as_rehearsed() {
    let rig = Rig::new("copies-not");
    let mixer = library(
        &rig,
        "mixer.so",
        "bench/rig/tests/laws_c/others.c",
        &["-DROLE=IRONBIRD_MIXER"],
    );
    let settings = rig.settings("[flight]\nslowdown = 10\nduration_s = 0.05\n");
    rig.ok(&format!(
        "fly --rt off --config {settings} --lead 4000 --mixer {mixer}"
    ));
    let lead = &rig.report()["lead"];
    assert!(
        lead["rehearsal_us"].as_f64().unwrap() > 0.0,
        "outer and inner loop are rehearsed: {lead}"
    );
    assert_eq!(lead["rehearsals"], 0, "{lead}");
}

#[test]
fn files_whose_laws_have_one_name_are_not_compared() {
    let rig = Rig::new("namesakes");
    let (one, other) = (
        cascade(&rig),
        library(&rig, "other.so", "examples/law_c/cascade.c", &["-O1"]),
    );
    let refused = rig.refused(&format!(
        "compare --inner {one} --inner {other} --duration 100ms"
    ));
    let told =
        format!("{one} and {other} have one name: both would be told as pd + cascade + priority");
    refused
        .complains(&told)
        .complains("give one of the two laws another name");
    rig.ok(&format!(
        "compare --inner {one} --inner pid --duration 100ms"
    ))
    .says("pd + cascade");
}

#[test]
fn settings_of_a_file_are_not_taken_for_another_one() {
    let rig = Rig::new("another");
    let mixer = |name: &str, flags: &[&str]| {
        library(
            &rig,
            name,
            "bench/rig/tests/laws_c/others.c",
            &[&["-DROLE=IRONBIRD_MIXER"], flags].concat(),
        )
    };
    let printed = |flags: &[&str]| {
        rig.settings(
            &rig.run("fly", [flags, &["--print-config"]].concat())
                .expect(0)
                .stdout,
        )
    };
    let (law, other) = (
        cascade(&rig),
        library(&rig, "other.so", "examples/law_c/cascade.c", &["-O1"]),
    );
    let config = printed(&["--inner", &law]);
    let refused = rig.refused(&format!("simulate --config {config} --inner {other}"));
    refused.complains(&format!(
        "its section [inner] is of the law `{law}`, and would go before those of --inner {other}"
    ));
    rig.ok(&format!(
        "simulate --config {config} --inner ./libcascade.so --duration 100ms"
    ));
    // Without settings of its own there is nothing to be mixed, and the sum goes with its file.
    let config = printed(&["--mixer", &mixer("one.so", &[])]);
    for flag in ["priority", mixer("two.so", &["-O1"]).as_str()] {
        rig.ok(&format!(
            "simulate --config {config} --mixer {flag} --duration 100ms"
        ));
    }
}

#[test]
fn what_is_no_law_is_named_and_nothing_starts() {
    let rig = Rig::new("no-law");
    let whole = fs::read(cascade(&rig)).unwrap();
    let changed = |at: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        bytes
    };
    let other_machine = if std::env::consts::ARCH == "x86_64" {
        183
    } else {
        62
    };
    fs::write(rig.file("text.so"), "#!/bin/sh\n").unwrap();
    fs::write(rig.file("empty.so"), "").unwrap();
    fs::write(rig.file("cut.so"), &whole[..whole.len() / 2]).unwrap();
    fs::write(rig.file("foreign.so"), changed(18, other_machine)).unwrap();
    fs::write(rig.file("object.so"), changed(16, 1)).unwrap();
    fs::create_dir(rig.file("folder.so")).unwrap();
    fs::write(rig.file("plain.c"), "int nothing;\n").unwrap();
    let plain = [
        "-shared",
        "-fPIC",
        "-o",
        &rig.file("plain.so"),
        &rig.file("plain.c"),
    ];
    assert!(Command::new("gcc").args(plain).status().unwrap().success());
    for [file, error, remedy] in table(include_str!("law_file_refusals.md")) {
        for command in ["fly", "simulate", "mixer"] {
            let named = format!("./{file}");
            rig.run(command, format!("--inner {named}"))
                .expect(2)
                .complains(&named)
                .complains(error)
                .complains(remedy);
        }
        rig.refused(&format!("laws ./{file}")).complains(error);
    }
    rig.assert_nothing_started();
}

#[test]
fn a_law_that_may_not_be_read_is_named() {
    let rig = Rig::new("closed");
    let law = cascade(&rig);
    fs::set_permissions(&law, fs::Permissions::from_mode(0o000)).unwrap();
    let Some(command) = unprivileged(&rig, "simulate", format!("--inner {law}")) else {
        return;
    };
    rig.launch(command)
        .end()
        .expect(2)
        .complains("cannot read the law")
        .complains("Permission denied");
}

#[test]
fn a_law_in_python_is_handed_to_the_adapter_and_without_one_its_command_is_told() {
    let rig = Rig::new("adapter");
    let adapter = library(&rig, "adapter.so", "bench/rig/tests/laws_c/adapter.c", &[]);
    let (hover, weak) = (rig.file("hover_law.py"), rig.file("weak_law.py"));
    fs::write(&hover, "# 1.0\n").unwrap();
    fs::write(&weak, "# 0.5\n").unwrap();
    fs::write(rig.file("wrong.py"), "import os\n").unwrap();
    let run = |command: &str, args: &[&str]| {
        let mut command = rig.command(command, args);
        command.env("IRONBIRD_PYTHON_ADAPTER", &adapter);
        rig.launch(command).end()
    };
    let flight = [
        "--inner",
        &hover,
        "--trajectory",
        "hover",
        "--duration",
        "500ms",
    ];
    let simulated = run("simulate", &flight).expect(0);
    run("fly", &[&flight[..], &["--pace", "lockstep"]].concat()).expect(0);
    assert_eq!(rig.report()["run"]["laws"]["inner"]["not_real_time"], true);
    run("report", &["--full"])
        .expect(0)
        .says("inner hover_law (hover_law.py, not real-time)");
    run("replay", &["--verify"])
        .expect(0)
        .says(&simulated.result()["outputs"]);
    run("replay", &["--inner", &weak])
        .expect(2)
        .complains("weak_law.py: its SHA-256 is");
    run("laws", &[&hover])
        .expect(0)
        .says("not real-time: it promises nothing about its time")
        .says("rehearsal  no");
    run("simulate", &["--inner", &rig.file("wrong.py")])
        .expect(2)
        .complains("wrong.py: line 1: expected `# FACTOR`");
    // Beside a copy of the executable there is no adapter.
    let copy = rig.path("alone");
    copy_executable(&copy);
    let mut alone = Command::new(&copy);
    alone
        .arg("simulate")
        .args(rig.own_args("simulate", ["--inner", &hover]))
        .env("IRONBIRD_ROOT", rig.root());
    let none = rig.launch(alone).end().expect(2);
    none.complains("hover_law.py: a law in Python needs libironbird_python.so")
        .complains(
            "build it: python/build (docs/python.md); or name it with IRONBIRD_PYTHON_ADAPTER",
        );
    let with_adapter = |adapter: &str, words: [&str; 3]| {
        let mut command = rig.command("simulate", format!("--inner {hover}"));
        command.env("IRONBIRD_PYTHON_ADAPTER", adapter);
        let ended = rig.launch(command).end().expect(2);
        assert!(!ended.stderr.contains("cc ... -lm"), "{ended}");
        words.into_iter().fold(ended, Ended::complains);
    };
    let adapter = "error: the adapter for laws in Python, ";
    let no_function = "it exports no function `ironbird_law_open`";
    with_adapter(
        &cascade(&rig),
        [adapter, no_function, "IRONBIRD_PYTHON_ADAPTER"],
    );
    with_adapter(&weak, [adapter, "it cannot be loaded: ", "python/build"]);
    let absent = "error: IRONBIRD_PYTHON_ADAPTER names /nope, and there is no such file";
    with_adapter("/nope", [absent, absent, "python/build"]);
}
