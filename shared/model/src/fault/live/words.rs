//! Faults as numbers of the wire, and back: what is no fault comes back as none.

use super::{LiveFault, Trouble};
use crate::fault::{Kind, PORTS, Place, Port, Span};
use crate::layout::{from_wire, layout};
use crate::role::{Role, STAGES};

/// What goes wrong, as a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
enum What {
    Drop = 1,
    DropEach = 2,
    Delay = 3,
    Lag = 4,
    Freeze = 5,
    Noise = 6,
    Bias = 7,
    Nan = 8,
    Late = 9,
    Stop = 10,
    Kill = 11,
    Hog = 12,
    Load = 13,
}
from_wire!(What { Drop, DropEach, Delay, Lag, Freeze, Noise, Bias, Nan, Late, Stop, Kill, Hog, Load });

/// Hash over the words of faults and their numbers.
pub const WORDS: u64 = What::WORDS;

/// The same as numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct FaultWords {
    /// What goes wrong.
    pub what: u64,
    /// Place of the input among [`PORTS`], or of the stage among [`STAGES`].
    pub place: u64,
    /// Place of the field among those that faults can strike.
    pub field: u64,
    /// Place of the number in it, and 1; 0 is all of them.
    pub axis: u64,
    /// The number of the fault, or the bits of it.
    pub first: u64,
    /// A second one.
    pub second: u64,
    /// Whether it ends.
    pub ends: u64,
    /// First tick.
    pub from: u64,
    /// First tick after it.
    pub to: u64,
}
layout!(FaultWords { what, place, field, axis, first, second, ends, from, to });

impl FaultWords {
    /// A fault in numbers.
    #[must_use]
    pub fn of(fault: &LiveFault) -> Self {
        let LiveFault { trouble, ends, span } = *fault;
        let words = Self { ends: u64::from(ends), from: span.from, to: span.to, ..Self::default() };
        let stage = |what: What, role: Role, first, second| Self {
            what: what as u64,
            place: role as u64,
            first,
            second,
            ..words
        };
        match trouble {
            Trouble::Messages { port, kind } => {
                let place = PORTS.iter().position(|it| *it == port).unwrap_or_default() as u64;
                let words = match kind.place() {
                    Some(Place { field, axis }) => {
                        Self { field: field as u64, axis: axis.map_or(0, |axis| axis as u64 + 1), ..words }
                    }
                    None => words,
                };
                let (what, first, second) = match kind {
                    Kind::Drop(share) => (What::Drop, share.to_bits(), 0),
                    Kind::DropEach { lost, of } => (What::DropEach, lost, of),
                    Kind::Delay(ticks) => (What::Delay, ticks, 0),
                    Kind::Lag(ticks) => (What::Lag, ticks, 0),
                    Kind::Freeze => (What::Freeze, 0, 0),
                    Kind::Noise(_, number) => (What::Noise, number.to_bits(), 0),
                    Kind::Bias(_, number) => (What::Bias, number.to_bits(), 0),
                    Kind::Nan(_) => (What::Nan, 0, 0),
                };
                Self { what: what as u64, place, first, second, ..words }
            }
            Trouble::Late { role, least_ns, most_ns } => stage(What::Late, role, least_ns, most_ns),
            Trouble::Stop { role, for_ns } => stage(What::Stop, role, for_ns, 0),
            Trouble::Kill { role } => stage(What::Kill, role, 0, 0),
            Trouble::Hog { priority } => Self { what: What::Hog as u64, first: priority, ..words },
            Trouble::Load { share } => Self { what: What::Load as u64, first: share.to_bits(), ..words },
        }
    }

    /// The fault; nothing where the numbers are none that a fault may have.
    #[must_use]
    pub fn fault(&self) -> Option<LiveFault> {
        let Self { what, place, first, second, ends, from, to, .. } = *self;
        let at = usize::try_from(place).ok()?;
        let number = f64::from_bits(first);
        let role = || STAGES.get(at).copied();
        let port = || PORTS.get(at).copied();
        let struck = || self.struck(port()?);
        let messages = |kind| Some(Trouble::Messages { port: port()?, kind });
        let trouble = match What::from_wire(what)? {
            What::Drop => messages(Kind::Drop(number))?,
            What::DropEach => messages(Kind::DropEach { lost: first, of: second })?,
            What::Delay => messages(Kind::Delay(first))?,
            What::Lag => messages(Kind::Lag(first))?,
            What::Freeze => messages(Kind::Freeze)?,
            What::Noise => messages(Kind::Noise(struck()?, number))?,
            What::Bias => messages(Kind::Bias(struck()?, number))?,
            What::Nan => messages(Kind::Nan(struck()?))?,
            What::Late => Trouble::Late { role: role()?, least_ns: first, most_ns: second },
            What::Stop => Trouble::Stop { role: role()?, for_ns: first },
            What::Kill => Trouble::Kill { role: role()? },
            What::Hog => Trouble::Hog { priority: first },
            What::Load => Trouble::Load { share: number },
        };
        let is_fault = trouble.is_possible() && ends <= 1 && !(ends == 1 && trouble.is_once());
        is_fault.then_some(LiveFault { trouble, ends: ends == 1, span: Span { from, to } })
    }

