//! A finding: what was examined, what it means, and what to do about it.
//!
//! The verdict follows from all findings together.

use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    Ok,
    Unknown,
    Warning,
    /// As it is, nothing flies in real time.
    Blocks,
}

/// What can be expected of a machine; the later, the better.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum RealtimeClass {
    #[default]
    #[serde(rename = "not real-time here")]
    NotRealTime,
    /// In time nearly always; rarely delayed by something outside this machine.
    #[serde(rename = "soft")]
    Soft,
    /// Nothing was found that holds a wake-up off for long.
    #[serde(rename = "hard")]
    Hard,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    pub subject: String,
    pub level: Level,
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

    /// It could not be examined; `found` says why.
    pub fn unknown(self, allows: RealtimeClass) -> Self {
        self.of_level(Level::Unknown, allows, None)
    }

    /// It could be better, and wake-ups are as bounded as without it.
    pub fn could_be_better(self, fix: impl Into<String>) -> Self {
        let allows = self.allows;
        self.of_level(Level::Warning, allows, Some(fix.into()))
    }

    pub fn softens(self, fix: impl Into<String>) -> Self {
        self.of_level(Level::Warning, RealtimeClass::Soft, Some(fix.into()))
    }

    pub fn blocks(self, fix: impl Into<String>) -> Self {
        self.of_level(Level::Blocks, RealtimeClass::NotRealTime, Some(fix.into()))
    }

    fn of_level(self, level: Level, allows: RealtimeClass, fix: Option<String>) -> Self {
        Self {
            level,
            allows,
            fix,
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
        let classes = findings.iter().map(|finding| finding.allows);
        let verdict = classes.min().unwrap_or(RealtimeClass::Hard);
        let is_due = |it: &&Finding| it.allows == verdict && verdict != RealtimeClass::Hard;
        let due = findings.iter().filter(is_due);
        let reasons = due
            .map(|it| format!("{}: {}", it.subject, it.found))
            .collect();
        Self { verdict, reasons }
    }
}
