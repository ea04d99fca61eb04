//! A message of one of the topics of the flight log, and what is known of each topic before its first message.

use std::collections::BTreeMap;

use messages::content::{Decisions, Loss, RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::{Header, Message};
use messages::monitor::Monitor;
use messages::role::Role;
use messages::telemetry::Telemetry;
use messages::vectors::prefetch;

use crate::codec::Logged;
use crate::{rows, schema, units};

pub type Counts = [u64; TOPICS.len()];

/// Declares the topics of the log: what holds a message of any of them, and what is known of each.
macro_rules! topics {
    ($($topic:ident($content:ty),)+) => {
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(
            clippy::large_enum_variant,
            reason = "the largest is the most frequent"
        )]
        pub enum LogEntry {
            $($topic(Message<$content>),)+
        }

        /// A reference to a message of any topic.
        #[derive(Clone, Copy, Debug)]
        pub enum EntryRef<'a> {
            $($topic(&'a Message<$content>),)+
        }

        impl<'a> From<&'a LogEntry> for EntryRef<'a> {
            fn from(entry: &'a LogEntry) -> Self {
                match entry {
                    $(LogEntry::$topic(message) => Self::$topic(message),)+
                }
            }
        }

        impl EntryRef<'_> {
            pub const fn copied(self) -> LogEntry {
                match self {
                    $(Self::$topic(message) => LogEntry::$topic(*message),)+
                }
            }

            /// Fetches the message into the processor's cache.
            pub fn prefetch(self) {
                match self {
                    $(Self::$topic(message) => prefetch(message),)+
                }
            }
        }

        enum Place {
            $($topic,)+
        }

        /// Messages by topic, without the room that an entry of a short one leaves free.
        #[derive(Debug, Default)]
        #[allow(non_snake_case, reason = "a list has the name of its topic")]
        pub struct EntryLists {
            $($topic: Vec<Message<$content>>,)+
        }

        /// Place of a message in the list of its topic.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum EntryPlace {
            $($topic(usize),)+
        }

        impl EntryLists {
            pub fn push(&mut self, entry: &LogEntry) -> EntryPlace {
                match entry {
                    $(LogEntry::$topic(message) => {
                        self.$topic.push(*message);
                        EntryPlace::$topic(self.$topic.len() - 1)
                    })+
                }
            }

            pub fn at(&self, place: EntryPlace) -> EntryRef<'_> {
                match place {
                    $(EntryPlace::$topic(place) => EntryRef::$topic(&self.$topic[place]),)+
                }
            }

            pub fn clear(&mut self) {
                $(self.$topic.clear();)+
            }
        }

        impl LogEntry {
            /// Place of its topic in [`TOPICS`].
            pub const fn topic(&self) -> usize {
                match self {
                    $(Self::$topic(_) => Place::$topic as usize,)+
                }
            }
        }

        pub const FORMATS: [TopicFormat; [$(Place::$topic,)+].len()] = [
            $(TopicFormat::of::<$content>(|| LogEntry::$topic(Message::default())),)+
        ];
    };
}

topics! {
    State(State),
    Setpoint(Setpoint),
    Wrench(Wrench),
    RotorSpeeds(RotorSpeeds),
    Swap(SwapRecord),
    Theorem(Monitor),
    Decisions(Decisions),
    Loss(Loss),
}

/// The same for a message of any topic: `with_message!(entry, message => message.envelope.tick)`.
#[macro_export]
macro_rules! with_message {
    ($entry:expr, $message:ident => $same:expr) => {
        match $entry {
            $crate::entry::LogEntry::State($message) => $same,
            $crate::entry::LogEntry::Setpoint($message) => $same,
            $crate::entry::LogEntry::Wrench($message) => $same,
            $crate::entry::LogEntry::RotorSpeeds($message) => $same,
            $crate::entry::LogEntry::Swap($message) => $same,
            $crate::entry::LogEntry::Theorem($message) => $same,
            $crate::entry::LogEntry::Decisions($message) => $same,
            $crate::entry::LogEntry::Loss($message) => $same,
        }
    };
}
pub use with_message;

/// What is known of a topic before its first message.
pub struct TopicFormat {
    pub name: &'static str,
    pub sender: Role,
    pub schema_name: fn() -> String,
    pub descriptor_set: fn() -> Vec<u8>,
    pub describe: fn() -> BTreeMap<String, String>,
    pub columns: fn() -> Vec<rows::Column>,
    pub empty: fn() -> LogEntry,
}

impl TopicFormat {
    const fn of<C: Logged>(empty: fn() -> LogEntry) -> Self {
        Self {
            name: C::NAME,
            sender: C::SENDER,
            schema_name: schema::name::<C>,
            descriptor_set: schema::descriptor_set::<C>,
            describe: units::describe::<C>,
            columns: rows::columns::<C>,
            empty,
        }
    }
}

/// Topics of the loop, in the order of data flow, then the others.
pub const TOPICS: [&str; FORMATS.len()] = {
    let [a, b, c, d, e, f, g, h] = &FORMATS;
    [
        a.name, b.name, c.name, d.name, e.name, f.name, g.name, h.name,
    ]
};

impl LogEntry {
    pub const fn envelope(&self) -> &Header {
        with_message!(self, message => &message.envelope)
    }

    /// The signals of its sender's law; none where the sender has no law.
    pub const fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        match self {
            Self::Setpoint(message) => Some(&mut message.content.telemetry),
            Self::Wrench(message) => Some(&mut message.content.telemetry),
            Self::RotorSpeeds(message) => Some(&mut message.content.telemetry),
            _ => None,
        }
    }
}
