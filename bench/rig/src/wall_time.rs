//! Formats instants of the wall clock, in UTC.

use std::time::SystemTime;

/// An instant for people: `2026-03-01 14:05:09 UTC`.
#[must_use]
pub fn utc(instant: SystemTime) -> String {
    humantime::format_rfc3339_seconds(instant).to_string().replace('T', " ").replace('Z', " UTC")
}

/// An instant as the name of a file: `2026-03-01T14-05-09Z`.
#[must_use]
pub fn file_stamp(instant: SystemTime) -> String {
    humantime::format_rfc3339_seconds(instant).to_string().replace(':', "-")
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, UNIX_EPOCH};

    use super::*;

    #[test]
    fn an_instant_is_written_in_utc() {
        let instant = UNIX_EPOCH + Duration::from_millis(1_772_373_909_250);
        assert_eq!(utc(instant), "2026-03-01 14:05:09 UTC");
        assert_eq!(file_stamp(instant), "2026-03-01T14-05-09Z");
    }
}
