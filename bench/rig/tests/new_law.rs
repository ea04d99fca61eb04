//! `ironbird new law`: what it makes builds, flies and passes its own test; what it refuses is named.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use crate::rig::{IRONBIRD, Rig, lacks_feature, lacks_tool};

fn has_compiler() -> bool {
    let has = Command::new("cc")
        .arg("--version")
        .output()
        .is_ok_and(|it| it.status.success());
    if !has {
        lacks_tool("cc is not there");
    }
    has
}

/// Makes a law, builds it, and says where it is.
fn built(rig: &Rig, role: &str, lang: &str) -> String {
    let name = format!("my_{role}");
    let made = rig.run(
        "new",
        format!(
            "law {name} --role {role} --lang {lang} --to {}",
            rig.file(".")
        ),
    );
    assert_eq!(made.code, Some(0), "{}", made.stderr);
    let folder = rig.file(&name);
    let unbuilt = rig.run("simulate", format!("--{role} {folder}"));
    assert_eq!(unbuilt.code, Some(2));
    assert!(
        unbuilt.stderr.contains("has no law.so and no law.py"),
        "{}",
        unbuilt.stderr
    );
    assert!(
        unbuilt
            .stderr
            .contains(&format!("build it first: {folder}/build")),
        "{}",
        unbuilt.stderr
    );
    assert!(
        Command::new(format!("{folder}/build"))
            .status()
            .unwrap()
            .success()
    );
    folder
}

/// The defaults that a law declares, as lines of a settings file.
fn declared(rig: &Rig, folder: &str) -> Vec<String> {
    let laws = rig.run("laws", folder);
    assert_eq!(laws.code, Some(0), "{}{}", laws.stdout, laws.stderr);
    let settings = laws
        .stdout
        .split("\nTelemetry\n")
        .next()
        .unwrap()
        .to_owned();
    let lines = settings.lines().filter(|line| line.contains(" = "));
    lines
        .map(|line| line.trim().split(" [").next().unwrap().to_owned())
        .collect()
}

#[test]
fn what_it_makes_in_c_flies_as_its_settings_say_and_passes_its_trial() {
    if !has_compiler() {
        return;
    }
    let rig = Rig::new("new_c");
    for role in ["outer", "inner", "mixer"] {
        let folder = built(&rig, role, "c");
        let of_file = fs::read_to_string(format!("{folder}/settings.toml")).unwrap();
        for line in declared(&rig, &folder) {
            assert!(
                of_file.contains(&format!("{line} #")),
                "{role}: {line} is not in\n{of_file}"
            );
        }
        let by_flag = rig.run("simulate", format!("--{role} {folder} --duration 5s"));
        let by_file = rig.run(
            "simulate",
            format!("--config {folder}/settings.toml --duration 5s"),
        );
        assert_eq!(
            (by_flag.code, by_file.code),
            (Some(0), Some(0)),
            "{}{}",
            by_flag.stderr,
            by_file.stderr
        );
        let outputs = |text: &str| {
            text.split("outputs=")
                .nth(1)
                .unwrap()
                .split(' ')
                .next()
                .unwrap()
                .to_owned()
        };
        assert_eq!(outputs(&by_flag.stdout), outputs(&by_file.stdout), "{role}");
    }
}

#[test]
fn its_own_test_fails_when_the_law_answers_differently() {
    if !has_compiler() {
        return;
    }
    let rig = Rig::new("new_test");
    let folder = built(&rig, "inner", "c");
    let test = || {
        let mut test = Command::new(format!("{folder}/test"));
        test.env("IRONBIRD", IRONBIRD)
            .env("IRONBIRD_ROOT", rig.root())
            .output()
            .unwrap()
    };
    let first = test();
    assert!(
        first.status.success(),
        "{}",
        String::from_utf8_lossy(&first.stderr)
    );
    // A law that looks at something that is not its input: the number of the process.
    let law = fs::read_to_string(format!("{folder}/law.c")).unwrap();
    let law = law
        .replacen(
            "#include <math.h>",
            "#include <math.h>\n#include <unistd.h>",
            1,
        )
        .replace(
            "demand->thrust_n = wanted->thrust_n;",
            "demand->thrust_n = wanted->thrust_n + 1e-9 * (getpid() % 1000);",
        );
    fs::write(format!("{folder}/law.c"), law).unwrap();
    assert!(
        Command::new(format!("{folder}/build"))
            .status()
            .unwrap()
            .success()
    );
    let second = test();
    assert_eq!(
        second.status.code(),
        Some(3),
        "{}",
        String::from_utf8_lossy(&second.stdout)
    );
    let said = String::from_utf8_lossy(&second.stdout);
    assert!(said.contains("thrust_n"), "{said}");
}

#[test]
fn a_trial_finds_what_a_law_must_not_do() {
    if !has_compiler() {
        return;
    }
    let rig = Rig::with_features("trial");
    let folder = built(&rig, "inner", "c");
    let source = format!("{folder}/law.c");
    let good = fs::read_to_string(&source).unwrap();
    let line = "demand->thrust_n = wanted->thrust_n;";
    assert!(good.contains(line));
    for (worse, code, said) in [
        (
            "static double n; demand->thrust_n = n++;",
            3,
            "same twice   NO: thrust_n of input 0",
        ),
        (
            "demand->thrust_n = wanted->thrust_n / (input->tick % 2 == 0 ? 0.0 : 1.0);",
            3,
            "finite       NO: thrust_n",
        ),
        (
            "void *volatile kept = malloc(input->tick + 1); free(kept); demand->thrust_n = 1.0;",
            3,
            "allocations  NO: 10000 in 10000 ticks",
        ),
        (
            "if (input->tick > 500) abort(); demand->thrust_n = 1.0;",
            134,
            "SIGABRT: it aborted",
        ),
        (
            "while (input->tick > 500) {} demand->thrust_n = 1.0;",
            3,
            "did not come back within 10s",
        ),
    ] {
        if said.starts_with("allocations") && !cfg!(feature = "instrumented") {
            lacks_feature("laws that allocate", "instrumented");
            continue;
        }
        fs::write(&source, good.replace(line, worse)).unwrap();
        assert!(
            Command::new(format!("{folder}/build"))
                .status()
                .unwrap()
                .success()
        );
        let tried = rig.run("laws", &folder);
        let all = format!("{}{}", tried.stdout, tried.stderr);
        assert!(all.contains(said), "{worse}: {all}");
        assert_eq!(tried.code.unwrap_or(134), code, "{worse}: {all}");
    }
}

#[test]
fn a_folder_that_is_there_stays() {
    let rig = Rig::new("new_no");
    fs::create_dir(rig.path("mine")).unwrap();
    fs::write(rig.path("mine").join("law.c"), "mine").unwrap();
    let ended = rig.run(
        "new",
        format!("law mine --lang c --role inner --to {}", rig.file(".")),
    );
    assert_eq!(ended.code, Some(2));
    assert!(
        ended.stderr.contains("mine cannot be made: File exists")
            && ended.stderr.contains("another name"),
        "{}",
        ended.stderr
    );
    assert_eq!(
        fs::read_to_string(rig.path("mine").join("law.c")).unwrap(),
        "mine"
    );
    let ended = rig.run("new", "law x --lang c --role inner --to /proc/nowhere");
    assert_eq!(ended.code, Some(2));
    assert!(
        ended
            .stderr
            .contains("make the directory that --to names first"),
        "{}",
        ended.stderr
    );
    assert_ne!(
        fs::metadata(rig.path(".")).unwrap().permissions().mode() & 0o700,
        0
    );
}
