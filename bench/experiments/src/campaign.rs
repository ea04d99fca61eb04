//! The flights of a campaign: each is that of `ironbird simulate` with the same settings, bit for bit.

pub mod flight_settings;
pub mod rows;
