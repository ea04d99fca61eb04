//! Other implementations that read what ironbird writes: scripts for the Python that `IRONBIRD_PYTHON` names.

use crate::rig::lacks_tool;
use std::process::Command;

/// A Python that has these packages; `None` if no Python was named and `python3` lacks them.
pub fn python_with(packages: &str, purpose: &str) -> Option<String> {
    let named = std::env::var("IRONBIRD_PYTHON").ok();
    let named = named.filter(|python| !python.is_empty());
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let imports = format!("import {packages}");
    let has_them = Command::new(&python).args(["-c", &imports]).output();
    if has_them.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let missing = format!(
        "{python} lacks packages ({packages}): pip install -r bench/cli/tests/requirements.txt"
    );
    assert!(named.is_none(), "IRONBIRD_PYTHON: {missing}");
    lacks_tool(&format!("{purpose}: {missing}"));
    None
}
