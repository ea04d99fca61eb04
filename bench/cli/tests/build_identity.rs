//! Which executable flew: the same words everywhere, and two builds are never taken for one.

use crate::c_laws::root;
use crate::rig;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

#[test]
fn the_commit_is_that_of_the_checkout() {
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        let output = command.args(arguments).current_dir(root()).output().ok();
        let output = output.filter(|output| output.status.success())?;
        Some(String::from_utf8(output.stdout).unwrap().trim().to_owned())
    };
    let toplevel = git(&["rev-parse", "--show-toplevel"]).map(PathBuf::from);
    let workspace = fs::canonicalize(root()).unwrap();
    let expected = git(&["rev-parse", "--short=7", "HEAD"]).filter(|_| toplevel == Some(workspace));
    let commit = ironbird::build::here().commit;
    assert_eq!(commit, expected.unwrap_or_else(|| "unknown".into()));
}

#[test]
fn only_an_instrumented_build_replaces_functions_of_the_c_library() {
    let mut command = Command::new("nm");
    command.args(["-D", "--defined-only", "--format=just-symbols"]);
    let Ok(listed) = command.arg(rig::ironbird()).output() else {
        rig::lacks_tool("exported symbols are not listed: apt-get install binutils");
        return;
    };
    assert!(listed.status.success(), "{listed:?}");
    let listed = String::from_utf8(listed.stdout).unwrap();
    let is_replaced = |symbol: &&str| REPLACED.contains(symbol);
    let exported: Vec<&str> = listed.lines().filter(is_replaced).collect();
    if rig::ironbird() == rig::BUILT_WITH_TESTS && cfg!(feature = "instrumented") {
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
