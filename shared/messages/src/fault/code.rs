//! The kinds of faults: one table of names, scopes and values, and the numbers that stand for a fault in messages.
//!
//! Whoever reads or prints a fault goes by the table and by [`FaultCode`], and needs no list of the kinds of its own.

use crate::fault::{Kind, MessageFault, PORTS, Place, Port, Span, is_share};
use crate::layout::{from_wire, layout};
use crate::role::{Role, STAGES};

/// What goes wrong, as a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum What {
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
from_wire!(What {
    Drop,
    DropEach,
    Delay,
    Lag,
    Freeze,
    Noise,
    Bias,
    Nan,
    Late,
    Stop,
    Kill,
    Hog,
    Load
});

/// What goes wrong in the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    Messages {
        port: Port,
        kind: Kind,
    },
    Late {
        role: Role,
        /// The least [ns].
        least_ns: u64,
        /// The most [ns].
        most_ns: u64,
    },
    /// The process of a stage is stopped, and goes on.
    Stop {
        role: Role,
        /// For how long [ns].
        for_ns: u64,
    },
    /// The process of a stage is killed.
    Kill {
        role: Role,
    },
    /// A process is always busy on the loops' processor, under SCHED_FIFO.
    Hog {
        priority: u64,
    },
    /// A process of ordinary priority is busy on the loops' processor.
    Load {
        /// In this share of its time.
        share: f64,
    },
}

/// The longest time that a stage stops or is late [ns]: the airframe is lost long before.
pub const LONGEST_NS: u64 = 60_000_000_000;

pub const HIGHEST_PRIORITY: u64 = 99;

impl FaultKind {
    /// Whether its numbers are ones that a fault may have, planned or injected.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        match *self {
            Self::Messages { kind, .. } => kind.is_possible(),
            Self::Late {
                least_ns, most_ns, ..
            } => 1 <= least_ns && least_ns <= most_ns && most_ns <= LONGEST_NS,
            Self::Stop { for_ns, .. } => (1..=LONGEST_NS).contains(&for_ns),
            // A flight ends with its plant.
            Self::Kill { role } => role != Role::Plant,
            Self::Hog { priority } => (1..=HIGHEST_PRIORITY).contains(&priority),
            Self::Load { share } => is_share(share),
        }
    }

    /// Whether it happens once, at an instant, and nothing of it can be ended.
    #[must_use]
    pub const fn is_once(&self) -> bool {
        matches!(self, Self::Stop { .. } | Self::Kill { .. })
    }

    /// Whether it is the same thing that goes wrong, whatever the numbers are.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        match (*self, *other) {
            (
                Self::Messages { port, kind },
                Self::Messages {
                    port: other,
                    kind: with,
                },
            ) => MessageFault {
                port,
                kind,
                span: Span { from: 0, to: 1 },
            }
            .is_like(other, with),
            (Self::Late { role, .. }, Self::Late { role: other, .. })
            | (Self::Stop { role, .. }, Self::Stop { role: other, .. })
            | (Self::Kill { role }, Self::Kill { role: other }) => role == other,
            (Self::Hog { .. }, Self::Hog { .. }) | (Self::Load { .. }, Self::Load { .. }) => true,
            _ => false,
        }
    }
}

/// A fault with its ticks, or the end of what it names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveFault {
    pub trouble: FaultKind,
    /// Whether it ends with the first tick of the span; its numbers mean nothing then.
    pub ends: bool,
    pub span: Span,
}

impl LiveFault {
    /// The ticks that it strikes of those that were asked for: what happens once happens in the first one.
    #[must_use]
    pub const fn span_from(&self, asked: Span) -> Span {
        match self.trouble {
            FaultKind::Stop { .. } | FaultKind::Kill { .. } => {
                asked.cut(asked.from.saturating_add(1))
            }
            _ if self.ends => asked.cut(asked.from.saturating_add(1)),
            FaultKind::Late { .. } if asked.to == Span::FOR_GOOD => {
                asked.cut(asked.from.saturating_add(1))
            }
            _ => asked,
        }
    }
}

/// What a fault acts on, and so what its name begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Whole messages of an input: `TOPIC.drop`.
    Message,
    /// A field of the messages, or one number of it: `TOPIC.FIELD.bias`.
    Number,
    /// `ROLE.stop`.
    Stage,
    /// `cpu.hog`.
    Processor,
}

