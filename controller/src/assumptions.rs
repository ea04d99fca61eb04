//! Watches the theorem's assumptions: which one fails and so explains a rise.
//!
//! The proof in docs/paper.md that V_th does not rise assumes constant parameters (A), the exact model (B) and true
//! values inside the bounds (C). Saturation, delay and stale inputs are no excuse for a rise of V_th, because V_th
//! follows what the rotors really did. They are an excuse for V, which contains the rate error.
//!
//! A broken assumption is remembered until the low-pass of the adaptation has forgotten the samples taken under it. It takes no
//! sample in a tick whose start or end was not measured, and forgets none then.

use messages::content::{Mode, Stamped, State, Truth, Wrench};
use messages::math::ln;
use messages::monitor::{CAUSES, Cause};
use messages::parameters::{Airframe, Parameter, ROTOR_EFFICIENCY};
use nalgebra::Vector3;

use crate::adaptation::Adaptation;

/// Share of a sample in the low-pass below which it counts as forgotten.
pub const FORGOTTEN: f64 = 1e-9;
/// Share of the error of the measured rates that changes in a tick if it is noise.
const NOISY: f64 = 0.1;
/// Ticks for which a saturated or stale command shows in the rate error: it acts for one, a tick later.
const RATE_LOOP_TICKS: u64 = 2;

/// Parameters of the rate loop (8) that the adaptation takes from its model.
const MODELLED: [Parameter; 6] = [
    Parameter::ArmLength,
    Parameter::ThrustCoefficient,
    Parameter::DragFactor,
    Parameter::InertiaX,
    Parameter::InertiaY,
    Parameter::InertiaZ,
];

/// What explains a rise of V_th, in order of precedence.
pub const EXCUSES: [Cause; 5] = [
    Cause::LiveSwap,
    Cause::OutOfBounds,
    Cause::BrokenModel,
    Cause::GyroNoise,
    Cause::MotorLag,
];

#[derive(Clone, Debug)]
pub struct Assumptions {
    model: Airframe,
    lo: Vector3<f64>,
    hi: Vector3<f64>,
    faded_samples: u64,
    /// When each cause was seen last.
    seen: [Option<Seen>; CAUSES],
    /// Samples that the low-pass has taken.
    samples: u64,
    newest: Option<Known>,
    rates: Rates,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    tick: u64,
    samples: u64,
}

/// Body rates of a tick [rad/s].
#[derive(Clone, Copy, Debug, Default)]
struct Rates {
    measured: Vector3<f64>,
    truth: Vector3<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Known {
    theta: [f64; 3],
    parameter_epoch: u64,
    ticks_skipped: u64,
}

/// How the true values of the estimated parameters have come to a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moved {
    /// They are those of the state before.
    Not,
    /// They have gone on along a ramp.
    Along,
    /// They have been swapped, or have begun a ramp.
    Swapped,
}

impl Rates {
    /// Noise changes from tick to tick, and so do rates that stand still while the true ones move. A bias or a lag stays:
    /// neither explains a rise, wherever it comes from.
    fn are_noisy(&self, before: &Self) -> bool {
        let error = self.measured - self.truth;
        let change = error - (before.measured - before.truth);
        let is_frozen = self.measured == before.measured && self.truth != before.truth;
        is_frozen || change.norm() > NOISY * error.norm()
    }
}

impl Assumptions {
    /// Those of an adaptation with its model.
    pub fn new(adaptation: &Adaptation, model: &Airframe) -> Self {
        let faded_samples = if adaptation.p > 0.0 {
            (ln(FORGOTTEN) / ln(adaptation.p)).ceil() as u64
        } else {
            1
        };
        Self {
            model: *model,
            lo: adaptation.lo,
            hi: adaptation.hi,
            faded_samples,
            seen: [None; CAUSES],
            samples: 0,
            newest: None,
            rates: Rates::default(),
        }
    }

    /// Samples after which one counts as forgotten.
    pub const fn faded_samples(&self) -> u64 {
        self.faded_samples
    }

    /// Samples that the low-pass has taken.
    pub const fn samples(&self) -> u64 {
        self.samples
    }

    /// Counts a sample that the low-pass has taken after [`Self::look`].
    pub const fn count_sample(&mut self) {
        self.samples += 1;
    }

