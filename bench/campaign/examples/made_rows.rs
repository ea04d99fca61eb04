//! Fills a campaign's directory with made-up rows, to measure what merging and reporting many of them takes.
//!
//! ```text
//! ironbird campaign run FILE.toml --out DIR --shard 1/1000      # makes DIR, and a chunk that was flown
//! cargo run --release -p campaign --example made_rows -- DIR    # writes all other chunks
//! ```
//!
//! Draws are those of the campaign, so are the files; what came of the flights is drawn as well. Nothing was flown.

use std::path::Path;
use std::{env, fs};

use campaign::chunk;
use campaign::chunk::{Identity, State};
use campaign::gates::METRICS;
use campaign::generator::Stream;
use campaign::outcome::{Outcome, Shown};
use campaign::table::Row;
use errors::{Failure, InFile as _, read_text};

fn main() -> Result<(), Failure> {
    let directory = env::args_os()
        .nth(1)
        .ok_or_else(|| Failure::usage("name a campaign's directory"))?;
    let directory = Path::new(&directory);
    let campaign = campaign::file::read(&read_text("read", &directory.join("campaign.toml"))?)?;
    let path = directory.join("campaign.json");
    let facts: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(&path).in_file("read", &path)?)
            .map_err(|e| Failure::failed(format!("{}: {e}", path.display())))?;
    let fact = |key: &str| facts[key].as_str().unwrap_or_default().to_owned();
    let identity = Identity {
        name: campaign.name.clone(),
        campaign: fact("campaign"),
        build: fact("build"),
    };
    let outcome = |flight: u64, arm: usize| {
        let unit = |name: &str| Stream::new(campaign.seed, name).units(flight, arm as u32)[0];
        let metrics = METRICS.map(|metric| Some(unit(metric.name)));
        let lost = (unit("lost") < 0.01).then(|| "made up".to_owned());
        let telemetry = vec![Shown::NotOfThisLaw; campaign.gates.telemetry.len()];
        Outcome {
            lost,
            metrics,
            telemetry,
            outputs: format!("{:016x}", unit("outputs").to_bits()),
        }
    };
    for number in 0..campaign.chunks() {
        if chunk::state(directory, &campaign, &identity, number) == State::Missing {
            let rows: Vec<Row> = campaign
                .flights_of(number)
                .flat_map(|flight| (0..campaign.arms.len()).map(move |arm| (flight, arm)))
                .map(|(flight, arm)| Row {
                    flight,
                    arm,
                    draws: campaign.draws(flight),
                    outcome: outcome(flight, arm),
                })
                .collect();
            chunk::write(directory, &campaign, &identity, number, &rows)?;
        }
    }
    Ok(())
}
