//! Effort of a flight: how often its rotors saturated, and how much their commands changed from tick to tick.

use crate::schema::RotorEffort;
use messages::content::{ROTORS, RotorSpeeds};

/// Summed up command by command.
#[derive(Clone, Copy, Debug, Default)]
pub struct EffortStatistics {
    commands: u64,
    pub saturated: u64,
    speed_sum: f64,
    /// Rotor command of the previous tick [rad/s].
    command: Option<[f64; ROTORS]>,
    changes_squared_sum: f64,
}

impl EffortStatistics {
    pub fn take(&mut self, rotors: &RotorSpeeds) {
        let command = rotors.speed_rad_s;
        self.commands += 1;
        self.saturated += rotors.saturated;
        self.speed_sum += command.iter().sum::<f64>();
        let before = self.command.replace(command).unwrap_or(command);
        let squares = (0..ROTORS).map(|i| (command[i] - before[i]) * (command[i] - before[i]));
        self.changes_squared_sum += squares.sum::<f64>();
    }

    /// Share of the commands that could not deliver the demand [%].
    pub fn saturated_percent(&self) -> f64 {
        100.0 * self.saturated as f64 / self.commands.max(1) as f64
    }

    /// Root mean square of the change of a rotor's command from tick to tick [rad/s].
    pub fn agitation_rad_s(&self) -> f64 {
        let changes = ROTORS as f64 * self.commands.saturating_sub(1).max(1) as f64;
        (self.changes_squared_sum / changes).sqrt()
    }

    /// The figures; none without a command.
    pub fn section(&self) -> Option<RotorEffort> {
        let speeds = ROTORS as f64 * self.commands as f64;
        (self.commands > 0).then(|| RotorEffort {
            commands: self.commands,
            saturated_percent: self.saturated_percent(),
            agitation_rad_s: self.agitation_rad_s(),
            command_mean_rad_s: self.speed_sum / speeds,
        })
    }
}
