//! How the rig finds a law by name, and holds it whatever its type.

use crate::description::{Description, Refused, Settings};
use crate::law::{InnerLaw, Law, MixerLaw, OuterLaw, Rig};

type Make<L> = fn(&Rig, &Settings) -> Result<Box<L>, Refused>;

/// A law that can be chosen by its name; `L` is `dyn` [`OuterLaw`], [`InnerLaw`] or [`MixerLaw`].
#[derive(Debug)]
pub struct Entry<L: ?Sized> {
    pub description: &'static Description,
    make: Make<L>,
}

impl<L: ?Sized> Entry<L> {
    /// For laws of one type that differ in their descriptions.
    pub const fn new(description: &'static Description, make: Make<L>) -> Self {
        Self { description, make }
    }

    /// The law as it is before tick 0, and its twin for warm-up runs.
    pub fn make(&self, rig: &Rig, settings: &Settings) -> Result<Made<L>, Refused> {
        Ok(Made {
            law: (self.make)(rig, settings)?,
            twin: (self.make)(rig, settings)?,
            signals: self.description.telemetry.len(),
            state_hash: self.description.state_hash(),
        })
    }
}

/// A law, its twin for warm-up runs, and what the rig needs of its description.
pub struct Made<L: ?Sized> {
    pub law: Box<L>,
    pub twin: Box<L>,
    pub signals: usize,
    /// As [`Description::state_hash`]; 0 for a law without a description.
    pub state_hash: u64,
}

macro_rules! of_role {
    ($role:ident, $trait:ident) => {
        impl Entry<dyn $trait> {
            pub const fn $role<L: Law + $trait>() -> Self {
                Self {
                    description: &L::DESCRIPTION,
                    make: |rig, settings| Ok(Box::new(L::new(rig, settings)?)),
                }
            }
        }

        impl Made<dyn $trait> {
            pub fn of(law: impl $trait + Clone + 'static, signals: usize) -> Self {
                Self {
                    twin: Box::new(law.clone()),
                    law: Box::new(law),
                    signals,
                    state_hash: 0,
                }
            }
        }

        impl<L: Law + $trait + Clone + 'static> From<L> for Made<dyn $trait> {
            fn from(law: L) -> Self {
                Self {
                    state_hash: L::DESCRIPTION.state_hash(),
                    ..Self::of(law, L::DESCRIPTION.telemetry.len())
                }
            }
        }
    };
}

of_role!(outer, OuterLaw);
of_role!(inner, InnerLaw);
of_role!(mixer, MixerLaw);
