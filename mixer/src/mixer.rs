//! The mixer stage: newest wrench in, rotor speeds out, at every tick.
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
//! any other, with one exception: a wrench marked idle idles the rotors.

use law::MixerLaw;
use model::allocation::Allocation;
use model::limits::RotorLimits;
use model::messages::{Dated, Mode, RotorSpeeds, Wrench};
use model::parameters::Airframe;
use nalgebra::{Vector3, Vector4};

use crate::mix::{mix, speeds};

/// Ticks for which the last wrench is held at least, and time where that is longer [s].
pub const HELD_TICKS: u64 = 3;
/// See [`HELD_TICKS`].
pub const HELD_S: f64 = 0.003;

/// Age of the wrench at which the rotors go to idle [s].
pub const IDLE_AFTER_S: f64 = 0.050;

/// What a mixer is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MixerSettings {
    /// Length of a tick, T [s].
    pub period_s: f64,
    /// Nominal parameters: the mixer does not learn what is swapped in flight.
    pub model: Airframe,
    /// Range of the rotor speeds.
    pub rotor: RotorLimits,
}

/// The mixer of an airframe.
#[derive(Clone, Copy, Debug)]
pub struct Mixer {
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    f_min: f64,
    f_max: f64,
    /// Greatest age of a wrench that is held.
    held_ticks: u64,
    /// Age of the wrench at which the rotors go to idle.
    idle_after_ticks: u64,
}

impl Mixer {
    /// A mixer for the nominal airframe.
    #[must_use]
    pub fn new(settings: &MixerSettings) -> Self {
        let MixerSettings { period_s, model, rotor } = settings;
        let k = model.k();
        let ticks = |time_s: f64| (time_s / period_s).round().max(1.0) as u64;
        let idle_after_ticks = ticks(IDLE_AFTER_S);
        Self {
            allocation: Allocation::new(model),
            k,
            f_min: rotor.f_min(k),
            f_max: rotor.f_max(k),
            held_ticks: ticks(HELD_S).max(HELD_TICKS).min(idle_after_ticks / 2),
            idle_after_ticks,
        }
    }

    fn mixed(&self, (u, tau): (f64, Vector3<f64>), mode: Mode) -> RotorSpeeds {
        let mix = mix(&self.allocation, u, &tau, self.f_min, self.f_max);
        self.message(&mix.f, mix.saturated, mode)
    }

    fn message(&self, f: &Vector4<f64>, saturated: bool, mode: Mode) -> RotorSpeeds {
        let (thrust_n, torque) = self.allocation.wrench(f);
        RotorSpeeds {
            speed_rad_s: speeds(f, self.k).into(),
            thrust_n,
            torque_b_nm: torque.into(),
            saturated: u64::from(saturated),
            mode: mode as u64,
        }
    }
}

impl MixerLaw for Mixer {
    /// Rotor speeds at `tick`, from the newest wrench with the tick that it was made for.
    ///
    /// The result carries the thrust and torque that are really asked of the rotors, by the nominal model.
    fn tick(&mut self, tick: u64, wrench: &Dated<Wrench>) -> RotorSpeeds {
        let Wrench { thrust_n, torque_b_nm, mode, .. } = wrench.content;
        let demand = (thrust_n, Vector3::from(torque_b_nm));
        match wrench.age(tick) {
            age if age >= self.idle_after_ticks || mode == Mode::Idle as u64 => self.idle(),
            0 => self.mixed(demand, Mode::Fresh),
            age if age <= self.held_ticks => self.mixed(demand, Mode::Held),
            _ => self.mixed((thrust_n, Vector3::zeros()), Mode::Fallback),
        }
    }

    /// Every rotor at its smallest speed. Nothing is demanded of idle rotors, so nothing saturates.
    fn idle(&self) -> RotorSpeeds {
        self.message(&Vector4::repeat(self.f_min), false, Mode::Idle)
    }
}
