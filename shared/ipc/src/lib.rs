//! Ports of an instance over iceoryx2, with every limit explicit: topics, blackboards, requests, wake-up events.
//!
//! Only this crate knows the middleware's services. Ports are created before a loop is armed. After that, a send costs
//! one loan and a receive costs one copy, and both compute the check word of the message. Start reading in [`Wire`].

mod access;
mod blackboard;
pub mod clock;
pub mod error;
pub mod instance;
mod ports;
mod requests;
pub mod sys;
mod wake_event;
mod wake_file;

pub use access::Wire;
pub use blackboard::{Blackboard, BlackboardReader, Notice, SHEETS};
pub use ports::{
    DEEP, LATEST, OBSERVED, OBSERVERS, Receiver, Relay, Sender, TopicPorts, Wakes, recorder_depth,
};
pub use requests::{
    ACCEPTED, BUSY, Call, ENDED, FaultAnswer, FaultOrder, MALFORMED, MOST_AT_ONCE, Order,
    RequestClient, RequestServer, SwapAnswer, SwapOrder, SwapOutcome, TargetAnswer, TargetOrder,
};
pub use wake_event::{Notifier, Owner, WakeEvent};
