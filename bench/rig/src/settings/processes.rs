//! What each process of a flight takes from the settings.

use std::collections::BTreeMap;

use model::parameters::{Airframe, Parameter};

use super::Settings;
use failure::Failure;

impl Settings {
    /// The true airframe at tick 0.
    ///
    /// # Errors
    /// A usage [`Failure`] names the parameter.
    pub fn airframe(&self) -> Result<Airframe, Failure> {
        airframe("plant", &self.plant)
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
            trajectory: self.flight.trajectory,
            gains: self.gains,
            limits: self.limits,
            rotor: self.rotor,
            model: airframe("model", &self.model)?,
        })
    }

    /// Settings of the mixer.
    ///
    /// # Errors
    /// As [`Self::controller`].
    pub fn mixer(&self) -> Result<mixer::MixerSettings, Failure> {
        Ok(mixer::MixerSettings {
            period_s: self.flight.period_s,
            model: airframe("model", &self.model)?,
            rotor: self.rotor,
        })
    }
}

fn airframe(section: &str, values: &BTreeMap<String, f64>) -> Result<Airframe, Failure> {
    let mut airframe = Airframe::nominal();
    for (name, value) in values {
        Parameter::from_name(name)
            .and_then(|parameter| airframe.set(parameter, *value))
            .map_err(|e| Failure::usage(format!("{section}.{e}")).help("see `ironbird params`"))?;
    }
    Ok(airframe)
}
