//! The plant stage: the airframe on the grid of ticks, commands in, states out.
//!
//! There is one round per tick k. [`Plant::begin`] settles what holds from t_k on and returns the state to publish.
//! [`Plant::finish`] integrates to t_k+1 while the other stages compute. At each tick boundary the order is: parameter
//! swaps, rotor command, deadline verdict. A tick that the shell slept through is flown all the same, with the command
//! that was in force: an outage affects the flight.
//!
//! This file owns the order of these steps. The steps themselves are [`crate::swap`], [`crate::command_hold`],
//! [`crate::command_delay`], [`crate::rotors`], [`crate::turbulence`],
//! [`crate::integrator`], [`crate::sensors`] and [`crate::guidance`].

pub mod batch;

use std::f64::consts::PI;

use faults::filter::{FaultFilter, Passed};
use faults::{MessageFaults, Port};
use messages::attitude::Attitude;
use messages::content::{Decision, FlightTarget, NO_TICK, ROTORS, RotorSpeeds, Stamped, State};
use messages::inspection::Rejections;
use messages::parameters::Airframe;
use messages::role::Channel;
use nalgebra::{Vector3, Vector4};

use crate::command_delay::CommandDelay;
use crate::command_hold::CommandHold;
use crate::envelope_violation::{Crash, EnvelopeViolation};
use crate::ground::{Contact, Ground};
use crate::guidance::Guidance;
use crate::integrator::{Steps, integrate_with};
use crate::rigid_body::{Dynamics, RigidBody};
use crate::rotors::{Rotors, Spin, SpinMeans, hover};
use crate::sensors::Sensors;
use crate::settings::PlantSettings;
use crate::swap::{AppliedSwap, PENDING_SWAPS, Ramps, Swap, SwapError, SwapQueue};
use crate::turbulence::Turbulence;

/// The simulated airframe, standing at a grid tick or on its way to the next.
#[derive(Clone, Debug)]
pub struct Plant {
    steps: Steps,
    airframe: Airframe,
    /// Quotients of the parameters, until they change.
    dynamics: Dynamics,
    rotors: Rotors,
    body: RigidBody,
    /// Roll, pitch, yaw of the body [rad], followed tick by tick so that roll and yaw are not wrapped.
    eta2: Vector3<f64>,
    tilt_max_rad: f64,
    ground: Option<Ground>,
    /// Mean acceleration by the ground over the last tick, world frame [m/s^2].
    pushed_w: Vector3<f64>,
    crash: Option<Crash>,
    sensors: Sensors,
    /// Of a vehicle that a ground station flies.
    guidance: Option<Guidance>,
    turbulence: Turbulence,
    /// Actual rotor speeds at the tick [rad/s].
    rotor_speed: Vector4<f64>,
    means: SpinMeans,
    command_hold: CommandHold,
    delay: CommandDelay,
    /// Behind the inspection of commands, where they have faults.
    filter: Option<Box<FaultFilter<RotorSpeeds>>>,
    commands_taken: u64,
    command_taken_tick: u64,
    /// Boxed: with `applied` it takes 100 kB, and a plant is moved.
    swaps: Box<SwapQueue>,
    applied: Box<heapless::Vec<AppliedSwap, PENDING_SWAPS>>,
    ramps: Ramps,
    /// Tick of the newest change of a parameter since the last [`Plant::begin`] or [`Plant::end`] began.
    changed_tick: Option<u64>,
    tick: u64,
    /// Whether swaps, command and verdict of this tick are settled.
    has_begun: bool,
    ticks_skipped: u64,
    parameter_epoch: u64,
}