/// How the value of a fault is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueType {
    None,
    /// A number from above 0 to 1.
    Share,
    /// `n/m`.
    Pattern,
    /// Any number.
    Number,
    /// A whole number.
    Integer,
    /// `20ms`.
    Time,
    /// `40us..400us`, or one time.
    TimeRange,
}

/// A kind of fault.
#[derive(Clone, Copy, Debug)]
pub struct FaultSpec {
    pub what: What,
    /// The last part of its name.
    pub name: &'static str,
    pub scope: Scope,
    pub value: ValueType,
    /// Whether it happens at an instant, so that nothing of it can be ended.
    pub is_once: bool,
    /// The values that are allowed, for an error; `WHAT` stands for the full name.
    pub allowed: &'static str,
}

const fn spec(
    what: What,
    name: &'static str,
    scope: Scope,
    value: ValueType,
    allowed: &'static str,
) -> FaultSpec {
    FaultSpec {
        what,
        name,
        scope,
        value,
        is_once: matches!(what, What::Stop | What::Kill),
        allowed,
    }
}

const SHARE_OR_PATTERN: &str =
    "a share above 0 and up to 1, or n/m for the first n of each m, as in WHAT=0.1 or 2/5";
const TICKS: &str = "whole ticks from 1 to 60, as in WHAT=5";

/// Every kind of fault. Two rows of one name are two ways to write its value; the first is tried first.
pub const FAULTS: [FaultSpec; 13] = {
    use Scope::{Message, Number, Processor, Stage};
    use ValueType as V;
    [
        spec(
            What::DropEach,
            "drop",
            Message,
            V::Pattern,
            SHARE_OR_PATTERN,
        ),
        spec(What::Drop, "drop", Message, V::Share, SHARE_OR_PATTERN),
        spec(What::Delay, "delay", Message, V::Integer, TICKS),
        spec(What::Lag, "lag", Message, V::Integer, TICKS),
        spec(What::Freeze, "freeze", Message, V::None, ""),
        spec(
            What::Noise,
            "noise",
            Number,
            V::Number,
            "a standard deviation above 0 in the unit of the field, as in WHAT=0.1",
        ),
        spec(
            What::Bias,
            "bias",
            Number,
            V::Number,
            "a number other than 0 in the unit of the field, as in WHAT=0.1",
        ),
        spec(What::Nan, "nan", Number, V::None, ""),
        spec(
            What::Late,
            "late",
            Stage,
            V::TimeRange,
            "a time above 0 and up to 1m, as in WHAT=20ms, or from the least to the most, WHAT=40us..400us",
        ),
        spec(
            What::Stop,
            "stop",
            Stage,
            V::Time,
            "a time above 0 and up to 1m, as in WHAT=20ms",
        ),
        spec(What::Kill, "kill", Stage, V::None, ""),
        spec(
            What::Hog,
            "hog",
            Processor,
            V::Integer,
            "a SCHED_FIFO priority from 1 to 99, as in WHAT=90",
        ),
        spec(
            What::Load,
            "load",
            Processor,
            V::Share,
            "a share above 0 and up to 1, as in WHAT=0.5",
        ),
    ]
};

impl FaultSpec {
    /// The spec of a kind by its number; none where there is no such kind.
    #[must_use]
    pub fn of(what: u64) -> Option<&'static Self> {
        FAULTS.iter().find(|spec| spec.what as u64 == what)
    }

    /// Those of a name in a scope.
    pub fn named(scope: Scope, name: &str) -> impl Iterator<Item = &'static Self> {
        FAULTS
            .iter()
            .filter(move |spec| spec.scope == scope && spec.name == name)
    }

    /// The names of a scope, each once.
    pub fn names(scope: Scope) -> impl Iterator<Item = &'static str> {
        FAULTS
            .iter()
            .filter(move |spec| spec.scope == scope && spec.value != ValueType::Pattern)
            .map(|spec| spec.name)
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct FaultCode {
    pub what: u64,
    /// Place of the input among [`PORTS`], or of the stage among [`STAGES`].
    pub place: u64,
    /// Place of the field among those that faults can strike.
    pub field: u64,
    /// Place of the number in it, and 1; 0 is all of them.
    pub axis: u64,
    /// The number of the fault, or the bits of it.
    pub first: u64,
    pub second: u64,
    pub ends: u64,
    pub from: u64,
    pub to: u64,
}
layout!(FaultCode {
    what,
    place,
    field,
    axis,
    first,
    second,
    ends,
    from,
    to
});

