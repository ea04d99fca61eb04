//! Faults for a flight in the air: request to the plant and response, over iceoryx2.

use super::Wire;
use crate::error::Error;
use crate::request_response::{DeskCall, DeskClient, DeskServer, Question};
use faults::FaultRefusal;
use faults::code::FaultCode;
use messages::layout::layout;

/// Faults that can be asked for at once, each counted as often as it has inputs.
pub const MOST_AT_ONCE: usize = 16;

/// Faults as they are asked for: all strike from one tick on, which the plant says. The ticks that stand in them mean
/// nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct FaultOrder {
    /// First tick that they strike; `NO_TICK` if the tick is counted from now.
    pub at_tick: u64,
    /// With `at_tick == NO_TICK`: ticks from the plant's present one.
    pub in_ticks: u64,
    /// For how many ticks; `Span::FOR_GOOD` without an end.
    pub for_ticks: u64,
    pub count: u64,
    pub faults: [FaultCode; MOST_AT_ONCE],
}
layout!(FaultOrder {
    at_tick,
    in_ticks,
    for_ticks,
    count,
    faults
});

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct FaultAnswer {
    /// 0 where they strike; else a [`FaultRefusal`], or one of [`MALFORMED`], [`ENDED`].
    pub verdict: u64,
    pub from: u64,
    /// First tick that they do not strike any more; `Span::FOR_GOOD` without an end.
    pub to: u64,
    /// Refused: which of them, from 0 on.
    pub which: u64,
}
layout!(FaultAnswer {
    verdict,
    from,
    to,
    which
});

pub const STRIKES: u64 = 0;
/// Verdict: numbers that are no fault, none, or too many.
pub const MALFORMED: u64 = 100;
pub const ENDED: u64 = 101;

impl Question for FaultOrder {
    const SERVICE: &'static str = "injection";
    const WORDS: u64 = FaultRefusal::ENUM_HASH;
    type Answer = FaultAnswer;
}

pub type FaultServer = DeskServer<FaultOrder>;
pub type FaultCall = DeskCall<FaultOrder>;
pub type FaultClient = DeskClient<FaultOrder>;

impl Wire {
    pub fn fault_server(&self) -> Result<FaultServer, Error> {
        self.desk_server()
    }

    pub fn fault_client(&self) -> Result<FaultClient, Error> {
        self.desk_client()
    }
}
