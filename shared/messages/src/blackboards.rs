//! The contents of the blackboards.
//!
//! These are the run, each role's status, the parameters in force, and the settings.

use crate::content::NO_TICK;
use crate::grid::{Grid, Pace};
use crate::history::LawState;
use crate::layout::{layout, wire_enum, zeroed};
use crate::parameters::PARAMETERS;
use crate::realtime::{Grants, Lead, Usage};
use crate::rejections::Rejections;

/// Name of the plant's blackboard with the [`Run`].
pub const RUN: &str = "run";
/// Name of the plant's blackboard with the parameters [`ActiveParameters`].
pub const IN_FORCE: &str = "in_force";
/// Name of the plant's blackboard with the [`SettingsText`].
pub const SETTINGS: &str = "settings";
/// Name of the supervisor's blackboard with the [`Supervision`].
pub const SUPERVISION: &str = "supervision";

/// Length of a tick on the clock that stands for lockstep: the ticks have no length [ns].
pub const LOCKSTEP: u64 = 0;

wire_enum! {
    /// Where a run is between the first role's start and the last one's end.
    pub enum RunPhase {
        /// The plant waits for the other roles.
        Mustering = 0,
        /// t_0 is announced; the roles arm.
        Opening = 1,
        Flying = 2,
        Closed = 3,
    }
}

wire_enum! {
    pub enum EndReason {
        None = 0 => "still flying",
        /// The last tick asked for was flown.
        Completed = 1 => "completed",
        /// A signal asked a role to end.
        Interrupted = 2 => "interrupted",
        /// The airframe tilted beyond the limit of the settings.
        Attitude = 3 => "left the envelope: tilt beyond its limit",
        Position = 4 => "left the envelope: position error beyond its limit",
        NonFinite = 5 => "left the envelope: the state is not finite",
        Failed = 6 => "a role failed",
        /// The airframe hit the ground as no landing does.
        Crash = 7 => "left the envelope: crashed into the ground",
    }
}

impl EndReason {
    pub const fn left_envelope(self) -> bool {
        matches!(
            self,
            Self::Attitude | Self::Position | Self::NonFinite | Self::Crash
        )
    }
}

layout! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Run {
        /// A [`RunPhase`] as number.
        pub phase: u64,
        /// An [`EndReason`] as number.
        pub ending: u64,
        /// Number of the run: the wall clock when the plant opened it [ns since 1970].
        pub run_id: u64,
        pub settings: u64,
        /// Process number of the plant: its blackboard outlives it, and another plant may write on the same blackboard.
        pub plant_pid: u64,
        /// Process number of the plant's launcher; 0 where it was started by hand.
        pub launcher_pid: u64,
        /// Begin of tick 0 on CLOCK_MONOTONIC [ns].
        pub t0_ns: u64,
        /// Begin of tick 0 on the wall clock [ns since 1970].
        pub t0_wall_ns: u64,
        /// Length of a tick on the clock [ns], or [`LOCKSTEP`].
        pub period_ns: u64,
        /// Sample time T of the laws [ns]: flight time is ticks times this.
        pub sample_time_ns: u64,
        /// Last tick that is to be flown.
        pub last_tick: u64,
        /// Newest tick that was published; [`NO_TICK`] before the first.
        pub tick: u64,
        pub ticks_run: u64,
        pub ticks_skipped: u64,
        pub deadlines_missed: u64,
        /// Length of the run of missed deadlines at the end.
        pub deadline_miss_run: u64,
        pub parameter_epoch: u64,
        /// Control channels of the flight.
        pub channels: u64,
        /// How far ahead of a tick the plant's timer was set at take-off.
        pub lead: Lead,
    }
}

impl Default for Run {
    fn default() -> Self {
        // The first phase, and no end.
        Self {
            tick: NO_TICK,
            ..zeroed()
        }
    }
}

impl Run {
    /// Its phase; a number that is none counts as closed.
    pub fn phase(&self) -> RunPhase {
        RunPhase::from_wire(self.phase).unwrap_or(RunPhase::Closed)
    }

    pub const fn pace(&self) -> Pace {
        match self.period_ns {
            LOCKSTEP => Pace::Lockstep,
            period_ns => Pace::Realtime(Grid {
                t0_ns: self.t0_ns,
                period_ns,
            }),
        }
    }

