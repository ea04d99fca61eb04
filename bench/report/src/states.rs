//! The states of a flight as CSV: one row every few ticks, topics joined by tick.
//!
//! Every state has its row. A cell is empty if the stage published nothing for that tick.

use std::collections::BTreeMap;
use std::io::{BufWriter, Write};
use std::path::Path;

use model::messages::{RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;

use crate::tick::TickRecord;
use crate::tracking::Tracking;
use failure::{Failure, InFile as _, create_file};
use flight_log::spool::Spool;

/// What the states leave free on their disk, for the report [bytes].
const LEFT_FREE_BYTES: u64 = 1 << 20;

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
#[allow(missing_debug_implementations, reason = "what it writes to has none")]
pub struct StatesWriter {
    csv: csv::Writer<Box<dyn Write>>,
    /// What stands before the disk, where the file has something there.
    spool: Option<Spool>,
    tracking: Tracking,
    every_ticks: u64,
}

impl StatesWriter {
    /// A file with its header.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn create(path: &Path, tracking: Tracking, every_ticks: u64) -> Result<Self, Failure> {
        let file = create_file(path).in_file("write the states to", path)?;
        Self::begin(Box::new(BufWriter::new(file)), None, tracking, every_ticks).in_file("write the states to", path)
    }

    /// As [`Self::create`], and no row waits for the disk; what is no file is written as it comes.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn spooled(path: &Path, tracking: Tracking, every_ticks: u64) -> Result<Self, Failure> {
        let file = create_file(path).in_file("write the states to", path)?;
        if !file.metadata().is_ok_and(|facts| facts.is_file()) {
            let out = Box::new(BufWriter::new(file));
            return Self::begin(out, None, tracking, every_ticks).in_file("write the states to", path);
        }
        let spool = Spool::new(file, LEFT_FREE_BYTES).in_file("write the states to", path)?;
        let out = Box::new(spool.clone());
        Self::begin(out, Some(spool), tracking, every_ticks).in_file("write the states to", path)
    }

    fn begin(
        out: Box<dyn Write>,
        spool: Option<Spool>,
        tracking: Tracking,
        every_ticks: u64,
    ) -> Result<Self, csv::Error> {
        let mut csv = csv::Writer::from_writer(out);
        csv.write_record(COLUMNS)?;
        Ok(Self { csv, spool, tracking, every_ticks })
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
        let cell = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:?}"));
        self.csv
            .write_record(row(joined, &self.tracking).into_iter().map(cell))
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

fn row(joined: &Joined, tracking: &Tracking) -> Vec<Option<f64>> {
    let Joined { tick, state, wrench, rotor_speeds, .. } = joined;
    let mut row = vec![Some(*tick as f64 * tracking.period_s())];
    let vectors = [state.position_w_m, state.velocity_w_m_s, state.attitude_rad, state.rate_b_rad_s];
    row.extend(vectors.into_iter().flatten().map(Some));
    row.extend(cells(wrench.map(|wrench| wrench.estimate)));
    row.extend(cells(rotor_speeds.map(|speeds| speeds.speed_rad_s)));
    row.push(wrench.map(|wrench| wrench.thrust_n));
    row.extend(cells(wrench.map(|wrench| wrench.torque_b_nm)));
    row.extend(cells(wrench.map(|wrench| wrench.rate_error_b_rad_s)));
    row.extend(tracking.position_w_m(*tick).map(Some));
    row.push(Some(tracking.yaw_rad(*tick)));
    row
}

/// The cells of a vector; empty ones where nobody said it.
fn cells<const N: usize>(vector: Option<[f64; N]>) -> [Option<f64>; N] {
    vector.map_or([None; N], |vector| vector.map(Some))
}

