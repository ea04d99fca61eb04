//! Recorded flights whose timing a campaign applies to its flights.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use campaign::campaign::Campaign;
use errors::{Failure, USAGE};

use crate::recorded_timing::Timing;
use crate::run_directory::find_log;

#[derive(Clone, Debug, Default)]
pub(super) struct Timings(BTreeMap<String, Timing>);

impl Timings {
    /// Reads all timings of a campaign; relative names are relative to its file.
    pub fn read(campaign: &Campaign, file: &Path) -> Result<Self, Failure> {
        let mut timings = BTreeMap::new();
        for arm in &campaign.arms {
            let (key, names) = campaign.timings(arm);
            for name in names {
                if timings.contains_key(&name) {
                    continue;
                }
                let run = beside(file, &name);
                let timing = find_log(&run, run.parent()).and_then(|log| Timing::read(&log));
                let timing = timing.map_err(|failure| {
                    let line = campaign.lines.of_key(&key);
                    let place = format!(": line {line}: timing = {name:?}");
                    failure.or_code(USAGE).append(&place)
                })?;
                timings.insert(name, timing);
            }
        }
        Ok(Self(timings))
    }

    pub fn of(&self, name: Option<&str>) -> Option<&Timing> {
        self.0.get(name?)
    }

    pub fn sums(&self) -> BTreeMap<String, String> {
        let timings = self.0.iter();
        timings
            .map(|(name, timing)| (name.clone(), timing.sum()))
            .collect()
    }

    pub fn sums_of(&self, names: &[String]) -> String {
        let timings = names.iter().filter_map(|name| self.0.get(name));
        timings
            .map(|timing| format!("\ntiming {}", timing.sum()))
            .collect()
    }
}

pub(super) fn beside(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or_else(|| Path::new("")).join(name)
}
