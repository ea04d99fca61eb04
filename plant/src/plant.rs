//! The plant stage: the airframe on the grid of ticks, commands in, states out.
//!
//! There is one round per tick k. [`Plant::begin`] settles what holds from t_k on and returns the state to publish.
//! [`Plant::finish`] integrates to t_k+1 while the other stages compute. At each tick boundary the order is: parameter
//! swaps, rotor command, deadline verdict. A tick that the shell slept through is flown all the same, with the command
//! that was in force: an outage affects the flight.
//!
//! This file owns the order of these steps. The steps themselves are [`crate::swap`], [`crate::latch`],
//! [`crate::rotors`], [`crate::integrator`] and [`crate::gyro`].

use model::limits::RotorLimits;
use model::messages::{Dated, NO_TICK, ROTORS, RotorSpeeds, State, Truth};
use model::parameters::Airframe;
use nalgebra::Vector4;
use thiserror::Error;

use crate::gyro;
use crate::integrator::{SUBSTEPS, integrate};
use crate::latch::Latch;
use crate::rigid_body::RigidBody;
use crate::rotors::{Spin, SpinMeans, hover};
use crate::swap::{AppliedSwap, PENDING_SWAPS, Swap, SwapError, SwapQueue};

/// Pitch beyond which the flight counts as lost [rad]: J2 of (5) is singular at 90 degrees.
pub const PITCH_LIMIT_RAD: f64 = 80.0_f64.to_radians();

/// What a plant is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantSettings {
    /// Length of a tick, T [s].
    pub period_s: f64,
    /// True parameters at the start; swaps change them in flight.
    pub airframe: Airframe,
    /// Range of the rotor speeds, whose lower end is idle.
    pub rotor: RotorLimits,
    /// Seed of the gyro noise.
    pub seed: u64,
}

/// The simulated airframe, standing at a grid tick or on its way to the next.
#[derive(Clone, Debug)]
pub struct Plant {
    period_s: f64,
    seed: u64,
    airframe: Airframe,
    body: RigidBody,
    /// Actual rotor speeds at the tick [rad/s].
    rotor_speed: Vector4<f64>,
    /// Of the tick before.
    means: SpinMeans,
    latch: Latch,
    commands_taken: u64,
    command_taken_tick: u64,
    swaps: SwapQueue,
    applied: heapless::Vec<AppliedSwap, PENDING_SWAPS>,
    /// Tick at which the body stands.
    tick: u64,
    /// Whether swaps, command and verdict of this tick are settled.
    has_begun: bool,
    ticks_skipped: u64,
    parameter_epoch: u64,
}

/// The flight left the envelope in which the model means anything.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Departure {
    /// A position, velocity, angle or rate is infinite or not a number.
    #[error("the flight diverged: at tick {tick} the state is no longer finite")]
    NotFinite {
        /// Tick at which it was seen.
        tick: u64,
    },
    /// The pitch is beyond [`PITCH_LIMIT_RAD`].
    #[error(
        "the flight left its envelope: at tick {tick} the pitch is {:.1} degrees, allowed are +-{:.0}",
        pitch_rad.to_degrees(), PITCH_LIMIT_RAD.to_degrees()
    )]
    Pitch {
        /// Tick at which it was seen.
        tick: u64,
        /// The pitch [rad].
        pitch_rad: f64,
    },
}

impl Plant {
    /// A plant at tick 0: at rest in the origin, rotors at the hover speed of the airframe.
    #[must_use]
    pub fn new(settings: &PlantSettings) -> Self {
        let PlantSettings { period_s, airframe, rotor, seed } = *settings;
        let hover = hover(&airframe);
        Self {
            period_s,
            seed,
            airframe,
            body: RigidBody::default(),
            rotor_speed: hover,
            means: SpinMeans::steady(&hover),
            latch: Latch::new(hover.into(), [rotor.min_rad_s; ROTORS], period_s),
            commands_taken: 0,
            command_taken_tick: NO_TICK,
            swaps: SwapQueue::default(),
            applied: heapless::Vec::new(),
            tick: 0,
            has_begun: false,
            ticks_skipped: 0,
            parameter_epoch: 0,
        }
    }

    /// Hands over a rotor command. It is in force from `effective_tick` on at the earliest, and never before the tick
    /// after its own. The newest command in force wins; see [`crate::latch`] for what is late and what is lost.
    pub fn offer(&mut self, command: Dated<RotorSpeeds>, effective_tick: u64) {
        self.commands_taken += 1;
        self.command_taken_tick = command.tick;
        self.latch.offer(&command, effective_tick);
    }

    /// Takes a swap that holds from its tick on, or from the next boundary if its tick has already begun. Before the
    /// flight, tick 0 is still to come. Returns the tick from which the swap will hold.
    ///
    /// # Errors
    /// [`SwapError`] when the swap is not valid or too many are pending; nothing is changed then.
    pub fn schedule(&mut self, mut swap: Swap) -> Result<u64, SwapError> {
        for &(parameter, value) in &swap.changes {
            self.airframe.check(parameter, value)?;
        }
        let next_boundary = self.tick + u64::from(self.has_begun);
        let tick = swap.tick.max(next_boundary);
        swap.tick = tick;
        self.swaps.push(swap)?;
        Ok(tick)
    }

