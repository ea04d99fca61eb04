//! Every kind of fault, declared once in [`FAULTS`]: number, name, what it acts on, value, how long, meaning.
//!
//! The text that users write, its checks, the errors, the list of `ironbird faults` and the messages follow from the table.

use crate::layout::wire_enum;
use crate::role::Role;

/// Ticks by which a message is delayed, or its content lags, at most: the plant keeps at most 64 commands.
pub const LONGEST_DELAY_TICKS: u64 = 60;

/// Messages of the longest pattern of losses.
const LONGEST_PATTERN: u64 = 1_000_000;

/// The longest time that a stage stops or is late [ns]: the airframe is lost long before.
const LONGEST_NS: u64 = 60_000_000_000;

/// How long a stage that was killed takes until it works again [ns]: a launcher that lets nothing start anew within
/// 50 ms, and a process that is ready well within as much again.
const RESTART_NS: u64 = 100_000_000;

/// Declares kinds of faults by what they act on. A row: variant, number in messages and logs, name, value, how long it
/// lasts, meaning.
macro_rules! fault_kinds {
    ($($(#[$doc:meta])* $scope:ident($kind:ident) = $prefix:literal {
        $($variant:ident = $number:literal: $name:literal, $value:expr, $lasts:ident, $meaning:literal;)+
    })+) => {
        wire_enum! {
            pub enum FaultId { $($($variant = $number),+),+ }
        }

        /// Target of a fault, with which its name begins.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Scope { $($(#[$doc])* $scope),+ }

        impl Scope {
            /// The part of the name before that of the kind, in general.
            pub const fn prefix(self) -> &'static str {
                match self { $(Self::$scope => $prefix),+ }
            }
        }

        $(
            $(#[$doc])*
            #[derive(Clone, Copy, Debug, PartialEq, Eq)]
            pub enum $kind { $(#[doc = $meaning] $variant),+ }
        )+

        /// A kind of fault, by what it acts on.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Kind { $($scope($kind)),+ }

        impl Kind {
            pub const fn scope(self) -> Scope {
                match self { $(Self::$scope(_) => Scope::$scope),+ }
            }

            pub const fn spec(self) -> &'static FaultSpec {
                match self {
                    $($(Self::$scope($kind::$variant) => &FaultSpec {
                        id: FaultId::$variant,
                        kind: Self::$scope($kind::$variant),
                        name: $name,
                        value: $value,
                        lasts: Lasts::$lasts,
                        meaning: $meaning,
                    }),+),+
                }
            }
        }

        /// Every kind of fault. Two rows of one name are two ways to write its value; the first is tried first.
        pub const FAULTS: [FaultSpec; FaultId::ALL.len()] =
            [$($(*Kind::$scope($kind::$variant).spec()),+),+];
    };
}

use ValueType as V;

// Never reuse a number: logs contain it.
fault_kinds! {
    /// Whole messages of an input: `TOPIC.drop`.
    Message(MessageKind) = "TOPIC" {
        Drop = 1: "drop", V::Share, ForGood, "loses a random share of the messages";
        DropEach = 2: "drop", V::Pattern, ForGood, "loses the first n of each m messages";
        Delay = 3: "delay", TICKS, ForGood, "messages arrive this many ticks late, and stale";
        Lag = 4: "lag", TICKS, ForGood, "messages arrive on time with the content of this many ticks earlier";
        Freeze = 5: "freeze", V::None, ForGood, "messages arrive on time with the last content before the fault";
    }
    /// A field of the messages, or one number of it: `TOPIC.FIELD.bias`.
    Number(NumberKind) = "TOPIC.FIELD" {
        Noise = 6: "noise", V::Positive("standard deviation"), ForGood,
            "adds normal noise with this standard deviation, in the field's unit";
        Bias = 7: "bias", V::NotZero, ForGood, "adds a constant, in the field's unit";
        Nan = 8: "nan", V::None, ForGood, "not a number: inspection rejects the message";
    }
    /// The process of a stage: `ROLE.stop`.
    Stage(StageKind) = "ROLE" {
        Late = 9: "late", V::TimeRange, OneTick, "the stage computes longer by this time";
        Stop = 10: "stop", V::Time, Instant, "the stage pauses for this time";
        Kill = 11: "kill", V::None, Instant, "the process is killed; in a simulation it restarts 100ms later";
    }
    /// The loops' processor: `cpu.hog`.
    Processor(ProcessorKind) = "cpu" {
        Hog = 12: "hog", V::Integer { unit: "a SCHED_FIFO priority", most: 99, example: 90 }, ForGood,
            "a process of this SCHED_FIFO priority is always busy on the loops' processor";
        Load = 13: "load", V::Share, ForGood, "an ordinary process is busy there for this share of the time";
    }
    /// A channel: `b.switch`.
    Channel(ChannelKind) = "CHANNEL" {
        Switch = 14: "switch", V::None, Instant,
            "not a fault: with redundant channels, that one flies from then on";
    }
}

const TICKS: ValueType = V::Integer {
    unit: "whole ticks",
    most: LONGEST_DELAY_TICKS,
    example: 5,
};

/// The ticks of a stage that has a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageTicks {
    /// The stage misses those of this time [ns].
    Out(u64),
    /// The stage misses those of this time [ns], and then starts again.
    Anew(u64),
    /// Each takes longer, by the least to the most [ns]; each time between is as likely.
    Late([u64; 2]),
}

