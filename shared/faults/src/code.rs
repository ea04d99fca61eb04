//! The kinds of faults: one table of names, scopes and values, and the numbers that stand for a fault in messages.
//!
//! Code that reads or prints a fault uses the table and [`FaultCode`], not a second list of the kinds.

use crate::kind::{Kind, PORTS, Place, Port, Span, is_share};
use messages::fault_id::FaultId;
use messages::layout::layout;
use messages::role::{Channel, Replica, Role, STAGES};

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    Messages {
        port: Port,
        kind: Kind,
    },
    Late {
        role: Role,
        /// The channel of the stage; all if none is named. Likewise below.
        channel: Option<Channel>,
        /// The least and the most [ns]; each time between is as likely.
        range_ns: [u64; 2],
    },
    /// The process of a stage is stopped, and goes on.
    Stop {
        role: Role,
        channel: Option<Channel>,
        for_ns: u64,
    },
    /// The process of a stage is killed.
    Kill {
        role: Role,
        channel: Option<Channel>,
    },
    /// A process is always busy on the loops' processor, under SCHED_FIFO.
    Hog {
        priority: u64,
    },
    /// A process of ordinary priority is busy on the loops' processor.
    Load {
        share: f64,
    },
    /// The laws of a channel fly from then on. No fault, but it has a tick, an answer and a record as faults do.
    Switch {
        channel: Channel,
    },
}

/// The longest time that a stage stops or is late [ns]: the airframe is lost long before.
pub const LONGEST_NS: u64 = 60_000_000_000;

pub const HIGHEST_PRIORITY: u64 = 99;

impl FaultKind {
    /// Whether its numbers are ones that a fault may have, planned or injected.
    pub fn is_valid(&self) -> bool {
        match *self {
            Self::Messages { kind, .. } => kind.is_valid(),
            Self::Late { range_ns, .. } => {
                let [least, most] = range_ns;
                1 <= least && least <= most && most <= LONGEST_NS
            }
            Self::Stop { for_ns, .. } => (1..=LONGEST_NS).contains(&for_ns),
            // A flight ends with its plant.
            Self::Kill { role, .. } => role != Role::Plant,
            Self::Hog { priority } => (1..=HIGHEST_PRIORITY).contains(&priority),
            Self::Load { share } => is_share(share),
            Self::Switch { .. } => true,
        }
    }

    pub(crate) const fn id(&self) -> FaultId {
        match self {
            Self::Messages { kind, .. } => kind.id(),
            Self::Late { .. } => FaultId::Late,
            Self::Stop { .. } => FaultId::Stop,
            Self::Kill { .. } => FaultId::Kill,
            Self::Hog { .. } => FaultId::Hog,
            Self::Load { .. } => FaultId::Load,
            Self::Switch { .. } => FaultId::Switch,
        }
    }

    /// Whether it happens once, at an instant, and nothing of it can be ended.
    pub const fn is_once(&self) -> bool {
        is_once(self.id())
    }

    /// The stage that it acts on, where it acts on the process of one.
    pub const fn role(&self) -> Option<Role> {
        match *self {
            Self::Late { role, .. } | Self::Stop { role, .. } | Self::Kill { role, .. } => {
                Some(role)
            }
            Self::Messages { .. } | Self::Hog { .. } | Self::Load { .. } | Self::Switch { .. } => {
                None
            }
        }
    }

    /// The channel of the stage, if it is in one alone.
    pub const fn channel(&self) -> Option<Channel> {
        match *self {
            Self::Late { channel, .. }
            | Self::Stop { channel, .. }
            | Self::Kill { channel, .. } => channel,
            Self::Switch { channel } => Some(channel),
            Self::Messages { .. } | Self::Hog { .. } | Self::Load { .. } => None,
        }
    }

    /// Whether it acts on the process of this stage.
    pub fn is_of(&self, replica: Replica) -> bool {
        self.role() == Some(replica.role) && self.channel().is_none_or(|it| it == replica.channel)
    }

