//! The topics of the loop, and the checks that a content must pass.

use std::mem::offset_of;

use crate::content::{
    DECISIONS, Decisions, Loss, Mode, Reference, RotorSpeeds, Setpoint, State, SwapRecord,
    TakenCommand, TargetKind, Wrench,
};
use crate::layout::{Field, Visit, Visitor, words};
use crate::monitor::{CAUSES, Monitor};
use crate::parameters::{FIRST_PARAMETERS, PARAMETERS, Parameter};
use crate::role::{MOST_CHANNELS, Role};
use crate::telemetry::Telemetry;
use Bound::{Any, Positive, Size};

/// A content that travels on a topic of its own.
pub trait Topic: Visit + Copy + std::fmt::Debug + Default + 'static {
    const NAME: &'static str;
    const SENDER: Role;
    /// Processes that subscribe to it at the most: the loop's, and the recorder; none to what the recorder makes.
    const SUBSCRIBERS: usize;
    /// How many more each further channel adds.
    const SUBSCRIBERS_PER_CHANNEL: usize = 0;
    /// Whether several messages may be made for one tick.
    const MANY_PER_TICK: bool = false;

    /// Calls `look` on every number that another stage reads, with what is plausible of it. Telemetry is not among them: a
    /// law may show what it will.
    fn numbers(&self, look: impl FnMut(&[f64], Bound));

    /// Whether flags and indices are ones that exist.
    fn has_known_flags(&self) -> bool;

    /// Words that make the flight: not the record of whose command was taken, and not what another topic repeats.
    fn flight_words(&self) -> &[u64] {
        words(self)
    }

    /// What the law of its sender shows in it; none where the sender has no law.
    fn telemetry(&self) -> Option<&Telemetry> {
        None
    }

    /// As [`Self::telemetry`], to fill it in.
    fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        None
    }

    fn finite(&self) -> bool {
        let mut finite = true;
        self.numbers(|numbers, _| finite &= numbers.iter().all(|number| number.is_finite()));
        finite
    }

    /// Whether numbers are physically possible, and flags are ones that exist. What is not finite is possible only where
    /// the bound is [`Bound::Any`].
    fn plausible(&self) -> bool {
        let mut plausible = self.has_known_flags();
        self.numbers(|numbers, bound| plausible &= bound.holds(numbers));
        plausible
    }
}

// Bounds far outside any flight that ends well: what lies beyond is a broken or forged message.
pub(crate) const POSITION_M: f64 = 1e5;
pub(crate) const VELOCITY_M_S: f64 = 1e3;
/// Yaw is not wrapped.
pub(crate) const ANGLE_RAD: f64 = 1e6;
/// A unit quaternion, with room for rounding.
pub(crate) const QUATERNION: f64 = 1.001;
pub(crate) const RATE_RAD_S: f64 = 1e4;
pub(crate) const ACCELERATION_M_S2: f64 = 1e6;
pub(crate) const ACCELERATION_RAD_S2: f64 = 1e8;
/// Derivatives of a reference that jumps: each goes with one over the time between two points, 1 ms at the least.
const REFERENCE_ACCELERATION: f64 = 1e9;
const REFERENCE_JERK: f64 = 1e12;
const REFERENCE_SNAP: f64 = 1e15;
pub(crate) const ROTOR_SPEED_RAD_S: f64 = 1e5;
pub const THRUST_N: f64 = 1e4;
pub(crate) const TORQUE_NM: f64 = 1e5;
const PARAMETER: f64 = 1e3;

/// What is plausible of some numbers.
#[derive(Clone, Copy, Debug)]
pub enum Bound {
    /// Of either sign, up to this size.
    Size(f64),
    /// From 0 up to this.
    Positive(f64),
    /// Any finite number.
    Any,
}

impl Bound {
    /// Compares all numbers, even if the first is out of bounds: without branches, several are compared at once.
    #[inline]
    fn holds(self, numbers: &[f64]) -> bool {
        let numbers = numbers.iter();
        match self {
            Self::Size(bound) => numbers.fold(true, |holds, it| holds & (it.abs() <= bound)),
            Self::Positive(bound) => {
                numbers.fold(true, |holds, it| holds & (*it >= 0.0) & (*it <= bound))
            }
            Self::Any => true,
        }
    }
}

macro_rules! shows_telemetry {
    () => {
        fn telemetry(&self) -> Option<&Telemetry> {
            Some(&self.telemetry)
        }

        fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
            Some(&mut self.telemetry)
        }
    };
}

impl Topic for State {
    const NAME: &'static str = "state";
    const SENDER: Role = Role::Plant;
    const SUBSCRIBERS: usize = 3;
    const SUBSCRIBERS_PER_CHANNEL: usize = 2;

    #[inline]
    fn numbers(&self, mut look: impl FnMut(&[f64], Bound)) {
        self.fields(&mut look);
        let truth = &self.truth;
        look(&truth.position_w_m, Size(POSITION_M));
        look(&truth.velocity_w_m_s, Size(VELOCITY_M_S));
        look(&truth.rate_b_rad_s, Size(RATE_RAD_S));
        look(&truth.parameter, Size(PARAMETER));
        let target = &self.target;
        look(&target.position_w_m, Size(POSITION_M));
        look(&target.velocity_w_m_s, Size(VELOCITY_M_S));
        look(&[target.yaw_rad], Size(ANGLE_RAD));
        look_at_reference(&self.reference, look);
    }

