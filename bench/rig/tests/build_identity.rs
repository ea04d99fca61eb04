//! Which executable flew: the same words everywhere, and two builds are never taken for one.

use crate::rig::{self, Rig};
use flight_log::build::Build;
use flight_log::reader::LogReader;
use serde_json::Value;
use std::fs;

const LOCKSTEP: &str = "--pace lockstep --duration 300ms";

fn read(rig: &Rig, file: &str) -> String {
    fs::read_to_string(rig.out().join("latest").join(file)).unwrap()
}

fn version(rig: &Rig, flag: &str) -> String {
    let output = std::process::Command::new(rig::BUILT_WITH_TESTS)
        .arg(flag)
        .current_dir(rig.path(""))
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

#[test]
fn a_flight_names_the_build_that_version_names() {
    let rig = Rig::with_features("build");
    let ended = rig.run("fly", LOCKSTEP).expect(0);
    // From a directory that is no checkout: the build was known when it was built.
    let long = version(&rig, "--version");
    assert_eq!(
        version(&rig, "-V"),
        concat!("ironbird ", env!("CARGO_PKG_VERSION"))
    );
    let build: Build = serde_json::from_value(
        serde_json::from_str::<Value>(&read(&rig, "run.json")).unwrap()["build"].clone(),
    )
    .unwrap();
    assert_eq!(long, format!("ironbird {build}"));
    assert_eq!(
        serde_json::from_value::<Build>(rig.report()["run"]["build"].clone()).unwrap(),
        build
    );
    let mut log = LogReader::open(&rig.out().join("latest/flight.mcap")).unwrap();
    log.next_entry().unwrap();
    assert_eq!(log.build(), build);
    assert!(
        read(&rig, "report.txt").contains(&format!("\n{long}  ")),
        "{}",
        read(&rig, "report.txt")
    );
    assert!(read(&rig, "report.html").contains(&format!("{build} for {}", build.target)));
    assert_eq!(ended.result()["build"], build.token());
    assert!(
        build.profile
            == if cfg!(debug_assertions) {
                "debug"
            } else {
                "release"
            },
        "{build}"
    );
    assert!(
        build.rustc.starts_with("1.") && build.target.contains("linux"),
        "{build:?}"
    );
    rig.ok("replay --verify")
        .complains(&format!("flown by {build}, replayed by {build}: "));
    rig.ok("replay")
        .says(&format!("flown by {build}, replayed by {build}: "));
}

#[test]
fn the_commit_is_that_of_the_checkout() {
    let git = |arguments: &[&str]| {
        let output = std::process::Command::new("git")
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output();
        output
            .ok()
            .filter(|output| output.status.success())
            .map(|output| String::from_utf8(output.stdout).unwrap())
    };
    let toplevel =
        git(&["rev-parse", "--show-toplevel"]).map(|path| fs::canonicalize(path.trim()).unwrap());
    let workspace = fs::canonicalize(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    let is_checkout = toplevel == Some(workspace);
    let expected = git(&["rev-parse", "--short=7", "HEAD"]).filter(|_| is_checkout);
    assert_eq!(
        ironbird::build::here().commit,
        expected.as_deref().map_or("unknown", str::trim)
    );
}

#[test]
fn two_builds_are_said_to_differ_and_an_unknown_one_is_still_read() {
    let rig = Rig::with_features("builds");
    rig.run("fly", LOCKSTEP).expect(0);
    rig.run("fly", LOCKSTEP).expect(0);
    let [a, b]: [String; 2] = rig.run_directories().try_into().unwrap();
    let same = rig.ok(&format!("report diff {a} {b} --format json")).json();
    assert!(
        same["builds"].as_str().unwrap().starts_with("the same")
            || ironbird::build::here().commit == "unknown",
        "{same}"
    );
    let change = |file: &str, change: &dyn Fn(&mut Value)| {
        let path = rig.out().join(&b).join(file);
        let mut value: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut value);
        fs::write(&path, value.to_string()).unwrap();
    };
    change("run.json", &|facts| {
        facts["build"]["commit"] = "0000000".into()
    });
    let here = ironbird::build::here();
    let other = Build {
        commit: "0000000".into(),
        ..here.clone()
    };
    let ended = rig
        .ok(&format!("report diff {a} {b}"))
        .says("\nBuilds: different\n");
    let ended = ended
        .says(&format!("    {here}\n"))
        .says(&format!("    {other}\n"));
    assert!(
        ended.stdout.contains("\nMachine: the same\n"),
        "the machine is: {ended}"
    );
    // As a version leaves them that knew nothing of builds.
    change("run.json", &|facts| {
        drop(facts.as_object_mut().unwrap().remove("build"))
    });
    change("report.json", &|report| {
        drop(report["run"].as_object_mut().unwrap().remove("build"))
    });
    let unknown = format!("{} (build unknown)", here.version);
    rig.ok(&format!("report diff {a} {b}"))
        .says(&format!("    {unknown}\n"));
    rig.ok(&format!("report {b} --section head"))
        .says(&format!("ironbird {unknown}  "));
}

#[test]
fn only_an_instrumented_build_replaces_functions_of_the_c_library() {
    let listed = std::process::Command::new("nm")
        .args(["-D", "--defined-only", "--format=just-symbols"])
        .arg(rig::IRONBIRD)
        .output();
    let Ok(listed) = listed else {
        rig::lacks_tool("exported symbols are not listed: apt-get install binutils");
        return;
    };
    assert!(listed.status.success(), "{listed:?}");
    let listed = String::from_utf8(listed.stdout).unwrap();
    let exported: Vec<&str> = listed
        .lines()
        .filter(|symbol| REPLACED.contains(symbol))
        .collect();
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
