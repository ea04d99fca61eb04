//! The states of a flight as CSV: one row every few ticks, topics joined by tick.
//!
//! Every state has its row. A cell is empty if the stage published nothing for that tick, or if its law knows no such
//! number. What the laws show stands behind the other columns, as in `inner_telemetry.rate_error_x_rad_s`.

mod joiner;

use std::io::{BufWriter, Write};
use std::path::Path;

use flight_log::telemetry::TELEMETRY_TOPICS;
use model::telemetry::LAW_ROLES;

use crate::laws::{FlownLaws, Places};
use crate::tracking::Tracking;
use failure::{Failure, InFile as _, create_file};
use flight_log::spool::Spool;
pub use joiner::{Joined, Joiner, LoopMessage};

/// What the states leave free on their disk, for the report [bytes].
const LEFT_FREE_BYTES: u64 = 1 << 20;

/// The first columns, as in the reference flights.
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
#[allow(missing_debug_implementations, reason = "what it writes to has none")]
pub struct StatesWriter {
    csv: csv::Writer<Box<dyn Write>>,
    /// What stands before the disk, where the file has something there.
    spool: Option<Spool>,
    tracking: Tracking,
    laws: FlownLaws,
    every_ticks: u64,
}

impl StatesWriter {
    /// A file with its header.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn create(path: &Path, tracking: Tracking, laws: FlownLaws, every_ticks: u64) -> Result<Self, Failure> {
        let file = create_file(path).in_file("write the states to", path)?;
        Self::begin(Box::new(BufWriter::new(file)), None, tracking, laws, every_ticks)
            .in_file("write the states to", path)
    }

    /// As [`Self::create`], and no row waits for the disk; what is no file is written as it comes.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn spooled(path: &Path, tracking: Tracking, laws: FlownLaws, every_ticks: u64) -> Result<Self, Failure> {
        let file = create_file(path).in_file("write the states to", path)?;
        if !file.metadata().is_ok_and(|facts| facts.is_file()) {
            let out = Box::new(BufWriter::new(file));
            return Self::begin(out, None, tracking, laws, every_ticks).in_file("write the states to", path);
        }
        let spool = Spool::new(file, LEFT_FREE_BYTES).in_file("write the states to", path)?;
        let out = Box::new(spool.clone());
        Self::begin(out, Some(spool), tracking, laws, every_ticks).in_file("write the states to", path)
    }

    fn begin(
        out: Box<dyn Write>,
        spool: Option<Spool>,
        tracking: Tracking,
        laws: FlownLaws,
        every_ticks: u64,
    ) -> Result<Self, csv::Error> {
        let mut csv = csv::Writer::from_writer(out);
        let shown = LAW_ROLES.into_iter().zip(TELEMETRY_TOPICS).flat_map(|(role, topic)| {
            laws.signals.of(role).iter().map(move |signal| format!("{topic}.{}", signal.name))
        });
        csv.write_record(COLUMNS.into_iter().map(str::to_owned).chain(shown))?;
        Ok(Self { csv, spool, tracking, laws, every_ticks })
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
    pub fn write(&mut self, joined: &Joined) -> Result<(), Failure> {
        if !self.wants(joined.tick) {
            return Ok(());
        }
        let known = |value: Option<f64>| value.filter(|value| !value.is_nan());
        let cell = |value| known(value).map_or_else(String::new, |value| format!("{value:?}"));
        self.csv
            .write_record(row(joined, &self.tracking, &self.laws).into_iter().map(cell))
            .map_err(|e| Failure::failed(format!("cannot write the states: {e}")))
    }

    /// Writes out what is buffered.
    ///
    /// # Errors
    /// [`Failure`] with the system's reason.
    pub fn flush(&mut self) -> Result<(), Failure> {
        self.csv.flush().map_err(|e| Failure::failed(format!("cannot write the states: {e}")))?;
        if let Some(spool) = &self.spool {
            spool.settle_or_drop();
        }
        Ok(())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// [`Failure`] with the system's reason, where it is not all there.
    pub fn finish(&mut self) -> Result<(), Failure> {
        self.flush()?;
        let Some(spool) = &self.spool else { return Ok(()) };
        spool.finish().map_or(Ok(()), |reason| Err(Failure::failed(format!("the states are not whole: {reason}"))))
    }
}

fn row(joined: &Joined, tracking: &Tracking, laws: &FlownLaws) -> Vec<Option<f64>> {
    let Joined { tick, state, wrench, rotor_speeds, .. } = joined;
    let shown = |places: Option<Places>| Some(places?.of(wrench.as_ref()?));
    let mut row = vec![Some(*tick as f64 * tracking.period_s())];
    let vectors = [
        state.measured.position_w_m,
        state.measured.velocity_w_m_s,
        state.measured.attitude_rad,
        state.measured.rate_b_rad_s,
    ];
    row.extend(vectors.into_iter().flatten().map(Some));
    row.extend(cells(shown(laws.estimates())));
    row.extend(cells(rotor_speeds.map(|speeds| speeds.speed_rad_s)));
    row.push(wrench.map(|wrench| wrench.thrust_n));
    row.extend(cells(wrench.map(|wrench| wrench.torque_b_nm)));
    row.extend(cells(shown(laws.rate_error())));
    row.extend(tracking.position_w_m(*tick).map(Some));
    row.push(Some(tracking.yaw_rad(*tick)));
    for (role, telemetry) in LAW_ROLES.into_iter().zip(joined.telemetry()) {
        let value = |i: usize| telemetry.map(|telemetry| telemetry.value[i]);
        row.extend((0..laws.signals.of(role).len()).map(value));
    }
    row
}

/// The cells of a vector; empty ones where nobody said it.
fn cells<const N: usize>(vector: Option<[f64; N]>) -> [Option<f64>; N] {
    vector.map_or([None; N], |vector| vector.map(Some))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io;

    use super::*;
    use flight_log::spool::Disk;
    use model::messages::{State, Wrench};
    use model::telemetry::{RATE_ERROR, Signal, Signals, Telemetry};

    #[test]
    fn what_nobody_said_is_an_empty_cell() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let tracking = Tracking::of(controller::Trajectory::Step, 1e-3);
        let mut states = StatesWriter::create(file.path(), tracking, FlownLaws::default(), 1).unwrap();
        let state = State::default();
        let joined = Joined { tick: 3, state, setpoint: None, wrench: None, rotor_speeds: None, monitor: None };
        states.write(&joined).unwrap();
        states.flush().unwrap();
        let text = std::fs::read_to_string(file.path()).unwrap();
        let zeros = ",0.0".repeat(12);
        assert_eq!(text.lines().nth(1), Some(format!("0.003{zeros}{},1.0,-1.0,1.0,0.5", ",".repeat(14)).as_str()));
    }

    const SIGNALS: [Signal; 7] = {
        const fn signal(name: &'static str) -> Signal {
            Signal { name, unit: "" }
        }
        let [x, y, z] = RATE_ERROR;
        [
            signal("first"),
            signal(x),
            signal(y),
            signal(z),
            signal("rotor_inertia_kg_m2"),
            signal("rotational_drag_nm_s"),
            signal("disturbance_gain_rad_s2"),
        ]
    };

    /// The row of a tick with a wrench of which nothing is said of the theorem, by column.
    fn row_of(laws: FlownLaws, telemetry: Telemetry) -> BTreeMap<String, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        let tracking = Tracking::of(controller::Trajectory::Step, 1e-3);
        let mut states = StatesWriter::create(file.path(), tracking, laws, 1).unwrap();
        let (state, wrench) = (State::default(), Some(Wrench { telemetry, ..Wrench::default() }));
        let joined = Joined { tick: 3, state, setpoint: None, wrench, rotor_speeds: None, monitor: None };
        states.write(&joined).unwrap();
        states.flush().unwrap();
        let text = std::fs::read_to_string(file.path()).unwrap();
        let cells: Vec<Vec<String>> = text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        cells[0].iter().cloned().zip(cells[1].iter().cloned()).collect()
    }

    #[test]
    fn after_a_lost_message_the_estimates_are_still_there_and_what_a_law_does_not_know_is_not() {
        let mut telemetry = Telemetry::unsaid(SIGNALS.len());
        telemetry.value[0] = 7.0;
        telemetry.value[2..7].copy_from_slice(&[-0.0, 0.5, 3e-5, 0.1, 0.2]);
        let signals = Signals { inner: &SIGNALS, ..Signals::default() };
        let row = row_of(FlownLaws { signals, without_theorem: None }, telemetry);
        let of = |row: &BTreeMap<String, String>, names: &[&str]| -> Vec<String> {
            names.iter().map(|name| row[*name].clone()).collect()
        };
        assert_eq!(of(&row, &["IR_hat", "kr_hat", "delta_hat"]), ["3e-5", "0.1", "0.2"]);
        assert_eq!(of(&row, &["e_p", "e_q", "e_r"]), ["", "-0.0", "0.5"]);
        assert_eq!(of(&row, &["inner_telemetry.first", "inner_telemetry.rate_error_x_rad_s"]), ["7.0", ""]);
        let row = row_of(FlownLaws { signals, without_theorem: Some("other") }, telemetry);
        assert_eq!(of(&row, &["IR_hat", "kr_hat", "delta_hat", "e_r"]), ["", "", "", "0.5"]);
        assert_eq!(row["inner_telemetry.rotational_drag_nm_s"], "0.1");
    }

    /// A disk that stands still for good, and refuses nothing.
    struct Stuck;

    impl Disk for Stuck {
        fn free(&self) -> Option<u64> {
            None
        }

        fn write_at(&self, _: &[u8], _: u64) -> io::Result<()> {
            loop {
                std::thread::park();
            }
        }

        fn cut(&self, _: u64) -> io::Result<()> {
            Ok(())
        }

        fn sync(&self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_disk_that_stands_still_at_the_end_leaves_no_whole_file() {
        let spool = Spool::new(Stuck, 0).unwrap();
        let tracking = Tracking::of(controller::Trajectory::Step, 1e-3);
        let mut states =
            StatesWriter::begin(Box::new(spool.clone()), Some(spool), tracking, FlownLaws::default(), 1).unwrap();
        let failure = states.finish().unwrap_err().to_string();
        assert_eq!(failure, "the states are not whole: the disk took nothing for 3 s");
    }
}
