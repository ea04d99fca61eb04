//! `ironbird new law`: what it makes builds, flies and passes its own test; what it refuses is named.

use std::fs;
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

/// Makes an inner law or another one in C, builds it, and says where it is.
fn built(rig: &Rig, role: &str) -> String {
    let (name, home) = (format!("my_{role}"), rig.file("."));
    rig.ok(&format!(
        "new law {name} --role {role} --lang c --to {home}"
    ));
    let folder = rig.file(&name);
    rig.refused(&format!("simulate --{role} {folder}"))
        .complains("has no law.so and no law.py")
        .complains(&format!("build it first: {folder}/build"));
    build(&folder);
    folder
}

fn build(folder: &str) {
    let build = Command::new(format!("{folder}/build")).status();
    assert!(build.unwrap().success(), "{folder}");
}

#[test]
fn what_it_makes_in_c_flies_as_its_settings_say_and_passes_its_trial() {
    if !has_compiler() {
        return;
    }
    let rig = Rig::new("new_c");
    for role in ["outer", "inner", "mixer"] {
        let folder = built(&rig, role);
        let of_file = fs::read_to_string(format!("{folder}/settings.toml")).unwrap();
        // The defaults that it declares are those of its settings file.
        let declared = rig.ok(&format!("laws {folder}")).stdout;
        let (declared, _) = declared.split_once("\nTelemetry\n").unwrap();
        for line in declared.lines().filter(|line| line.contains(" = ")) {
            let line = line.trim().split(" [").next().unwrap();
            assert!(
                of_file.contains(&format!("{line} #")),
                "{role}: no {line} in\n{of_file}"
            );
        }
        let by_flag = rig.ok(&format!("simulate --{role} {folder} --duration 5s"));
        let by_file = rig.ok(&format!(
            "simulate --config {folder}/settings.toml --duration 5s"
        ));
        assert_eq!(
            by_flag.result()["outputs"],
            by_file.result()["outputs"],
            "{role}"
        );
    }
}

#[test]
fn its_own_test_fails_when_the_law_answers_differently() {
    if !has_compiler() {
        return;
    }
    let rig = Rig::new("new_test");
    let folder = built(&rig, "inner");
    let test = || {
        let mut test = Command::new(format!("{folder}/test"));
        test.env("IRONBIRD", IRONBIRD)
            .env("IRONBIRD_ROOT", rig.root());
        rig.launch(test).end()
    };
    test().expect(0);
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
    build(&folder);
    test().expect(3).says("thrust_n");
}

#[test]
fn a_trial_finds_what_a_law_must_not_do() {
    if !has_compiler() {
        return;
    }
    let rig = Rig::with_features("trial");
    let folder = built(&rig, "inner");
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
        build(&folder);
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
    let home = rig.file(".");
    rig.refused(&format!("new law mine --lang c --role inner --to {home}"))
        .complains("mine cannot be made: File exists")
        .complains("another name");
    let kept = fs::read_to_string(rig.path("mine").join("law.c")).unwrap();
    assert_eq!(kept, "mine");
}
