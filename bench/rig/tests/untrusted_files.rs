//! Files that somebody hands over: what has no end is refused, and what is only read runs no code.

use crate::c_laws::library;
use crate::rig::Rig;
use std::fs::{self, File};
use std::path::Path;
use std::process::Command;

/// Puts something in the place of a file.
type Maker = fn(&Path);

#[test]
fn a_file_without_an_end_is_refused_wherever_one_is_read() {
    let rig = Rig::new("no-end");
    rig.ok("fly --pace lockstep --duration 50ms");
    let whole = rig.run_directories().pop().unwrap();
    let readers: [(&str, &[&str]); 5] = [
        ("x.toml", &["simulate", "--config"]),
        ("x.toml", &["simulate", "--airframe"]),
        ("x.csv", &["simulate", "--trajectory"]),
        ("x.so", &["simulate", "--inner"]),
        ("x.mcap", &["replay"]),
    ];
    let makers: [(&str, Maker); 3] = [
        ("a pipe", |path| {
            assert!(Command::new("mkfifo").arg(path).status().unwrap().success())
        }),
        ("a device", |path| {
            std::os::unix::fs::symlink("/dev/zero", path).unwrap()
        }),
        // Without blocks on the disk.
        ("4 GiB", |path| {
            File::create(path).unwrap().set_len(4 << 30).unwrap()
        }),
    ];
    for (what, make) in makers {
        for (name, command) in readers {
            let path = rig.path(name);
            make(&path);
            let refused = rig.run(
                command[0],
                [&command[1..], &[path.to_str().unwrap()]].concat(),
            );
            assert!(matches!(refused.code, Some(1 | 2)), "{what}: {refused}");
            // What a link leads to is named in place of it.
            assert!(
                refused.stderr.contains(name) || refused.stderr.contains("/dev/zero"),
                "{what}: {refused}"
            );
            fs::remove_file(path).unwrap();
        }
        for name in ["report.json", "run.json", "flight.mcap"] {
            let flight = rig.out().join(format!("{}-{name}", what.replace(' ', "-")));
            assert!(
                Command::new("cp")
                    .arg("-r")
                    .arg(rig.out().join(&whole))
                    .arg(&flight)
                    .status()
                    .unwrap()
                    .success()
            );
            fs::remove_file(flight.join(name)).unwrap();
            make(&flight.join(name));
            let flight = flight.to_str().unwrap();
            let refused = match name {
                "report.json" => rig.run("report", flight),
                "run.json" => rig.run("report", format!("diff {flight} {whole}")),
                _ => rig.run("export", format!("{flight} --to {}", rig.file("exported"))),
            };
            assert!(matches!(refused.code, Some(1 | 2)), "{what}: {refused}");
            refused.complains(name);
        }
    }
    rig.ok("runs");
}

#[test]
fn what_is_only_read_runs_no_law_and_a_replay_runs_it() {
    let rig = Rig::new("no-code");
    let law = library(
        &rig,
        "law.so",
        "examples/law_c/cascade.c",
        &["-include", &marking(&rig)],
    );
    let marker = rig.path("ran");
    rig.ok(&format!(
        "fly --inner {law} --pace lockstep --duration 100ms"
    ));
    assert!(marker.exists(), "the flight runs it");
    fs::remove_file(&marker).unwrap();
    let other = rig.run_directories().pop().unwrap();
    rig.ok("fly --pace lockstep --duration 100ms");
    for args in [
        &["report", &other][..],
        &["report", &other, "--full"],
        &["report", &other, "--format", "html"],
        &["report", "diff", &other, "latest"],
        &["export", &other, "--to", &rig.file("exported")],
        &["export", &other, "--format", "perfetto"],
        &["runs"],
    ] {
        rig.run(args[0], &args[1..]).expect(0);
        assert!(!marker.exists(), "{args:?}");
    }
    rig.ok(&format!("replay {other} --verify"));
    assert!(marker.exists(), "a replay flies the law that the log names");
}

/// C code that leaves a mark as soon as it is loaded.
fn marking(rig: &Rig) -> String {
    let path = rig.file("mark.h");
    let marker = rig.file("ran");
    fs::write(
        &path,
        format!(
            "#include <stdio.h>\n__attribute__((constructor)) static void mark(void)\n\
             {{ FILE *f = fopen(\"{marker}\", \"w\"); if (f) fclose(f); }}\n"
        ),
    )
    .unwrap();
    path
}
