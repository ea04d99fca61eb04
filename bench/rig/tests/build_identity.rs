//! Which executable flew: the same words everywhere, and two builds are never taken for one.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::fs;

use crate::rig::Rig;
use flight_log::build::Build;
use flight_log::reader::LogReader;
use serde_json::Value;

const LOCKSTEP: [&str; 4] = ["--pace", "lockstep", "--duration", "300ms"];

fn read(rig: &Rig, file: &str) -> String {
    fs::read_to_string(rig.out().join("latest").join(file)).unwrap()
}

fn version(rig: &Rig, flag: &str) -> String {
    let output = std::process::Command::new(rig::IRONBIRD).arg(flag).current_dir(rig.path("")).output().unwrap();
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

#[test]
fn a_flight_names_the_build_that_version_names() {
    let rig = Rig::new("build");
    let ended = rig.run("fly", &LOCKSTEP).expect(0);
    // From a directory that is no checkout: the build was known when it was built.
    let long = version(&rig, "--version");
    assert_eq!(version(&rig, "-V"), concat!("ironbird ", env!("CARGO_PKG_VERSION")));
    let build: Build =
        serde_json::from_value(serde_json::from_str::<Value>(&read(&rig, "run.json")).unwrap()["build"].clone())
            .unwrap();
    assert_eq!(long, format!("ironbird {build}"));
    assert_eq!(serde_json::from_value::<Build>(rig.report()["run"]["build"].clone()).unwrap(), build);
    let mut log = LogReader::open(&rig.out().join("latest/flight.mcap")).unwrap();
    log.next_entry().unwrap();
    assert_eq!(log.build(), build);
    assert!(read(&rig, "report.txt").contains(&format!("\n{long}  ")), "{}", read(&rig, "report.txt"));
    assert!(read(&rig, "report.html").contains(&format!("{build} for {}", build.target)));
    assert_eq!(ended.result()["build"], build.token());
    assert!(build.profile == if cfg!(debug_assertions) { "debug" } else { "release" }, "{build}");
    assert!(build.rustc.starts_with("1.") && build.target.contains("linux"), "{build:?}");
    rig.run("replay", &["--verify"]).expect(0).complains(&format!("flown by {build}, replayed by {build}: "));
    rig.run("replay", &[]).expect(0).says(&format!("flown by {build}, replayed by {build}: "));
}

#[test]
fn the_commit_is_that_of_the_checkout() {
    let git = |arguments: &[&str]| {
        let output = std::process::Command::new("git").args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output();
        output.ok().filter(|output| output.status.success()).map(|output| String::from_utf8(output.stdout).unwrap())
    };
    let toplevel = git(&["rev-parse", "--show-toplevel"]).map(|path| fs::canonicalize(path.trim()).unwrap());
    let workspace = fs::canonicalize(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    let is_checkout = toplevel == Some(workspace);
    let expected = git(&["rev-parse", "--short=7", "HEAD"]).filter(|_| is_checkout);
    assert_eq!(ironbird::build::here().commit, expected.as_deref().map_or("unknown", str::trim));
}

#[test]
fn two_builds_are_said_to_differ_and_an_unknown_one_is_still_read() {
    let rig = Rig::new("builds");
    rig.run("fly", &LOCKSTEP).expect(0);
    rig.run("fly", &LOCKSTEP).expect(0);
    let [a, b]: [String; 2] = rig.run_directories().try_into().unwrap();
    let same = rig.run("report", &["diff", &a, &b, "--format", "json"]).expect(0).json();
    assert!(
        same["builds"].as_str().unwrap().starts_with("the same") || ironbird::build::here().commit == "unknown",
        "{same}"
    );
    let change = |file: &str, change: &dyn Fn(&mut Value)| {
        let path = rig.out().join(&b).join(file);
        let mut value: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut value);
        fs::write(&path, value.to_string()).unwrap();
    };
    change("run.json", &|facts| facts["build"]["commit"] = "0000000".into());
    let here = ironbird::build::here();
    let other = Build { commit: "0000000".into(), ..here.clone() };
    let ended = rig.run("report", &["diff", &a, &b]).expect(0).says("\nBuilds: different\n");
    let ended = ended.says(&format!("    {here}\n")).says(&format!("    {other}\n"));
    assert!(ended.stdout.contains("\nMachine: the same\n"), "the machine is: {ended}");
    // As a version leaves them that knew nothing of builds.
    change("run.json", &|facts| drop(facts.as_object_mut().unwrap().remove("build")));
    change("report.json", &|report| drop(report["run"].as_object_mut().unwrap().remove("build")));
    let unknown = format!("{} (build unknown)", here.version);
    rig.run("report", &["diff", &a, &b]).expect(0).says(&format!("    {unknown}\n"));
    rig.run("report", &[&b, "--section", "head"]).expect(0).says(&format!("ironbird {unknown}  "));
}