    /// Whether both act on the process of one stage.
    pub fn overlaps(&self, other: &Self) -> bool {
        let channels = self.channel().zip(other.channel());
        self.role() == other.role() && channels.is_none_or(|(one, other)| one == other)
    }

    /// Whether it is the same thing that goes wrong, whatever the numbers are.
    pub fn is_like(&self, other: &Self) -> bool {
        match (*self, *other) {
            (
                Self::Messages { port, kind },
                Self::Messages {
                    port: at,
                    kind: with,
                },
            ) => port == at && kind.is_like(with),
            _ => {
                let target = |kind: &Self| (kind.id() as u64, kind.role(), kind.channel());
                target(self) == target(other)
            }
        }
    }
}

/// A fault with its ticks, or the end of what it names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveFault {
    pub kind: FaultKind,
    /// Whether it ends with the first tick of the span; its numbers mean nothing then.
    pub ends: bool,
    pub span: Span,
}

impl LiveFault {
    /// The ticks in which it acts, of those requested: what happens once happens in the first one.
    pub fn span_from(&self, requested: Span) -> Span {
        let is_endless_late =
            matches!(self.kind, FaultKind::Late { .. }) && requested.to == Span::FOR_GOOD;
        if self.kind.is_once() || self.ends || is_endless_late {
            requested.once()
        } else {
            requested
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
    /// `b.switch`.
    Channel,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueType {
    None,
    /// A number from above 0 to 1.
    Share,
    /// `n/m`.
    Pattern,
    Number,
    Integer,
    /// `20ms`.
    Time,
    /// `40us..400us`, or one time.
    TimeRange,
}

#[derive(Clone, Copy, Debug)]
pub struct FaultSpec {
    pub what: FaultId,
    pub name: &'static str,
    pub scope: Scope,
    pub value: ValueType,
}

/// Every kind of fault. Two rows of one name are two ways to write its value; the first is tried first.
pub const FAULTS: [FaultSpec; 14] = {
    use FaultId::*;
    use Scope::{Message, Number, Processor, Stage};
    use ValueType as V;
    [
        spec(DropEach, "drop", Message, V::Pattern),
        spec(Drop, "drop", Message, V::Share),
        spec(Delay, "delay", Message, V::Integer),
        spec(Lag, "lag", Message, V::Integer),
        spec(Freeze, "freeze", Message, V::None),
        spec(Noise, "noise", Number, V::Number),
        spec(Bias, "bias", Number, V::Number),
        spec(Nan, "nan", Number, V::None),
        spec(Late, "late", Stage, V::TimeRange),
        spec(Stop, "stop", Stage, V::Time),
        spec(Kill, "kill", Stage, V::None),
        spec(Hog, "hog", Processor, V::Integer),
        spec(Load, "load", Processor, V::Share),
        spec(Switch, "switch", Scope::Channel, V::None),
    ]
};

const fn spec(what: FaultId, name: &'static str, scope: Scope, value: ValueType) -> FaultSpec {
    FaultSpec {
        what,
        name,
        scope,
        value,
    }
}

const fn is_once(id: FaultId) -> bool {
    matches!(id, FaultId::Stop | FaultId::Kill | FaultId::Switch)
}

impl FaultSpec {
    /// Whether it happens at an instant, so that nothing of it can be ended.
    pub const fn is_once(&self) -> bool {
        is_once(self.what)
    }

    /// The values that are allowed, for an error; `WHAT` stands for the full name.
    pub const fn allowed(&self) -> &'static str {
        match self.what {
            FaultId::Drop | FaultId::DropEach => {
                "a share above 0 and up to 1, or n/m for the first n of each m, as in WHAT=0.1 or 2/5"
            }
            FaultId::Delay | FaultId::Lag => "whole ticks from 1 to 60, as in WHAT=5",
            FaultId::Noise => {
                "a standard deviation above 0 in the unit of the field, as in WHAT=0.1"
            }
            FaultId::Bias => "a number other than 0 in the unit of the field, as in WHAT=0.1",
            FaultId::Late => {
                "a time above 0 and up to 1m, as in WHAT=20ms, or from the least to the most, WHAT=40us..400us"
            }
            FaultId::Stop => "a time above 0 and up to 1m, as in WHAT=20ms",
            FaultId::Hog => "a SCHED_FIFO priority from 1 to 99, as in WHAT=90",
            FaultId::Load => "a share above 0 and up to 1, as in WHAT=0.5",
            FaultId::Freeze | FaultId::Nan | FaultId::Kill | FaultId::Switch => "",
        }
    }

    /// The spec of a kind by its number; none where there is no such kind.
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

impl Kind {
    pub fn name(self) -> &'static str {
        FaultSpec::of(self.id() as u64).map_or("", |spec| spec.name)
    }

    /// Whether it does what another kind does, to the whole message or to a number that both mean.
    pub fn is_like(self, other: Self) -> bool {
        let same_place = match (self.place(), other.place()) {
            (Some(a), Some(b)) => a.overlaps(b),
            (a, b) => a.is_none() && b.is_none(),
        };
        self.name() == other.name() && same_place
    }
}

layout! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct FaultCode {
        pub what: u64,
        /// Place of the input among [`PORTS`], or of the stage among [`STAGES`].
        pub place: u64,
        /// Place of the field among those that faults can change.
        pub field: u64,
        /// Place of the number in it, or of the stage's channel, and 1; 0 is all of them.
        pub axis: u64,
        /// The number of the fault, or the bits of it.
        pub first: u64,
        pub second: u64,
        pub ends: u64,
        pub from: u64,
        pub to: u64,
    }
}

impl FaultCode {
    pub fn of(fault: &LiveFault) -> Self {
        let kind = fault.kind;
        let (place, target, [first, second]) = match kind {
            FaultKind::Messages { port, kind } => (port as u64, kind.place(), kind.numbers()),
            FaultKind::Late { role, range_ns, .. } => (role as u64, None, range_ns),
            FaultKind::Stop { role, for_ns, .. } => (role as u64, None, [for_ns, 0]),
            FaultKind::Kill { role, .. } => (role as u64, None, [0, 0]),
            FaultKind::Hog { priority } => (0, None, [priority, 0]),
            FaultKind::Load { share } => (0, None, [share.to_bits(), 0]),
            FaultKind::Switch { .. } => (0, None, [0, 0]),
        };
        let channel = kind.channel().map(|channel| channel as usize);
        let axis = target.and_then(|place| place.axis).or(channel);
        Self {
            what: kind.id() as u64,
            place,
            field: target.map_or(0, |place| place.field as u64),
            axis: axis.map_or(0, |axis| axis as u64 + 1),
            first,
            second,
            ends: u64::from(fault.ends),
            from: fault.span.from,
            to: fault.span.to,
        }
    }

