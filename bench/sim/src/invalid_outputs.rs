//! Counts law outputs that could not be used (not finite), in a simulation.

use analysis::laws::NotFinite;

use crate::simulator::Simulator;
use config::Settings;
use config::law_settings::Chosen;
use errors::Failure;

/// By law: outer, inner, mixer.
#[derive(Clone, Copy, Debug, Default)]
pub struct InvalidOutputs([NotFinite; 3]);

impl InvalidOutputs {
    /// Counts the outputs of the last tick.
    pub fn take(&mut self, rig: &Simulator) {
        let modes = [
            rig.setpoint().map_or(0, |setpoint| setpoint.mode),
            rig.new_wrench().map_or(0, |wrench| wrench.mode),
            rig.new_rotor_speeds().map_or(0, |speeds| speeds.mode),
        ];
        self.0
            .iter_mut()
            .zip(modes)
            .for_each(|(counted, mode)| counted.take(rig.flown_tick(), mode));
    }

    /// A sentence for each law with unusable outputs.
    pub fn sentences(self, settings: &Settings) -> Result<Vec<String>, Failure> {
        let counted = settings.chosen_laws()?.into_iter().zip(self.0);
        let sentence = |(law, counted): (Chosen, NotFinite)| {
            let section = law.section(counted, Vec::new());
            render::sentences::not_finite(&section, law.description().role.name())
        };
        Ok(counted.filter_map(sentence).collect())
    }
}
