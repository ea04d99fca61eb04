//! A campaign with the settings of its flights, each end of its distributions checked; and its directory, with its rows
//! and a copy of its file.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use ::campaign::campaign::{Campaign, Variant};
use ::campaign::chunk::{Identity, SCHEMA};
use ::campaign::distribution::Distribution;
use ::campaign::file;
use ::campaign::gates::SignalGate;
use errors::{Failure, InFile as _, USAGE, read_text, write_whole};
use serde::{Deserialize, Serialize};
use toml::Value;

use config::{Settings, utf8};
use flight_log::build;
use recorder::run_directory::find_log;
use sim::recorded_timing::Timing;

#[derive(Clone, Debug)]
pub struct Plan {
    pub campaign: Campaign,
    /// The file; relative names of laws start from its directory.
    pub file: PathBuf,
    pub text: String,
    pub identity: Identity,
    pub timings: Timings,
    /// The settings of the first flight of each arm, also with each drawn inner law: whether a firmware flies.
    pub flown: Vec<Settings>,
}

impl Plan {
    pub fn read(file: &Path) -> Result<Self, Failure> {
        let text = read_text("read the campaign", file).map_err(|failure| {
            failure
                .or_code(USAGE)
                .help("name a campaign's file; `ironbird docs campaigns` has one to begin with")
        })?;
        Self::of(text, file)
    }

    pub fn of(text: String, file: &Path) -> Result<Self, Failure> {
        let place = format!(" (campaign {})", file.display());
        let campaign = file::read(&text).map_err(|failure| failure.append(&place))?;
        let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
        utf8(&file)?;
        let identity = Identity {
            name: campaign.name.clone(),
            campaign: String::new(),
            build: flown_by(),
        };
        let timings = read_timings(&campaign, &file).map_err(|failure| failure.append(&place))?;
        let mut plan = Self {
            campaign,
            file,
            text,
            identity,
            timings,
            flown: Vec::new(),
        };
        let (shared, flown) = plan.check()?;
        plan.flown = flown;
        plan.identity.campaign = plan.campaign.fingerprint(&shared);
        Ok(plan)
    }

    /// The settings of a flight by an arm, and its recorded timing if it has one.
    pub fn flight(&self, flight: u64, arm: usize) -> Result<(Settings, Option<&Timing>), Failure> {
        let (arm, draws) = (&self.campaign.arms[arm], self.campaign.draws(flight));
        let flown = self.resolved(arm, &draws).and_then(|settings| {
            let timing = self.checked(arm, &draws, &settings)?;
            Ok((settings, timing))
        });
        let arm = &arm.name;
        let what = format!(": flight {flight} of the arm {arm} cannot be flown");
        flown.map_err(|failure| failure.append(&what))
    }

    /// The recorded flight whose timing a flight by an arm has, if it has one.
    pub fn recorded(&self, flight: u64, arm: usize) -> Option<PathBuf> {
        let draws = self.campaign.draws(flight);
        let name = self.campaign.timing(&self.campaign.arms[arm], &draws)?;
        Some(relative_to(&self.file, name))
    }

    fn checked(
        &self,
        arm: &Variant,
        draws: &[Value],
        settings: &Settings,
    ) -> Result<Option<&Timing>, Failure> {
        let name = self.campaign.timing(arm, draws);
        let Some(timing) = name.and_then(|name| self.timings.get(name)) else {
            return Ok(None);
        };
        let (key, _) = self.campaign.timings(arm);
        timing.check(settings, &key).map(|()| Some(timing))
    }

    fn resolved(&self, arm: &Variant, draws: &[Value]) -> Result<Settings, Failure> {
        Settings::of_file(self.campaign.given(arm, draws), &self.file)
    }

    fn tried(&self, arm: &Variant, draws: &[Value]) -> Result<Settings, Failure> {
        let settings = self.resolved(arm, draws)?;
        let place = format!(" (campaign {})", self.file.display());
        self.checked(arm, draws, &settings)
            .map_err(|failure| failure.append(&place))?;
        Ok(settings)
    }

