//! Redundant channels: which channel's command of a tick is taken, and the account of it. Pure: no clock, port or process.
//!
//! ```text
//! commands --> ChannelSelection (waits for the next tick) --> GroupSelection --> select --> the command taken
//!                     |
//!                     +--> RedundancyAccount
//! ```

mod account;
mod selection;
mod waiting_commands;

pub use account::RedundancyAccount;
pub use selection::{
    Arrangement, Candidate, Excursion, GroupSelection, Selection, SimplexLimits, select,
};
pub use waiting_commands::ChannelSelection;