    /// Brings the plant to grid tick `tick`, settles what holds from then on, and gives the state to publish.
    ///
    /// Ticks in between that were never begun are flown, judged and counted as skipped; a begun tick that was not
    /// finished is finished. A tick that lies behind changes nothing.
    pub fn begin(&mut self, tick: u64) -> State {
        self.fly_to(tick);
        if self.tick == tick {
            self.enter();
        }
        self.state()
    }

    /// Ends the flight after its last tick, flown or skipped: judges the last command, at the tick that would be next.
    ///
    /// That tick is not flown, so no swap takes hold in it.
    pub fn end(&mut self, last_tick: u64) -> State {
        self.fly_to(last_tick + 1);
        if !self.has_begun {
            self.latch.enter(self.tick);
            self.has_begun = true;
        }
        self.state()
    }

    /// Flies what lies before `tick`: the rest of the begun tick, and ticks that were skipped.
    fn fly_to(&mut self, tick: u64) {
        self.applied.clear();
        if tick > self.tick {
            self.finish();
        }
        while self.tick < tick {
            self.ticks_skipped += 1;
            self.enter();
            self.finish();
        }
    }

    /// Integrates to the next tick with what is in force; does nothing when the tick has not begun.
    pub fn finish(&mut self) {
        if !self.has_begun {
            return;
        }
        let spin = Spin::new(&self.airframe, self.rotor_speed, Vector4::from(self.latch.speed()));
        self.body = integrate(&self.body, &self.airframe, &spin, self.tick, self.period_s, SUBSTEPS);
        self.means = spin.means(self.period_s);
        self.rotor_speed = spin.speed(self.period_s);
        self.tick += 1;
        self.has_begun = false;
    }

    /// Settles, once, what holds from the body's present tick on.
    fn enter(&mut self) {
        if self.has_begun {
            return;
        }
        while let Some(swap) = self.swaps.pop_due(self.tick) {
            self.parameter_epoch += 1;
            let changes = swap.apply(&mut self.airframe);
            // As many places as the queue has, and emptied by every `begin`: there is always room.
            let _ = self.applied.push(AppliedSwap {
                tick: self.tick,
                epoch: self.parameter_epoch,
                ticket: swap.ticket,
                changes,
            });
        }
        self.latch.enter(self.tick);
        self.has_begun = true;
    }

    /// The state as it would be published now.
    #[must_use]
    pub fn state(&self) -> State {
        let RigidBody { eta1, v, eta2, nu2 } = self.body;
        let measured = gyro::measured(&nu2, self.airframe.gyro_noise_rad_s(), self.seed, self.tick);
        State {
            position_w_m: eta1.into(),
            velocity_w_m_s: v.into(),
            attitude_rad: eta2.into(),
            rate_b_rad_s: measured.into(),
            rotor_speed_mean_rad_s: self.means.speed.into(),
            rotor_speed_squared_mean_rad2_s2: self.means.speed_squared.into(),
            rotor_speed_command_rad_s: self.latch.speed(),
            command_tick: self.latch.command_tick(),
            commands_taken: self.commands_taken,
            command_taken_tick: self.command_taken_tick,
            command_saturated: u64::from(self.latch.is_saturated()),
            deadlines_missed: self.latch.deadlines_missed(),
            deadline_miss_run: self.latch.deadline_miss_run(),
            ticks_skipped: self.ticks_skipped,
            parameter_epoch: self.parameter_epoch,
            truth: Truth { rate_b_rad_s: nu2.into(), parameter: *self.airframe.values() },
        }
    }

    /// The true parameters that hold now.
    #[must_use]
    pub fn airframe(&self) -> &Airframe {
        &self.airframe
    }

    /// Swaps applied so far.
    #[must_use]
    pub fn parameter_epoch(&self) -> u64 {
        self.parameter_epoch
    }

    /// Swaps that the last [`Plant::begin`] or [`Plant::end`] applied, in order, those of skipped ticks among them.
    #[must_use]
    pub fn applied(&self) -> &[AppliedSwap] {
        &self.applied
    }

    /// Whether the state is one that the model covers.
    ///
    /// # Errors
    /// [`Departure`] says in what way it is not, and at which tick.
    pub fn envelope(&self) -> Result<(), Departure> {
        let (tick, pitch_rad) = (self.tick, self.body.eta2.y);
        if !self.body.is_finite() {
            return Err(Departure::NotFinite { tick });
        }
        if pitch_rad.abs() > PITCH_LIMIT_RAD {
            return Err(Departure::Pitch { tick, pitch_rad });
        }
        Ok(())
    }
}
