//! A finding: what was examined, what it means, and what to do about it.
//!
//! The verdict follows from all findings together.

use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    Ok,
    Warning,
    /// As it is, nothing flies in real time.
    Blocks,
}

impl Level {
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Blocks => "BLOCKS",
        }
    }
}

/// What can be expected of a machine; the later, the better.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum RealtimeClass {
    #[default]
    #[serde(rename = "not real-time here")]
    NotRealTime,
    /// In time nearly always; now and then something that nobody here controls is in the way.
    #[serde(rename = "soft")]
    Soft,
    /// Nothing was found that holds a wake-up off for long.
    #[serde(rename = "hard")]
    Hard,
}

impl RealtimeClass {
    pub const fn words(self) -> &'static str {
        match self {
            Self::Hard => "hard",
            Self::Soft => "soft",
            Self::NotRealTime => "not real-time here",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    pub subject: String,
    /// Whether it is as it should be.
    pub level: Level,
    /// The best verdict that it leaves open.
    pub allows: RealtimeClass,
    pub found: String,
    pub why: String,
    /// The command or configuration line that changes it; none where nothing needs to.
    pub fix: Option<String>,
}

impl Finding {
    pub fn ok(subject: &str, found: impl Into<String>, why: &str) -> Self {
        Self {
            subject: subject.into(),
            level: Level::Ok,
            allows: RealtimeClass::Hard,
            found: found.into(),
            why: why.into(),
            fix: None,
        }
    }

    /// It could be better, and wake-ups are as bounded as without it.
    pub fn could_be_better(self, fix: impl Into<String>) -> Self {
        Self {
            level: Level::Warning,
            fix: Some(fix.into()),
            ..self
        }
    }

    pub fn softens(self, fix: impl Into<String>) -> Self {
        Self {
            level: Level::Warning,
            allows: RealtimeClass::Soft,
            fix: Some(fix.into()),
            ..self
        }
    }

    pub fn blocks(self, fix: impl Into<String>) -> Self {
        Self {
            level: Level::Blocks,
            allows: RealtimeClass::NotRealTime,
            fix: Some(fix.into()),
            ..self
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnosis {
    pub verdict: RealtimeClass,
    /// Why it is not better: a subject with what was found, each.
    pub reasons: Vec<String>,
}

impl Diagnosis {
    pub fn of(findings: &[Finding]) -> Self {
        let verdict = findings
            .iter()
            .map(|finding| finding.allows)
            .min()
            .unwrap_or(RealtimeClass::Hard);
        let is_due =
            |finding: &&Finding| finding.allows == verdict && verdict != RealtimeClass::Hard;
        let reasons = findings
            .iter()
            .filter(is_due)
            .map(|it| format!("{}: {}", it.subject, it.found))
            .collect();
        Self { verdict, reasons }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_verdict_is_the_worst_that_any_finding_leaves_open_with_its_reasons() {
        let fine = Finding::ok("a", "x", "");
        let better = Finding::ok("b", "x", "").could_be_better("f");
        let soft = Finding::ok("c", "y", "").softens("f");
        let blocks = Finding::ok("d", "z", "").blocks("f");
        let of = |findings: &[&Finding]| {
            let findings: Vec<_> = findings.iter().map(|finding| (*finding).clone()).collect();
            let diagnosis = Diagnosis::of(&findings);
            (diagnosis.verdict.words(), diagnosis.reasons)
        };
        assert_eq!(of(&[&fine, &better]), ("hard", vec![]));
        assert_eq!(
            of(&[&fine, &soft, &better]),
            ("soft", vec!["c: y".to_owned()])
        );
        assert_eq!(
            of(&[&soft, &blocks]),
            ("not real-time here", vec!["d: z".to_owned()])
        );
    }
}