    /// The fault; nothing where the numbers are none that a fault may have.
    pub fn fault(&self) -> Option<LiveFault> {
        let (first, second, ends) = (self.first, self.second, self.ends);
        let at = usize::try_from(self.place).ok()?;
        let number = f64::from_bits(first);
        let role = || STAGES.get(at).copied();
        let port = || PORTS.get(at).copied();
        let place = || self.target(port()?);
        let of = |kind| port().map(|port| FaultKind::Messages { port, kind });
        let lost = first;
        let channel = match self.axis.checked_sub(1) {
            _ if self.what <= FaultId::Nan as u64 => None,
            None => None,
            Some(place) => Some(*Channel::ALL.get(usize::try_from(place).ok()?)?),
        };
        let of_plant = self.place == Role::Plant as u64 && channel.is_some();
        let kind = match FaultId::from_wire(self.what)? {
            FaultId::Drop => of(Kind::Drop(number))?,
            FaultId::DropEach => of(Kind::DropEach { lost, of: second })?,
            FaultId::Delay => of(Kind::Delay(first))?,
            FaultId::Lag => of(Kind::Lag(first))?,
            FaultId::Freeze => of(Kind::Freeze)?,
            FaultId::Noise => of(Kind::Noise(place()?, number))?,
            FaultId::Bias => of(Kind::Bias(place()?, number))?,
            FaultId::Nan => of(Kind::Nan(place()?))?,
            FaultId::Late => FaultKind::Late {
                role: role()?,
                channel,
                range_ns: [first, second],
            },
            FaultId::Stop => FaultKind::Stop {
                role: role()?,
                channel,
                for_ns: first,
            },
            FaultId::Kill => FaultKind::Kill {
                role: role()?,
                channel,
            },
            FaultId::Hog => FaultKind::Hog { priority: first },
            FaultId::Load => FaultKind::Load { share: number },
            FaultId::Switch => FaultKind::Switch { channel: channel? },
        };
        let of_plant = of_plant && kind.role().is_some();
        let is_fault = kind.is_valid() && !of_plant && ends <= 1 && !(ends == 1 && kind.is_once());
        is_fault.then_some(LiveFault {
            kind,
            ends: ends == 1,
            span: Span::new(self.from, self.to),
        })
    }

