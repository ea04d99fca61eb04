//! The results of a campaign.

use crate::bins::Bin;
use crate::metric_distribution::Distribution;
use analysis::schema::Gate;
use analysis::statistics::{Discordant, Interval, Mean, MeanInterval};
use serde::Serialize;

pub const SCHEMA: &str = "ironbird-campaign-report/2";

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CampaignResults {
    pub schema: &'static str,
    pub name: String,
    pub campaign: String,
    pub build: String,
    pub flights: u64,
    pub planned: u64,
    /// How the intervals of success were made, at 95 %.
    pub intervals: &'static str,
    pub arms: Vec<VariantResults>,
    pub pairs: Vec<Pair>,
    /// What was drawn, the factor that matters most first.
    pub factors: Vec<FactorResults>,
    pub maps: Vec<Map>,
    pub worst: Vec<Worst>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VariantResults {
    pub name: String,
    pub flights: u64,
    pub successes: u64,
    pub interval: Interval,
    pub lost: u64,
    pub gates: Vec<GateResults>,
    /// Each metric, as [`crate::gates::METRICS`].
    pub metrics: Vec<Of<Distribution>>,
}

impl VariantResults {
    /// A gate on the success rate [%] of a campaign of so many flights: it does not hold while some of them are missing.
    pub fn success_gate(&self, least_percent: f64, planned: u64) -> Gate {
        let (successes, flights) = (self.successes, self.flights);
        let percent = 100.0 * successes as f64 / flights.max(1) as f64;
        Gate {
            name: format!("success rate of {} [%]", self.name),
            limit: format!(">= {least_percent} in all {planned} flights"),
            value: format!("{percent:.3} ({successes} of {flights})"),
            held: flights == planned && percent >= least_percent,
            asked: true,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateResults {
    pub name: String,
    pub held: u64,
    pub asked: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Of<T> {
    pub name: String,
    #[serde(flatten)]
    pub is: T,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    pub first: String,
    pub second: String,
    /// Flights in which one alone was a success.
    pub discordant: Discordant,
    /// McNemar's test: how probable so uneven a split is, were both alike.
    pub p_value: f64,
    pub difference: MeanInterval,
    /// Mean difference of each metric, first less second, over the flights that neither lost.
    pub metrics: Vec<Of<MeanDifference>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeanDifference {
    /// Over the flights in which both have a value.
    #[serde(flatten)]
    pub of: Mean,
    /// Flights that neither lost and that are left out, because the first or the second did not recover.
    pub missing: [u64; 2],
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FactorResults {
    pub name: String,
    /// What it is, where its column's name does not say so.
    pub meaning: String,
    pub arms: Vec<Effect>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Share of the variance of success that it accounts for; none where all flights ended alike.
    pub of_success: Option<f64>,
    /// Share of the variance of the logarithm of the largest position error.
    pub of_error: Option<f64>,
    pub bins: Vec<Bin>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Map {
    pub arm: String,
    pub x: Side,
    pub y: Side,
    pub cells: Vec<Vec<[u64; 2]>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Side {
    pub factor: String,
    pub bins: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worst {
    pub flight: u64,
    pub arm: String,
    pub success: bool,
    pub position_error_max_m: f64,
    pub lost: String,
    pub drew: Vec<(String, String)>,
}
