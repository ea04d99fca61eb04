//! A campaign with the settings that it means, each end of its draws tried.

use std::path::{Path, PathBuf};

use campaign::campaign::{Campaign, Variant};
use campaign::chunk::Identity;
use campaign::file;
use errors::{Failure, USAGE, read_text};
use toml::Value;

use super::timings::{Timings, beside};
use crate::build;
use crate::recorded_timing::Timing;
use crate::settings::Settings;

/// A campaign that can be flown.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub campaign: Campaign,
    /// The file; relative names of laws are beside it.
    pub file: PathBuf,
    pub text: String,
    pub identity: Identity,
    /// The recorded flights that it names.
    pub timings: Timings,
}

impl Plan {
    /// Reads a campaign's file.
    pub fn read(file: &Path) -> Result<Self, Failure> {
        let text = read_text("read the campaign", file).map_err(|failure| {
            failure
                .or_code(USAGE)
                .help("name a campaign's file; docs/campaigns.md has one to begin with")
        })?;
        Self::of(text, file)
    }

    /// The plan of a text that stands, or stood, in a file.
    pub fn of(text: String, file: &Path) -> Result<Self, Failure> {
        let place = format!(" (campaign {})", file.display());
        let campaign = file::read(&text).map_err(|failure| failure.append(&place))?;
        let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
        let identity = Identity {
            name: campaign.name.clone(),
            campaign: String::new(),
            build: flown_by(),
        };
        let timings = Timings::read(&campaign, &file).map_err(|failure| failure.append(&place))?;
        let mut plan = Self {
            campaign,
            file,
            text,
            identity,
            timings,
        };
        let shared = plan.check()?;
        plan.identity.campaign = plan.campaign.fingerprint(&shared);
        Ok(plan)
    }

    /// The settings of a flight by an arm.
    pub fn settings(&self, flight: u64, arm: usize) -> Result<Settings, Failure> {
        let arm = &self.campaign.arms[arm];
        let draws = self.campaign.draws(flight);
        self.resolved(arm, &draws).map_err(|failure| {
            failure.append(&format!(
                ": flight {flight} of the arm {} cannot be flown",
                arm.name
            ))
        })
    }

    /// The recorded timing of a flight by an arm, if it has one.
    pub fn timing(
        &self,
        flight: u64,
        arm: usize,
        settings: &Settings,
    ) -> Result<Option<&Timing>, Failure> {
        let arm = &self.campaign.arms[arm];
        self.checked(arm, &self.campaign.draws(flight), settings)
            .map_err(|failure| {
                failure.append(&format!(
                    ": flight {flight} of the arm {} cannot be flown",
                    arm.name
                ))
            })
    }

    /// The recorded flight whose timing a flight by an arm has, if it has one.
    pub fn recorded(&self, flight: u64, arm: usize) -> Option<PathBuf> {
        let draws = self.campaign.draws(flight);
        let name = self.campaign.timing(&self.campaign.arms[arm], &draws)?;
        Some(beside(&self.file, name))
    }

    fn checked(
        &self,
        arm: &Variant,
        draws: &[Value],
        settings: &Settings,
    ) -> Result<Option<&Timing>, Failure> {
        let Some(timing) = self.timings.of(self.campaign.timing(arm, draws)) else {
            return Ok(None);
        };
        timing
            .check(settings, &self.campaign.timings(arm).0)
            .map(|()| Some(timing))
    }

    fn resolved(&self, arm: &Variant, draws: &[Value]) -> Result<Settings, Failure> {
        Settings::of_file(self.campaign.given(arm, draws), &self.file)
    }

    /// The settings of a flight that can be flown.
    fn tried(&self, arm: &Variant, draws: &[Value]) -> Result<Settings, Failure> {
        let settings = self.resolved(arm, draws)?;
        let place = format!(" (campaign {})", self.file.display());
        self.checked(arm, draws, &settings)
            .map_err(|failure| failure.append(&place))?;
        Ok(settings)
    }

    /// Whether the first flight can be flown by each arm, also with each end of what is drawn; the settings that the
    /// flights of each arm share.
    fn check(&self) -> Result<Vec<String>, Failure> {
        let first = self.campaign.draws(0);
        let mut shared = Vec::new();
        let mut shown = vec![false; self.campaign.gates.telemetry.len()];
        for arm in &self.campaign.arms {
            let settings = self
                .tried(arm, &first)
                .map_err(|failure| self.at_line(failure, arm, None))?;
            for (place, factor) in self.campaign.factors.iter().enumerate() {
                for end in factor.distribution.ends() {
                    let mut draws = first.clone();
                    draws[place] = end;
                    self.tried(arm, &draws)
                        .map_err(|failure| self.at_line(failure, arm, Some(factor.line)))?;
                }
            }
            let signals = settings.flown_laws()?.signals;
            for (gate, shown) in self.campaign.gates.telemetry.iter().zip(&mut shown) {
                *shown |= signals
                    .of(gate.role)
                    .iter()
                    .any(|signal| signal.name == gate.signal);
            }
            shared
                .push(settings.shared_text()? + &self.timings.told(&self.campaign.timings(arm).1));
        }
        let unknown = self
            .campaign
            .gates
            .telemetry
            .iter()
            .zip(shown)
            .find(|(_, shown)| !shown);
        if let Some((gate, _)) = unknown {
            let line = self
                .campaign
                .lines
                .of_key(&format!("success.telemetry.{}", gate.name()));
            return Err(Failure::usage(format!(
                "{}: line {line}: no arm has a law of the role {} that shows `{}`",
                self.file.display(),
                gate.role,
                gate.signal
            ))
            .help(format!(
                "`ironbird laws LAW` lists what a law of the role {} shows",
                gate.role
            )));
        }
        Ok(shared)
    }

    /// The line of the key that a failure speaks of, or else of the factor, or else of the arm.
    fn at_line(&self, failure: Failure, arm: &Variant, factor: Option<usize>) -> Failure {
        let said = failure.to_string();
        let of_key = || self.campaign.lines.spoken_of(&said);
        let line = factor
            .or_else(|| self.line_of_fault(&said))
            .or_else(of_key)
            .unwrap_or(arm.line);
        failure.append(&format!(": line {line}, flown by the arm {}", arm.name))
    }
}

impl Plan {
    /// The line of the [[fault]] that a failure of the first flight speaks of, or of the only one.
    fn line_of_fault(&self, said: &str) -> Option<usize> {
        let (draws, faults) = (self.campaign.draws(0), &self.campaign.faults);
        let named = faults
            .iter()
            .find(|fault| said.contains(fault.what(&draws)));
        let only = faults.first().filter(|_| faults.len() == 1);
        let fault = named.or(only).filter(|_| said.starts_with("fault: "))?;
        Some(self.campaign.factors[fault.what].line)
    }
}

/// The build, as far as the bits of flights depend on it: profile and target do not change them.
fn flown_by() -> String {
    let build = build::here();
    format!(
        "{} {}{}",
        build.version,
        build.commit,
        if build.dirty { "-dirty" } else { "" }
    )
}
