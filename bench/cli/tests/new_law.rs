//! `ironbird new law`: the new folder builds, flies and passes its own test; the trial of laws finds harmful changes.

use std::fs;
use std::process::Command;

use crate::rig::{IRONBIRD, Rig, lacks_feature, lacks_tool};

/// Creates a law in C and builds it; returns its folder, or none without a compiler.
fn new_law(rig: &Rig, role: &str) -> Option<String> {
    if Command::new("cc").arg("--version").output().is_err() {
        lacks_tool("cc is not installed");
        return None;
    }
    let name = format!("my_{role}");
    let (home, folder) = (rig.file("."), rig.file(&name));
    rig.ok(&format!(
        "new law {name} --role {role} --lang c --to {home}"
    ));
    rig.refused(&format!("simulate --{role} {folder}"))
        .complains("has no law.so and no law.py")
        .complains(&format!("build it first: {folder}/build"));
    build(&folder);
    Some(folder)
}

fn build(folder: &str) {
    let status = Command::new(format!("{folder}/build")).status();
    assert!(status.unwrap().success(), "{folder}");
}

#[test]
fn harmful_changes_of_a_law_are_found_by_its_test_and_by_the_trial() {
    let rig = Rig::with_features("trial");
    let Some(folder) = new_law(&rig, "inner") else {
        return;
    };
    let source = format!("{folder}/law.c");
    let good = fs::read_to_string(&source).unwrap();
    let line = "demand->thrust_n = wanted->thrust_n;";
    assert!(good.contains(line));
    let change = |change: &str| {
        let changed = good.replace(line, change).replacen(
            "#include <math.h>",
            "#include <math.h>\n#include <unistd.h>",
            1,
        );
        fs::write(&source, changed).unwrap();
        build(&folder);
    };
    let test = || {
        let mut test = Command::new(format!("{folder}/test"));
        test.env("IRONBIRD", IRONBIRD)
            .env("IRONBIRD_ROOT", rig.root());
        rig.launch(test).end()
    };
    test().expect(0);
    // The process id is not an input.
    change("demand->thrust_n = wanted->thrust_n + 1e-9 * (getpid() % 1000);");
    test().expect(3).says("thrust_n");
    for (worse, code, words) in [
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
        if words.starts_with("allocations") && !cfg!(feature = "instrumented") {
            lacks_feature("laws that allocate", "instrumented");
            continue;
        }
        change(worse);
        let ended = rig.run("laws", &folder);
        let text = format!("{}{}", ended.stdout, ended.stderr);
        assert!(text.contains(words), "{worse}: {text}");
        assert_eq!(ended.code.unwrap_or(134), code, "{worse}: {text}");
    }
}