impl Plant {
    /// A plant at tick 0: where the settings say, rotors at the hover speed of the airframe.
    pub fn new(settings: &PlantSettings) -> Self {
        let (period_s, airframe) = (settings.period_s, settings.airframe);
        let (rotor, initial) = (&settings.rotor, &settings.initial);
        let eta2 = Vector3::from(initial.attitude_rad);
        let attitude = Attitude::of_euler(&eta2);
        let body = RigidBody {
            eta1: initial.position_w_m.into(),
            v: initial.velocity_w_m_s.into(),
            attitude,
            nu2: initial.rate_b_rad_s.into(),
        };
        let hover = hover(&airframe);
        Self {
            steps: Steps::new(period_s, settings.substeps),
            airframe,
            dynamics: Dynamics::new(&airframe),
            rotors: Rotors::new(&airframe),
            body,
            eta2: attitude.euler_near(&eta2),
            tilt_max_rad: settings.tilt_max_rad,
            ground: settings.ground,
            pushed_w: Vector3::zeros(),
            crash: None,
            sensors: Sensors::new(period_s, settings.seed, &airframe, &body),
            guidance: settings
                .follows_targets
                .then(|| Guidance::at(initial.position_w_m, initial.attitude_rad[2], period_s)),
            turbulence: Turbulence::new(period_s, settings.seed),
            rotor_speed: hover,
            means: SpinMeans::steady(&hover),
            command_hold: CommandHold::new(hover.into(), [rotor.min_rad_s; ROTORS], period_s),
            delay: CommandDelay::new(period_s, &airframe, hover.into()),
            filter: None,
            commands_taken: 0,
            command_taken_tick: NO_TICK,
            swaps: Box::default(),
            applied: Box::default(),
            ramps: Ramps::default(),
            changed_tick: None,
            tick: 0,
            has_begun: false,
            ticks_skipped: 0,
            parameter_epoch: 0,
        }
    }

    /// Hands over a rotor command. It is in force from `effective_tick` on at the earliest, and never before the tick
    /// after its own. Returns the tick from which it may act; [`NO_TICK`] if a fault dropped it or no place was free.
    /// The newest command in force wins; see [`crate::command_hold`] for what is late and what is lost.
    #[inline]
    pub fn offer(&mut self, command: &Stamped<RotorSpeeds>, effective_tick: u64) -> u64 {
        self.offer_of(Channel::A, command, effective_tick)
    }

    /// As [`Self::offer`], with the first of the channels whose laws made the command.
    #[inline]
    pub fn offer_of(
        &mut self,
        group: Channel,
        command: &Stamped<RotorSpeeds>,
        effective_tick: u64,
    ) -> u64 {
        self.commands_taken += 1;
        self.command_taken_tick = command.tick;
        match self.filter.as_mut().filter(|filter| filter.has_faults()) {
            None => self.command_hold.offer(group, command, effective_tick),
            Some(filter) => {
                let tick = command.tick;
                let passed = filter.pass(tick, &command.content);
                passed.map_or(NO_TICK, |Passed { content, delay }| {
                    let acts_from = effective_tick.max(tick + 1) + delay;
                    self.command_hold
                        .offer(group, &Stamped { tick, content }, acts_from)
                })
            }
        }
    }

    /// Counts a command that was not offered, because no place was free for it to wait in.
    pub const fn refuse(&mut self) {
        self.command_hold.refused += 1;
    }

    /// Passes its commands through a fault filter.
    pub fn set_fault_filter(&mut self, filter: Option<FaultFilter<RotorSpeeds>>) {
        self.filter = filter.map(Box::new);
    }

    /// The same with faults that may change in flight.
    pub fn take_faults(&mut self, faults: &MessageFaults) {
        self.set_fault_filter(Some(FaultFilter::changing(faults, Port::PlantRotorSpeeds)));
    }

    /// Takes the faults of its commands as they are from now on, without an allocation; `newest` came last.
    pub fn change_faults(&mut self, faults: &MessageFaults, newest: Option<RotorSpeeds>) {
        if let Some(filter) = &mut self.filter {
            filter.change(faults, Port::PlantRotorSpeeds, newest);
        }
    }

    /// Commands that were refused for what a fault had made of them.
    pub fn rejections(&self) -> Rejections {
        self.filter
            .as_ref()
            .map(|filter| *filter.rejections())
            .unwrap_or_default()
    }

