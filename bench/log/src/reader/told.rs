//! What a log says of its flight: its writer, its pace, what it was to hold.

use failure::Failure;
use model::boards::LOCKSTEP;
use model::envelope::LAYOUT;
use model::grid::{Grid, Pace};

use super::{End, LogReader};
use crate::build::Build;
use crate::{TOPICS, facts};

/// What a log holds, by its own words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Ticks around missed deadlines that it keeps; none where it keeps every message.
    pub around_ticks: Option<u64>,
    /// Files that were before the first one that is there.
    pub files_before: u64,
}

impl LogReader {
    /// What the log says of its flight, as far as it has been read: all but the landing stands before the messages.
    ///
    /// # Errors
    /// [`Failure`] names the file and the missing fact.
    pub fn fact(&self, record: &str, name: &str) -> Result<&str, Failure> {
        self.facts
            .get(record)
            .and_then(|record| record.get(name))
            .map(String::as_str)
            .ok_or_else(|| self.damaged(&format!("its record `{record}` has no `{name}`")))
    }

    /// A number of the record that ends the log; none where it does not say.
    ///
    /// # Errors
    /// [`Failure`] names the file, where the record is missing or says no number.
    pub fn landed(&self, name: &str) -> Result<Option<u64>, Failure> {
        let landing = self.facts.get(facts::LANDING).ok_or_else(|| {
            self.damaged("its record `landing` is missing: it has an end, but not the one that its recorder wrote")
        })?;
        let Some(text) = landing.get(name) else { return Ok(None) };
        let number = text
            .parse()
            .map_err(|_| self.damaged(&format!("its record `landing` has {name} = `{text}`, which is no number")))?;
        Ok(Some(number))
    }

    /// A number of the record about the run.
    ///
    /// # Errors
    /// As [`Self::fact`].
    pub fn number(&self, name: &str) -> Result<u64, Failure> {
        let text = self.fact(facts::RUN, name)?;
        text.parse().map_err(|_| self.damaged(&format!("its record `run` has {name} = `{text}`, which is no number")))
    }

    /// What moved the ticks of the run on.
    ///
    /// # Errors
    /// As [`Self::fact`].
    pub fn pace(&self) -> Result<Pace, Failure> {
        let (t0_ns, period_ns) = (self.number("t0_ns")?, self.number("period_ns")?);
        Ok(if period_ns == LOCKSTEP { Pace::Lockstep } else { Pace::Realtime(Grid { t0_ns, period_ns }) })
    }

    /// What it holds: of its first file that is there.
    ///
    /// # Errors
    /// [`Failure`] names the file, where it says no number.
    pub fn kept(&self) -> Result<Kept, Failure> {
        // Logs from before there were excerpts do not say.
        let number = |name: &str| match self.facts.get(facts::KEPT).and_then(|record| record.get(name)) {
            None => Ok(0),
            Some(text) => text.parse().map_err(|_| {
                self.damaged(&format!("its record `{}` has {name} = `{text}`, which is no number", facts::KEPT))
            }),
        };
        let is_excerpt = self.fact(facts::KEPT, "kept").is_ok_and(|kept| kept == facts::AROUND_MISSES);
        let around_ticks = number("around_ticks")?;
        Ok(Kept { around_ticks: is_excerpt.then_some(around_ticks), files_before: number("part")? })
    }

    /// The executable that wrote it; what the log does not say is unknown.
    #[must_use]
    pub fn build(&self) -> Build {
        let told = |name: &str| self.fact(facts::RUN, name).map_or_else(|_| "unknown".to_owned(), str::to_owned);
        Build {
            version: told("version"),
            commit: told("commit"),
            dirty: told("dirty") == "true",
            profile: told("profile"),
            rustc: told("rustc"),
            target: told("target"),
        }
    }

    /// A failure of this log.
    #[must_use]
    pub fn damaged(&self, what: &str) -> Failure {
        Failure::failed(format!("{} is damaged or no flight log: {what}", self.path.display()))
            .help("only an undamaged log can be trusted; what stands before the damage can be exported")
    }

    /// Messages that a log with its beginning and its end lacks, by topic: those that it says it was to hold.
    ///
    /// # Errors
    /// As [`Self::landed`].
    pub fn missing(&self) -> Result<Vec<(&'static str, u64)>, Failure> {
        if self.end() != End::Complete || self.kept()?.files_before > 0 {
            return Ok(Vec::new());
        }
        let mut missing = Vec::new();
        for (topic, read) in TOPICS.into_iter().zip(self.read) {
            let told = self.landed(&format!("messages.{topic}"))?.unwrap_or(read);
            if told > read {
                missing.push((topic, told - read));
            }
        }
        Ok(missing)
    }

    /// A failure of a log that another version has written.
    pub(super) fn of_other_version(&self, how: &str) -> Failure {
        Failure::failed(format!(
            "{} was written by another version of ironbird, {}: {how}",
            self.path.display(),
            self.build(),
        ))
        .help("use that version; the schemas in the log let any MCAP reader read it (docs/recording.md)")
    }

    /// Refuses a log that another version wrote, or one with other layouts.
    ///
    /// # Errors
    /// [`Failure`] says what differs.
    pub fn check_version(&self) -> Result<(), Failure> {
        for (name, ours) in [
            ("format", facts::FORMAT.to_owned()),
            ("version", env!("CARGO_PKG_VERSION").into()),
            ("layout", format!("{LAYOUT:016x}")),
        ] {
            let theirs = self.fact(facts::RUN, name)?;
            if theirs != ours {
                return Err(self.of_other_version(&format!("{name} `{theirs}`, here `{ours}`")));
            }
        }
        Ok(())
    }
}