    /// The number of a port's content that is meant.
    fn struck(&self, port: Port) -> Option<Place> {
        let field = usize::try_from(self.field).ok()?;
        let axes = port.fields().get(field)?.axes.len();
        let axis = usize::try_from(self.axis).ok().filter(|axis| *axis <= axes)?.checked_sub(1);
        Some(Place { field, axis })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::LONGEST_PATTERN;

    const SPAN: Span = Span { from: 10, to: 20 };

    fn words(trouble: Trouble) -> FaultWords {
        FaultWords::of(&LiveFault { trouble, ends: false, span: SPAN })
    }

    fn every_trouble() -> Vec<Trouble> {
        let (one, all) = (Place { field: 2, axis: Some(1) }, Place { field: 0, axis: None });
        let kinds = [
            Kind::Drop(0.1),
            Kind::DropEach { lost: 2, of: 5 },
            Kind::Delay(60),
            Kind::Lag(1),
            Kind::Freeze,
            Kind::Noise(one, 0.25),
            Kind::Bias(all, -3.0),
            Kind::Nan(one),
        ];
        let messages = PORTS.into_iter().flat_map(|port| kinds.map(|kind| Trouble::Messages { port, kind }));
        let has_field = |trouble: &Trouble| match trouble {
            Trouble::Messages { port, kind } => kind.place().is_none_or(|place| place.field < port.fields().len()),
            _ => true,
        };
        let stages = STAGES.into_iter().flat_map(|role| {
            [Trouble::Late { role, least_ns: 1, most_ns: 9 }, Trouble::Stop { role, for_ns: 5 }, Trouble::Kill { role }]
        });
        let processor = [Trouble::Hog { priority: 90 }, Trouble::Load { share: 0.5 }];
        let is_possible = |trouble: &Trouble| *trouble != Trouble::Kill { role: Role::Plant };
        messages.filter(has_field).chain(stages.filter(is_possible)).chain(processor).collect()
    }

    #[test]
    fn every_fault_comes_back_from_its_numbers() {
        for trouble in every_trouble() {
            for ends in [false, true].into_iter().filter(|ends| !(*ends && trouble.is_once())) {
                let fault = LiveFault { trouble, ends, span: SPAN };
                assert_eq!(FaultWords::of(&fault).fault(), Some(fault));
            }
        }
    }

    #[test]
    fn numbers_that_are_no_fault_are_none() {
        let [late, stop] = [(9, 40, 400), (10, 5, 0)].map(|(what, first, second)| FaultWords {
            what,
            place: 2,
            first,
            second,
            ..FaultWords::default()
        });
        assert!(late.fault().is_some() && stop.fault().is_some());
        let drop = words(Trouble::Messages { port: Port::OuterState, kind: Kind::Drop(0.1) });
        let noise = words(Trouble::Messages {
            port: Port::MixerWrench,
            kind: Kind::Noise(Place { field: 1, axis: Some(2) }, 1.0),
        });
        for broken in [
            FaultWords { what: 0, ..drop },
            FaultWords { what: 14, ..drop },
            FaultWords { place: 5, ..drop },
            FaultWords { first: 1.5_f64.to_bits(), ..drop },
            FaultWords { first: f64::NAN.to_bits(), ..drop },
            FaultWords { what: 2, first: 3, second: 2, ..drop },
            FaultWords { what: 3, first: 61, ..drop },
            FaultWords { what: 4, first: 0, ..drop },
            FaultWords { field: 2, ..noise },
            FaultWords { axis: 4, ..noise },
            FaultWords { first: f64::INFINITY.to_bits(), ..noise },
            FaultWords { what: 9, place: 4, ..drop },
            FaultWords { what: 2, first: 1, second: LONGEST_PATTERN + 1, ..drop },
            FaultWords { first: (-1.0_f64).to_bits(), ..noise },
            FaultWords { what: 7, first: 0.0_f64.to_bits(), ..noise },
            FaultWords { ends: 2, ..drop },
            FaultWords { first: 401, ..late },
            FaultWords { first: 0, ..late },
            FaultWords { second: 1 << 62, ..late },
            FaultWords { first: 1 << 62, ..stop },
            FaultWords { ends: 1, ..stop },
            FaultWords { what: 11, ends: 1, ..stop },
            FaultWords { what: 11, place: Role::Plant as u64, ..stop },
            FaultWords { what: 12, first: 100, ..stop },
            FaultWords { what: 12, first: 0, ..stop },
            FaultWords { what: 13, first: 1.5_f64.to_bits(), ..stop },
        ] {
            assert_eq!(broken.fault(), None, "{broken:?}");
        }
    }
}
