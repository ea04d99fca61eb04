//! The roles that processes play, in the order of the data flow. A name is also a subcommand.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::layout::wire_enum;

wire_enum! {
    #[derive(Hash, PartialOrd, Ord, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Role {
        Plant = 0 => "plant",
        Outer = 1 => "outer",
        /// The inner (attitude and rate) loop.
        Inner = 2 => "inner",
        Mixer = 3 => "mixer",
        /// The recorder: no part of the loop, not real-time.
        Record = 4 => "record",
    }
}

/// The four roles of the control loop.
pub const STAGES: [Role; 4] = [Role::Plant, Role::Outer, Role::Inner, Role::Mixer];

pub const ROLES: [Role; 5] = Role::ALL;

impl Role {
    /// Share of the tick, in percent, after which a stage no longer waits for its input.
    ///
    /// Staggered along the chain, so that each stage can still hand on what it makes of stale data.
    pub const fn deadline_percent(self) -> u64 {
        match self {
            Self::Outer => 70,
            Self::Inner => 80,
            _ => 90,
        }
    }
}

wire_enum! {
    /// A complete control chain: outer loop, inner loop and mixer. Redundant channels fly the same laws at the same time.
    #[derive(Hash, PartialOrd, Ord, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Channel {
        A = 0 => "a",
        B = 1 => "b",
        C = 2 => "c",
    }
}

/// Channels that a flight can have.
pub const MOST_CHANNELS: usize = Channel::ALL.len();

/// The roles of a channel.
pub const CHANNEL_ROLES: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];

impl Channel {
    /// The first `count` channels.
    pub fn first(count: usize) -> impl Iterator<Item = Self> + Clone {
        Self::ALL.into_iter().take(count)
    }

    /// What a name of this channel begins with; nothing for channel a, whose names are those of a flight without
    /// redundancy.
    pub const fn prefix(self) -> &'static str {
        match self {
            Self::A => "",
            Self::B => "b.",
            Self::C => "c.",
        }
    }
}

/// A role in a channel. The plant and the recorder are always in channel a.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Replica {
    pub channel: Channel,
    pub role: Role,
}

impl Replica {
    pub const fn new(role: Role, channel: Channel) -> Self {
        let channel = match role {
            Role::Plant | Role::Record => Channel::A,
            Role::Outer | Role::Inner | Role::Mixer => channel,
        };
        Self { channel, role }
    }

    /// Every process of a flight with so many channels: channel a first, the recorder before the other channels.
    pub fn all(channels: usize) -> impl Iterator<Item = Self> {
        let more = Channel::first(channels).skip(1);
        let more = more.flat_map(|channel| CHANNEL_ROLES.map(|role| Self::new(role, channel)));
        ROLES.into_iter().map(Self::from).chain(more)
    }

    /// Steps from the real-time priority of the settings. A later stage preempts an earlier one.
    ///
    /// On one processor, channels b and c are below the plant and channel a: they cost neither of them time. On two, the
    /// plant is above channel a: a stage that computes without end stops neither the plant nor channel b.
    pub const fn priority_step(self, channel_cpus: usize) -> i32 {
        let step = self.role as i32;
        match (self.role, self.channel) {
            (Role::Plant, _) if channel_cpus > 1 => Role::Mixer as i32 + 1,
            (_, Channel::A) => step,
            (_, Channel::B) if channel_cpus > 1 => step,
            (_, Channel::B) => step - 4,
            (_, Channel::C) => step - 7,
        }
    }

    /// Whether the plant preempts it on their processor.
    pub const fn is_below_plant(self, channel_cpus: usize) -> bool {
        self.priority_step(channel_cpus) < Role::Plant as i32
    }
}

impl From<Role> for Replica {
    fn from(role: Role) -> Self {
        Self::new(role, Channel::A)
    }
}

impl fmt::Display for Replica {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.channel.prefix(), self.role)
    }
}
