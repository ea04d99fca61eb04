//! What a campaign has shown.

mod made;
pub mod page;
pub mod text;

use serde::Serialize;

use crate::statistics::bins::Bin;
use crate::statistics::bootstrap::MeanInterval;
use crate::statistics::distributions::Distribution;
use crate::statistics::rates::{Discordant, RateInterval};
pub use made::of;

/// Identifies the JSON form of [`Findings`].
pub const SCHEMA: &str = "ironbird-campaign-report/1";

/// What a campaign has shown.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// Name of the campaign.
    pub name: String,
    /// Its fingerprint.
    pub campaign: String,
    /// The build that flew.
    pub build: String,
    /// Flights of each arm whose rows are there.
    pub flights: u64,
    /// Flights of each arm that the campaign has.
    pub planned: u64,
    /// How the intervals of success were made: `Wilson` or `Clopper-Pearson`, at 95 %.
    pub intervals: &'static str,
    /// What each arm came to.
    pub arms: Vec<ArmFindings>,
    /// Arms two by two, on the same draws.
    pub pairs: Vec<Pair>,
    /// What was drawn, the factor that matters most first.
    pub factors: Vec<FactorFindings>,
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
    /// Their rows.
    pub rows: u64,
    /// Rows in which something differed.
    pub differ: u64,
    /// The first of these.
    pub differences: Vec<Difference>,
}

/// A cell that came out differently.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The flight.
    pub flight: u64,
    /// What flew it.
    pub arm: String,
    /// The first column that differs.
    pub column: String,
    /// What the row has.
    pub kept: String,
    /// What came out now.
    pub again: String,
}

impl Audit {
    /// What it came to.
    #[must_use]
    pub fn words(&self) -> String {
        let Self { flights, rows, differ, .. } = self;
        let flown = format!("{} flown again", counted(*flights as usize, "flight"));
        match differ {
            0 => format!("{flown}, {}: identical", counted(*rows as usize, "row")),
            _ => format!("{flown}, {}: {differ} differ", counted(*rows as usize, "row")),
        }
    }
}

impl Difference {
    /// The cell, and both values.
    #[must_use]
    pub fn words(&self) -> String {
        let Self { flight, arm, column, kept, again } = self;
        format!("flight {flight} by {arm}: {column} is {kept} in its row, and {again} now")
    }
}

/// What an arm came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArmFindings {
    /// Its name.
    pub name: String,
    /// Flights.
    pub flights: u64,
    /// Successes.
    pub successes: u64,
    /// Interval of the success rate.
    pub interval: RateInterval,
    /// Flights that were lost: not flown to their end within their envelope.
    pub lost: u64,
    /// Each gate that was asked of it.
    pub gates: Vec<GateFindings>,
    /// Each metric, as [`crate::gates::METRICS`].
    pub metrics: Vec<Of<Distribution>>,
}

/// What a gate came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateFindings {
    /// Its name.
    pub name: String,
    /// Flights in which it held.
    pub held: u64,
    /// Flights that it was asked of.
    pub asked: u64,
}

/// What is known of a metric.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Of<T> {
    /// The metric.
    pub name: String,
    /// What is known.
    #[serde(flatten)]
    pub is: T,
}

/// Two arms on the same draws.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// The one.
    pub first: String,
    /// The other.
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

/// What a factor does.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FactorFindings {
    /// Its column.
    pub name: String,
    /// What it is, where its column's name does not say so.
    pub meaning: String,
    /// By arm.
    pub arms: Vec<Effect>,
}

/// What a factor does to an arm, by itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Share of the variance of success that it accounts for; none where all flights ended alike.
    pub of_success: Option<f64>,
    /// Share of the variance of the logarithm of the largest position error.
    pub of_error: Option<f64>,
    /// Success over its range.
    pub bins: Vec<Bin>,
}

/// Success over two factors at once.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Map {
    /// The arm.
    pub arm: String,
    /// Along the one side.
    pub x: Side,
    /// Along the other.
    pub y: Side,
    /// Successes and flights of each cell, row by row.
    pub cells: Vec<Vec<[u64; 2]>>,
}

/// A side of a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Side {
    /// The factor.
    pub factor: String,
    /// Its bins.
    pub bins: Vec<String>,
}

/// A flight that went wrong, or nearly.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Its number.
    pub flight: u64,
    /// What flew it.
    pub arm: String,
    /// Whether it counts as success.
    pub success: bool,
    /// Its largest position error [m].
    pub position_error_max_m: f64,
    /// Why it was lost; empty where it was not.
    pub lost: String,
    /// What it drew.
    pub drew: Vec<(String, String)>,
}

/// A number of things.
fn counted(count: usize, thing: &str) -> String {
    report::text::count(count as u64, thing)
}
