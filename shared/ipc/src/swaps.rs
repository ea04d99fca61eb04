//! Parameter swaps: request to the plant and response, over iceoryx2.

use iceoryx2::prelude::ZeroCopySend;

use super::Wire;
use crate::error::Error;
use crate::request_response::{DeskCall, DeskClient, DeskServer, Question};
use messages::layout::{from_wire, layout};
use messages::parameters::PARAMETERS;

#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
pub struct SwapOrder {
    /// Tick from which it takes hold; `NO_TICK` if the tick is counted from now.
    pub at_tick: u64,
    /// With `at_tick == NO_TICK`: ticks from the plant's present one.
    pub in_ticks: u64,
    /// How many of the following pairs are meant.
    pub count: u64,
    /// Parameters, as indices of the table [`messages::parameters::SPECS`].
    pub parameter: [u64; PARAMETERS],
    pub value: [f64; PARAMETERS],
    /// Equal steps in which they get there, one a tick; 1 is at once.
    pub steps: [u64; PARAMETERS],
}
layout!(SwapOrder {
    at_tick,
    in_ticks,
    count,
    parameter,
    value,
    steps
});

#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
pub struct SwapAnswer {
    /// A [`SwapOutcome`] as number.
    pub verdict: u64,
    /// Applied: the tick from which it holds. Refused: the plant's tick.
    pub tick: u64,
    pub parameter_epoch: u64,
    /// Refused for one parameter: its index.
    pub parameter: u64,
    /// Values before the swap, in the order of the request.
    pub old: [f64; PARAMETERS],
}
layout!(SwapAnswer {
    verdict,
    tick,
    parameter_epoch,
    parameter,
    old
});

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum SwapOutcome {
    Applied = 0,
    UnknownParameter = 1,
    OutOfRange = 2,
    /// It names no parameter, too many, or one twice; or a ramp takes no step, or more than a flight has ticks.
    Malformed = 3,
    QueueFull = 4,
    Ended = 5,
}

from_wire!(SwapOutcome {
    Applied,
    UnknownParameter,
    OutOfRange,
    Malformed,
    QueueFull,
    Ended
});

impl Question for SwapOrder {
    const SERVICE: &'static str = "parameters";
    const WORDS: u64 = SwapOutcome::ENUM_HASH;
    type Answer = SwapAnswer;
}

pub type SwapServer = DeskServer<SwapOrder>;
pub type SwapCall = DeskCall<SwapOrder>;
pub type SwapClient = DeskClient<SwapOrder>;

impl Wire {
    pub fn swap_server(&self) -> Result<SwapServer, Error> {
        self.desk_server()
    }

    pub fn swap_client(&self) -> Result<SwapClient, Error> {
        self.desk_client()
    }
}
