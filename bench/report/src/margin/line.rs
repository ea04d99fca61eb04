//! A flight's worst outage against what its loop bears: the line of the report.

use std::collections::BTreeMap;

use flight_log::build::Build;
use serde::{Deserialize, Serialize};

use crate::autopsy::section::Section as Outages;
use crate::margin::Margins;
use crate::schema::Report;
use crate::text::count;

/// What stands for outages of all stages at once: `machine` in a table of margins.
pub const MACHINE: &str = "machine";

/// What a flight's loop bears, and how near the flight came to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Section {
    /// Fingerprint of the settings that margins depend on: the name of their table.
    pub fingerprint: String,
    /// How to measure them, where they are not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<String>,
    /// The longest outage survived, by stage; empty where not known.
    pub bears: BTreeMap<String, Bears>,
    /// Phases of the trajectory that these are the least of.
    pub phases: u64,
    /// The build that measured, where another one flew.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_by: Option<String>,
    /// The longest outages of this flight, by stage [ticks].
    pub outages: BTreeMap<String, u64>,
    /// Outages of this flight whose length by stage is not known, because messages were lost there.
    pub unmeasured: u64,
    /// The stage whose outage came nearest to what is borne; none without an outage, or where nothing is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nearest: Option<String>,
    /// What it bears over its outage; no flight survived a margin below 1 in simulation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<f64>,
}

/// The longest outage of a stage that is survived.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bears {
    /// At the worst phase [ticks].
    pub ticks: u64,
    /// Whether no longer one was tried.
    pub is_most: bool,
}

impl Section {
    /// Of a flight whose margins nobody has measured; `command` measures them.
    #[must_use]
    pub fn unknown(fingerprint: String, command: String) -> Self {
        Self { fingerprint, unknown: Some(command), ..Self::default() }
    }

    /// Of a flight of a build, whose laws bear what a table says; nothing where the table is of other settings, or lacks
    /// a stage.
    #[must_use]
    pub fn known(fingerprint: &str, table: &Margins, build: &Build) -> Option<Self> {
        let law = table.laws.iter().find(|law| law.fingerprint == fingerprint)?;
        let bears = |of: &str| {
            let ticks = law.outages.iter().find(|margin| margin.of == of && !margin.ticks.is_empty())?.least();
            Some((of.to_owned(), Bears { ticks, is_most: ticks >= table.longest_ticks }))
        };
        let stages = model::role::STAGES.into_iter().map(|role| role.name()).chain([MACHINE]);
        let bears = stages.map(bears).collect::<Option<_>>()?;
        let phases = table.phases_s.len() as u64;
        let measured_by = (table.build != *build).then(|| table.build.token());
        Some(Self { fingerprint: fingerprint.into(), bears, phases, measured_by, ..Self::default() })
    }

    /// The same with the outages of a flight.
    #[must_use]
    pub fn with(mut self, outages: &Outages) -> Self {
        // A report from before they were counted keeps what it says.
        if let Some(longest) = &outages.longest {
            self.outages.clone_from(longest);
            self.unmeasured = outages.unmeasured;
        }
        let ratio = |(stage, outage): (&String, &u64)| {
            Some((self.bears.get(stage)?.ticks as f64 / *outage as f64, stage.clone()))
        };
        let nearest = self.outages.iter().filter_map(ratio).min_by(|a, b| a.0.total_cmp(&b.0));
        (self.margin, self.nearest) = nearest.map_or((None, None), |(margin, stage)| (Some(margin), Some(stage)));
        self
    }

