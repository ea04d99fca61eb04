//! What every law gets before a flight, and the check that refuses a rig on which nothing can fly.

use std::ops::RangeInclusive;

use ironbird_law::Refused;
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter, shown};
use messages::topic::THRUST_N;

/// Periods with which a law can fly [s].
pub const PERIODS_S: RangeInclusive<f64> = 1e-4..=2e-2;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// T, length of a tick [s].
    pub period_s: f64,
    /// The airframe as it is believed to be; what is swapped in flight does not change it.
    pub airframe: Airframe,
    pub rotor: RotorLimits,
}

impl Default for Rig {
    /// The nominal airframe with its rotors, at 1 kHz.
    fn default() -> Self {
        Self {
            period_s: 1e-3,
            airframe: Airframe::nominal(),
            rotor: RotorLimits::default(),
        }
    }
}

impl Rig {
    /// Refuses a period with which no law can fly.
    pub fn check_period(period_s: f64) -> Result<(), Refused> {
        if PERIODS_S.contains(&period_s) {
            return Ok(());
        }
        Err(Refused(format!(
            "flight.period_s = {} is out of range: allowed is {} to {} s",
            shown(period_s),
            PERIODS_S.start(),
            PERIODS_S.end()
        )))
    }

    /// Refuses a period or rotors with which no law can fly.
    pub fn check(&self) -> Result<(), Refused> {
        Self::check_period(self.period_s)?;
        let airframe = &self.airframe;
        let (min_rad_s, max_rad_s) = (self.rotor.min_rad_s, self.rotor.max_rad_s);
        for (key, value) in [
            ("rotor.min_rad_s", min_rad_s),
            ("rotor.max_rad_s", max_rad_s),
        ] {
            if !(0.0..=f64::MAX).contains(&value) {
                return Err(Refused(format!(
                    "{key} = {value} is out of range: allowed is 0 or a finite number above it"
                )));
            }
        }
        if min_rad_s > max_rad_s {
            return Err(Refused(format!(
                "rotor.min_rad_s = {min_rad_s} must not be above rotor.max_rad_s = {max_rad_s}"
            )));
        }
        if airframe.g() == 0.0 {
            return Err(Refused(
                "model.gravity_m_s2 = 0: the laws hold a weight, and have none then; write a gravity above 0, and for \
                 an airframe without weight that the laws do not know of, plant.gravity_m_s2 = 0"
                    .into(),
            ));
        }
        let hover_n = airframe.m() * airframe.g();
        let min_n = 4.0 * self.rotor.f_min(airframe.k());
        let max_n = 4.0 * self.rotor.f_max(airframe.k());
        if max_n > THRUST_N {
            return Err(Refused(format!(
                "the rotors give more than {THRUST_N} N in all, the most that a message can carry: lower rotor.max_rad_s"
            )));
        }
        if min_n < hover_n && hover_n < max_n {
            return Ok(());
        }
        Err(Refused(format!(
            "the airframe cannot hover: it needs {hover_n:.3} N, and its rotors give {min_n:.3} to {max_n:.3} N; \
             change rotor.min_rad_s, rotor.max_rad_s or the model"
        )))
    }
}

impl From<&Rig> for ironbird_law::Rig {
    fn from(rig: &Rig) -> Self {
        let of = |parameter| rig.airframe.get(parameter);
        Self {
            period_s: rig.period_s,
            airframe: ironbird_law::Airframe {
                mass_kg: of(Parameter::Mass),
                gravity_m_s2: of(Parameter::Gravity),
                translational_drag_kg_s: of(Parameter::TranslationalDrag),
                rotational_drag_nm_s: of(Parameter::RotationalDrag),
                arm_length_m: of(Parameter::ArmLength),
                thrust_coefficient_n_s2: of(Parameter::ThrustCoefficient),
                drag_factor_nm_s2: of(Parameter::DragFactor),
                rotor_inertia_kg_m2: of(Parameter::RotorInertia),
                inertia_kg_m2: rig.airframe.i_m(),
                disturbance_gain_rad_s2: of(Parameter::DisturbanceGain),
                rotor_efficiency: rig.airframe.rotor_efficiency(),
                motor_time_constant_s: of(Parameter::MotorTimeConstant),
            },
            rotor_min_rad_s: rig.rotor.min_rad_s,
            rotor_max_rad_s: rig.rotor.max_rad_s,
        }
    }
}
