//! Observers of a running flight, and changes of it: the dashboard, the live page, bridges to Foxglove and MAVLink, injection.
//!
//! It joins a flight as an observer ([`observation`]), which has no effect on the control loops, and sends requests to
//! the plant's parameter server ([`inject`]). It starts no flight (`supervisor`) and writes no log (`recorder`).

#[cfg(feature = "foxglove")]
pub mod bridge;
pub mod inject;
#[cfg(test)]
mod made_up;
pub mod observation;
pub mod parameter_text;
#[cfg(any(feature = "foxglove", feature = "web"))]
mod request_head;
#[cfg(feature = "mavlink")]
pub mod vehicle;
pub mod watch;
#[cfg(feature = "web")]
pub mod web;
