//! The worst outage of a flight compared with the robustness margin of its control loop.

use crate::margin::Margins;
use crate::outages::OutageSection;
use crate::phrase::count;
use crate::schema::Report;
use crate::schema::{MACHINE, MarginSection, RobustnessMargin};
use flight_log::build::Build;

impl MarginSection {
    /// Of a flight whose margins nobody has measured; `command` measures them.
    pub fn unknown(fingerprint: String, command: String) -> Self {
        Self {
            fingerprint,
            unknown: Some(command),
            ..Self::default()
        }
    }

    /// Of a flight of a build, whose laws bear what a table says; nothing where the table is of other settings, or lacks
    /// a stage.
    pub fn known(fingerprint: &str, table: &Margins, build: &Build) -> Option<Self> {
        let law = table
            .laws
            .iter()
            .find(|law| law.fingerprint == fingerprint)?;
        let bears = |of: &str| {
            let ticks = law
                .outages
                .iter()
                .find(|margin| margin.of == of && !margin.ticks.is_empty())?
                .least();
            Some((
                of.to_owned(),
                RobustnessMargin {
                    ticks,
                    is_most: ticks >= table.longest_ticks,
                },
            ))
        };
        let stages = messages::role::STAGES
            .into_iter()
            .map(|role| role.name())
            .chain([MACHINE]);
        let bears = stages.map(bears).collect::<Option<_>>()?;
        let phases = table.phases_s.len() as u64;
        let measured_by = (table.build != *build).then(|| table.build.token());
        Some(Self {
            fingerprint: fingerprint.into(),
            bears,
            phases,
            measured_by,
            ..Self::default()
        })
    }

    /// The same with the outages of a flight.
    pub fn with(mut self, outages: &OutageSection) -> Self {
        // A report from before they were counted keeps what it says.
        if let Some(longest) = &outages.longest {
            self.outages.clone_from(longest);
            self.unmeasured = outages.unmeasured;
        }
        let ratio = |(stage, outage): (&String, &u64)| {
            Some((
                self.bears.get(stage)?.ticks as f64 / *outage as f64,
                stage.clone(),
            ))
        };
        let nearest = self
            .outages
            .iter()
            .filter_map(ratio)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        (self.margin, self.nearest) =
            nearest.map_or((None, None), |(margin, stage)| (Some(margin), Some(stage)));
        self
    }

    pub fn sentence(&self) -> String {
        if let Some(command) = &self.unknown {
            return format!("not known: run {command}");
        }
        let by = self.measured_by.as_ref();
        let mut by = by.map_or_else(String::new, |build| {
            format!("; measured by another build, {build}")
        });
        if self.unmeasured > 0 {
            by += &format!(
                "; not in it: {}, of which messages were lost",
                count(self.unmeasured, "outage")
            );
        }
        let most = |bears: &RobustnessMargin| if bears.is_most { "more than " } else { "" };
        match self
            .nearest
            .as_ref()
            .and_then(|stage| Some((stage, self.bears.get(stage)?, self.outages.get(stage)?)))
        {
            Some((stage, bears, outage)) => {
                let least = if bears.is_most { "at least " } else { "" };
                format!(
                    "worst outage in this flight {} ({stage}); this loop tolerates {}{} (least of {}): margin {least}{:.1}{by}",
                    count(*outage, "tick"),
                    most(bears),
                    bears.ticks,
                    count(self.phases, "phase"),
                    self.margin.unwrap_or_default()
                )
            }
            None => {
                let each = self
                    .bears
                    .iter()
                    .map(|(stage, bears)| format!("{stage} {}{}", most(bears), bears.ticks));
                let phases = count(self.phases, "phase");
                format!(
                    "no stage had an outage in this flight; this loop tolerates, in ticks: {} (least of {phases}){by}",
                    each.collect::<Vec<_>>().join(", ")
                )
            }
        }
    }
}

/// The line of a flight, where it has one. A margin is of one airframe: that of the settings.
pub fn sentence(report: &Report) -> Option<String> {
    let margin = report.margin.as_ref()?;
    let swaps = report.swaps.len() as u64 + report.swaps_left_out;
    let swapped = match swaps {
        _ if margin.unknown.is_some() => String::new(),
        0 => String::new(),
        _ => format!(
            "; of the airframe before {} in flight",
            count(swaps, "swap")
        ),
    };
    Some(format!("{}{swapped}", margin.sentence()))
}

#[cfg(test)]
mod tests {
    use super::*;
    fn bears(all: &[(&str, u64)]) -> MarginSection {
        let bears = |(stage, ticks): &(&str, u64)| {
            (
                (*stage).into(),
                RobustnessMargin {
                    ticks: *ticks,
                    is_most: *ticks >= 2000,
                },
            )
        };
        MarginSection {
            bears: all.iter().map(bears).collect(),
            phases: 32,
            ..MarginSection::default()
        }
    }

    fn outages(all: &[(&str, u64)]) -> OutageSection {
        let longest = all
            .iter()
            .map(|(stage, ticks)| ((*stage).to_owned(), *ticks))
            .collect();
        OutageSection {
            longest: Some(longest),
            ..OutageSection::default()
        }
    }

    #[test]
    fn the_smallest_margin_is_told_and_not_the_longest_outage() {
        let section = bears(&[("outer", 2000), ("inner", 118), ("machine", 30)]);
        let told = |all: &[(&str, u64)]| section.clone().with(&outages(all)).sentence();
        assert_eq!(
            told(&[("inner", 47), ("outer", 300)]),
            "worst outage in this flight 47 ticks (inner); this loop tolerates 118 (least of 32 phases): margin 2.5"
        );
        assert_eq!(
            told(&[(MACHINE, 20), ("inner", 47)]),
            "worst outage in this flight 20 ticks (machine); this loop tolerates 30 (least of 32 phases): margin 1.5"
        );
        assert_eq!(
            told(&[("outer", 1)]),
            "worst outage in this flight 1 tick (outer); this loop tolerates more than 2000 (least of 32 phases): margin \
             at least 2000.0"
        );
        assert_eq!(
            told(&[]),
            "no stage had an outage in this flight; this loop tolerates, in ticks: inner 118, machine 30, outer more than 2000 (least of \
             32 phases)"
        );
        let lost = OutageSection {
            unmeasured: 2,
            ..outages(&[("inner", 47)])
        };
        assert_eq!(
            section.clone().with(&lost).sentence(),
            "worst outage in this flight 47 ticks (inner); this loop tolerates 118 (least of 32 phases): margin 2.5; not in \
             it: 2 outages, of which messages were lost"
        );
        let other = MarginSection {
            measured_by: Some("7fa27a4-release".into()),
            ..section.clone()
        };
        assert_eq!(
            other.with(&outages(&[("inner", 47)])).sentence(),
            "worst outage in this flight 47 ticks (inner); this loop tolerates 118 (least of 32 phases): margin 2.5; \
             measured by another build, 7fa27a4-release"
        );
        let unknown =
            MarginSection::unknown("ab".into(), "ironbird margin --config settings.toml".into());
        let unknown = unknown.with(&outages(&[(MACHINE, 5)]));
        assert_eq!(
            unknown.sentence(),
            "not known: run ironbird margin --config settings.toml"
        );
        assert_eq!((unknown.outages["machine"], unknown.margin), (5, None));
    }
}