/// A state, with what the stages made of it.
#[derive(Clone, Copy, Debug)]
pub struct Joined {
    /// The tick.
    pub tick: u64,
    /// State at the tick.
    pub state: State,
    /// Set-point of the tick; none where none was published.
    pub setpoint: Option<Setpoint>,
    /// Thrust and torque demanded at the tick; none where nobody demanded any.
    pub wrench: Option<Wrench>,
    /// Rotor command of the tick; none where none was published.
    pub rotor_speeds: Option<RotorSpeeds>,
    /// What is said of the theorem; none where nobody could tell.
    pub monitor: Option<Monitor>,
}

impl From<&TickRecord> for Joined {
    fn from(record: &TickRecord) -> Self {
        let TickRecord { tick, state, setpoint, wrench, rotor_speeds, monitor } = *record;
        Self { tick, state, setpoint, wrench: Some(wrench), rotor_speeds: Some(rotor_speeds), monitor }
    }
}

/// Joins the messages of a tick, which come by topic.
#[derive(Debug, Default)]
pub struct Joiner {
    waiting: BTreeMap<u64, Parts>,
    /// Newest tick of each topic: a topic never goes back.
    newest: [Option<u64>; TOPICS],
    /// Newest tick that nothing is waited for any more.
    settled: Option<u64>,
    /// Ticks of which a topic had no message.
    pub incomplete: u64,
}

/// Topics that are joined.
const TOPICS: usize = 4;

#[derive(Debug, Default)]
struct Parts {
    state: Option<State>,
    setpoint: Option<Setpoint>,
    wrench: Option<Wrench>,
    rotor_speeds: Option<RotorSpeeds>,
    monitor: Option<Monitor>,
}

/// A message of one topic.
#[derive(Clone, Copy, Debug)]
pub enum LoopMessage {
    /// Topic `state`.
    State(State),
    /// Topic `setpoint`.
    Setpoint(Setpoint),
    /// Topic `wrench`, with what topic `theorem` says of it.
    Wrench(Wrench, Option<Monitor>),
    /// Topic `rotor_speeds`.
    RotorSpeeds(RotorSpeeds),
}

/// Ticks for which a message may come later than another topic's of a newer tick.
const PATIENCE_TICKS: u64 = 5_000;

impl Joiner {
    /// Takes a message in.
    pub fn take(&mut self, tick: u64, part: LoopMessage) {
        let topic = match part {
            LoopMessage::State(_) => 0,
            LoopMessage::Setpoint(_) => 1,
            LoopMessage::Wrench(..) => 2,
            LoopMessage::RotorSpeeds(_) => 3,
        };
        self.newest[topic] = self.newest[topic].max(Some(tick));
        if Some(tick) <= self.settled {
            return;
        }
        let parts = self.waiting.entry(tick).or_default();
        match part {
            LoopMessage::State(state) => parts.state = Some(state),
            LoopMessage::Setpoint(setpoint) => parts.setpoint = Some(setpoint),
            LoopMessage::Wrench(wrench, monitor) => (parts.wrench, parts.monitor) = (Some(wrench), monitor),
            LoopMessage::RotorSpeeds(speeds) => parts.rotor_speeds = Some(speeds),
        }
    }

    /// The next state for whose tick nothing more can come, in the order of the ticks; to be asked when all topics are
    /// drained.
    pub fn settled(&mut self) -> Option<Joined> {
        let newest = self.newest.into_iter().max().flatten()?;
        while let Some((tick, parts)) = self.waiting.first_key_value() {
            let is_over = parts.there().iter().zip(self.newest).all(|(there, newest)| *there || newest > Some(*tick));
            if !is_over && tick + PATIENCE_TICKS >= newest {
                return None;
            }
            if let Some(joined) = self.next() {
                return Some(joined);
            }
        }
        None
    }

    /// As [`Self::settled`], when nothing more comes at all.
    pub fn rest(&mut self) -> Option<Joined> {
        while !self.waiting.is_empty() {
            if let Some(joined) = self.next() {
                return Some(joined);
            }
        }
        None
    }

