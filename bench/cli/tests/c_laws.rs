//! Laws in C, compiled for a test.

use crate::rig::Rig;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, OnceLock};

pub fn root() -> PathBuf {
    let mut ancestors = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    ancestors.nth(2).unwrap().to_owned()
}

/// Compiles a file of the repository into a library of the rig's directory, once for all tests; returns its path.
pub fn library(rig: &Rig, name: &str, source: &str, flags: &[&str]) -> String {
    static BUILT: Mutex<BTreeMap<String, Arc<OnceLock<Vec<u8>>>>> = Mutex::new(BTreeMap::new());
    let key = format!("{source} {flags:?}");
    let built = Arc::clone(BUILT.lock().unwrap().entry(key).or_default());
    let library = rig.file(name);
    let bytes = built.get_or_init(|| {
        compile(&library, source, flags);
        fs::read(&library).unwrap()
    });
    fs::write(&library, bytes).unwrap();
    library
}

fn compile(library: &str, source: &str, flags: &[&str]) {
    let mut gcc = Command::new("gcc");
    gcc.args("-std=c11 -O2 -Wall -Wextra -Werror -fPIC -shared".split(' '))
        .args(flags)
        .arg("-I")
        .arg(root().join("shared/ironbird_law/include"))
        .args(["-o", library])
        .arg(root().join(source))
        .arg("-lm");
    assert!(gcc.status().unwrap().success(), "{gcc:?}");
}

pub fn cascade(rig: &Rig) -> String {
    library(rig, "libcascade.so", "examples/law_c/cascade.c", &[])
}
