//! The states of a flight as CSV: one row every few ticks, topics joined by tick.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use model::messages::{RotorSpeeds, Setpoint, State, Wrench};

use crate::tick::TickRecord;
use failure::{Failure, InFile as _};

/// Columns, as in the reference flights.
const COLUMNS: [&str; 31] = [
    "t",
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "phi",
    "theta",
    "psi",
    "p",
    "q",
    "r",
    "IR_hat",
    "kr_hat",
    "delta_hat",
    "w1",
    "w2",
    "w3",
    "w4",
    "u",
    "tau_p",
    "tau_q",
    "tau_r",
    "e_p",
    "e_q",
    "e_r",
    "xd",
    "yd",
    "zd",
    "psid",
];

/// Writes rows.
#[derive(Debug)]
pub struct StatesWriter {
    csv: csv::Writer<BufWriter<File>>,
    period_s: f64,
    every_ticks: u64,
}

impl StatesWriter {
    /// A file with its header.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn create(path: &Path, period_s: f64, every_ticks: u64) -> Result<Self, Failure> {
        let file = File::create(path).in_file("write the states to", path)?;
        let mut csv = csv::Writer::from_writer(BufWriter::new(file));
        csv.write_record(COLUMNS).in_file("write the states to", path)?;
        Ok(Self { csv, period_s, every_ticks })
    }

    /// Whether a tick has a row.
    #[must_use]
    pub const fn wants(&self, tick: u64) -> bool {
        tick.is_multiple_of(self.every_ticks)
    }

    /// Writes the row of a tick, if it has one.
    ///
    /// # Errors
    /// [`Failure`] with the system's reason.
    pub fn write(&mut self, record: &TickRecord) -> Result<(), Failure> {
        let TickRecord { tick, state, setpoint: Some(setpoint), wrench, rotor_speeds } = record else { return Ok(()) };
        if !self.wants(*tick) {
            return Ok(());
        }
        let t_s = *tick as f64 * self.period_s;
        let row = row(t_s, state, setpoint, wrench, rotor_speeds);
        self.csv
            .write_record(row.iter().map(|value| format!("{value:?}")))
            .map_err(|e| Failure::failed(format!("cannot write the states: {e}")))
    }

    /// Writes out what is buffered.
    ///
    /// # Errors
    /// [`Failure`] with the system's reason.
    pub fn flush(&mut self) -> Result<(), Failure> {
        self.csv.flush().map_err(|e| Failure::failed(format!("cannot write the states: {e}")))
    }
}

fn row(t_s: f64, state: &State, setpoint: &Setpoint, wrench: &Wrench, speeds: &RotorSpeeds) -> Vec<f64> {
    let mut row = vec![t_s];
    row.extend(state.position_w_m);
    row.extend(state.velocity_w_m_s);
    row.extend(state.attitude_rad);
    row.extend(state.rate_b_rad_s);
    row.extend(wrench.estimate);
    row.extend(speeds.speed_rad_s);
    row.push(wrench.thrust_n);
    row.extend(wrench.torque_b_nm);
    row.extend(wrench.rate_error_b_rad_s);
    row.extend(setpoint.reference_position_w_m);
    row.push(setpoint.reference_yaw_rad);
    row
}

/// Joins the messages of a tick, which come by topic.
#[derive(Debug, Default)]
pub struct Joiner {
    waiting: std::collections::BTreeMap<u64, Parts>,
    /// Ticks of which a topic had no message.
    pub incomplete: u64,
}

#[derive(Debug, Default)]
struct Parts {
    state: Option<State>,
    setpoint: Option<Setpoint>,
    wrench: Option<Wrench>,
    rotor_speeds: Option<RotorSpeeds>,
}

/// A message of one topic.
#[derive(Clone, Copy, Debug)]
pub enum Part {
    /// Topic `state`.
    State(State),
    /// Topic `setpoint`.
    Setpoint(Setpoint),
    /// Topic `wrench`.
    Wrench(Wrench),
    /// Topic `rotor_speeds`.
    RotorSpeeds(RotorSpeeds),
}

/// Ticks for which a message may come later than another topic's of a newer tick.
const PATIENCE_TICKS: u64 = 5_000;

impl Joiner {
    /// Takes a message in; gives the tick's record when it was the last that was missing.
    pub fn take(&mut self, tick: u64, part: Part) -> Option<TickRecord> {
        let parts = self.waiting.entry(tick).or_default();
        match part {
            Part::State(state) => parts.state = Some(state),
            Part::Setpoint(setpoint) => parts.setpoint = Some(setpoint),
            Part::Wrench(wrench) => parts.wrench = Some(wrench),
            Part::RotorSpeeds(speeds) => parts.rotor_speeds = Some(speeds),
        }
        if let (Some(state), Some(setpoint), Some(wrench), Some(rotor_speeds)) =
            (parts.state, parts.setpoint, parts.wrench, parts.rotor_speeds)
        {
            self.waiting.remove(&tick);
            return Some(TickRecord { tick, state, setpoint: Some(setpoint), wrench, rotor_speeds });
        }
        while self.waiting.first_key_value().is_some_and(|(oldest, _)| oldest + PATIENCE_TICKS < tick) {
            self.waiting.pop_first();
            self.incomplete += 1;
        }
        None
    }

    /// Counts what will never be complete.
    pub fn finish(&mut self) {
        self.incomplete += self.waiting.len() as u64;
        self.waiting.clear();
    }
}
