//! The states of a flight as CSV: one row every few ticks, topics joined by tick.
//!
//! Every state has its row. A cell is empty if the stage published nothing for that tick, or if its law knows no such
//! number. What the laws show stands behind the other columns, as in `inner_telemetry.rate_error_x_rad_s`.

use crate::laws::{FlownLaws, Places};
use crate::tracking::Tracking;
use errors::{Failure, InFile as _, create_file};
use flight_log::async_writer::AsyncWriter;
use flight_log::entry::LogEntry;
use flight_log::telemetry::TELEMETRY_TOPICS;
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;
use messages::role::Role;
use messages::telemetry::{LAW_ROLES, Telemetry};
use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// What the states leave free on their disk, for the report [bytes].
const LEFT_FREE_BYTES: u64 = 1 << 20;

/// Names of columns, their unit and their meaning; signals of the laws follow.
const COLUMNS: [(&str, &str, &str); 13] = [
    ("t", "s", "time of the flight"),
    (
        "x,y,z",
        "m",
        "position in the world frame, as the sensors show it",
    ),
    (
        "vx,vy,vz",
        "m/s",
        "velocity in the world frame, as the sensors show it",
    ),
    ("phi,theta,psi", "rad", "roll, pitch, yaw"),
    ("p,q,r", "rad/s", "body rates, as the sensors show them"),
    (
        "IR_hat,kr_hat,delta_hat",
        "kg m^2, N m s, rad/s^2",
        "estimates of rotor inertia, rotational drag and disturbance gain; empty if the inner law has none",
    ),
    ("w1,w2,w3,w4", "rad/s", "rotor speeds commanded"),
    ("u", "N", "thrust demanded by the inner law"),
    (
        "tau_p,tau_q,tau_r",
        "N m",
        "torque demanded by the inner law, before saturation",
    ),
    (
        "e_p,e_q,e_r",
        "rad/s",
        "error of the body rates e = nu2 - nu2_d; empty if the inner law shows none",
    ),
    ("xd,yd,zd", "m", "position of the reference"),
    ("psid", "rad", "yaw of the reference"),
    (
        "ROLE_telemetry.SIGNAL",
        "",
        "signals of the laws, with the units that `ironbird laws NAME` lists",
    ),
];

fn fixed_columns() -> impl Iterator<Item = String> {
    let fixed = COLUMNS.iter().filter(|(names, ..)| !names.contains('.'));
    fixed.flat_map(|(names, ..)| names.split(',').map(str::to_owned))
}

pub struct StatesWriter {
    path: PathBuf,
    csv: csv::Writer<Box<dyn Write>>,
    /// None where rows are written as they come.
    queue: Option<AsyncWriter>,
    tracking: Tracking,
    laws: FlownLaws,
    every_ticks: u64,
}

impl StatesWriter {
    /// Begins a file with its header. With `in_background`, no row waits for the disk, unless `path` is a pipe or a device.
    pub fn create(
        path: &Path,
        tracking: Tracking,
        laws: FlownLaws,
        every_ticks: u64,
        in_background: bool,
    ) -> Result<Self, Failure> {
        let begin = || -> io::Result<Self> {
            let file = create_file(path)?;
            let (out, queue): (Box<dyn Write>, _) =
                if in_background && file.metadata().is_ok_and(|it| it.is_file()) {
                    let queue = AsyncWriter::new(file, LEFT_FREE_BYTES)?;
                    (Box::new(queue.clone()), Some(queue))
                } else {
                    (Box::new(BufWriter::new(file)), None)
                };
            let mut csv = csv::Writer::from_writer(out);
            let roles = LAW_ROLES.into_iter().zip(TELEMETRY_TOPICS);
            let signals = roles.flat_map(|(role, topic)| {
                let signals = laws.signals.of(role).iter();
                signals.map(move |signal| format!("{topic}.{}", signal.name))
            });
            csv.write_record(fixed_columns().chain(signals))?;
            Ok(Self {
                csv,
                queue,
                path: path.to_owned(),
                tracking,
                laws,
                every_ticks,
            })
        };
        begin().in_file("write the states to", path)
    }

