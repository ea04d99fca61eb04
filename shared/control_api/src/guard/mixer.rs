//! The mixer's stage: any mixer law; newest wrench in, rotor speeds out, at every tick.
//!
//! Its reaction depends only on the age of the wrench in ticks. There is no state that could go stale or would have to
//! be restored after a restart:
//!
//! ```text
//!   age 0            Fresh     mixed as demanded
//!   1 to 3 ticks     Held      the same wrench again
//!   then             Fallback  its thrust, and no torque: an old torque would roll the vehicle over
//!   from 50 ms on    Idle      every rotor at its smallest speed; likewise before the first wrench
//! ```
//!
//! Up to 1 kHz, three ticks are three ticks. Above 1 kHz a wrench is held for 3 ms, because a stall of the machine does
//! not depend on the tick. It is never held for more than half of the way to idle, so that each mode has its turn even
//! at 50 Hz.
//!
//! The mode gives the age of the *mixer's* input. A wrench that the inner loop made in a mode of its own is mixed like
//! any other, with one exception: a wrench marked idle idles the rotors. An answer that is not finite is replaced by
//! the thrust demanded and no torque: `NotFinite`. Speeds beyond the rotors' range are brought to its ends.

use messages::allocation::Allocation;
use messages::checks::{Check, is_on};
use messages::content::{Mode, ROTORS, RotorSpeeds, Stamped, Wrench};
use messages::telemetry::Telemetry;
use nalgebra::Vector4;

use crate::law::{Rig, WrenchSetpoint};
use crate::registry::{AnyMixer, Made};
use crate::stage::MixerStage;

/// Ticks for which the last wrench is held at least, and time where that is longer [s].
pub const HELD_TICKS: u64 = 3;
/// See [`HELD_TICKS`].
pub const HELD_S: f64 = 0.003;

/// Age of the wrench at which the rotors go to idle [s].
pub const IDLE_AFTER_S: f64 = 0.050;

#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct GuardedMixer {
    made: Made<dyn AnyMixer>,
    rotors: Rotors,
}

/// What the rotors can do, by the nominal model, and how long a wrench is held.
#[derive(Clone, Copy, Debug)]
struct Rotors {
    /// How many numbers the law shows.
    signals: usize,
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    /// Smallest and largest speed [rad/s].
    slowest: f64,
    fastest: f64,
    /// Greatest age of a wrench that is held.
    held_ticks: u64,
    /// Age of the wrench at which the rotors go to idle.
    idle_after_ticks: u64,
}

impl GuardedMixer {
    #[must_use]
    pub fn new(made: Made<dyn AnyMixer>, rig: &Rig) -> Self {
        let Rig {
            period_s,
            ref airframe,
            ref rotor,
        } = *rig;
        let k = airframe.k();
        let ticks = |time_s: f64| (time_s / period_s).round().max(1.0) as u64;
        let idle_after_ticks = ticks(IDLE_AFTER_S);
        // By way of the thrust, as a mixer comes by its speeds: the ends of the range are the same to the last bit.
        let speed = |f: f64| (f / k).sqrt();
        let rotors = Rotors {
            signals: made.signals,
            allocation: Allocation::new(airframe),
            k,
            slowest: speed(rotor.f_min(k)),
            fastest: speed(rotor.f_max(k)),
            held_ticks: ticks(HELD_S).max(HELD_TICKS).min(idle_after_ticks / 2),
            idle_after_ticks,
        };
        Self { made, rotors }
    }

    /// Makes this stage what another one of the same law is; false where the law cannot be copied.
    #[must_use]
    pub fn copy_from(&mut self, other: &Self) -> bool {
        other.made.law.copy_into(&mut *self.made.law)
    }
}

impl MixerStage for GuardedMixer {
    fn tick_into(&mut self, tick: u64, wrench: &Stamped<Wrench>, speeds: &mut RotorSpeeds) {
        self.rotors.tick(&mut *self.made.law, tick, wrench, speeds);
    }

    fn rehearse(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> Option<RotorSpeeds> {
        let Self { made, rotors } = self;
        let mut speeds = RotorSpeeds::default();
        made.law.copy_into(&mut *made.twin).then(|| {
            rotors.tick(&mut *made.twin, tick, wrench, &mut speeds);
            speeds
        })
    }

    fn idle(&self) -> RotorSpeeds {
        let telemetry = Telemetry::unknown(self.rotors.signals);
        let mut speeds = RotorSpeeds {
            telemetry,
            ..RotorSpeeds::default()
        };
        self.rotors.idle(&mut speeds);
        speeds
    }
}

impl Rotors {
    fn tick(
        &self,
        law: &mut dyn AnyMixer,
        tick: u64,
        wrench: &Stamped<Wrench>,
        speeds: &mut RotorSpeeds,
    ) {
        speeds.telemetry.forget(self.signals);
        let Wrench {
            thrust_n,
            torque_b_nm,
            mode,
            ..
        } = wrench.content;
        let demand = WrenchSetpoint {
            thrust_n,
            torque_b_nm,
        };
        match wrench.age(tick) {
            age if (age >= self.idle_after_ticks && is_on(Check::Stale))
                || mode == Mode::Idle as u64 =>
            {
                self.idle(speeds)
            }
            0 => self.mix(law, tick, &demand, Mode::Fresh, speeds),
            age if age <= self.held_ticks || !is_on(Check::Stale) => {
                self.mix(law, tick, &demand, Mode::Held, speeds)
            }
            _ => self.mix(
                law,
                tick,
                &WrenchSetpoint {
                    torque_b_nm: [0.0; 3],
                    ..demand
                },
                Mode::Fallback,
                speeds,
            ),
        }
    }

    fn mix(
        &self,
        law: &mut dyn AnyMixer,
        tick: u64,
        demand: &WrenchSetpoint,
        mode: Mode,
        speeds: &mut RotorSpeeds,
    ) {
        let (speed, saturated) = law.tick(tick, demand, &mut speeds.telemetry);
        speeds.telemetry.truncate(self.signals);
        if speed.iter().all(|w| w.is_finite()) {
            let inside = speed.map(|w| w.clamp(self.slowest, self.fastest));
            self.write(inside, saturated || inside != speed, mode, speeds);
        } else {
            let wanted = (demand.thrust_n / ROTORS as f64 / self.k).sqrt();
            let speed = wanted.max(self.slowest).min(self.fastest);
            self.write([speed; ROTORS], true, Mode::NotFinite, speeds);
        }
    }

    /// Every rotor at its smallest speed. Nothing is demanded of idle rotors, so nothing saturates.
    fn idle(&self, speeds: &mut RotorSpeeds) {
        self.write([self.slowest; ROTORS], false, Mode::Idle, speeds);
    }

    fn write(&self, speed: [f64; ROTORS], saturated: bool, mode: Mode, speeds: &mut RotorSpeeds) {
        let f = Vector4::from(speed).map(|w| self.k * w * w);
        let (thrust_n, torque) = self.allocation.wrench(&f);
        speeds.speed_rad_s = speed;
        speeds.thrust_n = thrust_n;
        speeds.torque_b_nm = torque.into();
        speeds.saturated = u64::from(saturated);
        speeds.mode = mode as u64;
    }
}
