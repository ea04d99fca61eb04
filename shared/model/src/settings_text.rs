//! The settings that all roles of a run must share, as text: `key = value` lines.

use std::collections::{BTreeMap, BTreeSet};

use crate::layout::{FNV_OFFSET, fnv1a};
use crate::role::Role;

/// Fingerprint of a settings text.
#[must_use]
pub fn fingerprint(text: &str) -> u64 {
    fnv1a(FNV_OFFSET, text.as_bytes())
}

/// Each key whose value differs, with both values.
#[must_use]
pub fn differences(ours: &str, theirs: &str, role: Role) -> Vec<String> {
    let pairs = |text: &str| -> BTreeMap<String, String> {
        text.lines().filter_map(|line| line.split_once(" = ")).map(|(k, v)| (k.to_owned(), v.to_owned())).collect()
    };
    let (ours, theirs) = (pairs(ours), pairs(theirs));
    let keys: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
    let value = |of: &BTreeMap<String, String>, key| of.get(key).cloned().unwrap_or("nothing".into());
    keys.into_iter()
        .filter(|key| ours.get(*key) != theirs.get(*key))
        .map(|key| format!("`{key}` is {} for {role} and {} for the plant", value(&ours, key), value(&theirs, key)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differing_settings_are_named_with_both_values() {
        let ours = "gains.alpha_1_s = 200.0\nflight.preset = \"flight\"\n";
        let theirs = "gains.alpha_1_s = 40.0\nflight.preset = \"flight\"\n";
        let found = differences(ours, theirs, Role::Inner);
        assert_eq!(found, ["`gains.alpha_1_s` is 200.0 for inner and 40.0 for the plant"]);
        assert!(differences(ours, ours, Role::Inner).is_empty());
        assert_eq!(differences("", "a = 1\n", Role::Outer), ["`a` is nothing for outer and 1 for the plant"]);
    }
}
