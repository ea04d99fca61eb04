//! The build that this executable is of. The crate's `build.rs` finds it out.

use std::sync::LazyLock;

use flight_log::build::Build;
use messages::checks::IS_MUTANT;

/// This executable as `--version` names it.
pub static VERSION: LazyLock<String> = LazyLock::new(|| here().to_string());

/// This executable.
///
/// ```
/// let build = ironbird::build::here();
/// assert_eq!(build.to_string(), *ironbird::build::VERSION);
/// assert!(build.token().ends_with(&build.profile) && !build.token().contains(' '));
/// ```
pub fn here() -> Build {
    Build {
        version: env!("CARGO_PKG_VERSION").into(),
        commit: env!("IRONBIRD_COMMIT").into(),
        dirty: env!("IRONBIRD_DIRTY") == "true",
        // Whatever names a build says of one whose guards can be switched off that it is one.
        profile: told_profile(env!("IRONBIRD_PROFILE"), IS_MUTANT),
        rustc: env!("IRONBIRD_RUSTC").into(),
        target: env!("IRONBIRD_TARGET").into(),
    }
}

fn told_profile(profile: &str, is_mutant: bool) -> String {
    if is_mutant {
        format!("{profile}-mutant")
    } else {
        profile.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mutant_says_that_it_is_one_and_no_other_build_does() {
        assert_eq!(told_profile("debug", true), "debug-mutant");
        assert_eq!(told_profile("debug", false), "debug");
        assert_eq!(here().profile.ends_with("-mutant"), IS_MUTANT);
    }
}
