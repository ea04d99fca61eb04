//! How the rig finds a law by name, and holds it whatever its type.

use std::any::Any;

use messages::content::Measured;
use messages::content::Reference;
use messages::content::{ROTORS, Stamped};
use messages::telemetry::Telemetry;

use crate::description::{Description, Refused, Settings};
use crate::law::{Desired, InnerLaw, MixerLaw, OuterLaw, Rig, WrenchSetpoint};

/// An [`OuterLaw`] of any type.
pub trait AnyOuter: Any + Send {
    /// As [`OuterLaw::tick`].
    fn tick(
        &mut self,
        tick: u64,
        measured: &Measured,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> Desired;

    /// Makes another instance of the same law what this one is, without allocating where the law owns no memory.
    /// False where the law cannot do that: it is not rehearsed then.
    fn copy_into(&self, other: &mut dyn AnyOuter) -> bool;
}

/// An [`InnerLaw`] of any type.
pub trait AnyInner: Any + Send {
    /// As [`InnerLaw::tick`].
    fn tick(
        &mut self,
        tick: u64,
        measured: &Stamped<Measured>,
        wanted: &Stamped<Desired>,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> WrenchSetpoint;

    /// As [`AnyOuter::copy_into`].
    fn copy_into(&self, other: &mut dyn AnyInner) -> bool;

    /// As [`InnerLaw::estimates`].
    fn estimates(&self) -> Option<[f64; 3]> {
        None
    }

    /// As [`InnerLaw::resume`].
    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        let _ = estimates;
        false
    }
}

/// A [`MixerLaw`] of any type.
pub trait AnyMixer: Any + Send {
    /// As [`MixerLaw::tick`].
    fn tick(
        &mut self,
        tick: u64,
        demand: &WrenchSetpoint,
        telemetry: &mut Telemetry,
    ) -> ([f64; ROTORS], bool);

    /// As [`AnyOuter::copy_into`].
    fn copy_into(&self, other: &mut dyn AnyMixer) -> bool;
}

/// Copies a value into another of the same type.
fn copy<L: Clone + 'static>(from: &L, into: &mut dyn Any) -> bool {
    into.downcast_mut::<L>().is_some_and(|into| {
        into.clone_from(from);
        true
    })
}

impl<L: OuterLaw + Clone + Send + 'static> AnyOuter for L {
    fn tick(
        &mut self,
        tick: u64,
        measured: &Measured,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> Desired {
        OuterLaw::tick(self, tick, measured, reference, telemetry)
    }

    fn copy_into(&self, other: &mut dyn AnyOuter) -> bool {
        copy(self, other)
    }
}

impl<L: InnerLaw + Clone + Send + 'static> AnyInner for L {
    fn tick(
        &mut self,
        tick: u64,
        measured: &Stamped<Measured>,
        wanted: &Stamped<Desired>,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> WrenchSetpoint {
        InnerLaw::tick(self, tick, measured, wanted, reference, telemetry)
    }

    fn copy_into(&self, other: &mut dyn AnyInner) -> bool {
        copy(self, other)
    }

    fn estimates(&self) -> Option<[f64; 3]> {
        InnerLaw::estimates(self)
    }

    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        InnerLaw::resume(self, estimates)
    }
}

impl<L: MixerLaw + Clone + Send + 'static> AnyMixer for L {
    fn tick(
        &mut self,
        tick: u64,
        demand: &WrenchSetpoint,
        telemetry: &mut Telemetry,
    ) -> ([f64; ROTORS], bool) {
        MixerLaw::tick(self, tick, demand, telemetry)
    }

    fn copy_into(&self, other: &mut dyn AnyMixer) -> bool {
        copy(self, other)
    }
}

impl<L: OuterLaw + Clone + Send + 'static> From<L> for Made<dyn AnyOuter> {
    fn from(law: L) -> Self {
        Self {
            signals: L::DESCRIPTION.telemetry.len(),
            twin: Box::new(law.clone()),
            law: Box::new(law),
        }
    }
}

impl<L: InnerLaw + Clone + Send + 'static> From<L> for Made<dyn AnyInner> {
    fn from(law: L) -> Self {
        Self {
            signals: L::DESCRIPTION.telemetry.len(),
            twin: Box::new(law.clone()),
            law: Box::new(law),
        }
    }
}

impl<L: MixerLaw + Clone + Send + 'static> From<L> for Made<dyn AnyMixer> {
    fn from(law: L) -> Self {
        Self {
            signals: L::DESCRIPTION.telemetry.len(),
            twin: Box::new(law.clone()),
            law: Box::new(law),
        }
    }
}

/// Makes a law for a rig.
type Make<L> = fn(&Rig, &Settings) -> Result<Box<L>, Refused>;

/// A law that can be chosen by its name; `L` is [`AnyOuter`], [`AnyInner`] or [`AnyMixer`].
#[derive(Debug)]
pub struct Entry<L: ?Sized> {
    pub description: &'static Description,
    make: Make<L>,
}

impl Entry<dyn AnyOuter> {
    #[must_use]
    pub const fn outer<L: OuterLaw + Clone + Send + 'static>() -> Self {
        Self {
            description: &L::DESCRIPTION,
            make: |rig, settings| Ok(Box::new(L::new(rig, settings)?)),
        }
    }
}

impl Entry<dyn AnyInner> {
    #[must_use]
    pub const fn inner<L: InnerLaw + Clone + Send + 'static>() -> Self {
        Self {
            description: &L::DESCRIPTION,
            make: |rig, settings| Ok(Box::new(L::new(rig, settings)?)),
        }
    }
}

impl Entry<dyn AnyMixer> {
    #[must_use]
    pub const fn mixer<L: MixerLaw + Clone + Send + 'static>() -> Self {
        Self {
            description: &L::DESCRIPTION,
            make: |rig, settings| Ok(Box::new(L::new(rig, settings)?)),
        }
    }
}

impl<L: ?Sized> Entry<L> {
    /// The law as it is before tick 0, and another instance of it to rehearse on.
    pub fn make(&self, rig: &Rig, settings: &Settings) -> Result<Made<L>, Refused> {
        let signals = self.description.telemetry.len();
        Ok(Made {
            law: (self.make)(rig, settings)?,
            twin: (self.make)(rig, settings)?,
            signals,
        })
    }
}

/// A law, and another instance of it to rehearse on.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct Made<L: ?Sized> {
    pub law: Box<L>,
    pub twin: Box<L>,
    pub signals: usize,
}
