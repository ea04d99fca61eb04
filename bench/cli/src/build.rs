//! The build that this executable is of. The crate's `build.rs` finds it out.

use std::sync::LazyLock;

use flight_log::build::Build;

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
        profile: env!("IRONBIRD_PROFILE").into(),
        rustc: env!("IRONBIRD_RUSTC").into(),
        target: env!("IRONBIRD_TARGET").into(),
    }
}