    /// The newest tick; 0 before the first has begun.
    pub const fn present_tick(&self) -> u64 {
        if self.tick == NO_TICK { 0 } else { self.tick }
    }

    /// Time of the flight at which a tick begins [s].
    pub fn flight_time_s(&self, tick: u64) -> f64 {
        tick.saturating_mul(self.sample_time_ns) as f64 / 1e9
    }

    /// How many times as long as the flight's time the clock's is; 1 in lockstep.
    pub fn slowdown(&self) -> u32 {
        let times = self.period_ns / self.sample_time_ns.max(1);
        u32::try_from(times.max(1)).unwrap_or(u32::MAX)
    }

    /// Why it ended; a number that is none counts as a failure.
    pub fn ending(&self) -> EndReason {
        EndReason::from_wire(self.ending).unwrap_or(EndReason::Failed)
    }
}

wire_enum! {
    pub enum RolePhase {
        Starting = 0,
        /// It waits for the plant to open a run.
        Ready = 1,
        /// It is connected and waits for tick 0.
        Armed = 2,
        Flying = 3,
        /// Its loop is over, and its figures are final.
        Landed = 4,
    }
}

layout! {
    /// When a process came past each part of its way to its first tick, on CLOCK_MONOTONIC [ns]; 0 where it has not yet.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Arrival {
        /// It was started.
        pub begun_ns: u64,
        /// It had its settings and its law.
        pub made_ns: u64,
        /// It had its place: the role's lock, a node of the middleware, its status blackboard.
        pub placed_ns: u64,
        pub ported_ns: u64,
        pub engaged_ns: u64,
        /// Its ports were connected to those of a run.
        pub armed_ns: u64,
    }
}

layout! {
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Status {
        /// A [`RolePhase`] as number.
        pub phase: u64,
        pub pid: u64,
        /// Number of the process that gives back what this one had if it is killed; 0 is none.
        pub releaser: u64,
        pub epoch: u64,
        pub arrival: Arrival,
        pub settings: u64,
        /// t_0 that it is armed for [ns].
        pub armed_t0_ns: u64,
        /// An [`EndReason`] that it asks the plant for; 0 while it wants to go on.
        pub wants_end: u64,
        pub ticks_run: u64,
        /// Ticks that it skipped because the next one had begun.
        pub ticks_skipped: u64,
        /// Ticks that it worked with an input that was not of the tick.
        pub ticks_stale: u64,
        /// Ticks after the first with a warm-up run, so none before take-off; 0 of the plant, which calls for them.
        pub rehearsals: u64,
        pub rejections: Rejections,
        pub grants: Grants,
        /// What its loop used since it was armed; final once it has landed.
        pub usage: Usage,
        /// Ticks that flew without a fresh command on time, as the recorder counts them: those whose command missed its deadline,
        /// and those whose command came of an older input; 0 of loops.
        pub commands_missed: u64,
        pub commands_stale: u64,
        /// Wrenches that the recorder's monitor could not judge, because a message was lost or another process took over; 0 of loops.
        pub wrenches_unwatched: u64,
        /// How often the recorder has looked for messages: it shows that it lives, also while the plant does not; 0 of loops.
        pub rounds: u64,
        /// 1 where its state is published after each tick; 0 before the first, or if its law cannot be saved.
        pub is_saved: u64,
        /// The tick after the one whose [`StageState`] it began with; 0 where it began with its initial state.
        pub resumed_at: u64,
    }
}

impl Status {
    /// Its phase; a number that is none counts as starting.
    pub fn phase(&self) -> RolePhase {
        RolePhase::from_wire(self.phase).unwrap_or(RolePhase::Starting)
    }
}

/// Longest state of a stage [bytes].
pub const STATE_BYTES: usize = 2048;

layout! {
    /// The state of a stage after a tick, which another process of its role can continue from.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct StageState {
        /// The run that it is of; 0 where there is none.
        pub run_id: u64,
        pub tick: u64,
        /// The state that the tick was worked from, and the history of both.
        pub law_state: LawState,
        /// The tick since which the state has had fresh inputs in every tick.
        pub fresh_since: u64,
        pub length: u64,
        pub bytes: [u8; STATE_BYTES],
    }
}

