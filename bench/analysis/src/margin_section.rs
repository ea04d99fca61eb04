//! The worst outage of a flight compared with the robustness margin of its control loop.

use crate::margin::Margins;
use crate::outages::OutageSection;
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
            let mut known = law.outages.iter().filter(|margin| !margin.ticks.is_empty());
            let ticks = known.find(|margin| margin.of == of)?.least();
            let is_most = ticks >= table.longest_ticks;
            Some((of.to_owned(), RobustnessMargin { ticks, is_most }))
        };
        let stages = messages::role::STAGES.into_iter().map(|role| role.name());
        let bears = stages.chain([MACHINE]).map(bears).collect::<Option<_>>()?;
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

    pub fn with(mut self, outages: &OutageSection) -> Self {
        // A report from before they were counted keeps what it says.
        if let Some(longest) = &outages.longest {
            self.outages.clone_from(longest);
            self.unmeasured = outages.unmeasured;
        }
        let ratio = |(stage, outage): (&String, &u64)| {
            let bears = self.bears.get(stage)?.ticks;
            Some((bears as f64 / *outage as f64, stage.clone()))
        };
        let ratios = self.outages.iter().filter_map(ratio);
        let nearest = ratios.min_by(|a, b| a.0.total_cmp(&b.0));
        (self.margin, self.nearest) = nearest.unzip();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outages(all: &[(&str, u64)], unmeasured: u64) -> OutageSection {
        let longest = all
            .iter()
            .map(|(stage, ticks)| ((*stage).to_owned(), *ticks));
        OutageSection {
            longest: Some(longest.collect()),
            unmeasured,
            ..OutageSection::default()
        }
    }

    #[test]
    fn the_smallest_margin_counts_and_not_the_longest_outage() {
        let bears = |(stage, ticks): (&str, u64)| {
            let is_most = ticks >= 2000;
            (stage.to_owned(), RobustnessMargin { ticks, is_most })
        };
        let known = MarginSection {
            bears: [("outer", 2000), ("inner", 118), ("machine", 30)]
                .map(bears)
                .into(),
            ..MarginSection::default()
        };
        let unknown = MarginSection::unknown("ab".into(), String::new());
        for (section, all, nearest, margin) in [
            (
                &known,
                &[("inner", 47), ("outer", 300)][..],
                Some("inner"),
                Some(118.0 / 47.0),
            ),
            (
                &known,
                &[(MACHINE, 20), ("inner", 47)],
                Some(MACHINE),
                Some(1.5),
            ),
            (&known, &[], None, None),
            (&unknown, &[(MACHINE, 5)], None, None),
        ] {
            let section = section.clone().with(&outages(all, 2));
            assert_eq!(
                (section.nearest.as_deref(), section.margin),
                (nearest, margin)
            );
            assert_eq!((section.outages.len(), section.unmeasured), (all.len(), 2));
        }
    }
}