impl StageKind {
    pub const fn ticks(self, value: FaultValue) -> StageTicks {
        match self {
            Self::Late => StageTicks::Late(value.0),
            Self::Stop => StageTicks::Out(value.integer()),
            Self::Kill => StageTicks::Anew(RESTART_NS),
        }
    }

    /// Whether a stage can have it: a flight ends with its plant.
    pub fn acts_on(self, role: Role) -> bool {
        match self {
            Self::Late | Self::Stop => true,
            Self::Kill => role != Role::Plant,
        }
    }
}

impl ProcessorKind {
    /// Priority of the process under SCHED_FIFO, 0 for an ordinary one, and the share of the time that it is busy.
    pub const fn load(self, value: FaultValue) -> (u64, f64) {
        match self {
            Self::Hog => (value.integer(), 1.0),
            Self::Load => (0, value.number()),
        }
    }
}

/// One kind of fault.
#[derive(Clone, Copy, Debug)]
pub struct FaultSpec {
    pub id: FaultId,
    pub kind: Kind,
    pub name: &'static str,
    pub value: ValueType,
    pub lasts: Lasts,
    pub meaning: &'static str,
}

/// How long a fault lasts whose end is not given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lasts {
    ForGood,
    OneTick,
    /// At one instant: there is nothing to end.
    Instant,
}

impl FaultSpec {
    /// Whether it happens at an instant, so that nothing of it can be ended.
    pub const fn is_once(&self) -> bool {
        matches!(self.lasts, Lasts::Instant)
    }

    /// The kind of a number; none where there is no such kind.
    pub fn of(number: u64) -> Option<&'static Self> {
        FAULTS.iter().find(|spec| spec.id as u64 == number)
    }

    /// The rows of a name in a scope.
    pub fn named(scope: Scope, name: &str) -> impl Iterator<Item = &'static Self> {
        FAULTS
            .iter()
            .filter(move |spec| spec.kind.scope() == scope && spec.name == name)
    }
}

/// The value of a fault: integers, or the bits of a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultValue(pub [u64; 2]);

impl FaultValue {
    pub const fn of_number(number: f64) -> Self {
        Self([number.to_bits(), 0])
    }

    pub const fn number(self) -> f64 {
        f64::from_bits(self.0[0])
    }

