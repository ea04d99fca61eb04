//! Answers of laws that could not be used, in a flight in one process.

use report::laws::NotFinite;

use crate::in_process::InProcess;
use crate::settings::Settings;
use crate::settings::laws::Chosen;
use failure::Failure;

/// Counts them by law: outer, inner, mixer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unusable([NotFinite; 3]);

impl Unusable {
    /// Takes the tick that was flown last.
    pub fn take(&mut self, rig: &InProcess) {
        let modes = [
            rig.setpoint().map_or(0, |setpoint| setpoint.mode),
            rig.new_wrench().map_or(0, |wrench| wrench.mode),
            rig.new_rotor_speeds().map_or(0, |speeds| speeds.mode),
        ];
        self.0.iter_mut().zip(modes).for_each(|(counted, mode)| counted.take(rig.flown_tick(), mode));
    }

    /// A sentence for each law whose answers could not all be used.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub fn sentences(self, settings: &Settings) -> Result<Vec<String>, Failure> {
        let counted = settings.chosen_laws()?.into_iter().zip(self.0);
        let sentence = |(law, counted): (Chosen, NotFinite)| {
            law.section(counted, Vec::new()).not_finite(law.description().role.name())
        };
        Ok(counted.filter_map(sentence).collect())
    }
}
