//! What each process of a flight takes from the settings.

use std::collections::BTreeMap;

use model::parameters::{Airframe, Parameter};
use model::realtime::{RealtimeMode, RealtimeSettings};
use toml::Value;

use super::{PaceName, Settings};
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

    /// What to ask the system for.
    ///
    /// # Errors
    /// A usage [`Failure`] where `rt.cpu` is neither a processor nor "auto".
    pub fn realtime(&self) -> Result<RealtimeSettings, Failure> {
        // A SCHED_FIFO process that never sleeps is throttled by the kernel, and starves whoever shares its processor.
        if self.flight.pace == PaceName::Lockstep {
            return Ok(RealtimeSettings { mode: RealtimeMode::Off, priority: self.rt.priority, cpu: None });
        }
        let cpu = match &self.rt.cpu {
            Value::String(auto) if auto == "auto" => None,
            Value::Integer(cpu) if (0..1024).contains(cpu) => usize::try_from(*cpu).ok(),
            other => {
                return Err(Failure::usage(format!("rt.cpu = {other}: allowed are a processor's number and \"auto\""))
                    .help("`taskset -p $$` shows the processors that this shell may use"));
            }
        };
        Ok(RealtimeSettings { mode: self.rt.mode, priority: self.rt.priority, cpu })
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
