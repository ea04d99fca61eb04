//! Reads what an engine is asked for.

use std::time::Duration;

use toml::{Table, Value};

use super::Reader;
use crate::campaign::Submission;

/// Longest time limit: engines count minutes in 32 bits [s].
const TIME_LIMIT_MAX_S: f64 = 1e8;
/// Processors of a shard at the most.
const PROCESSORS_MAX: i64 = 4096;

impl Reader {
    /// The section `[submit]`.
    pub(super) fn submission(&mut self, given: &Table) -> Submission {
        let own = self.section(given, "submit");
        self.check_keys("submit", &own, &["partition", "time_limit_s", "requeue", "processors"]);
        let is_name = |name: &&str| {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.,".contains(c);
            !name.is_empty() && !name.starts_with('-') && name.chars().all(is_plain)
        };
        let partition = self.key(&own, "partition", "a partition's name, as in \"batch\"", |value| {
            value.as_str().filter(is_name).map(str::to_owned)
        });
        let time_limit = self.key(&own, "time_limit_s", "a time from 60 to 1e8 s, as in 1800.0", |value| {
            let seconds = value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))?;
            (60.0..=TIME_LIMIT_MAX_S).contains(&seconds).then(|| Duration::from_secs_f64(seconds))
        });
        let requeue = self.key(&own, "requeue", "true or false", Value::as_bool);
        let processors = self.key(&own, "processors", "a whole number from 1 to 4096", |value| {
            value.as_integer().filter(|number| (1..=PROCESSORS_MAX).contains(number)).map(i64::cast_unsigned)
        });
        Submission { partition, time_limit, requeue: requeue.unwrap_or(true), processors: processors.unwrap_or(1) }
    }

    /// A key of the section that may be missing.
    fn key<T>(&mut self, own: &Table, key: &str, expected: &str, read: impl Fn(&Value) -> Option<T>) -> Option<T> {
        let value = own.get(key)?;
        let read = read(value);
        if read.is_none() {
            let path = format!("submit.{key}");
            self.says(&path, format!("{path} = {value}: expected {expected}"));
        }
        read
    }
}
