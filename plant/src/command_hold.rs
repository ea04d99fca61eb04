//! Command hold: which rotor command is in force, and whether it met its deadline.
//!
//! The rule is logical execution time: the command computed from tick k acts on [t_k+1, t_k+2), however early it was
//! ready. A later command acts from the tick of its arrival on. It counts as a missed deadline until a command is in
//! time again:
//!
//! ```text
//!   hover --a command--> its speeds --20 ms without a newer one--> idle --a newer command--> its speeds
//!   hover --20 ms without one--> idle
//! ```
//!
//! This file owns the rule and its counters. The shell knows when a command arrived; it names the tick from which the
//! command may act.

use heapless::Vec;
use messages::content::{NO_TICK, ROTORS, RotorSpeeds, Stamped};

/// How long a command holds without a newer one. After that the rotors spin down to idle, as speed controllers do.
pub const COMMAND_TIMEOUT_S: f64 = 0.020;

/// Commands that can wait for their tick, up to 1 kHz: the other stages produce them while the plant is stopped.
pub const PENDING_COMMANDS: usize = 64;
/// The same as a time, above that [s].
pub const PENDING_S: f64 = 0.064;
/// Room for the commands of that time at the highest rate, 10 kHz.
const PENDING_MAX: usize = 10 * PENDING_COMMANDS;

/// Commands that can wait at a tick of `period_s` [s].
pub fn pending_commands(period_s: f64) -> usize {
    ((PENDING_S / period_s).round() as usize).clamp(PENDING_COMMANDS, PENDING_MAX)
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pending {
    tick: u64,
    /// Tick from which on it may act.
    effective_tick: u64,
    /// Rotor speeds [rad/s].
    speed: [f64; ROTORS],
    /// Whether they could not deliver the demand.
    is_saturated: bool,
}

/// The rotor command in force, those that wait, and the verdicts so far.
#[derive(Clone, Debug)]
pub struct CommandHold {
    pending: Vec<Pending, PENDING_MAX>,
    room: usize,
    hover: [f64; ROTORS],
    /// The newest command; none before the first.
    newest: Option<Pending>,
    /// Tick from which on it has been in force.
    since_tick: u64,
    /// Ticks for which it holds without a newer one.
    timeout_ticks: u64,
    idle: [f64; ROTORS],
    is_idle: bool,
    /// Ticks that began without the command of the tick before.
    pub deadlines_missed: u64,
    /// Length of the run of missed deadlines that ends at the tick entered last; 0 when that one was met.
    pub deadline_miss_run: u64,
}

impl CommandHold {
    /// One that holds `hover` [rad/s] until the first command, and `idle` [rad/s] when none comes for
    /// [`COMMAND_TIMEOUT_S`], in whole ticks of `period_s` [s].
    pub fn new(hover: [f64; ROTORS], idle: [f64; ROTORS], period_s: f64) -> Self {
        Self {
            pending: Vec::new(),
            room: pending_commands(period_s),
            hover,
            newest: None,
            since_tick: 0,
            timeout_ticks: (COMMAND_TIMEOUT_S / period_s).round().max(1.0) as u64,
            idle,
            is_idle: false,
            deadlines_missed: 0,
            deadline_miss_run: 0,
        }
    }

    /// Takes a command that may act from `effective_tick` on, and never before the tick after its own.
    ///
    /// It replaces waiting commands that are older and would not act earlier. A command without a tick is ignored. If
    /// there is no room, the command is dropped, which shows as a missed deadline.
    #[inline]
    pub fn offer(&mut self, command: &Stamped<RotorSpeeds>, effective_tick: u64) {
        if command.tick == NO_TICK {
            return;
        }
        let offered = Pending {
            tick: command.tick,
            effective_tick: effective_tick.max(command.tick + 1),
            speed: command.content.speed_rad_s,
            is_saturated: command.content.saturated == 1,
        };
        self.pending.retain(|waiting| {
            waiting.tick > offered.tick || waiting.effective_tick < offered.effective_tick
        });
        // The ones that wait come first: were they dropped instead, a steady delay would let no command through.
        if self.pending.len() < self.room {
            // There are more places than ever may wait.
            let _ = self.pending.push(offered);
        }
    }

    /// Decides what is in force from `tick` on, and judges the deadline. Call it for every tick, in order.
    pub fn enter(&mut self, tick: u64) {
        let newest = self
            .pending
            .iter()
            .filter(|waiting| waiting.effective_tick <= tick)
            .max_by_key(|it| it.tick);
        if let Some(newest) = newest.copied() {
            // A command older than the one in force has lost its race and changes nothing.
            if self.newest.is_none_or(|current| newest.tick > current.tick) {
                self.newest = Some(newest);
                self.since_tick = tick;
            }
            self.pending.retain(|waiting| waiting.effective_tick > tick);
        }
        self.is_idle = tick - self.since_tick >= self.timeout_ticks;
        self.judge(tick);
    }

    fn judge(&mut self, tick: u64) {
        // No stage could compute a command for the first tick.
        if tick == 0 || self.newest.is_some_and(|newest| newest.tick == tick - 1) {
            self.deadline_miss_run = 0;
        } else {
            self.deadlines_missed += 1;
            self.deadline_miss_run += 1;
        }
    }

    /// Rotor speeds in force [rad/s].
    pub fn speed(&self) -> [f64; ROTORS] {
        if self.is_idle {
            return self.idle;
        }
        self.newest.map_or(self.hover, |newest| newest.speed)
    }

    /// Whether the active command could not deliver the demand; idle rotors have no demand.
    pub fn is_saturated(&self) -> bool {
        !self.is_idle && self.newest.is_some_and(|newest| newest.is_saturated)
    }

    /// Tick of the newest command that came into force; [`NO_TICK`] before the first. Idling leaves it as it is.
    pub fn command_tick(&self) -> u64 {
        self.newest.map_or(NO_TICK, |newest| newest.tick)
    }
}
