//! The settings that all roles of a run must share, as text: `key = value` lines.

use std::collections::{BTreeMap, BTreeSet};

use crate::layout::{FNV_OFFSET, fnv1a};
use crate::role::Role;
use crate::telemetry::LAW_ROLES;

pub fn fingerprint(text: &str) -> u64 {
    fnv1a(FNV_OFFSET, text.as_bytes())
}

/// Each key whose value differs, with both values; of another law its name alone.
pub fn differences(ours: &str, theirs: &str, role: Role) -> Vec<String> {
    let (ours, theirs) = (pairs(ours), pairs(theirs));
    let differs = |key: &str| ours.get(key) != theirs.get(key);
    let keys: BTreeSet<&str> = ours.keys().chain(theirs.keys()).copied().collect();
    let is_of_other_law = |key: &str| {
        let of = |role: &Role| {
            key.strip_prefix(role.name())
                .is_some_and(|rest| rest.starts_with('.'))
        };
        LAW_ROLES
            .iter()
            .find(|role| of(role))
            .is_some_and(|role| differs(&law(*role)) && key != law(*role))
    };
    let value =
        |of: &BTreeMap<&str, &str>, key| of.get(key).copied().unwrap_or("nothing").to_owned();
    keys.into_iter()
        .filter(|key| differs(key) && !is_of_other_law(key))
        .map(|key| {
            format!(
                "`{key}` is {} for {role} and {} for the plant",
                value(&ours, key),
                value(&theirs, key)
            )
        })
        .collect()
}

/// The options that choose the plant's laws, as `--inner geometric`, where ours are others; empty where none is.
pub fn other_laws(ours: &str, theirs: &str) -> String {
    let (ours, theirs) = (pairs(ours), pairs(theirs));
    let option = |role: &Role| {
        let theirs = theirs
            .get(law(*role).as_str())
            .filter(|theirs| ours.get(law(*role).as_str()) != Some(*theirs))?;
        Some(format!("--{role} {}", theirs.trim_matches('"')))
    };
    LAW_ROLES
        .iter()
        .filter_map(option)
        .collect::<Vec<_>>()
        .join(" ")
}

/// The key that names a role's law.
fn law(role: Role) -> String {
    format!("{role}.law")
}

fn pairs(text: &str) -> BTreeMap<&str, &str> {
    text.lines()
        .filter_map(|line| line.split_once(" = "))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differing_settings_are_named_with_both_values() {
        let ours = "gains.alpha_1_s = 200.0\nflight.preset = \"flight\"\n";
        let theirs = "gains.alpha_1_s = 40.0\nflight.preset = \"flight\"\n";
        let alpha = "`gains.alpha_1_s` is 200.0 for inner and 40.0 for the plant";
        assert_eq!(differences(ours, theirs, Role::Inner), [alpha]);
        assert!(differences(ours, ours, Role::Inner).is_empty());
        assert_ne!(fingerprint(ours), fingerprint(theirs));
        let missing = "`a` is nothing for outer and 1 for the plant";
        assert_eq!(differences("", "a = 1\n", Role::Outer), [missing]);
    }

    #[test]
    fn of_another_law_its_name_is_given_and_the_option_that_chooses_it() {
        let ours = "inner.law = \"adaptive\"\ninner.alpha_1_s = 200.0\nouter.law = \"pd\"\nouter.tilt_max_rad = 0.5\n";
        let theirs = "inner.law = \"indi\"\ninner.filter_rad_s = 50.0\nouter.law = \"pd\"\nouter.tilt_max_rad = 0.4\n";
        let expected = [
            "`inner.law` is \"adaptive\" for mixer and \"indi\" for the plant",
            "`outer.tilt_max_rad` is 0.5 for mixer and 0.4 for the plant",
        ];
        assert_eq!(differences(ours, theirs, Role::Mixer), expected);
        assert_eq!(other_laws(ours, theirs), "--inner indi");
        assert_eq!(other_laws(ours, ours), "");
        let theirs = theirs.replace("\"pd\"", "\"estimating\"");
        assert_eq!(other_laws(ours, &theirs), "--outer estimating --inner indi");
    }
}
