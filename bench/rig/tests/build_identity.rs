//! Which executable flew: the same words everywhere, and two builds are never taken for one.

use crate::rig::{self, Rig};
use flight_log::build::Build;
use flight_log::reader::LogReader;
use serde_json::Value;
use std::fs;
use std::process::Command;

const LOCKSTEP: &str = "--pace lockstep --duration 300ms";

#[test]
fn a_flight_names_the_build_that_version_names() {
    let rig = Rig::with_features("build");
    let ended = rig.run("fly", LOCKSTEP).expect(0);
    let read = |file: &str| fs::read_to_string(rig.out().join("latest").join(file)).unwrap();
    // From a directory that is no checkout: the build was known when it was built.
    let version = |flag: &str| {
        let mut command = Command::new(rig::BUILT_WITH_TESTS);
        let output = command.arg(flag).current_dir(rig.path("")).output();
        String::from_utf8(output.unwrap().stdout)
            .unwrap()
            .trim()
            .to_owned()
    };
    let facts: Value = serde_json::from_str(&read("run.json")).unwrap();
    let build: Build = serde_json::from_value(facts["build"].clone()).unwrap();
    let long = version("--version");
    assert_eq!(
        version("-V"),
        concat!("ironbird ", env!("CARGO_PKG_VERSION"))
    );
    assert_eq!(long, format!("ironbird {build}"));
    assert_eq!(rig.report()["run"]["build"], facts["build"]);
    let mut log = LogReader::open(&rig.out().join("latest/flight.mcap")).unwrap();
    log.next_entry().unwrap();
    assert_eq!(log.build(), build);
    assert!(read("report.txt").contains(&format!("\n{long}  ")));
    assert!(read("report.html").contains(&format!("{build} for {}", build.target)));
    assert_eq!(ended.result()["build"], build.token());
    let profile = if cfg!(debug_assertions) {
        "debug"
    } else {
        "release"
    };
    assert_eq!(build.profile, profile, "{build}");
    assert!(
        build.rustc.starts_with("1.") && build.target.contains("linux"),
        "{build:?}"
    );
    let both = format!("flown by {build}, replayed by {build}: ");
    rig.ok("replay --verify").complains(&both);
    rig.ok("replay").says(&both);
}

#[test]
fn the_commit_is_that_of_the_checkout() {
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        command
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"));
        let output = command
            .output()
            .ok()
            .filter(|output| output.status.success())?;
        Some(String::from_utf8(output.stdout).unwrap().trim().to_owned())
    };
    let toplevel =
        git(&["rev-parse", "--show-toplevel"]).map(|path| fs::canonicalize(path).unwrap());
    let workspace = fs::canonicalize(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    let expected = git(&["rev-parse", "--short=7", "HEAD"]).filter(|_| toplevel == Some(workspace));
    let commit = ironbird::build::here().commit;
    assert_eq!(commit, expected.unwrap_or_else(|| "unknown".into()));
}

#[test]
fn two_builds_are_said_to_differ_and_an_unknown_one_is_still_read() {
    let rig = Rig::with_features("builds");
    for _ in 0..2 {
        rig.run("fly", LOCKSTEP).expect(0);
    }
    let [a, b]: [String; 2] = rig.run_directories().try_into().unwrap();
    let diff = format!("report diff {a} {b}");
    let here = ironbird::build::here();
    let same = rig.ok(&format!("{diff} --format json")).json();
    let is_the_same = same["builds"].as_str().unwrap().starts_with("the same");
    assert!(is_the_same || here.commit == "unknown", "{same}");
    let change = |file: &str, change: &dyn Fn(&mut Value)| {
        let path = rig.out().join(&b).join(file);
        let mut value: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut value);
        fs::write(&path, value.to_string()).unwrap();
    };
    change("run.json", &|it| it["build"]["commit"] = "0000000".into());
    let mut other = here.clone();
    other.commit = "0000000".into();
    rig.ok(&diff)
        .says("\nBuilds: different\n")
        .says(&format!("    {here}\n"))
        .says(&format!("    {other}\n"))
        .says("\nMachine: the same\n");
    // As a version leaves them that knew nothing of builds.
    let remove = |it: &mut Value| drop(it.as_object_mut().unwrap().remove("build"));
    change("run.json", &remove);
    change("report.json", &|it| remove(&mut it["run"]));
    let unknown = format!("{} (build unknown)", here.version);
    rig.ok(&diff).says(&format!("    {unknown}\n"));
    rig.ok(&format!("report {b} --section head"))
        .says(&format!("ironbird {unknown}  "));
}

#[test]
fn only_an_instrumented_build_replaces_functions_of_the_c_library() {
    let mut command = Command::new("nm");
    command.args(["-D", "--defined-only", "--format=just-symbols"]);
    let Ok(listed) = command.arg(rig::IRONBIRD).output() else {
        rig::lacks_tool("exported symbols are not listed: apt-get install binutils");
        return;
    };
    assert!(listed.status.success(), "{listed:?}");
    let listed = String::from_utf8(listed.stdout).unwrap();
    let is_replaced = |symbol: &&str| REPLACED.contains(symbol);
    let exported: Vec<&str> = listed.lines().filter(is_replaced).collect();
    if rig::IRONBIRD == rig::BUILT_WITH_TESTS && cfg!(feature = "instrumented") {
        assert_eq!(exported.len(), REPLACED.len(), "{exported:?}");
    } else {
        assert!(exported.is_empty(), "{exported:?}");
    }
}

/// Functions of the C library that an instrumented build has in their place.
const REPLACED: [&str; 8] = [
    "_Exit",
    "_exit",
    "aligned_alloc",
    "calloc",
    "malloc",
    "memalign",
    "posix_memalign",
    "realloc",
];
