//! A campaign's directory: its rows, and a copy of its file.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use campaign::chunk::{SCHEMA, write_whole};
use errors::{Failure, InFile as _, USAGE, read_text};
use serde::{Deserialize, Serialize};
use std::io::Write as _;

use super::flight_settings::Plan;

const FILE: &str = "campaign.toml";
const FACTS: &str = "campaign.json";

/// What to do where a recorded flight is another one.
const OTHER_RECORDING: &str =
    "name the recorded flight itself, and not `latest`; or fly into another directory (--out DIR)";

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Facts {
    schema: String,
    /// Where the file was: relative names in it are beside it.
    file: PathBuf,
    campaign: String,
    build: String,
    /// The recorded flights that the file names, and the sums over their timing.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    timings: BTreeMap<String, String>,
}

impl Facts {
    fn changed(&self, plan: &Plan) -> Option<String> {
        let now = plan.timings.sums();
        let is_other = |name: &String, sum: &String| now.get(name).is_some_and(|it| it != sum);
        let changed = self
            .timings
            .iter()
            .filter(|(name, sum)| is_other(name, sum));
        let names: Vec<&str> = changed.map(|(name, _)| name.as_str()).collect();
        (!names.is_empty()).then(|| names.join(", "))
    }
}

pub(super) fn open(plan: &Plan, directory: &Path) -> Result<(), Failure> {
    fs::create_dir_all(directory).in_file("make the directory", directory)?;
    let (file, facts) = (directory.join(FILE), directory.join(FACTS));
    if facts.exists() {
        let there = read_facts(directory)?;
        let place = directory.display();
        if let Some(changed) = there.changed(plan) {
            return Err(Failure::usage(format!(
                "{place} holds rows of another recorded flight than the one that is now at {changed}"
            ))
            .help(OTHER_RECORDING));
        }
        if there.campaign != plan.identity.campaign {
            return Err(Failure::usage(format!(
                "{place} holds another campaign: the file has changed in more than its number of flights"
            ))
            .help("fly it into another directory (--out DIR), or remove this one"));
        }
    }
    let now = Facts {
        schema: SCHEMA.into(),
        file: plan.file.clone(),
        campaign: plan.identity.campaign.clone(),
        build: plan.identity.build.clone(),
        timings: plan.timings.sums(),
    };
    let now = serde_json::to_string_pretty(&now).map_err(|e| Failure::failed(e.to_string()))?;
    for (path, text) in [(&file, &plan.text), (&facts, &(now + "\n"))] {
        // Shards that run side by side write the same.
        if fs::read_to_string(path).is_ok_and(|there| there == *text) {
            continue;
        }
        write_whole(path, |file| file.write_all(text.as_bytes()))?;
    }
    Ok(())
}

pub(super) fn plan(directory: &Path) -> Result<Plan, Failure> {
    let facts = read_facts(directory)?;
    let text = read_text("read the campaign", &directory.join(FILE))
        .map_err(|failure| failure.or_code(USAGE))?;
    let plan = Plan::of(text, &facts.file)?;
    let (place, build) = (directory.display(), &facts.build);
    if let Some(changed) = facts.changed(&plan) {
        return Err(Failure::usage(format!(
            "{place} was flown with another recorded flight than the one that is now at {changed}"
        ))
        .help(OTHER_RECORDING));
    }
    if plan.identity.campaign != facts.campaign {
        return Err(Failure::usage(format!(
            "{place} was flown by the build {build}, for which its campaign means other settings than for this one"
        ))
        .help("read it with the build that flew it, or fly it again into another directory"));
    }
    Ok(plan)
}

fn read_facts(directory: &Path) -> Result<Facts, Failure> {
    let path = directory.join(FACTS);
    let text = read_text("read the campaign's directory", &path).map_err(|failure| {
        failure
            .or_code(USAGE)
            .help("name a directory of `ironbird campaign run FILE --out DIR`")
    })?;
    serde_json::from_str(&text).map_err(|e| Failure::usage(format!("{}: {e}", path.display())))
}