    pub const fn integer(self) -> u64 {
        self.0[0]
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueType {
    None,
    /// A number from above 0 to 1.
    Share,
    /// `n/m`.
    Pattern,
    /// A number above 0, in the unit of the field, with its name.
    Positive(&'static str),
    /// A number other than 0, in the unit of the field.
    NotZero,
    /// From 1.
    Integer {
        unit: &'static str,
        most: u64,
        example: u64,
    },
    /// `20ms`.
    Time,
    /// `40us..400us`, or one time.
    TimeRange,
}

impl ValueType {
    /// Whether a value is in range.
    pub fn has(self, value: FaultValue) -> bool {
        let (FaultValue([first, second]), number) = (value, value.number());
        let is_range = |most| 1 <= first && first <= second && second <= most;
        match self {
            Self::None => true,
            Self::Share => number > 0.0 && number <= 1.0,
            Self::Pattern => is_range(LONGEST_PATTERN),
            Self::Positive(_) => number.is_finite() && number > 0.0,
            Self::NotZero => number.is_finite() && number != 0.0,
            Self::Integer { most, .. } => (1..=most).contains(&first),
            Self::Time => (1..=LONGEST_NS).contains(&first),
            Self::TimeRange => is_range(LONGEST_NS),
        }
    }

    /// Some value in range, and how it is written.
    pub fn example(self) -> (FaultValue, String) {
        match self {
            Self::None => (FaultValue::default(), String::new()),
            Self::Pattern => (FaultValue([2, 5]), "2/5".into()),
            Self::Share | Self::Positive(_) | Self::NotZero => {
                (FaultValue::of_number(0.1), "0.1".into())
            }
            Self::Integer { example, .. } => (FaultValue([example, 0]), example.to_string()),
            Self::Time => (FaultValue([20_000_000, 0]), "20ms".into()),
            Self::TimeRange => (FaultValue([40_000, 400_000]), "40us..400us".into()),
        }
    }

    /// The values in range, for an error.
    pub fn range(self) -> String {
        match self {
            Self::None => String::new(),
            Self::Share => "a share above 0 and up to 1".into(),
            Self::Pattern => "n/m for the first n of each m".into(),
            Self::Positive(name) => format!("a {name} above 0 in the unit of the field"),
            Self::NotZero => "a number other than 0 in the unit of the field".into(),
            Self::Integer { unit, most, .. } => format!("{unit} from 1 to {most}"),
            Self::Time => "a time above 0 and up to 1m".into(),
            Self::TimeRange => "a time above 0 and up to 1m, or from the least to the most".into(),
        }
    }

    /// The values in range in few words, for a table.
    pub fn brief(self) -> String {
        match self {
            Self::None => String::new(),
            Self::Share => "up to 1".into(),
            Self::Pattern => "n/m".into(),
            Self::Positive(name) => name.into(),
            Self::NotZero => "number".into(),
            Self::Integer { most, .. } => format!("1 to {most}"),
            Self::Time => "time".into(),
            Self::TimeRange => "time, or 40us..400us".into(),
        }
    }
}

wire_enum! {
    /// Why a fault was refused. Never reuse a number, because logs contain it.
    pub enum FaultRefusal {
        /// A flight has as many as it can have.
        NoRoom = 1,
        /// Another one has a say in the same ticks.
        Contradiction = 2,
        /// There is none that could be ended.
        NothingToEnd = 3,
        AfterTheEnd = 4,
        /// A stop that is shorter than a tick.
        UnderATick = 5,
        /// The channel has no fresh command on time.
        NotReady = 6,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_example_of_each_kind_is_in_range_and_zero_is_not() {
        for spec in FAULTS.iter().filter(|spec| spec.value != V::None) {
            assert!(spec.value.has(spec.value.example().0), "{}", spec.name);
            for none in [FaultValue::default(), FaultValue([u64::MAX; 2])] {
                assert!(!spec.value.has(none), "{}", spec.name);
            }
        }
        assert!(FaultSpec::of(FaultId::Kill as u64).is_some_and(|it| it.meaning.contains("100ms")));
        assert_eq!(RESTART_NS, 100_000_000);
    }
}
