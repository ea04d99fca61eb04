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

use messages::content::{NO_TICK, ROTORS, RotorSpeeds, Stamped};
use messages::role::Channel;

/// How long a command holds without a newer one. After that the rotors spin down to idle, as speed controllers do.
pub const COMMAND_TIMEOUT_S: f64 = 0.020;

/// How long a command can wait while the plant is stopped [s].
pub const PENDING_S: f64 = 0.064;

/// Commands that can wait at a tick of `period_s` [s]: 64 up to 1 kHz, those of [`PENDING_S`] above.
pub fn pending_commands(period_s: f64) -> usize {
    ((PENDING_S / period_s).round() as usize).max(64)
}

/// Ticks whose commands can wait: a stopped plant reads its ports twice, before its tick and when it begins.
pub fn waiting_ticks(period_s: f64) -> usize {
    2 * pending_commands(period_s)
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pending {
    tick: u64,
    group: Channel,
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
    pending: Vec<Pending>,
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
    /// Commands for which no place was free.
    pub refused: u64,
    /// Ticks that began without the command of the tick before.
    pub deadlines_missed: u64,
    /// Length of the run of missed deadlines that ends at the tick entered last; 0 when that one was met.
    pub deadline_miss_run: u64,
}

impl CommandHold {
    /// One that holds `hover` [rad/s] until the first command, and `idle` [rad/s] when none comes for
    /// [`COMMAND_TIMEOUT_S`], in whole ticks of `period_s` [s].
    pub fn new(hover: [f64; ROTORS], idle: [f64; ROTORS], period_s: f64) -> Self {
        let room = waiting_ticks(period_s);
        Self {
            pending: Vec::with_capacity(room),
            room,
            hover,
            newest: None,
            since_tick: 0,
            timeout_ticks: (COMMAND_TIMEOUT_S / period_s).round().max(1.0) as u64,
            idle,
            is_idle: false,
            refused: 0,
            deadlines_missed: 0,
            deadline_miss_run: 0,
        }
    }

    /// Takes a command of a group of channels that may act from `effective_tick` on, and never before the tick after its own. Returns that tick;
    /// [`NO_TICK`] if no place was free, which shows as a missed deadline, or if the command has no tick.
    ///
    /// It replaces waiting commands that are older and would not act earlier.
    #[inline]
    pub fn offer(
        &mut self,
        group: Channel,
        command: &Stamped<RotorSpeeds>,
        effective_tick: u64,
    ) -> u64 {
        if command.tick == NO_TICK {
            return NO_TICK;
        }
        let offered = Pending {
            tick: command.tick,
            group,
            effective_tick: effective_tick.max(command.tick + 1),
            speed: command.content.speed_rad_s,
            is_saturated: command.content.saturated == 1,
        };
        self.pending.retain(|waiting| {
            waiting.tick > offered.tick || waiting.effective_tick < offered.effective_tick
        });
        // The ones that wait come first: were they dropped instead, a steady delay would let no command through.
        if self.pending.len() == self.room {
            self.refused += 1;
            return NO_TICK;
        }
        self.pending.push(offered);
        offered.effective_tick
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

    /// The group of channels that the newest command is of; the first one before it.
    pub fn group(&self) -> Channel {
        self.newest.map_or(Channel::A, |newest| newest.group)
    }

    /// Tick of the newest command that came into force; [`NO_TICK`] before the first. Idling leaves it as it is.
    pub fn command_tick(&self) -> u64 {
        self.newest.map_or(NO_TICK, |newest| newest.tick)
    }
}