    /// Whether the first flight can be flown by each arm, also with each end of what is drawn; the settings that the
    /// flights of each arm share, and [`Self::flown`].
    fn check(&self) -> Result<(Vec<String>, Vec<Settings>), Failure> {
        let first = self.campaign.draws(0);
        let (mut shared, mut flown) = (Vec::new(), Vec::new());
        let mut unknown: Vec<&SignalGate> = self.campaign.gates.telemetry.iter().collect();
        for arm in &self.campaign.arms {
            let settings = self
                .tried(arm, &first)
                .map_err(|failure| self.at_line(failure, arm, None))?;
            let mut text = settings.shared_text()?;
            let mut sums = String::new();
            for (place, factor) in self.campaign.factors.iter().enumerate() {
                for end in factor.distribution.ends() {
                    let mut draws = first.clone();
                    draws[place] = end;
                    let settings = self
                        .tried(arm, &draws)
                        .map_err(|failure| self.at_line(failure, arm, Some(factor.line)))?;
                    // Files that the first flight does not draw; what it draws is in its own text.
                    let of_end = settings.shared_text()?;
                    let of_end = of_end.lines().filter(|line| line.contains("sha256"));
                    for sum in of_end.filter(|sum| !text.contains(sum)) {
                        sums += &format!("\n{} {sum}", factor.name);
                    }
                    if factor.name == "inner.law" {
                        flown.push(settings);
                    }
                }
            }
            let signals = settings.flown_laws()?.signals;
            unknown.retain(|gate| {
                let mut signals = signals.of(gate.role).iter();
                !signals.any(|signal| signal.name == gate.signal)
            });
            text += &sums;
            for name in self.campaign.timings(arm).1 {
                text += &format!("\ntiming {}", self.timings[&name].sum());
            }
            shared.push(text);
            flown.push(settings);
        }
        let Some(gate) = unknown.first() else {
            return Ok((shared, flown));
        };
        let key = format!("success.telemetry.{}", gate.name());
        let (file, line) = (self.file.display(), self.campaign.lines.of_key(&key));
        let (role, signal) = (gate.role, &gate.signal);
        let what = format!("no arm has a law of the role {role} that shows `{signal}`");
        let help = format!("`ironbird laws LAW` lists what a law of the role {role} shows");
        Err(Failure::usage(format!("{file}: line {line}: {what}")).help(help))
    }

    /// Appends the line of the factor, or else of the key that a failure names, or else of the arm.
    fn at_line(&self, failure: Failure, arm: &Variant, factor: Option<usize>) -> Failure {
        let message = failure.to_string();
        let drawn = factor.map_or("", |_| "a value of ");
        let line = factor
            .or_else(|| self.line_of_fault(&message))
            .or_else(|| self.campaign.lines.named_in(&message))
            .unwrap_or(arm.line);
        failure.append(&format!(
            ": {drawn}line {line}, flown by the arm {}",
            arm.name
        ))
    }

    /// The line of the [[fault]] that a failure of the first flight names, or of the only one.
    fn line_of_fault(&self, message: &str) -> Option<usize> {
        let (draws, faults) = (self.campaign.draws(0), &self.campaign.faults);
        let mut all = faults.iter();
        let named = all.find(|fault| message.contains(fault.what(&draws)));
        let only = faults.first().filter(|_| faults.len() == 1);
        let fault = named.or(only).filter(|_| message.starts_with("fault: "))?;
        Some(self.campaign.factors[fault.what].line)
    }
}

/// The build, as far as the bits of flights depend on it: profile and target do not change them.
fn flown_by() -> String {
    let build = build::executable();
    let dirty = if build.dirty { "-dirty" } else { "" };
    format!("{} {}{dirty}", build.version, build.commit)
}

/// The recorded flights whose timing a campaign applies, by their names in its file.
pub type Timings = BTreeMap<String, Timing>;

fn read_timings(campaign: &Campaign, file: &Path) -> Result<Timings, Failure> {
    let mut timings = Timings::new();
    for arm in &campaign.arms {
        let (key, names) = campaign.timings(arm);
        for name in names {
            if timings.contains_key(&name) {
                continue;
            }
            let run = relative_to(file, &name);
            let timing = find_log(&run, run.parent()).and_then(|log| Timing::read(&log));
            let timing = timing.map_err(|failure| {
                let line = campaign.lines.of_key(&key);
                let place = format!(": line {line}: timing = {name:?}");
                failure.or_code(USAGE).append(&place)
            })?;
            timings.insert(name, timing);
        }
    }
    Ok(timings)
}

/// The checksum of each recorded flight, by its name.
fn sums(timings: &Timings) -> BTreeMap<String, String> {
    let timings = timings.iter();
    timings
        .map(|(name, timing)| (name.clone(), timing.sum()))
        .collect()
}

fn relative_to(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or_else(|| Path::new("")).join(name)
}

const FILE: &str = "campaign.toml";
const FACTS: &str = "campaign.json";
/// The remedy for a broken [`FILE`] or [`FACTS`].
const REPAIR: &str = "remove this file if it is there, and fly the campaign into this directory again (`ironbird campaign run FILE --out DIR`): \
                      rows that are whole are kept";
/// The remedy for a file or directory that cannot be written.
pub const IN_THE_WAY: &str =
    "remove what is in its place, or fly into another directory that you can write (--out DIR)";

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Facts {
    schema: String,
    /// Where the file was: relative names in it start from its directory.
    file: PathBuf,
    campaign: String,
    build: String,
    /// The recorded flights that the file names, and the sums over their timing.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    timings: BTreeMap<String, String>,
}

impl Facts {
    fn read(directory: &Path) -> Result<Self, Failure> {
        let path = directory.join(FACTS);
        let text = read_text("read the campaign's directory", &path).map_err(|failure| {
            let failure = failure.or_code(USAGE);
            failure.help("name a directory of `ironbird campaign run FILE --out DIR`")
        })?;
        serde_json::from_str(&text)
            .map_err(|e| Failure::usage(format!("{}: {e}", path.display())).help(REPAIR))
    }

