//! Telemetry: what a law wants to be seen of itself.

use crate::layout::layout;

/// How many numbers a law may show.
pub const TELEMETRY: usize = 32;

/// Numbers that a law shows of a tick, in the order in which its description names them; the rest is 0.
///
/// They are logged and drawn, and no stage reads them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Telemetry {
    /// The numbers, in the units of the description.
    pub value: [f64; TELEMETRY],
}

layout!(Telemetry { value });
