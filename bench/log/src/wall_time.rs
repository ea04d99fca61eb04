//! Formats wall-clock times in UTC, and the speed of a simulation.

use std::time::SystemTime;

/// A time for people: `2026-03-01 14:05:09 UTC`.
pub fn utc(instant: SystemTime) -> String {
    humantime::format_rfc3339_seconds(instant)
        .to_string()
        .replace('T', " ")
        .replace('Z', " UTC")
}

/// A time as a file name: `2026-03-01T14-05-09Z`.
pub fn file_stamp(instant: SystemTime) -> String {
    humantime::format_rfc3339_seconds(instant)
        .to_string()
        .replace(':', "-")
}

/// The speed of a simulation of `flown_s` seconds of flight: `0.071 s (850 times real time)`.
pub fn speed(flown_s: f64, wall_s: f64) -> String {
    format!("{wall_s:.3} s ({:.0} times real time)", flown_s / wall_s)
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, UNIX_EPOCH};

    use super::*;

    #[test]
    fn a_time_is_written_in_utc() {
        let instant = UNIX_EPOCH + Duration::from_millis(1_772_373_909_250);
        assert_eq!(utc(instant), "2026-03-01 14:05:09 UTC");
        assert_eq!(file_stamp(instant), "2026-03-01T14-05-09Z");
    }
}
