//! Reads whose timing flights have: that of recorded ones.

use toml::Value;

use super::Reader;
use crate::campaign::{Factor, Target};

/// The key, which is none of the settings.
pub(super) const TIMING: &str = "timing";

impl Reader {
    /// The recorded flight of a key; none where it is a mistake, which is noted.
    pub(super) fn recorded(&mut self, path: &str, value: &Value, factors: &[Factor]) -> Option<String> {
        if factors.iter().any(|factor| factor.target == Target::Timing) {
            self.says(path, format!("`timing` is drawn as a factor, so {path} cannot set it"));
            return None;
        }
        let name = value.as_str().filter(|name| !name.is_empty());
        if name.is_none() {
            self.says(path, format!("{path} = {value}: expected {EXPECTED}, as in timing = \"runs/latest\""));
        }
        name.map(str::to_owned)
    }

    /// The recorded flights that are drawn from.
    pub(super) fn drawn_timing(&mut self, value: &Value) -> Option<Factor> {
        let path = format!("factors.{TIMING}");
        let distribution = self.distribution(&path, TIMING, value)?;
        let is_name = |value: &Value| value.as_str().is_some_and(|name| !name.is_empty());
        if !distribution.ends().iter().all(is_name) {
            self.says(&path, format!("{TIMING} = {value}: expected for each choice {EXPECTED}"));
            return None;
        }
        let line = self.lines.of_key(&path);
        Some(Factor { name: TIMING.into(), target: Target::Timing, distribution, line })
    }
}

/// What a value may be.
const EXPECTED: &str = "a recorded flight, its directory or its log";