    /// The line.
    #[must_use]
    pub fn sentence(&self) -> String {
        if let Some(command) = &self.unknown {
            return format!("not known: run {command}");
        }
        let by = self.measured_by.as_ref();
        let mut by = by.map_or_else(String::new, |build| format!("; measured by another build, {build}"));
        if self.unmeasured > 0 {
            by += &format!("; not in it: {}, of which messages were lost", count(self.unmeasured, "outage"));
        }
        let most = |bears: &Bears| if bears.is_most { "more than " } else { "" };
        match self.nearest.as_ref().and_then(|stage| Some((stage, self.bears.get(stage)?, self.outages.get(stage)?))) {
            Some((stage, bears, outage)) => {
                let least = if bears.is_most { "at least " } else { "" };
                format!(
                    "worst outage in this flight {} ({stage}); this loop bears {}{} (least of {}): margin {least}{:.1}{by}",
                    count(*outage, "tick"),
                    most(bears),
                    bears.ticks,
                    count(self.phases, "phase"),
                    self.margin.unwrap_or_default()
                )
            }
            None => {
                let each = self.bears.iter().map(|(stage, bears)| format!("{stage} {}{}", most(bears), bears.ticks));
                let phases = count(self.phases, "phase");
                format!(
                    "no stage was seen out in this flight; this loop bears, in ticks: {} (least of {phases}){by}",
                    each.collect::<Vec<_>>().join(", ")
                )
            }
        }
    }
}

/// The line of a flight, where it has one. A margin is of one airframe: that of the settings.
#[must_use]
pub fn sentence(report: &Report) -> Option<String> {
    let margin = report.margin.as_ref()?;
    let swaps = report.swaps.len() as u64 + report.swaps_left_out;
    let swapped = match swaps {
        _ if margin.unknown.is_some() => String::new(),
        0 => String::new(),
        _ => format!("; of the airframe before {} in flight", count(swaps, "swap")),
    };
    Some(format!("{}{swapped}", margin.sentence()))
}

#[cfg(test)]
mod tests {
    use super::*;
    fn bears(all: &[(&str, u64)]) -> Section {
        let bears = |(stage, ticks): &(&str, u64)| ((*stage).into(), Bears { ticks: *ticks, is_most: *ticks >= 2000 });
        Section { bears: all.iter().map(bears).collect(), phases: 32, ..Section::default() }
    }

    fn outages(all: &[(&str, u64)]) -> Outages {
        let longest = all.iter().map(|(stage, ticks)| ((*stage).to_owned(), *ticks)).collect();
        Outages { longest: Some(longest), ..Outages::default() }
    }

    #[test]
    fn the_smallest_margin_is_told_and_not_the_longest_outage() {
        let section = bears(&[("outer", 2000), ("inner", 118), ("machine", 30)]);
        let told = |all: &[(&str, u64)]| section.clone().with(&outages(all)).sentence();
        assert_eq!(
            told(&[("inner", 47), ("outer", 300)]),
            "worst outage in this flight 47 ticks (inner); this loop bears 118 (least of 32 phases): margin 2.5"
        );
        assert_eq!(
            told(&[(MACHINE, 20), ("inner", 47)]),
            "worst outage in this flight 20 ticks (machine); this loop bears 30 (least of 32 phases): margin 1.5"
        );
        assert_eq!(
            told(&[("outer", 1)]),
            "worst outage in this flight 1 tick (outer); this loop bears more than 2000 (least of 32 phases): margin \
             at least 2000.0"
        );
        assert_eq!(
            told(&[]),
            "no stage was seen out in this flight; this loop bears, in ticks: inner 118, machine 30, outer more than 2000 (least of \
             32 phases)"
        );
        let lost = Outages { unmeasured: 2, ..outages(&[("inner", 47)]) };
        assert_eq!(
            section.clone().with(&lost).sentence(),
            "worst outage in this flight 47 ticks (inner); this loop bears 118 (least of 32 phases): margin 2.5; not in \
             it: 2 outages, of which messages were lost"
        );
        let other = Section { measured_by: Some("7fa27a4-release".into()), ..section.clone() };
        assert_eq!(
            other.with(&outages(&[("inner", 47)])).sentence(),
            "worst outage in this flight 47 ticks (inner); this loop bears 118 (least of 32 phases): margin 2.5; \
             measured by another build, 7fa27a4-release"
        );
        let unknown = Section::unknown("ab".into(), "ironbird margin --config settings.toml".into());
        let unknown = unknown.with(&outages(&[(MACHINE, 5)]));
        assert_eq!(unknown.sentence(), "not known: run ironbird margin --config settings.toml");
        assert_eq!((unknown.outages["machine"], unknown.margin), (5, None));
    }
}