    pub fn write(&mut self, joined: &Joined) -> Result<(), Failure> {
        if !joined.tick.is_multiple_of(self.every_ticks) {
            return Ok(());
        }
        let known = |value: Option<f64>| value.filter(|value| !value.is_nan());
        let cell = |value| known(value).map_or_else(String::new, |value| format!("{value:?}"));
        let row = row(joined, &self.tracking, &self.laws).into_iter();
        let written = self.csv.write_record(row.map(cell));
        written.in_file("write", &self.path)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn flush(&mut self) -> Result<(), Failure> {
        let flushed = self.csv.flush();
        flushed.in_file("write", &self.path)?;
        if let Some(queue) = &self.queue {
            queue.settle_or_drop();
        }
        Ok(())
    }

    pub fn finish(&mut self) -> Result<(), Failure> {
        self.flush()?;
        let gap = self.queue.as_ref().and_then(AsyncWriter::finish);
        gap.map_or(Ok(()), |reason| Err(Failure::failed(reason)))
    }
}

fn row(joined: &Joined, tracking: &Tracking, laws: &FlownLaws) -> Vec<Option<f64>> {
    let (tick, measured, wrench) = (joined.tick, &joined.state.measured, &joined.wrench);
    let at = |places: Option<Places>| Some(places?.of(wrench.as_ref()?));
    let mut row = vec![Some(tick as f64 * tracking.period_s())];
    row.extend(measured.position_w_m.map(Some));
    row.extend(measured.velocity_w_m_s.map(Some));
    row.extend(measured.attitude_rad.map(Some));
    row.extend(measured.rate_b_rad_s.map(Some));
    row.extend(cells(at(laws.estimates())));
    row.extend(cells(joined.rotor_speeds.map(|it| it.speed_rad_s)));
    row.push(wrench.map(|wrench| wrench.thrust_n));
    row.extend(cells(wrench.map(|wrench| wrench.torque_b_nm)));
    row.extend(cells(at(laws.rate_error())));
    let reference = tracking.reference(tick, &joined.state);
    row.extend(reference.position_w_m.map(Some));
    row.push(Some(reference.yaw_rad));
    for (role, telemetry) in LAW_ROLES.into_iter().zip(joined.telemetry()) {
        let value = |i: usize| telemetry.map(|telemetry| telemetry.value[i]);
        row.extend((0..laws.signals.of(role).len()).map(value));
    }
    row
}

/// The cells of a vector; empty without one.
fn cells<const N: usize>(vector: Option<[f64; N]>) -> [Option<f64>; N] {
    vector.map_or([None; N], |vector| vector.map(Some))
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Joined {
    pub tick: u64,
    pub state: State,
    /// Setpoint of the tick; none where none was published.
    pub setpoint: Option<Setpoint>,
    /// Thrust and torque demanded at the tick; none if there was no demand.
    pub wrench: Option<Wrench>,
    /// Rotor command of the tick; none where none was published.
    pub rotor_speeds: Option<RotorSpeeds>,
    /// The monitor's result; none if the monitor was silent.
    pub monitor: Option<Monitor>,
}

impl Joined {
    /// What outer, inner and mixer law showed at the tick; none of a stage that published nothing.
    pub fn telemetry(&self) -> [Option<&Telemetry>; LAW_ROLES.len()] {
        [
            self.setpoint.as_ref().map(|setpoint| &setpoint.telemetry),
            self.wrench.as_ref().map(|wrench| &wrench.telemetry),
            self.rotor_speeds.as_ref().map(|speeds| &speeds.telemetry),
        ]
    }
}

#[derive(Debug, Default)]
pub struct Joiner {
    /// By tick: whether its state is there, and what is.
    waiting: BTreeMap<u64, Box<(bool, Joined)>>,
    /// Newest tick of each topic: a topic never goes back.
    newest: [Option<u64>; TOPICS],
    /// Newest tick that nothing is waited for any more.
    settled: Option<u64>,
    pub incomplete: u64,
}

/// Topics that are joined: those of the loop, which come first among the topics of a log.
const TOPICS: usize = 4;

/// Whether a rotor command is the mixer's final one of a run: it idles the rotors, and is made from no state.
pub fn is_final_command(message: &Message<RotorSpeeds>) -> bool {
    message.envelope.stamps_of(Role::Mixer).receive_ns == 0
}

/// Ticks for which a message may come later than the state of a newer tick: longer than a stage may stand still with it
/// where stages are started again, also at 10 kHz. Each that waits is kept whole, some 4 KiB.
const STAGE_PATIENCE_TICKS: u64 = 1_000;
/// The same for any topic of a newer tick: a recorder that stood still between two of them finds the later ones ahead.
const PATIENCE_TICKS: u64 = 5_000;

impl Joiner {
    /// Takes a message of the flight; what the monitor says of a wrench comes right after it.
    pub fn take(&mut self, entry: &LogEntry) {
        let tick = entry.envelope().tick;
        match entry {
            LogEntry::Theorem(message) => {
                if let Some(parts) = self.waiting.get_mut(&tick) {
                    parts.1.monitor = Some(message.content);
                }
                return;
            }
            LogEntry::RotorSpeeds(message) if is_final_command(message) => return,
            _ => {}
        }
        let Some(newest) = self.newest.get_mut(entry.topic()) else {
            return;
        };
        *newest = (*newest).max(Some(tick));
        if Some(tick) <= self.settled {
            return;
        }
        let (has_state, joined) = &mut **self.waiting.entry(tick).or_default();
        match entry {
            LogEntry::State(message) => {
                (*has_state, joined.tick, joined.state) = (true, tick, message.content);
            }
            LogEntry::Setpoint(message) => joined.setpoint = Some(message.content),
            LogEntry::Wrench(message) => joined.wrench = Some(message.content),
            LogEntry::RotorSpeeds(message) => joined.rotor_speeds = Some(message.content),
            _ => {}
        }
    }

    /// The next state for whose tick nothing more can come, in the order of the ticks; call it after all topics are
    /// drained, states first: everything sent before the newest state has then arrived.
    pub fn next_complete(&mut self) -> Option<Joined> {
        let newest = self.newest.into_iter().max().flatten()?;
        let newest_state = self.newest[0].unwrap_or(0);
        while let Some((tick, parts)) = self.waiting.first_key_value() {
            let mut topics = there(parts).into_iter().zip(self.newest);
            let is_over = topics.all(|(there, newest)| there || newest > Some(*tick));
            let is_recent =
                tick + STAGE_PATIENCE_TICKS >= newest_state && tick + PATIENCE_TICKS >= newest;
            if !is_over && is_recent {
                return None;
            }
            if let Some(joined) = self.next() {
                return Some(joined);
            }
        }
        None
    }

    /// As [`Self::next_complete`], when nothing more comes at all.
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
        self.incomplete += u64::from(there(&parts) != [true; TOPICS]);
        let (has_state, joined) = *parts;
        has_state.then_some(joined)
    }
}

const fn there((has_state, joined): &(bool, Joined)) -> [bool; TOPICS] {
    [
        *has_state,
        joined.setpoint.is_some(),
        joined.wrench.is_some(),
        joined.rotor_speeds.is_some(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(tick: u64) -> Message<RotorSpeeds> {
        let mut message = Message::of_tick(tick, RotorSpeeds::default());
        message.envelope.stamps[Role::Mixer as usize].receive_ns = 1;
        message
    }

    fn take(joiner: &mut Joiner, tick: u64, topics: &str) {
        for topic in topics.chars() {
            let entry = match topic {
                's' => LogEntry::State(Message::of_tick(tick, State::default())),
                'p' => LogEntry::Setpoint(Message::of_tick(tick, Setpoint::default())),
                'w' => LogEntry::Wrench(Message::of_tick(tick, Wrench::default())),
                _ => LogEntry::RotorSpeeds(command(tick)),
            };
            joiner.take(&entry);
        }
    }

    fn complete(joiner: &mut Joiner) -> Vec<u64> {
        std::iter::from_fn(|| joiner.next_complete())
            .map(|joined| joined.tick)
            .collect()
    }

    #[test]
    fn the_page_lists_the_columns() {
        const BEGIN: &str = "<!-- columns of states.csv -->\n";
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/recording.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (before, rest) = page.split_once(BEGIN).unwrap();
        let (_, after) = rest.split_once("<!-- end -->").unwrap();
        let row = |(names, unit, meaning): &(&str, &str, &str)| {
            let names = names.split(',').map(|name| format!("`{name}`"));
            let names = names.collect::<Vec<_>>().join(", ");
            format!("| {names} | {unit} | {meaning} |\n")
        };
        let rows: String = COLUMNS.iter().map(row).collect();
        let table = format!("| columns | unit | meaning |\n|---|---|---|\n{rows}");
        let written = format!("{before}{BEGIN}{table}<!-- end -->{after}");
        if std::env::var_os("IRONBIRD_WRITE_DOCS").is_some() {
            std::fs::write(path, &written).unwrap();
        }
        assert!(
            std::fs::read_to_string(path).unwrap() == written,
            "IRONBIRD_WRITE_DOCS=1 cargo test -p analysis writes docs/recording.md"
        );
    }

    #[test]
    fn a_row_has_every_column_and_empty_cells_for_what_was_not_published() {
        let tracking = Tracking::of(controller::Trajectory::Step, 1e-3);
        let row_of = |joined: &Joined| row(joined, &tracking, &FlownLaws::default());
        let mut joined = Joined::default();
        let (at_rest, reference) = ([Some(0.0); 13], [1.0, -1.0, 1.0, 0.5].map(Some));
        let expected = [&at_rest[..], &[None; 14], &reference].concat();
        assert_eq!(row_of(&joined), expected);
        assert_eq!(expected.len(), fixed_columns().count());
        let speeds = joined.rotor_speeds.insert(RotorSpeeds::default());
        speeds.speed_rad_s = [1.0, 2.0, 3.0, 4.0];
        let wrench = joined.wrench.insert(Wrench::default());
        (wrench.thrust_n, wrench.torque_b_nm) = (5.0, [6.0, 7.0, 8.0]);
        let commands: Vec<_> = (1..=8).map(|i| Some(f64::from(i))).collect();
        assert_eq!(row_of(&joined)[16..24], commands);
    }

    #[test]
    fn a_state_that_no_stage_answered_is_there_in_its_place() {
        let mut joiner = Joiner::default();
        for (tick, topics) in [(7, "spwr"), (8, "sp"), (9, "s")] {
            take(&mut joiner, tick, topics);
        }
        assert_eq!(complete(&mut joiner), [7], "something may still come");
        take(&mut joiner, 10, "spwr");
        assert_eq!(complete(&mut joiner), [8, 9, 10], "every topic has gone on");
        assert_eq!(joiner.incomplete, 2);
        take(&mut joiner, 9, "w");
        assert_eq!(
            (complete(&mut joiner), joiner.incomplete),
            (vec![], 2),
            "too late"
        );
    }

    #[test]
    fn a_stage_that_is_silent_is_not_waited_for_for_ever() {
        let mut joiner = Joiner::default();
        (0..=STAGE_PATIENCE_TICKS + 2).for_each(|tick| take(&mut joiner, tick, "sp"));
        assert_eq!(complete(&mut joiner), [0, 1]);
        let rest = std::iter::from_fn(|| joiner.rest()).count() as u64;
        assert_eq!(rest, STAGE_PATIENCE_TICKS + 1);
        assert_eq!(joiner.incomplete, STAGE_PATIENCE_TICKS + 3);
    }

    #[test]
    fn topics_that_are_ahead_of_the_states_wait_for_them() {
        let mut joiner = Joiner::default();
        take(&mut joiner, 0, "spwr");
        // A recorder that stood still between the states and the others.
        (1..PATIENCE_TICKS).for_each(|tick| take(&mut joiner, tick, "pwr"));
        assert_eq!(complete(&mut joiner), [0]);
        (1..PATIENCE_TICKS).for_each(|tick| take(&mut joiner, tick, "s"));
        assert_eq!(complete(&mut joiner).len() as u64, PATIENCE_TICKS - 1);
        assert_eq!(joiner.incomplete, 0);
        // A plant that is silent for good.
        (PATIENCE_TICKS..3 * PATIENCE_TICKS).for_each(|tick| take(&mut joiner, tick, "w"));
        assert!(complete(&mut joiner).is_empty());
        assert!(joiner.waiting.len() as u64 <= PATIENCE_TICKS + 1);
    }

    #[test]
    fn a_tick_without_a_state_has_no_row_and_holds_nothing_up() {
        let mut joiner = Joiner::default();
        take(&mut joiner, 3, "wr");
        take(&mut joiner, 4, "spwr");
        assert_eq!((complete(&mut joiner), joiner.incomplete), (vec![4], 1));
    }
}
