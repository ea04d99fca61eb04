//! Whole ticks as they were measured: the input of the adaptation.
//!
//! The paper has no counterpart, since nothing is sampled in continuous time. A tick counts only if both its start and
//! its end were measured, because the rotor means of a state cover one tick.

use model::allocation::{Allocation, net_speed};
use model::messages::{ROTORS, State};
use nalgebra::Vector3;

use crate::adaptation::LastTick;
use crate::settings::LoopSettings;

/// The newest measured body rates, and the nominal rotors between them and the ones before.
#[derive(Clone, Debug)]
pub struct Samples {
    period_s: f64,
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    /// Newest body rates measured in time, with their tick.
    newest: Option<(u64, Vector3<f64>)>,
}

impl Samples {
    /// Before the first sample.
    #[must_use]
    pub fn new(settings: &LoopSettings) -> Self {
        Self {
            period_s: settings.period_s,
            allocation: Allocation::new(&settings.model),
            k: settings.model.k(),
            newest: None,
        }
    }

    /// Tick of the newest sample.
    #[must_use]
    pub fn newest_tick(&self) -> Option<u64> {
        self.newest.map(|(tick, _)| tick)
    }

    /// Takes the state of `tick`; gives the tick that ended with it, unless its start was not measured.
    pub fn take(&mut self, tick: u64, state: &State) -> Option<LastTick> {
        let nu2_end = state.rate_b_rad_s.into();
        let (sampled, nu2_start) = self.newest.replace((tick, nu2_end))?;
        (sampled + 1 == tick).then(|| LastTick {
            nu2_start,
            nu2_end,
            t_start_s: sampled as f64 * self.period_s,
            t_end_s: tick as f64 * self.period_s,
            om_m: net_speed(&state.rotor_speed_mean_rad_s.into()),
            tau_m: self.rotor_torque(&state.rotor_speed_squared_mean_rad2_s2),
        })
    }

    /// (6), (7): torque [N m] of rotors at these squared speeds [rad^2/s^2], by the nominal model.
    #[must_use]
    pub fn rotor_torque(&self, speed_squared: &[f64; ROTORS]) -> Vector3<f64> {
        let f = speed_squared.map(|w2| self.k * w2);
        self.allocation.wrench(&f.into()).1
    }
}