impl Default for StageState {
    fn default() -> Self {
        zeroed()
    }
}

impl StageState {
    pub fn bytes(&self) -> &[u8] {
        let length = usize::try_from(self.length).unwrap_or(0);
        self.bytes.get(..length).unwrap_or_default()
    }
}

layout! {
    /// The parameters in force, written by the plant at each swap.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct ActiveParameters {
        pub tick: u64,
        pub parameter_epoch: u64,
        /// Values in the order of the table [`crate::parameters::SPECS`].
        pub value: [f64; PARAMETERS],
    }
}

/// Longest settings text [bytes].
pub const SETTINGS_MAX: usize = 8192;

layout! {
    /// The settings that all roles of a run must share, as text.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct SettingsText {
        length: u64,
        bytes: [u8; SETTINGS_MAX],
    }
}

impl Default for SettingsText {
    fn default() -> Self {
        zeroed()
    }
}

impl SettingsText {
    /// Puts a text on the blackboard; `None` where it is too long.
    pub fn new(text: &str) -> Option<Self> {
        let mut value = Self {
            length: text.len() as u64,
            ..Self::default()
        };
        value
            .bytes
            .get_mut(..text.len())?
            .copy_from_slice(text.as_bytes());
        Some(value)
    }

    /// The text; empty where the blackboard holds none.
    pub fn text(&self) -> &str {
        let length = usize::try_from(self.length).unwrap_or(0).min(SETTINGS_MAX);
        std::str::from_utf8(&self.bytes[..length]).unwrap_or("")
    }
}

layout! {
    /// What the supervisor did in a flight.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Supervision {
        /// Processes that ended although the flight needed them.
        pub failed: u64,
        pub restarted: u64,
        /// The flight's directory, in which the newest recorder writes.
        pub directory: SettingsText,
        /// Its newest messages, each in a line behind its tick and what it is about.
        pub events: SettingsText,
    }
}

/// The subject of a message of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// A process that failed, and what becomes of it.
    Process,
    /// A fault that the supervisor injects.
    Fault,
}

impl Subject {
    const ALL: [Self; 2] = [Self::Process, Self::Fault];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Process => "process",
            Self::Fault => "fault",
        }
    }
}

impl Supervision {
    /// Adds a message; the oldest ones give way.
    pub fn add(&mut self, tick: u64, subject: Subject, message: &str) {
        let all = format!(
            "{}{tick} {} {message}\n",
            self.events.text(),
            subject.name()
        );
        let mut newest = all.as_str();
        self.events = loop {
            if let Some(events) = SettingsText::new(newest) {
                break events;
            }
            newest = newest.split_once('\n').map_or("", |(_, newer)| newer);
        };
    }

    /// Ticks, subjects and messages, the oldest first.
    pub fn events(&self) -> impl Iterator<Item = (u64, Subject, &str)> {
        let lines = self.events.text().lines();
        lines.filter_map(|line| {
            let (tick, rest) = line.split_once(' ')?;
            let (name, message) = rest.split_once(' ')?;
            let mut subjects = Subject::ALL.into_iter();
            let subject = subjects.find(|subject| subject.name() == name)?;
            Some((tick.parse().ok()?, subject, message))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_text_comes_back_whole_or_is_refused() {
        assert_eq!(SettingsText::new("a = 1\n").unwrap().text(), "a = 1\n");
        assert!(SettingsText::new(&"x".repeat(SETTINGS_MAX + 1)).is_none());
    }

    #[test]
    fn the_newest_messages_of_the_supervisor_are_kept() {
        let mut supervision = Supervision::default();
        let message = |tick| format!("{tick}: {}", "x".repeat(90));
        (0..200).for_each(|tick| supervision.add(tick, Subject::Process, &message(tick)));
        let kept: Vec<_> = supervision.events().collect();
        assert!(kept.len() > 70 && kept.len() < 200);
        assert_eq!(kept.last(), Some(&(199, Subject::Process, &*message(199))));
        assert!(kept.is_sorted_by_key(|(tick, ..)| *tick));
    }
}
