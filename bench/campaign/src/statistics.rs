//! What rows say: rates, differences of arms, what matters, distributions.

pub mod beta;
pub mod bins;
pub mod bootstrap;
pub mod distributions;
pub mod rates;