    /// Takes the oldest tick off; none where it has no state.
    fn next(&mut self) -> Option<Joined> {
        let (tick, parts) = self.waiting.pop_first()?;
        self.settled = Some(tick);
        self.incomplete += u64::from(parts.there() != [true; TOPICS]);
        let Parts { state, setpoint, wrench, rotor_speeds, monitor } = parts;
        state.map(|state| Joined { tick, state, setpoint, wrench, rotor_speeds, monitor })
    }
}

impl Parts {
    const fn there(&self) -> [bool; TOPICS] {
        [self.state.is_some(), self.setpoint.is_some(), self.wrench.is_some(), self.rotor_speeds.is_some()]
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;
    use flight_log::spool::Disk;

    fn take(joiner: &mut Joiner, tick: u64, topics: &str) {
        for topic in topics.chars() {
            joiner.take(
                tick,
                match topic {
                    's' => LoopMessage::State(State::default()),
                    'p' => LoopMessage::Setpoint(Setpoint::default()),
                    'w' => LoopMessage::Wrench(Wrench::default(), None),
                    _ => LoopMessage::RotorSpeeds(RotorSpeeds::default()),
                },
            );
        }
    }

    fn settled(joiner: &mut Joiner) -> Vec<u64> {
        std::iter::from_fn(|| joiner.settled()).map(|joined| joined.tick).collect()
    }

    #[test]
    fn a_state_that_no_stage_answered_is_there_in_its_place() {
        let mut joiner = Joiner::default();
        [(7, "spwr"), (8, "sp"), (9, "s")].into_iter().for_each(|(tick, topics)| take(&mut joiner, tick, topics));
        assert_eq!(settled(&mut joiner), [7], "something may still come");
        take(&mut joiner, 10, "spwr");
        assert_eq!(settled(&mut joiner), [8, 9, 10], "every topic has gone on");
        assert_eq!(joiner.incomplete, 2);
        take(&mut joiner, 9, "w");
        assert_eq!((settled(&mut joiner), joiner.incomplete), (vec![], 2), "too late");
    }

    #[test]
    fn one_who_is_silent_is_not_waited_for_for_ever() {
        let mut joiner = Joiner::default();
        (0..=PATIENCE_TICKS + 2).for_each(|tick| take(&mut joiner, tick, "sp"));
        assert_eq!(settled(&mut joiner), [0, 1]);
        assert_eq!(std::iter::from_fn(|| joiner.rest()).count() as u64, PATIENCE_TICKS + 1);
        assert_eq!(joiner.incomplete, PATIENCE_TICKS + 3);
    }

    #[test]
    fn a_tick_without_a_state_has_no_row_and_holds_nothing_up() {
        let mut joiner = Joiner::default();
        [(3, "wr"), (4, "spwr")].into_iter().for_each(|(tick, topics)| take(&mut joiner, tick, topics));
        assert_eq!((settled(&mut joiner), joiner.incomplete), (vec![4], 1));
    }

    #[test]
    fn what_nobody_said_is_an_empty_cell() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let tracking = Tracking::of(controller::Trajectory::Step, 1e-3);
        let mut states = StatesWriter::create(file.path(), tracking, 1).unwrap();
        let state = State::default();
        let joined = Joined { tick: 3, state, setpoint: None, wrench: None, rotor_speeds: None, monitor: None };
        states.write(&joined).unwrap();
        states.flush().unwrap();
        let text = std::fs::read_to_string(file.path()).unwrap();
        let zeros = ",0.0".repeat(12);
        assert_eq!(text.lines().nth(1), Some(format!("0.003{zeros}{},1.0,-1.0,1.0,0.5", ",".repeat(14)).as_str()));
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
        let mut states = StatesWriter::begin(Box::new(spool.clone()), Some(spool), tracking, 1).unwrap();
        let failure = states.finish().unwrap_err().to_string();
        assert_eq!(failure, "the states are not whole: the disk took nothing for 3 s");
    }
}