impl FaultCode {
    #[must_use]
    pub fn of(fault: &LiveFault) -> Self {
        let LiveFault {
            trouble,
            ends,
            span,
        } = *fault;
        let words = Self {
            ends: u64::from(ends),
            from: span.from,
            to: span.to,
            ..Self::default()
        };
        let stage = |what: What, role: Role, first, second| Self {
            what: what as u64,
            place: role as u64,
            first,
            second,
            ..words
        };
        match trouble {
            FaultKind::Messages { port, kind } => {
                let place = PORTS.iter().position(|it| *it == port).unwrap_or_default() as u64;
                let words = match kind.place() {
                    Some(Place { field, axis }) => Self {
                        field: field as u64,
                        axis: axis.map_or(0, |axis| axis as u64 + 1),
                        ..words
                    },
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
                Self {
                    what: what as u64,
                    place,
                    first,
                    second,
                    ..words
                }
            }
            FaultKind::Late {
                role,
                least_ns,
                most_ns,
            } => stage(What::Late, role, least_ns, most_ns),
            FaultKind::Stop { role, for_ns } => stage(What::Stop, role, for_ns, 0),
            FaultKind::Kill { role } => stage(What::Kill, role, 0, 0),
            FaultKind::Hog { priority } => Self {
                what: What::Hog as u64,
                first: priority,
                ..words
            },
            FaultKind::Load { share } => Self {
                what: What::Load as u64,
                first: share.to_bits(),
                ..words
            },
        }
    }

    /// The fault; nothing where the numbers are none that a fault may have.
    #[must_use]
    pub fn fault(&self) -> Option<LiveFault> {
        let Self {
            what,
            place,
            first,
            second,
            ends,
            from,
            to,
            ..
        } = *self;
        let at = usize::try_from(place).ok()?;
        let number = f64::from_bits(first);
        let role = || STAGES.get(at).copied();
        let port = || PORTS.get(at).copied();
        let struck = || self.struck(port()?);
        let messages = |kind| {
            Some(FaultKind::Messages {
                port: port()?,
                kind,
            })
        };
        let trouble = match What::from_wire(what)? {
            What::Drop => messages(Kind::Drop(number))?,
            What::DropEach => messages(Kind::DropEach {
                lost: first,
                of: second,
            })?,
            What::Delay => messages(Kind::Delay(first))?,
            What::Lag => messages(Kind::Lag(first))?,
            What::Freeze => messages(Kind::Freeze)?,
            What::Noise => messages(Kind::Noise(struck()?, number))?,
            What::Bias => messages(Kind::Bias(struck()?, number))?,
            What::Nan => messages(Kind::Nan(struck()?))?,
            What::Late => FaultKind::Late {
                role: role()?,
                least_ns: first,
                most_ns: second,
            },
            What::Stop => FaultKind::Stop {
                role: role()?,
                for_ns: first,
            },
            What::Kill => FaultKind::Kill { role: role()? },
            What::Hog => FaultKind::Hog { priority: first },
            What::Load => FaultKind::Load { share: number },
        };
        let is_fault = trouble.is_possible() && ends <= 1 && !(ends == 1 && trouble.is_once());
        is_fault.then_some(LiveFault {
            trouble,
            ends: ends == 1,
            span: Span { from, to },
        })
    }

    /// The number of a port's content that is meant.
    fn struck(&self, port: Port) -> Option<Place> {
        let field = usize::try_from(self.field).ok()?;
        let axes = port.fields().get(field)?.axes.len();
        let axis = usize::try_from(self.axis)
            .ok()
            .filter(|axis| *axis <= axes)?
            .checked_sub(1);
        Some(Place { field, axis })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::LONGEST_PATTERN;

    const SPAN: Span = Span { from: 10, to: 20 };

    #[test]
    fn the_table_has_each_kind_once_and_knows_the_bounds() {
        for what in 1..=FAULTS.len() as u64 {
            let rows = FAULTS.iter().filter(|spec| spec.what as u64 == what);
            assert_eq!(rows.count(), 1, "{what}");
        }
        assert!(
            TICKS.contains(&format!("1 to {} as", crate::fault::LONGEST_DELAY).replace(" as", ","))
        );
        for fault in every_trouble() {
            let spec = FaultSpec::of(words(fault).what).unwrap();
            assert_eq!(spec.is_once, fault.is_once(), "{fault:?}");
        }
    }

    fn words(trouble: FaultKind) -> FaultCode {
        FaultCode::of(&LiveFault {
            trouble,
            ends: false,
            span: SPAN,
        })
    }

    fn every_trouble() -> Vec<FaultKind> {
        let (one, all) = (
            Place {
                field: 2,
                axis: Some(1),
            },
            Place {
                field: 0,
                axis: None,
            },
        );
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
        let messages = PORTS
            .into_iter()
            .flat_map(|port| kinds.map(|kind| FaultKind::Messages { port, kind }));
        let has_field = |trouble: &FaultKind| match trouble {
            FaultKind::Messages { port, kind } => kind
                .place()
                .is_none_or(|place| place.field < port.fields().len()),
            _ => true,
        };
        let stages = STAGES.into_iter().flat_map(|role| {
            [
                FaultKind::Late {
                    role,
                    least_ns: 1,
                    most_ns: 9,
                },
                FaultKind::Stop { role, for_ns: 5 },
                FaultKind::Kill { role },
            ]
        });
        let processor = [
            FaultKind::Hog { priority: 90 },
            FaultKind::Load { share: 0.5 },
        ];
        let is_possible = |trouble: &FaultKind| *trouble != FaultKind::Kill { role: Role::Plant };
        messages
            .filter(has_field)
            .chain(stages.filter(is_possible))
            .chain(processor)
            .collect()
    }

    #[test]
    fn every_fault_comes_back_from_its_numbers() {
        for trouble in every_trouble() {
            for ends in [false, true]
                .into_iter()
                .filter(|ends| !(*ends && trouble.is_once()))
            {
                let fault = LiveFault {
                    trouble,
                    ends,
                    span: SPAN,
                };
                assert_eq!(FaultCode::of(&fault).fault(), Some(fault));
            }
        }
    }

    #[test]
    fn numbers_that_are_no_fault_are_none() {
        let [late, stop] = [(9, 40, 400), (10, 5, 0)].map(|(what, first, second)| FaultCode {
            what,
            place: 2,
            first,
            second,
            ..FaultCode::default()
        });
        assert!(late.fault().is_some() && stop.fault().is_some());
        let drop = words(FaultKind::Messages {
            port: Port::OuterState,
            kind: Kind::Drop(0.1),
        });
        let noise = words(FaultKind::Messages {
            port: Port::MixerWrench,
            kind: Kind::Noise(
                Place {
                    field: 1,
                    axis: Some(2),
                },
                1.0,
            ),
        });
        for broken in [
            FaultCode { what: 0, ..drop },
            FaultCode { what: 14, ..drop },
            FaultCode { place: 5, ..drop },
            FaultCode {
                first: 1.5_f64.to_bits(),
                ..drop
            },
            FaultCode {
                first: f64::NAN.to_bits(),
                ..drop
            },
            FaultCode {
                what: 2,
                first: 3,
                second: 2,
                ..drop
            },
            FaultCode {
                what: 3,
                first: 61,
                ..drop
            },
            FaultCode {
                what: 4,
                first: 0,
                ..drop
            },
            FaultCode { field: 2, ..noise },
            FaultCode { axis: 4, ..noise },
            FaultCode {
                first: f64::INFINITY.to_bits(),
                ..noise
            },
            FaultCode {
                what: 9,
                place: 4,
                ..drop
            },
            FaultCode {
                what: 2,
                first: 1,
                second: LONGEST_PATTERN + 1,
                ..drop
            },
            FaultCode {
                first: (-1.0_f64).to_bits(),
                ..noise
            },
            FaultCode {
                what: 7,
                first: 0.0_f64.to_bits(),
                ..noise
            },
            FaultCode { ends: 2, ..drop },
            FaultCode { first: 401, ..late },
            FaultCode { first: 0, ..late },
            FaultCode {
                second: 1 << 62,
                ..late
            },
            FaultCode {
                first: 1 << 62,
                ..stop
            },
            FaultCode { ends: 1, ..stop },
            FaultCode {
                what: 11,
                ends: 1,
                ..stop
            },
            FaultCode {
                what: 11,
                place: Role::Plant as u64,
                ..stop
            },
            FaultCode {
                what: 12,
                first: 100,
                ..stop
            },
            FaultCode {
                what: 12,
                first: 0,
                ..stop
            },
            FaultCode {
                what: 13,
                first: 1.5_f64.to_bits(),
                ..stop
            },
        ] {
            assert_eq!(broken.fault(), None, "{broken:?}");
        }
    }
}
