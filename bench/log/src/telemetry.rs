//! What a law shows, as a topic of its own: a message per tick, with a field per signal.
//!
//! The law's numbers come in the message of its stage. The log holds them beside it: first the stage's message, and right
//! after it the numbers, with the same tick, sequence number and times. The channel of the stage's topic says on which
//! topic they are ([`BESIDE`]). A reader puts both together again and loses no bit. A law without signals has no such
//! topic.

use std::collections::BTreeMap;

use messages::role::Role;
use messages::telemetry::{LAW_ROLES, Signal, TELEMETRY, Telemetry};
use prost::Message as _;
use prost_types::FileDescriptorSet;
use prost_types::field_descriptor_proto::Type;

use crate::codec::{put_word, take_word};
use crate::rows::{Cell, Column};
use crate::schema::{PACKAGE, file_of_topic, message, plain};

/// The topics, by role in the order of [`LAW_ROLES`].
pub const TELEMETRY_TOPICS: [&str; LAW_ROLES.len()] =
    ["outer_telemetry", "inner_telemetry", "mixer_telemetry"];

/// What the metadata of a stage's channel call the topic of what its law shows.
pub const BESIDE: &str = "telemetry";

/// Name of the first field: the tick of the stage's message.
pub const TICK: &str = "tick";
/// Its number; those of the signals follow.
const TICK_NUMBER: u32 = 1;

/// The topic of what a role's law shows; none where the role has no law.
pub fn topic(role: Role) -> Option<&'static str> {
    place(role).map(|place| TELEMETRY_TOPICS[place])
}

pub(crate) fn place(role: Role) -> Option<usize> {
    LAW_ROLES.iter().position(|it| *it == role)
}

/// A law's signals, as a log or a bridge names them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TelemetryTopic {
    role: Role,
    signals: Vec<(String, String)>,
}

impl TelemetryTopic {
    /// The topic of a law with these signals; none of a law without any.
    pub fn new(role: Role, signals: &[Signal]) -> Option<Self> {
        let signals = signals.iter().take(TELEMETRY);
        let signals: Vec<_> = signals
            .map(|signal| (signal.name.to_owned(), signal.unit.to_owned()))
            .collect();
        (place(role).is_some() && !signals.is_empty()).then_some(Self { role, signals })
    }

    /// As a log describes it: by its schema, and the metadata of its channel. None where that is another's schema.
    pub(crate) fn described(
        role: Role,
        schema: &[u8],
        metadata: &BTreeMap<String, String>,
    ) -> Option<Self> {
        let set = FileDescriptorSet::decode(schema).ok()?;
        let fields = &set.file.first()?.message_type.first()?.field;
        let names = fields.iter().skip(1).map(|field| field.name().to_owned());
        let unit = |name: &str| {
            let unit = metadata.get(&format!("unit.{name}"));
            unit.filter(|unit| *unit != RATIO).cloned()
        };
        let signals = names.map(|name| (name.clone(), unit(&name).unwrap_or_default()));
        let signals = signals.collect();
        let topic = Self { role, signals };
        (topic.signals.len() <= TELEMETRY && topic.descriptor_set() == schema).then_some(topic)
    }

    pub fn topic(&self) -> &'static str {
        topic(self.role).unwrap_or_default()
    }

    /// Full name of its message, as in `ironbird.InnerTelemetry`.
    pub fn schema_name(&self) -> String {
        format!("{PACKAGE}.{}", self.message())
    }

    const fn message(&self) -> &'static str {
        match self.role {
            Role::Outer => "OuterTelemetry",
            Role::Inner => "InnerTelemetry",
            _ => "MixerTelemetry",
        }
    }

    pub fn descriptor_set(&self) -> Vec<u8> {
        let mut field = vec![plain(TICK, TICK_NUMBER, None, Type::Fixed64)];
        for ((name, _), number) in self.signals.iter().zip(TICK_NUMBER + 1..) {
            field.push(plain(name, number, None, Type::Double));
        }
        file_of_topic(self.topic(), vec![message(self.message(), field)])
    }

    pub fn metadata(&self) -> BTreeMap<String, String> {
        let mut metadata = BTreeMap::from([(format!("unit.{TICK}"), TICK.to_owned())]);
        for (name, unit) in &self.signals {
            let unit = if unit.is_empty() { RATIO } else { unit };
            metadata.insert(format!("unit.{name}"), unit.to_owned());
        }
        metadata
    }

    pub fn encode(&self, tick: u64, telemetry: &Telemetry, out: &mut Vec<u8>) {
        put_word(TICK_NUMBER, tick, out);
        let values = &telemetry.value[..self.signals.len()];
        for (value, number) in values.iter().zip(TICK_NUMBER + 1..) {
            put_word(number, value.to_bits(), out);
        }
    }

    /// Reads the numbers of a tick into those of the stage's message; false where the bytes are not they.
    pub(crate) fn decode_into(
        &self,
        mut bytes: &[u8],
        tick: u64,
        telemetry: &mut Telemetry,
    ) -> bool {
        if take_word(TICK_NUMBER, &mut bytes) != Some(tick) {
            return false;
        }
        let values = &mut telemetry.value[..self.signals.len()];
        for (value, number) in values.iter_mut().zip(TICK_NUMBER + 1..) {
            let Some(bits) = take_word(number, &mut bytes) else {
                return false;
            };
            *value = f64::from_bits(bits);
        }
        bytes.is_empty()
    }

    pub fn columns(&self) -> Vec<Column> {
        let columns = self.signals.iter();
        columns
            .map(|(name, unit)| Column::number(name, unit))
            .collect()
    }

    pub fn cells(&self, telemetry: &Telemetry) -> Vec<Cell> {
        let values = &telemetry.value[..self.signals.len()];
        values.iter().copied().map(Cell::Number).collect()
    }
}

/// What metadata call the unit of a ratio.
const RATIO: &str = "1";
