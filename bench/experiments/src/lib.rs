//! Many simulated flights: campaigns, robustness margins, combinations of laws, spread over the processors.
//!
//! It flies ([`campaign`], [`margin`]); what campaigns are, and their statistics, is the crate `campaign`. It knows no
//! flags and prints nothing but progress. Results do not depend on the number of processors ([`parallel`]).

pub mod campaign;
pub mod combinations;
pub mod margin;
pub mod parallel;
pub mod progress;
