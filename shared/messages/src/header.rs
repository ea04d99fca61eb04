//! The envelope of every message: who sent it, when, and from which inputs.
//!
//! Only the plant stamps the sample. Every stage passes on the envelope of its input and adds its own two stamps. The
//! rotor command therefore carries the whole history of its tick, including the latency of each hop.

use std::mem::offset_of;

use crate::content::{
    Decision, Decisions, FlightTarget, NO_TICK, RotorSpeeds, Setpoint, State, SwapRecord,
    TakenCommand, Truth, Wrench,
};
use crate::enum_registry::Fingerprint as _;
use crate::history::LawState;
use crate::layout::{Element, Field, Kind, Layout, Plain, Visit, hash_of, layout, zeroed};
use crate::monitor::Monitor;
use crate::role::{Role, STAGES};

layout! {
    /// When a stage had its input, and when it published its output, on CLOCK_MONOTONIC.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Stamps {
        /// The stage woke and took its input [ns]; for the plant: it woke on its timer.
        pub receive_ns: u64,
        /// The stage handed its output to the wire [ns].
        pub send_ns: u64,
    }
}

layout! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Header as "Envelope" {
        /// [`LAYOUT`] of the sender's build.
        pub layout: u64,
        /// The run that the message belongs to.
        pub run_id: u64,
        /// Fingerprint of the settings that the sender flies with.
        pub settings: u64,
        /// When the sender started [ns]: a restarted sender has a later one.
        pub epoch: u64,
        /// Messages that the sender has published before this one, in this epoch.
        pub seq: u64,
        /// Tick that the message was made for.
        pub tick: u64,
        /// Parameter swaps that the plant had applied when it sampled.
        pub parameter_epoch: u64,
        /// When the plant sampled the state that it all goes back to [ns].
        pub sample_ns: u64,
        /// How far ahead of the tick the plant's timer was to be set [ns].
        pub lead_ns: u64,
        /// How late the kernel woke the plant, after the instant that its timer was set to [ns].
        pub timer_late_ns: u64,
        /// Tick of the newest state, setpoint and wrench used; [`NO_TICK`] where none was.
        pub input_tick: [u64; 3],
        /// How long the sender's previous tick kept it busy, from waking to having notified [ns].
        pub previous_busy_ns: u64,
        /// Stamps of each stage so far, in the order of [`STAGES`]; zero for stages not passed in this tick.
        pub stamps: [Stamps; STAGES.len()],
        /// The state that the sender's law continued from.
        pub law_state: LawState,
    }
}

impl Header {
    /// The envelope of a message that goes back to no sample yet.
    pub const fn new() -> Self {
        Self {
            layout: LAYOUT,
            tick: NO_TICK,
            input_tick: [NO_TICK; 3],
            law_state: LawState::INITIAL,
            ..zeroed()
        }
    }

    /// This history, with the tick of what was taken from the stage `sender`.
    pub fn made_from(mut self, sender: Role, tick: u64) -> Self {
        self.input_tick[sender as usize] = tick;
        self
    }

    /// When the message was sent [ns]: no message is sent before one that it goes back to.
    pub fn sent_ns(&self) -> u64 {
        let sent_ns = self.stamps.iter().map(|it| it.send_ns);
        sent_ns.max().unwrap_or(0)
    }

    /// Stamps of a stage of the loop; the recorder has none.
    pub fn stamps_of(&self, role: Role) -> Stamps {
        self.stamps.get(role as usize).copied().unwrap_or_default()
    }
}

impl Default for Header {
    fn default() -> Self {
        Self::new()
    }
}

/// A message as it lies in shared memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Message<C> {
    pub envelope: Header,
    pub content: C,
}

impl<C> Message<C> {
    /// A message of a tick; the rest of its header is empty.
    pub fn of_tick(tick: u64, content: C) -> Self {
        let envelope = Header {
            tick,
            ..Header::new()
        };
        Self { envelope, content }
    }
}

#[allow(
    unsafe_code,
    reason = "`layout!` knows no struct with a type parameter"
)]
// SAFETY: both fields are `Plain`.
unsafe impl<C: Visit> Plain for Message<C> {}

impl<C: Visit> Layout for Message<C> {
    const FIELDS: &'static [Field] = &[
        Field {
            name: "envelope",
            offset: offset_of!(Self, envelope),
            size: size_of::<Header>(),
            kind: <Header as Element>::KIND,
            length: None,
        },
        Field {
            name: "content",
            offset: offset_of!(Self, content),
            size: size_of::<C>(),
            kind: Kind::Struct {
                name: C::STRUCT,
                fields: C::FIELDS,
            },
            length: None,
        },
    ];
}

/// Fingerprint of all layouts of messages: processes whose fingerprints differ must not talk.
pub const LAYOUT: u64 = hash_of(&[
    Header::FINGERPRINT,
    Stamps::FINGERPRINT,
    LawState::FINGERPRINT,
    State::FINGERPRINT,
    Truth::FINGERPRINT,
    Decision::FINGERPRINT,
    TakenCommand::FINGERPRINT,
    FlightTarget::FINGERPRINT,
    Decisions::FINGERPRINT,
    Setpoint::FINGERPRINT,
    Wrench::FINGERPRINT,
    Monitor::FINGERPRINT,
    RotorSpeeds::FINGERPRINT,
    SwapRecord::FINGERPRINT,
]);
