//! The recorded flights whose timing the flights of a campaign have.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use campaign::campaign::Campaign;
use failure::{Failure, USAGE};

use crate::run_directory::find_log;
use crate::timing::Timing;

/// Timings by the names that the campaign's file gives them.
#[derive(Clone, Debug, Default)]
pub(super) struct Timings(BTreeMap<String, Timing>);

impl Timings {
    /// Reads all that a campaign names; relative names are beside its file.
    ///
    /// # Errors
    /// A usage [`Failure`] says which recorded flight cannot be had, with the line that names it.
    pub fn read(campaign: &Campaign, file: &Path) -> Result<Self, Failure> {
        let mut timings = BTreeMap::new();
        for arm in &campaign.arms {
            let (key, names) = campaign.timings(arm);
            for name in names {
                if timings.contains_key(&name) {
                    continue;
                }
                let run = beside(file, &name);
                let timing = find_log(&run, run.parent()).and_then(|log| Timing::read(&log)).map_err(|failure| {
                    let line = campaign.lines.of_key(&key);
                    failure.or_code(USAGE).append(&format!(": line {line}: timing = {name:?}"))
                })?;
                timings.insert(name, timing);
            }
        }
        Ok(Self(timings))
    }

    /// The one of a name, which was read.
    pub fn of(&self, name: Option<&str>) -> Option<&Timing> {
        self.0.get(name?)
    }

    /// What they are: of each name the sum over its content.
    pub fn sums(&self) -> BTreeMap<String, String> {
        self.0.iter().map(|(name, timing)| (name.clone(), timing.sum())).collect()
    }

    /// Some of them by their content, for a fingerprint.
    pub fn told(&self, names: &[String]) -> String {
        names.iter().filter_map(|name| self.0.get(name)).map(|timing| format!("\ntiming {}", timing.sum())).collect()
    }
}

/// Where a recorded flight is that a campaign's file names.
pub(super) fn beside(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or_else(|| Path::new("")).join(name)
}
