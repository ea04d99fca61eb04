//! The plant's account of redundant channels, as it stands on a blackboard.

use crate::layout::{layout, wire_enum, zeroed};
use crate::role::{Channel, MOST_CHANNELS};

/// Name of the plant's blackboard with the [`Redundancy`].
pub const REDUNDANCY: &str = "redundancy";

wire_enum! {
    /// Why another group of channels took over.
    pub enum SwitchoverReason {
        Requested = 0 => "requested",
        Silent = 1 => "no fresh command on time",
        Tilt = 2 => "tilt",
        Rate = 3 => "body rate",
        PositionError = 4 => "position error",
        CommandStep = 5 => "command step",
    }
}

layout! {
    /// A group of channels that took over from another one.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Switchover {
        /// The first tick whose command is the new group's.
        pub tick: u64,
        /// First channels of the groups, as places among [`Channel::ALL`].
        pub from: u64,
        pub to: u64,
        /// A [`SwitchoverReason`] as number.
        pub reason: u64,
        /// Largest change of a rotor's command from the tick before [rad/s].
        pub command_step_rad_s: f64,
    }
}

/// Switchovers that are kept each; later ones are only counted.
pub const SWITCHOVERS_KEPT: usize = 16;

wire_enum! {
    /// Why a channel had no command that could be flown.
    pub enum OutageReason {
        Missing = 0 => "no command",
        Late = 1 => "late",
        Stale = 2 => "not computed from the tick's state",
        Outvoted = 3 => "contradicted by two channels",
    }
}

layout! {
    /// Ticks in a row for which a channel had no command that could be flown.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Outage {
        /// Place of the channel among [`Channel::ALL`].
        pub channel: u64,
        /// The first tick without a command.
        pub tick: u64,
        pub ticks: u64,
        /// An [`OutageReason`] as number: that of the first tick.
        pub reason: u64,
        /// 1 where the channel flew until then, and another one took over.
        pub is_handover: u64,
    }
}

/// Outages that are kept: the longest and the newest. Others are only counted.
pub const OUTAGES_KEPT: usize = 64;

layout! {
    /// The plant's account of the channels.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Redundancy {
        pub channels: u64,
        /// Place of the channel whose command is in force.
        pub active: u64,
        /// Ticks whose command was each channel's.
        pub flown: [u64; MOST_CHANNELS],
        /// Ticks for which fewer than two channels had a command that could be flown.
        pub unprotected: u64,
        pub longest_unprotected: u64,
        /// Ticks in which the usable command was not that of the first channel of the group that flew.
        pub masked: u64,
        /// Ticks without a fresh command on time from any channel.
        pub not_fresh: u64,
        /// Ticks in which two usable commands with the same history were compared, and those in which they differed.
        pub votes: u64,
        pub mismatches: u64,
        /// The first of them.
        pub first_mismatch: u64,
        /// Ticks in which two channels contradicted each channel.
        pub outvoted: [u64; MOST_CHANNELS],
        /// Times that another channel's command was flown than in the tick before.
        pub handovers: u64,
        pub outage_count: u64,
        pub outages: [Outage; OUTAGES_KEPT],
        pub switchover_count: u64,
        pub switchovers: [Switchover; SWITCHOVERS_KEPT],
        /// Per channel, the ticks in which its usable command and the one flown came from different laws; the largest
        /// difference of a rotor's command in them [rad/s], and the sum over them of the square of the tick's largest
        /// difference [rad^2/s^2].
        pub compared: [u64; MOST_CHANNELS],
        pub difference_max_rad_s: [f64; MOST_CHANNELS],
        pub difference_square_sum_rad2_s2: [f64; MOST_CHANNELS],
    }
}

impl Redundancy {
    /// The channel whose command is in force.
    pub fn active_channel(&self) -> Channel {
        Channel::from_wire(self.active).unwrap_or(Channel::A)
    }

    pub fn switchovers(&self) -> &[Switchover] {
        let kept = (self.switchover_count as usize).min(SWITCHOVERS_KEPT);
        &self.switchovers[..kept]
    }
}

impl Default for Redundancy {
    fn default() -> Self {
        zeroed()
    }
}
