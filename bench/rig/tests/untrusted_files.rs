//! Files of others: a file without an end is refused, and a file that is only read runs no code.

use crate::c_laws::library;
use crate::rig::Rig;
use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

fn succeeds(program: &str, args: &[&Path]) {
    assert!(Command::new(program).args(args).status().unwrap().success());
}

/// Puts something in the place of a file.
type Maker = fn(&Path);

#[test]
fn a_file_without_an_end_is_refused_wherever_one_is_read() {
    let rig = Rig::new("no-end");
    rig.ok("fly --pace lockstep --duration 50ms");
    let whole = rig.run_directories().pop().unwrap();
    let makers: [(&str, Maker); 3] = [
        ("pipe", |path| succeeds("mkfifo", &[path])),
        ("device", |path| symlink("/dev/zero", path).unwrap()),
        // Without blocks on the disk.
        ("4GiB", |path| {
            File::create(path).unwrap().set_len(4 << 30).unwrap()
        }),
    ];
    for (what, make) in makers {
        for (name, line) in [
            ("x.toml", "simulate --config FILE"),
            ("x.toml", "simulate --airframe FILE"),
            ("x.csv", "simulate --trajectory FILE"),
            ("x.so", "simulate --inner FILE"),
            ("x.mcap", "replay FILE"),
            ("report.json", "report FLIGHT"),
            ("run.json", "report diff FLIGHT WHOLE"),
            ("flight.mcap", "export FLIGHT --to EXPORTED"),
        ] {
            let flight = rig.out().join(what);
            let copy = [Path::new("-r"), &rig.out().join(&whole), &flight];
            succeeds("cp", &copy);
            let file = flight.join(name);
            let _ = fs::remove_file(&file);
            make(&file);
            let line = line
                .replace("FILE", file.to_str().unwrap())
                .replace("FLIGHT", flight.to_str().unwrap())
                .replace("WHOLE", &whole)
                .replace("EXPORTED", &rig.file("exported"));
            let (command, args) = line.split_once(' ').unwrap();
            let refused = rig.run(command, args);
            assert!(matches!(refused.code, Some(1 | 2)), "{what}: {refused}");
            // What a link leads to is named in place of it.
            let mut names = [name, "/dev/zero"].into_iter();
            assert!(names.any(|it| refused.stderr.contains(it)), "{refused}");
            fs::remove_dir_all(flight).unwrap();
        }
    }
    rig.ok("runs");
}

#[test]
fn what_is_only_read_runs_no_law_and_a_replay_runs_it() {
    let rig = Rig::new("no-code");
    // C code that leaves a mark as soon as it is loaded.
    let (marker, header) = (rig.path("ran"), rig.file("mark.h"));
    let mark = format!("FILE *f = fopen({marker:?}, \"w\"); if (f) fclose(f);");
    let before = "#include <stdio.h>\n__attribute__((constructor)) static void mark(void)";
    fs::write(&header, format!("{before}\n{{ {mark} }}\n")).unwrap();
    let source = "examples/law_c/cascade.c";
    let law = library(&rig, "law.so", source, &["-include", &header]);
    rig.ok(&format!(
        "fly --inner {law} --pace lockstep --duration 100ms"
    ));
    assert!(marker.exists(), "the flight runs it");
    fs::remove_file(&marker).unwrap();
    let other = rig.run_directories().pop().unwrap();
    rig.ok("fly --pace lockstep --duration 100ms");
    for line in [
        "report OTHER",
        "report OTHER --full",
        "report OTHER --format html",
        "report diff OTHER latest",
        "export OTHER --to EXPORTED",
        "export OTHER --format perfetto",
        "runs",
    ] {
        let line = line.replace("OTHER", &other);
        rig.ok(&line.replace("EXPORTED", &rig.file("exported")));
        assert!(!marker.exists(), "{line}");
    }
    rig.ok(&format!("replay {other} --verify"));
    assert!(marker.exists(), "a replay flies the law that the log names");
}
