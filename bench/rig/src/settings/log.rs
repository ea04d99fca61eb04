//! Settings of the flight log and of latency.hlog.

use serde::{Deserialize, Serialize};

use super::{RecorderSettings, Settings, within};
use failure::Failure;
use flight_log::facts::{ALL, AROUND_MISSES, LogPlan, OFF};

/// Longest time that is kept before an event [s]: until one comes, the recorder holds it in memory.
const LONGEST_AROUND_S: f64 = 10.0;

/// Messages that the flight log keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogName {
    /// All of them.
    All,
    /// Those around missed deadlines, swaps, take-off and landing.
    AroundMisses,
    /// None: there is no log.
    Off,
}

impl LogName {
    /// As it is written.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => ALL,
            Self::AroundMisses => AROUND_MISSES,
            Self::Off => OFF,
        }
    }
}

impl Settings {
    /// What the flight log keeps.
    #[must_use]
    pub fn log_plan(&self) -> LogPlan {
        let RecorderSettings { log, log_around_s, log_file_mb, log_files, .. } = self.recorder;
        let around_ticks = (log_around_s / self.flight.period_s).round() as u64;
        LogPlan {
            around_ticks: (log == LogName::AroundMisses).then_some(around_ticks),
            file_bytes: log_file_mb * 1_000_000,
            files: (log_files > 0).then_some(log_files),
        }
    }

    pub(super) fn check_log(&self) -> Result<(), Failure> {
        within("recorder.log_around_s", self.recorder.log_around_s, 0.0, LONGEST_AROUND_S)?;
        within("recorder.log_file_mb", self.recorder.log_file_mb as f64, 1.0, 1e6)?;
        if self.recorder.log_files == 1 {
            return Err(Failure::usage(
                "recorder.log_files = 1 is out of range: allowed are 0, for all, and 2 or more",
            )
            .help("the newest file may have only just begun; `ironbird fly --print-config` explains every setting"));
        }
        within("recorder.hlog_every_s", self.recorder.hlog_every_s as f64, 1.0, 3600.0)?;
        Ok(())
    }
}
