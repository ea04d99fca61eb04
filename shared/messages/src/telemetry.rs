//! Telemetry: what a law wants to be seen of itself.

use ironbird_law::abi::IRONBIRD_TELEMETRY;
pub use ironbird_law::{Signal, Telemetry};

use crate::layout::{layout, wire_enum};
use crate::role::Role;

/// How many numbers a law may show.
pub const TELEMETRY: usize = IRONBIRD_TELEMETRY;

/// The roles that have a law, in the order of the data flow.
pub const LAW_ROLES: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];

/// Names of the signals that are a law's rate error about body x, y, z.
pub const RATE_ERROR: [&str; 3] = [
    "rate_error_x_rad_s",
    "rate_error_y_rad_s",
    "rate_error_z_rad_s",
];

/// Names of the signals of a law that is another program: what a tick brought ([`AnswerOutcome`]), how long the answer
/// took, answers to older states, answers to none, whether the program has switched the motors off against the sticks,
/// and its exit status.
pub const ANSWERS: [&str; 6] = [
    "answer_outcome",
    "answer_latency_us",
    "answers_late",
    "answers_repeated",
    "firmware_disarmed",
    "firmware_exit_status",
];

wire_enum! {
    /// Outcome of a tick's request to another program.
    #[derive(Default)]
    pub enum AnswerOutcome {
        /// No state of this tick had arrived, so nothing was sent.
        #[default]
        NotAsked = 0 => "not asked",
        Answered = 1 => "answered",
        /// Nothing came in time.
        Silent = 2 => "silent",
        /// A packet had another length than an answer, or did not begin like one.
        WrongSize = 3 => "wrong size",
        /// A packet had numbers that are not finite.
        NotFinite = 4 => "not finite",
        /// The program has ended.
        Ended = 5 => "ended",
    }
}

/// What the laws of a flight show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    pub outer: &'static [Signal],
    pub inner: &'static [Signal],
    pub mixer: &'static [Signal],
}

impl Signals {
    /// The signals of a role's law; none where it has no law.
    pub const fn of(&self, role: Role) -> &'static [Signal] {
        match role {
            Role::Outer => self.outer,
            Role::Inner => self.inner,
            Role::Mixer => self.mixer,
            Role::Plant | Role::Record => &[],
        }
    }

    /// Places of signals among those of a role's law; none where it lacks one of them.
    pub fn places<const N: usize>(&self, role: Role, names: [&str; N]) -> Option<[usize; N]> {
        let mut places = [0; N];
        for (place, name) in places.iter_mut().zip(names) {
            *place = self
                .of(role)
                .iter()
                .take(TELEMETRY)
                .position(|signal| signal.name == name)?;
        }
        Some(places)
    }
}

layout!(Telemetry { value });

#[cfg(test)]
mod tests {
    use super::*;

    const fn ratio(name: &'static str) -> Signal {
        Signal { name, unit: "" }
    }

    const SIGNALS: [Signal; 2] = [ratio("mass_kg"), ratio("limited")];

    #[test]
    fn what_a_law_does_not_say_is_not_zero_and_what_is_no_signal_is() {
        let mut telemetry = Telemetry::unknown(2);
        telemetry.value[1] = 0.5;
        telemetry.value[2] = 7.0;
        telemetry.truncate(2);
        assert!(telemetry.value[0].is_nan() && telemetry.value[1] == 0.5);
        assert_eq!(telemetry.value[2..], [0.0; TELEMETRY - 2]);
        let mut all = Telemetry::unknown(TELEMETRY + 1);
        all.truncate(TELEMETRY + 1);
        assert!(all.value.iter().all(|value| value.is_nan()));
    }

    #[test]
    fn signals_are_found_by_name_all_or_none() {
        let signals = Signals {
            inner: &SIGNALS,
            ..Signals::default()
        };
        let both = signals.places(Role::Inner, ["limited", "mass_kg"]);
        assert_eq!(both, Some([1, 0]));
        assert_eq!(signals.places(Role::Inner, ["limited", "mass"]), None);
        assert_eq!(signals.places(Role::Outer, ["limited"]), None);
    }
}
