//! Logs that are written again, with messages left out or changed.

use std::path::Path;

use flight_log::entry::LogEntry;
use flight_log::facts::record;
use flight_log::reader::LogReader;
use flight_log::writer::FlightLog;

use super::{facts, settings};

/// Writes a log again, with another number of ticks in its landing record.
pub fn rewrite_landing(from: &Path, to: &Path, text: &str, ticks_run: &str) {
    finish_again(from, to, text, |_| true, &[("ticks_run", ticks_run)]);
}

/// Writes a log again, without the messages that `keep` does not want, which it may also change.
pub fn rewrite(from: &Path, to: &Path, text: &str, keep: impl FnMut(&mut LogEntry) -> bool) {
    finish_again(from, to, text, keep, &[]);
}

fn finish_again(
    from: &Path,
    to: &Path,
    text: &str,
    mut keep: impl FnMut(&mut LogEntry) -> bool,
    landing: &[(&str, &str)],
) {
    let mut reader = LogReader::open(from).unwrap();
    let mut log = FlightLog::create(to, &facts(&settings(text))).unwrap();
    while let Some(mut entry) = reader.next_entry().unwrap().copied() {
        if !keep(&mut entry) {
            continue;
        }
        log.take(entry);
    }
    log.finish(record(landing)).unwrap();
}

pub fn flip(value: &mut f64) {
    *value = f64::from_bits(value.to_bits() ^ 1);
}

/// Changes the lowest bit of a value: of tick 90, or of the swap of tick 60.
pub fn change(entry: &mut LogEntry, field: &str) {
    match entry {
        LogEntry::State(message)
            if field == "state.measured.position_w_m[1]" && message.envelope.tick == 90 =>
        {
            flip(&mut message.content.measured.position_w_m[1]);
        }
        LogEntry::Setpoint(message)
            if field == "setpoint.thrust_n" && message.envelope.tick == 90 =>
        {
            flip(&mut message.content.thrust_n);
        }
        LogEntry::Wrench(message)
            if field == "wrench.torque_b_nm[2]" && message.envelope.tick == 90 =>
        {
            flip(&mut message.content.torque_b_nm[2]);
        }
        LogEntry::Wrench(message)
            if field == "inner_telemetry.rotational_drag_nm_s" && message.envelope.tick == 90 =>
        {
            flip(&mut message.content.telemetry.value[4]);
        }
        LogEntry::RotorSpeeds(message)
            if field == "mixer_telemetry.yaw_share" && message.envelope.tick == 90 =>
        {
            flip(&mut message.content.telemetry.value[1]);
        }
        LogEntry::RotorSpeeds(message)
            if field == "rotor_speeds.saturated" && message.envelope.tick == 90 =>
        {
            message.content.saturated ^= 1;
        }
        LogEntry::Theorem(message) if field == "theorem.v_th" && message.envelope.tick == 90 => {
            flip(&mut message.content.v_th);
        }
        LogEntry::Swap(message) if field == "swaps.old[0]" && message.envelope.tick == 60 => {
            flip(&mut message.content.old[0]);
        }
        _ => {}
    }
}