    fn of_another_build(&self, place: &dyn Display) -> Failure {
        let build = &self.build;
        Failure::usage(format!(
            "{place} was flown by the build {build}, for which its campaign means other settings than for this one"
        ))
        .help("read it with the build that flew it, or fly it again into another directory")
    }

    /// Whether a recorded flight has changed since; `what` the directory has of it.
    fn check_recordings(&self, plan: &Plan, what: &str) -> Result<(), Failure> {
        let now = sums(&plan.timings);
        let is_other =
            |(name, sum): &(&String, &String)| now.get(*name).is_some_and(|it| it != *sum);
        let changed = self.timings.iter().filter(is_other);
        let changed: Vec<&str> = changed.map(|(name, _)| name.as_str()).collect();
        if changed.is_empty() {
            return Ok(());
        }
        let changed = changed.join(", ");
        Err(Failure::usage(format!(
            "{what} another recorded flight than the one that is now at {changed}"
        ))
        .help(
            "name the recorded flight itself, and not `latest`; or fly into another directory (--out DIR)",
        ))
    }
}

/// Prepares a directory for the rows of a campaign. It may have some of them already, but no more flights than the campaign:
/// the last file of rows would lose some.
pub fn open_directory(plan: &Plan, directory: &Path) -> Result<(), Failure> {
    open(plan, directory).map_err(|failure| failure.or_help(IN_THE_WAY))
}

fn open(plan: &Plan, directory: &Path) -> Result<(), Failure> {
    fs::create_dir_all(directory).in_file("make the directory", directory)?;
    // Another campaign that starts in this directory waits until this function returns, if the file system has locks.
    let lock = File::open(directory).in_file("open", directory)?;
    let _ = lock.lock();
    let (file, facts) = (directory.join(FILE), directory.join(FACTS));
    if facts.exists() {
        let (there, place) = (Facts::read(directory)?, directory.display());
        there.check_recordings(plan, &format!("{place} holds rows of"))?;
        if there.campaign != plan.identity.campaign && there.build != plan.identity.build {
            return Err(there.of_another_build(&place));
        }
        if there.campaign != plan.identity.campaign {
            let mut factors = plan.campaign.factors.iter();
            let latin = factors.find(|it| matches!(it.distribution, Distribution::Latin { .. }));
            let how = latin.map_or("in more than its number of flights".into(), |it| {
                let name = &it.name;
                format!("in more than its number of flights, or in that, on which its latin factor {name} depends")
            });
            return Err(Failure::usage(format!(
                "{place} holds another campaign: the file has changed {how}"
            ))
            .help("fly it into another directory (--out DIR), or remove this one"));
        }
        // A directory without the copy gets it again.
        let flown = file.exists().then(|| read_copy(&file)).transpose()?;
        let (flights, now) = (flown.map_or(0, |it| it.1.flights), plan.campaign.flights);
        if flights > now {
            return Err(Failure::usage(format!(
                "{place} holds this campaign with {flights} flights, and its file now has {now}"
            ))
            .help(format!(
                "set flights = {flights} or more to keep its rows, fly into another directory (--out DIR), or remove this one"
            )));
        }
    }
    let now = Facts {
        schema: SCHEMA.into(),
        file: plan.file.clone(),
        campaign: plan.identity.campaign.clone(),
        build: plan.identity.build.clone(),
        timings: sums(&plan.timings),
    };
    let now = serde_json::to_string_pretty(&now).map_err(|e| Failure::failed(e.to_string()))?;
    for (path, text) in [(&file, &plan.text), (&facts, &(now + "\n"))] {
        // Shards that run side by side write the same.
        if fs::read_to_string(path).is_ok_and(|there| there == *text) {
            continue;
        }
        let written = write_whole(path, |file| file.write_all(text.as_bytes()));
        written.in_file("write", path)?;
    }
    Ok(())
}

/// The copy of a campaign's file in its directory.
fn read_copy(copy: &Path) -> Result<(String, Campaign), Failure> {
    let text = read_text("read the campaign", copy);
    let text = text.map_err(|failure| failure.or_code(USAGE).help(REPAIR))?;
    let campaign = file::read(&text);
    let place = format!(" ({})", copy.display());
    let campaign = campaign.map_err(|failure| failure.append(&place).help(REPAIR))?;
    Ok((text, campaign))
}

pub fn plan_of(directory: &Path) -> Result<Plan, Failure> {
    let facts = Facts::read(directory)?;
    let (text, _) = read_copy(&directory.join(FILE))?;
    let plan = Plan::of(text, &facts.file)?;
    let place = directory.display();
    facts.check_recordings(&plan, &format!("{place} was flown with"))?;
    if plan.identity.campaign != facts.campaign && facts.build == plan.identity.build {
        return Err(Failure::usage(format!(
            "{FILE} and {FACTS} of {place} are of different campaigns: one of them was changed"
        ))
        .help("run the campaign's file again into it: `ironbird campaign run FILE --out DIR`"));
    }
    if plan.identity.campaign != facts.campaign {
        return Err(facts.of_another_build(&place));
    }
    Ok(plan)
}
