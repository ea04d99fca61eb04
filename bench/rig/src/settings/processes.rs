//! What each process of a flight takes from the settings.

use std::collections::BTreeMap;

use model::parameters::{Airframe, Parameter, ParameterError};

use super::Settings;
use super::airframe::built;
use failure::Failure;

impl Settings {
    /// The true airframe at tick 0.
    ///
    /// # Errors
    /// A usage [`Failure`] names the parameter.
    pub fn airframe(&self) -> Result<Airframe, Failure> {
        self.airframe_of("plant", &self.plant)
    }

    /// Settings of the plant.
    ///
    /// # Errors
    /// As [`Self::airframe`].
    pub fn plant(&self) -> Result<plant::PlantSettings, Failure> {
        Ok(plant::PlantSettings {
            period_s: self.flight.period_s,
            airframe: self.airframe()?,
            rotor: self.rotor,
            seed: self.flight.seed,
            initial: (&self.initial).into(),
            ground: self.ground.plane(self.flight.ground_z_m),
            tilt_max_rad: self.flight.tilt_max_rad,
        })
    }

    /// Settings of the two loops.
    ///
    /// # Errors
    /// A usage [`Failure`] names the parameter of the model.
    pub fn controller(&self) -> Result<controller::LoopSettings, Failure> {
        Ok(controller::LoopSettings {
            period_s: self.flight.period_s,
            trajectory: self.course()?,
            gains: self.gains,
            limits: self.limits,
            rotor: self.rotor,
            model: self.airframe_of("model", &self.model)?,
        })
    }

    /// Settings of the mixer.
    ///
    /// # Errors
    /// As [`Self::controller`].
    pub fn mixer(&self) -> Result<mixer::MixerSettings, Failure> {
        Ok(mixer::MixerSettings {
            period_s: self.flight.period_s,
            model: self.airframe_of("model", &self.model)?,
            rotor: self.rotor,
        })
    }

    /// The airframe that was built, with the values of a section.
    fn airframe_of(&self, section: &str, values: &BTreeMap<String, f64>) -> Result<Airframe, Failure> {
        let refused = |section: &str, e: ParameterError| {
            Failure::usage(format!("{section}.{e}"))
                .help(format!("see `ironbird params --airframe {}`", self.flight.airframe))
        };
        let mut airframe = built(&self.airframe).map_err(|e| refused("airframe", e))?;
        for (name, value) in values {
            Parameter::from_name(name)
                .and_then(|parameter| airframe.set(parameter, *value))
                .map_err(|e| refused(section, e))?;
        }
        Ok(airframe)
    }
}