    /// Takes a swap that holds from its tick on, or from the next boundary if its tick has already begun. Before the
    /// flight, tick 0 is still to come. Returns the tick from which the swap will hold.
    ///
    /// # Errors
    /// [`SwapError`] when the swap is not valid or too many are pending; nothing is changed then.
    pub fn schedule(&mut self, mut swap: Swap) -> Result<u64, SwapError> {
        for target in &swap.targets {
            self.airframe.check(target.parameter, target.value)?;
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
        let mut state = State::default();
        self.begin_into(tick, &mut state);
        state
    }

    /// The same into the place of another state.
    pub fn begin_into(&mut self, tick: u64, state: &mut State) {
        self.fly_to(tick);
        if self.tick == tick {
            self.enter();
        }
        self.show(state);
    }

    /// Ends the flight after its last tick, flown or skipped: judges the last command, at the tick that would be next.
    ///
    /// That tick is not flown, so no swap takes hold in it.
    pub fn end(&mut self, last_tick: u64) -> State {
        self.fly_to(last_tick + 1);
        if !self.has_begun {
            self.command_hold.enter(self.tick);
            self.has_begun = true;
        }
        self.state()
    }

    /// Flies what lies before `tick`: the rest of the begun tick, and ticks that were skipped.
    fn fly_to(&mut self, tick: u64) {
        self.applied.clear();
        self.changed_tick = None;
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
        let spin = self.spin();
        let body = self.flown(&spin);
        let eta2 = body.attitude.euler_near(&self.eta2);
        self.arrive(&spin, body, eta2);
    }

    /// How the rotors turn in this tick.
    fn spin(&self) -> Spin {
        self.rotors
            .spin(self.rotor_speed, Vector4::from(self.delay.acting()))
    }

    /// Stands at the next tick, to which the body has come with these rotors.
    fn arrive(&mut self, spin: &Spin, body: RigidBody, eta2: Vector3<f64>) {
        (self.body, self.eta2) = (body, eta2);
        self.sensors.advance(&self.airframe, &self.body);
        if let Some(guidance) = &mut self.guidance {
            guidance.advance();
        }
        self.means = spin.means(self.steps.period_s);
        self.rotor_speed = spin.speed(self.steps.period_s);
        self.tick += 1;
        self.has_begun = false;
    }

    /// The body at the next tick, kept above the ground.
    fn flown(&mut self, spin: &Spin) -> RigidBody {
        let (tick, steps) = (self.tick, &self.steps);
        let (airframe, dynamics, body) = (&self.airframe, &self.dynamics, &self.body);
        let Some(ground) = self.ground else {
            return integrate_with(body, dynamics, spin, tick, steps, |_, _| {});
        };
        let mut contact = Contact::default();
        let period_s = steps.period_s;
        let step_s = period_s / f64::from(steps.substeps);
        let keep_above = |start: &RigidBody, body: &mut RigidBody| {
            ground.keep_above(airframe, start, body, step_s, &mut contact);
        };
        let body = integrate_with(body, dynamics, spin, tick, steps, keep_above);
        self.pushed_w = contact.impulse_w / (airframe.m() * period_s);
        self.crash = self.crash.or_else(|| ground.crash(tick + 1, &contact));
        body
    }

    /// Settles, once, what holds from the body's present tick on.
    fn enter(&mut self) {
        if self.has_begun {
            return;
        }
        while let Some(swap) = self.swaps.pop_due(self.tick) {
            self.parameter_epoch += 1;
            let changes = self.ramps.begin(&swap, self.tick, &mut self.airframe);
            self.changed_tick = Some(self.tick);
            // As many places as the queue has, and emptied by every `begin`: there is always room.
            let _ = self.applied.push(AppliedSwap {
                tick: self.tick,
                epoch: self.parameter_epoch,
                request_id: swap.request_id,
                changes,
            });
        }
        if self.ramps.step(self.tick, &mut self.airframe) {
            self.changed_tick = Some(self.tick);
        }
        if self.changed_tick == Some(self.tick) {
            self.dynamics = Dynamics::new(&self.airframe);
            self.rotors = Rotors::new(&self.airframe);
            self.sensors.tune(&self.airframe);
            self.delay.tune(&self.airframe);
        }
        if let Some(gust) = self.turbulence.gust(&self.airframe, self.tick) {
            self.dynamics.gust(&self.airframe, &gust);
        }
        self.sensors.settle();
        if let Some(guidance) = &mut self.guidance {
            guidance.enter(self.tick);
        }
        self.command_hold.enter(self.tick);
        self.delay.take(self.command_hold.speed());
        self.has_begun = true;
    }

    /// With what the sensors would show now. The accelerometer feels the rotors as they turned until now.
    pub fn state(&self) -> State {
        let mut state = State::default();
        self.show(&mut state);
        state
    }

    /// Writes every number of the state as it would be published now.
    fn show(&self, state: &mut State) {
        let (airframe, body) = (&self.airframe, &self.body);
        let (sensors, command_hold) = (&self.sensors, &self.command_hold);
        let (fix, fix_velocity) = sensors.fix(airframe);
        let force = self.dynamics.specific_force(
            body,
            self.rotors.thrust(&self.rotor_speed),
            &self.pushed_w,
        );
        // Field by field: a value of all would be made elsewhere, and copied.
        let measured = &mut state.measured;
        measured.position_w_m = fix.into();
        measured.velocity_w_m_s = fix_velocity.into();
        measured.attitude_rad = self.eta2.into();
        measured.attitude_quaternion = body.attitude.wxyz();
        measured.rate_b_rad_s = sensors.rates(airframe, &body.nu2).into();
        measured.specific_force_b_m_s2 = sensors.specific_force(airframe, &force).into();
        measured.rotor_speed_mean_rad_s = self.means.speed.into();
        measured.rotor_speed_squared_mean_rad2_s2 = self.means.speed_squared.into();
        measured.rotor_speed_command_rad_s = command_hold.speed();
        state.command_tick = command_hold.command_tick();
        state.commands_taken = self.commands_taken;
        state.command_taken_tick = self.command_taken_tick;
        state.command_saturated = u64::from(command_hold.is_saturated());
        state.deadlines_missed = command_hold.deadlines_missed;
        state.deadline_miss_run = command_hold.deadline_miss_run;
        state.ticks_skipped = self.ticks_skipped;
        state.parameter_epoch = self.parameter_epoch;
        state.decision = Decision {
            refused: command_hold.refused,
            group: command_hold.group() as u64,
            ..Decision::default()
        };
        let truth = &mut state.truth;
        truth.position_w_m = body.eta1.into();
        truth.velocity_w_m_s = body.v.into();
        truth.rate_b_rad_s = body.nu2.into();
        truth.touches_ground = u64::from(self.pushed_w != Vector3::zeros());
        truth.parameter = *airframe.values();
        if let Some(guidance) = &self.guidance {
            (state.target, state.reference) = (*guidance.target(), *guidance.reference());
        }
    }

    /// Takes a target of the ground station; false if no ground station flies this vehicle.
    pub fn aim(&mut self, target: FlightTarget) -> bool {
        let guidance = self.guidance.as_mut();
        guidance.map(|guidance| guidance.aim(target)).is_some()
    }

    /// The newest target of the ground station; none if no ground station flies this vehicle.
    pub fn target(&self) -> Option<&FlightTarget> {
        self.guidance.as_ref().map(Guidance::newest)
    }

    pub fn airframe(&self) -> &Airframe {
        &self.airframe
    }

    /// Mean torque of the rotors on the body over the last tick [N m], body frame, with their reaction torque.
    pub fn mean_torque_b_nm(&self) -> [f64; 3] {
        self.rotors.mean_torque(&self.means).into()
    }

    pub fn parameter_epoch(&self) -> u64 {
        self.parameter_epoch
    }

    /// Swaps that the last [`Plant::begin`] or [`Plant::end`] applied, in order, those of skipped ticks among them.
    pub fn applied(&self) -> &[AppliedSwap] {
        &self.applied
    }

    /// Tick of the newest change of a parameter, by a swap or a step of a ramp, that the last [`Plant::begin`] or
    /// [`Plant::end`] made.
    pub const fn changed_tick(&self) -> Option<u64> {
        self.changed_tick
    }

    /// Height of the airframe's lowest point above the ground [m], where there is one.
    pub fn clearance_m(&self) -> Option<f64> {
        self.ground
            .map(|ground| ground.clearance_m(&self.airframe, &self.body))
    }

    /// Whether the state lies within the envelope of the settings.
    pub fn envelope(&self) -> Result<(), EnvelopeViolation> {
        let (tick, tilt_max_rad) = (self.tick, self.tilt_max_rad);
        if !self.body.is_finite() {
            return Err(EnvelopeViolation::NotFinite { tick });
        }
        if let Some(crash) = self.crash {
            return Err(EnvelopeViolation::Crash(crash));
        }
        // No angle needs to be computed where none is too large.
        if tilt_max_rad < PI {
            let tilt_rad = self.body.tilt_rad();
            if tilt_rad > tilt_max_rad {
                return Err(EnvelopeViolation::Tilt {
                    tick,
                    tilt_rad,
                    tilt_max_rad,
                });
            }
        }
        Ok(())
    }
}