    /// The number of a port's content that is meant.
    fn target(&self, port: Port) -> Option<Place> {
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
    use crate::kind::{LONGEST_DELAY_TICKS, LONGEST_PATTERN};

    #[test]
    fn the_table_has_each_kind_once() {
        for what in 1..=FAULTS.len() as u64 {
            let rows = FAULTS.iter().filter(|spec| spec.what as u64 == what);
            assert_eq!(rows.count(), 1, "{what}");
        }
        let delay = FaultSpec::of(FaultId::Delay as u64).unwrap();
        assert!(
            delay
                .allowed()
                .contains(&format!("1 to {LONGEST_DELAY_TICKS},"))
        );
    }

    #[test]
    fn numbers_that_are_no_fault_are_none() {
        let share = |share: f64| share.to_bits();
        let (third, long) = (3, 1 << 62);
        // What, place, field, axis, first, second, ends.
        let code = |[what, place, field, axis, first, second, ends]: [u64; 7]| FaultCode {
            what,
            place,
            field,
            axis,
            first,
            second,
            ends,
            ..FaultCode::default()
        };
        for sound in [
            [1, 0, 0, 0, share(0.1), 0, 0],
            [6, third, 1, 3, share(1.0), 0, 0],
            [9, 2, 0, 0, 40, 400, 0],
            [10, 2, 0, 0, 5, 0, 0],
        ] {
            assert!(code(sound).fault().is_some(), "{sound:?}");
        }
        for broken in [
            [0, 0, 0, 0, share(0.1), 0, 0],
            [14, 0, 0, 0, 0, 0, 0],
            [15, 0, 0, 0, share(0.1), 0, 0],
            [1, 5, 0, 0, share(0.1), 0, 0],
            [1, 0, 0, 0, share(1.5), 0, 0],
            [1, 0, 0, 0, share(f64::NAN), 0, 0],
            [1, 0, 0, 0, share(0.1), 0, 2],
            [2, 0, 0, 0, 3, 2, 0],
            [2, 0, 0, 0, 1, LONGEST_PATTERN + 1, 0],
            [3, 0, 0, 0, 61, 0, 0],
            [4, 0, 0, 0, 0, 0, 0],
            [6, third, 2, 3, share(1.0), 0, 0],
            [6, third, 1, 4, share(1.0), 0, 0],
            [6, third, 1, 3, share(f64::INFINITY), 0, 0],
            [6, third, 1, 3, share(-1.0), 0, 0],
            [7, third, 1, 3, share(0.0), 0, 0],
            [9, 4, 0, 0, 40, 400, 0],
            [9, 2, 0, 0, 401, 400, 0],
            [9, 2, 0, 0, 0, 400, 0],
            [9, 2, 0, 0, 40, long, 0],
            [10, 2, 0, 0, long, 0, 0],
            [10, 2, 0, 0, 5, 0, 1],
            [11, 2, 0, 0, 5, 0, 1],
            [11, Role::Plant as u64, 0, 0, 5, 0, 0],
            [12, 2, 0, 0, 100, 0, 0],
            [12, 2, 0, 0, 0, 0, 0],
            [13, 2, 0, 0, share(1.5), 0, 0],
        ] {
            assert_eq!(code(broken).fault(), None, "{broken:?}");
        }
    }
}