    /// Looks at a tick; says whether the true value of an estimated parameter has changed since the last state.
    pub fn look(&mut self, tick: u64, state: &Stamped<State>, wrench: &Wrench) -> Moved {
        if wrench.mode != Mode::Fresh as u64 {
            self.see(Cause::StaleInput, tick);
        }
        if state.tick != tick {
            self.see(Cause::StaleInput, tick);
            return Moved::Not;
        }
        let state = &state.content;
        let (truth, parameter_epoch) = (&state.truth, state.parameter_epoch);
        let ticks_skipped = state.ticks_skipped;
        let theta = truth.theta();
        let known = self.newest.replace(Known {
            theta,
            parameter_epoch,
            ticks_skipped,
        });
        let moved = match known {
            Some(known) if known.theta == theta => Moved::Not,
            Some(known) if known.parameter_epoch == parameter_epoch => Moved::Along,
            Some(_) => Moved::Swapped,
            None => Moved::Not,
        };
        let drifts = truth.get(Parameter::GyroDrift) > 0.0;
        let rates = Rates {
            measured: state.measured.rate_b_rad_s.into(),
            truth: truth.rate_b_rad_s.into(),
        };
        let is_noisy = drifts || rates.are_noisy(&std::mem::replace(&mut self.rates, rates));
        let skipped = known.is_some_and(|known| known.ticks_skipped != ticks_skipped);
        let theta = Vector3::from(theta);
        for (cause, holds) in [
            (Cause::LiveSwap, moved != Moved::Not),
            (
                Cause::OutOfBounds,
                theta.sup(&self.lo).inf(&self.hi) != theta,
            ),
            (Cause::BrokenModel, self.model_is_broken(truth)),
            (Cause::GyroNoise, is_noisy),
            (
                Cause::MotorLag,
                truth.get(Parameter::MotorTimeConstant) > 0.0,
            ),
            (Cause::Saturation, state.command_saturated == 1),
            (Cause::StaleInput, skipped || state.deadline_miss_run > 0),
            (Cause::Delay, true),
        ] {
            if holds {
                self.see(cause, tick);
            }
        }
        moved
    }

    fn see(&mut self, cause: Cause, tick: u64) {
        let samples = self.samples;
        self.seen[cause as usize] = Some(Seen { tick, samples });
    }

    fn model_is_broken(&self, truth: &Truth) -> bool {
        // The model has no ground either.
        truth.touches_ground == 1
            || MODELLED.iter().any(|parameter| truth.get(*parameter) != self.model.get(*parameter))
            // The controller's model has no efficiencies: it takes every rotor for a whole one.
            || ROTOR_EFFICIENCY.iter().any(|parameter| truth.get(*parameter) != 1.0)
    }

    /// Whether a cause is in force at a tick.
    pub fn holds(&self, cause: Cause, tick: u64) -> bool {
        self.seen[cause as usize].is_some_and(|seen| match cause {
            Cause::Saturation | Cause::StaleInput | Cause::Delay => {
                tick - seen.tick <= RATE_LOOP_TICKS
            }
            _ => self.samples - seen.samples <= self.faded_samples,
        })
    }

    /// Whether a cause was seen at this very tick.
    pub fn seen_at(&self, cause: Cause, tick: u64) -> bool {
        self.seen[cause as usize].is_some_and(|seen| seen.tick == tick)
    }

    /// Every cause in force at a tick: the sum of [`Cause::bit`].
    pub fn bits(&self, tick: u64) -> u64 {
        Cause::ALL
            .into_iter()
            .filter(|cause| self.holds(*cause, tick))
            .map(Cause::bit)
            .sum()
    }

    /// What explains a rise of V_th; [`Cause::Unexplained`] where (A), (B) and (C) hold.
    pub fn cause_of_rise(&self, tick: u64) -> Cause {
        self.first(EXCUSES, tick)
    }

    /// What explains that V changes by more than its bound.
    pub fn cause_of_v(&self, tick: u64) -> Cause {
        match self.cause_of_rise(tick) {
            Cause::Unexplained => {
                self.first([Cause::Saturation, Cause::StaleInput, Cause::Delay], tick)
            }
            cause => cause,
        }
    }

    fn first<const N: usize>(&self, causes: [Cause; N], tick: u64) -> Cause {
        causes
            .into_iter()
            .find(|cause| self.holds(*cause, tick))
            .unwrap_or(Cause::Unexplained)
    }
}
