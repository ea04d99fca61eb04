//! What a campaign has shown.

use crate::bins::Bin;
use crate::metric_distribution::Distribution;
use report::statistics::{Discordant, Interval, MeanInterval};
use serde::Serialize;

/// Identifies the JSON form of [`CampaignResults`].
pub const SCHEMA: &str = "ironbird-campaign-report/1";

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CampaignResults {
    /// [`SCHEMA`].
    pub schema: &'static str,
    pub name: String,
    pub campaign: String,
    pub build: String,
    /// Flights of each arm whose rows are there.
    pub flights: u64,
    /// Flights of each arm that the campaign has.
    pub planned: u64,
    /// How the intervals of success were made: `Wilson` or `Clopper-Pearson`, at 95 %.
    pub intervals: &'static str,
    pub arms: Vec<VariantResults>,
    /// Arms two by two, on the same draws.
    pub pairs: Vec<Pair>,
    /// What was drawn, the factor that matters most first.
    pub factors: Vec<FactorResults>,
    /// Success over two factors at once.
    pub maps: Vec<Map>,
    /// The worst flights, the worst first.
    pub worst: Vec<Worst>,
    /// What came of flying a share of the flights again; none where nobody asked for it.
    pub audit: Option<Audit>,
}

/// A share of the flights that were flown again.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Audit {
    /// The share that was asked for.
    pub share: f64,
    /// Flights that were flown again, each by all arms.
    pub flights: u64,
    pub rows: u64,
    pub differ: u64,
    pub differences: Vec<Difference>,
}

/// A cell that came out differently.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    pub flight: u64,
    pub arm: String,
    pub column: String,
    pub kept: String,
    pub again: String,
}

impl Audit {
    pub fn words(&self) -> String {
        let Self {
            flights,
            rows,
            differ,
            ..
        } = self;
        let flown = format!("{} flown again", counted(*flights as usize, "flight"));
        match differ {
            0 => format!("{flown}, {}: identical", counted(*rows as usize, "row")),
            _ => format!(
                "{flown}, {}: {differ} differ",
                counted(*rows as usize, "row")
            ),
        }
    }
}

impl Difference {
    pub fn words(&self) -> String {
        let Self {
            flight,
            arm,
            column,
            kept,
            again,
        } = self;
        format!("flight {flight} by {arm}: {column} is {kept} in its row, and {again} now")
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VariantResults {
    pub name: String,
    pub flights: u64,
    pub successes: u64,
    pub interval: Interval,
    /// Flights that were lost: not flown to their end within their envelope.
    pub lost: u64,
    /// Each gate that was asked of it.
    pub gates: Vec<GateResults>,
    /// Each metric, as [`crate::gates::METRICS`].
    pub metrics: Vec<Of<Distribution>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateResults {
    pub name: String,
    pub held: u64,
    /// Flights that it was asked of.
    pub asked: u64,
}

/// What is known of a metric.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Of<T> {
    pub name: String,
    #[serde(flatten)]
    pub is: T,
}

/// Two arms on the same draws.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    pub first: String,
    pub second: String,
    /// Flights in which one alone was a success.
    pub discordant: Discordant,
    /// McNemar's test: how probable so uneven a split is, were both alike.
    pub p_value: f64,
    /// Success rate of the first less that of the second.
    pub difference: MeanInterval,
    /// Mean difference of each metric, first less second, over the flights that neither lost.
    pub metrics: Vec<Of<MeanInterval>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FactorResults {
    pub name: String,
    /// What it is, where its column's name does not say so.
    pub meaning: String,
    pub arms: Vec<Effect>,
}

/// What a factor does to an arm, by itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Share of the variance of success that it accounts for; none where all flights ended alike.
    pub of_success: Option<f64>,
    /// Share of the variance of the logarithm of the largest position error.
    pub of_error: Option<f64>,
    pub bins: Vec<Bin>,
}

/// Success over two factors at once.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Map {
    pub arm: String,
    pub x: Side,
    pub y: Side,
    /// Successes and flights of each cell, row by row.
    pub cells: Vec<Vec<[u64; 2]>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Side {
    pub factor: String,
    pub bins: Vec<String>,
}

/// A flight that went wrong, or nearly.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worst {
    pub flight: u64,
    pub arm: String,
    pub success: bool,
    /// Its largest position error [m].
    pub position_error_max_m: f64,
    /// Why it was lost; empty where it was not.
    pub lost: String,
    pub drew: Vec<(String, String)>,
}

pub fn counted(count: usize, thing: &str) -> String {
    report::phrase::count(count as u64, thing)
}
