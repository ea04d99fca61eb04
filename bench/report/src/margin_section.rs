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

    pub fn sentence(&self) -> String {
        if let Some(command) = &self.unknown {
            return format!("not known: run {command}");
        }
        let by = self.measured_by.as_ref();
        let by = by.map(|build| format!("; measured by another build, {build}"));
        let mut by = by.unwrap_or_default();
        if self.unmeasured > 0 {
            let outages = count(self.unmeasured, "outage");
            by += &format!("; not in it: {outages}, of which messages were lost");
        }
        let most = |bears: &RobustnessMargin| if bears.is_most { "more than " } else { "" };
        let phases = count(self.phases, "phase");
        let nearest = self.nearest.as_ref();
        let nearest = nearest.and_then(|it| Some((it, self.bears.get(it)?, self.outages.get(it)?)));
        let Some((stage, bears, outage)) = nearest else {
            let each = self.bears.iter();
            let each = each.map(|(stage, it)| format!("{stage} {}{}", most(it), it.ticks));
            let each = each.collect::<Vec<_>>().join(", ");
            return format!(
                "no stage had an outage in this flight; this loop tolerates, in ticks: {each} (least of {phases}){by}"
            );
        };
        let least = if bears.is_most { "at least " } else { "" };
        format!(
            "worst outage in this flight {} ({stage}); this loop tolerates {}{} (least of {phases}): margin {least}{:.1}{by}",
            count(*outage, "tick"),
            most(bears),
            bears.ticks,
            self.margin.unwrap_or_default()
        )
    }
}

/// The line of a flight, where it has one. A margin is of one airframe: that of the settings.
pub fn sentence(report: &Report) -> Option<String> {
    let margin = report.margin.as_ref()?;
    let swaps = report.swaps.len() as u64 + report.swaps_left_out;
    let sentence = margin.sentence();
    if margin.unknown.is_some() || swaps == 0 {
        return Some(sentence);
    }
    let swaps = count(swaps, "swap");
    Some(format!(
        "{sentence}; of the airframe before {swaps} in flight"
    ))
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
    fn the_smallest_margin_is_told_and_not_the_longest_outage() {
        let bears = |(stage, ticks): (&str, u64)| {
            let is_most = ticks >= 2000;
            (stage.to_owned(), RobustnessMargin { ticks, is_most })
        };
        let known = MarginSection {
            bears: [("outer", 2000), ("inner", 118), ("machine", 30)]
                .map(bears)
                .into(),
            phases: 32,
            ..MarginSection::default()
        };
        let other = MarginSection {
            measured_by: Some("7fa27a4-release".into()),
            ..known.clone()
        };
        let command = "ironbird margin --config settings.toml";
        let unknown = MarginSection::unknown("ab".into(), command.into());
        type Row<'a> = (&'a MarginSection, &'a [(&'a str, u64)], u64, &'a str);
        let rows: [Row<'_>; 7] = [
            (
                &known,
                &[("inner", 47), ("outer", 300)],
                0,
                "worst outage in this flight 47 ticks (inner); this loop tolerates 118 (least of 32 phases): margin 2.5",
            ),
            (
                &known,
                &[(MACHINE, 20), ("inner", 47)],
                0,
                "worst outage in this flight 20 ticks (machine); this loop tolerates 30 (least of 32 phases): margin 1.5",
            ),
            (
                &known,
                &[("outer", 1)],
                0,
                "worst outage in this flight 1 tick (outer); this loop tolerates more than 2000 (least of 32 phases): \
                 margin at least 2000.0",
            ),
            (
                &known,
                &[],
                0,
                "no stage had an outage in this flight; this loop tolerates, in ticks: inner 118, machine 30, outer more \
                 than 2000 (least of 32 phases)",
            ),
            (
                &known,
                &[("inner", 47)],
                2,
                "worst outage in this flight 47 ticks (inner); this loop tolerates 118 (least of 32 phases): margin 2.5; \
                 not in it: 2 outages, of which messages were lost",
            ),
            (
                &other,
                &[("inner", 47)],
                0,
                "worst outage in this flight 47 ticks (inner); this loop tolerates 118 (least of 32 phases): margin 2.5; \
                 measured by another build, 7fa27a4-release",
            ),
            (
                &unknown,
                &[(MACHINE, 5)],
                0,
                "not known: run ironbird margin --config settings.toml",
            ),
        ];
        for (section, all, unmeasured, sentence) in rows {
            let section = section.clone().with(&outages(all, unmeasured));
            assert_eq!(section.sentence(), sentence);
        }
        let unknown = unknown.with(&outages(&[(MACHINE, 5)], 0));
        assert_eq!((unknown.outages["machine"], unknown.margin), (5, None));
    }
}
