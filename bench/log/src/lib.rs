//! The flight log: every message in one MCAP file, which other tools can read too.
//!
//! ```text
//! topics --causal_order, channel_merge--> messages --event_log, codec--> writer --chunks--> async_writer --> flight.mcap, flight.1.mcap, ...
//!                                                           --> reader --> export, replay
//! ```
//!
//! Schemas, units and codec are derived from the layouts of the messages, and from the signals of the laws. docs/recording.md describes the
//! file. Start reading in [`entry::LogEntry`].

use messages::role::Channel;

pub mod async_writer;
pub mod build;
pub mod causal_order;
pub mod channel_merge;
mod chunk;
pub mod codec;
pub mod entry;
pub mod event_log;
pub mod facts;
pub mod fault_record;
mod log_file;
pub mod perfetto;
mod protobuf;
pub mod reader;
pub mod rows;
pub mod scene;
pub mod schema;
pub mod telemetry;
pub mod units;
pub mod wall_time;
pub mod writer;

/// Name of the log in a flight's directory: of its first file.
pub const FILE: &str = "flight.mcap";

/// Directory of a channel's own log in that of a flight with several channels.
pub fn log_directory(channel: Channel) -> String {
    format!("channel-{channel}")
}

/// Name of the files of the log: the first has no number.
pub fn file_name(part: u64) -> String {
    if part == 0 {
        FILE.into()
    } else {
        format!("flight.{part}.mcap")
    }
}

/// Number of a file of the log; none of another file.
pub fn part_of(file_name: &str) -> Option<u64> {
    let part = match file_name.strip_prefix("flight.")?.strip_suffix("mcap")? {
        "" => 0,
        number => number.strip_suffix('.')?.parse().ok()?,
    };
    (crate::file_name(part) == file_name).then_some(part)
}

pub use entry::TOPICS;

pub fn topics() -> impl Iterator<Item = &'static str> {
    TOPICS.into_iter().chain(telemetry::TELEMETRY_TOPICS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_log_are_told_from_others() {
        for part in [0, 1, 17] {
            assert_eq!(part_of(&file_name(part)), Some(part));
        }
        for other in [
            "flight.svg",
            "flight.0.mcap",
            "flight.01.mcap",
            "flight.+1.mcap",
            "flight.one.mcap",
            "myflight.mcap",
        ] {
            assert_eq!(part_of(other), None, "{other}");
        }
    }
}