    fn has_known_flags(&self) -> bool {
        self.command_saturated <= 1
            && self.truth.touches_ground <= 1
            && self.decision.command.is_known()
            && self.decision.group < MOST_CHANNELS as u64
            && TargetKind::from_wire(self.target.kind).is_some()
    }

    fn flight_words(&self) -> &[u64] {
        let words = &words(self)[..offset_of!(Self, decision) / size_of::<u64>()];
        let (first, later) = words.split_at(words.len() - (PARAMETERS - FIRST_PARAMETERS));
        let used = later.iter().rposition(|word| *word != 0);
        &words[..first.len() + used.map_or(0, |last| last + 1)]
    }
}

impl Topic for Setpoint {
    const NAME: &'static str = "setpoint";
    const SENDER: Role = Role::Outer;
    const SUBSCRIBERS: usize = 2;

    #[inline]
    fn numbers(&self, mut look: impl FnMut(&[f64], Bound)) {
        self.fields(&mut look);
        look_at_reference(&self.reference, look);
    }

    fn has_known_flags(&self) -> bool {
        self.limited <= 1 && Mode::from_wire(self.mode).is_some()
    }

    shows_telemetry!();
}

impl Topic for Wrench {
    const NAME: &'static str = "wrench";
    const SENDER: Role = Role::Inner;
    const SUBSCRIBERS: usize = 2;

    #[inline]
    fn numbers(&self, mut look: impl FnMut(&[f64], Bound)) {
        self.fields(&mut look);
    }

    fn has_known_flags(&self) -> bool {
        Mode::from_wire(self.mode).is_some()
    }

    shows_telemetry!();
}

impl Topic for RotorSpeeds {
    const NAME: &'static str = "rotor_speeds";
    const SENDER: Role = Role::Mixer;
    const SUBSCRIBERS: usize = 2;

    #[inline]
    fn numbers(&self, mut look: impl FnMut(&[f64], Bound)) {
        self.fields(&mut look);
        look(&[self.thrust_n], Positive(THRUST_N));
        look(&self.torque_b_nm, Size(TORQUE_NM));
    }

    fn has_known_flags(&self) -> bool {
        self.saturated <= 1 && Mode::from_wire(self.mode).is_some()
    }

    shows_telemetry!();
}

fn look_at_reference(reference: &Reference, mut look: impl FnMut(&[f64], Bound)) {
    look(&reference.position_w_m, Size(POSITION_M));
    look(&reference.velocity_w_m_s, Size(VELOCITY_M_S));
    look(&reference.acceleration_w_m_s2, Size(REFERENCE_ACCELERATION));
    look(&reference.jerk_w_m_s3, Size(REFERENCE_JERK));
    look(&reference.snap_w_m_s4, Size(REFERENCE_SNAP));
    look(&[reference.yaw_rad], Size(ANGLE_RAD));
    look(&[reference.yaw_rate_rad_s], Size(RATE_RAD_S));
    look(
        &[reference.yaw_acceleration_rad_s2],
        Size(REFERENCE_ACCELERATION),
    );
}

/// All numbers of a struct, of which any finite one is plausible.
struct AnyNumbers<F>(F);

impl<F: FnMut(&[f64], Bound)> Visitor for AnyNumbers<F> {
    fn integers(&mut self, _: &'static Field, _: &[u64]) {}

    fn numbers(&mut self, _: &'static Field, values: &[f64]) {
        (self.0)(values, Any);
    }
}

impl Topic for SwapRecord {
    const NAME: &'static str = "swaps";
    const SENDER: Role = Role::Plant;
    const SUBSCRIBERS: usize = 1;
    const MANY_PER_TICK: bool = true;

    fn numbers(&self, look: impl FnMut(&[f64], Bound)) {
        self.visit(&mut AnyNumbers(look));
    }

    fn has_known_flags(&self) -> bool {
        let changes = self.parameter.iter().zip(self.steps);
        let is_known =
            |(index, steps): (&u64, u64)| Parameter::from_index(*index).is_some() && steps > 0;
        self.count <= PARAMETERS as u64 && changes.take(self.count as usize).all(is_known)
    }
}

impl Topic for Decisions {
    const NAME: &'static str = "decisions";
    const SENDER: Role = Role::Plant;
    const SUBSCRIBERS: usize = 1;
    const MANY_PER_TICK: bool = true;

    fn numbers(&self, _: impl FnMut(&[f64], Bound)) {}

    fn has_known_flags(&self) -> bool {
        self.count <= DECISIONS as u64 && self.command.iter().all(TakenCommand::is_known)
    }
}

impl Topic for Loss {
    const NAME: &'static str = "losses";
    const SENDER: Role = Role::Record;
    const SUBSCRIBERS: usize = 0;
    const MANY_PER_TICK: bool = true;

    fn numbers(&self, _: impl FnMut(&[f64], Bound)) {}

    fn has_known_flags(&self) -> bool {
        self.channel < MOST_CHANNELS as u64
    }
}

impl Topic for Monitor {
    const NAME: &'static str = "theorem";
    const SENDER: Role = Role::Record;
    const SUBSCRIBERS: usize = 0;

    fn numbers(&self, look: impl FnMut(&[f64], Bound)) {
        self.visit(&mut AnyNumbers(look));
    }

    fn has_known_flags(&self) -> bool {
        self.causes < 1 << CAUSES && self.is_violation <= 1 && self.is_live <= 1
    }
}
