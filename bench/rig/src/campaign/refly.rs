//! `ironbird campaign fly`: one flight of a campaign again, with all it leaves.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use campaign::chunk;
use campaign::chunk::State;
use campaign::rows::Rows;
use errors::{Failure, GATE, InFile as _, OK};

use super::directory;
use super::flight_settings::Plan;
use crate::cli::{
    self, CampaignFlyArgs, FlightArgs, FlyArgs, OnDeath, RecorderArgs, RtArgs, TrajectoryArgs,
};
use crate::output::print;
use crate::recorded_timing::Timing;
use crate::replay::fly_again;
use crate::run_directory::find_log;
use crate::settings::law_settings::Moved;
use crate::settings::{PaceName, Settings};
use crate::simulate::{OutputFiles, report};

/// Flies a flight again; in lockstep its outputs must be those of its row.
///
/// # Errors
/// Usage: a directory of no campaign, a flight or an arm that it has not; what can go wrong on the way of `fly`.
pub(super) fn fly(args: &CampaignFlyArgs) -> Result<u8, Failure> {
    let plan = directory::plan(&args.directory)?;
    let arm = arm(&plan, args.arm.as_deref())?;
    if args.flight >= plan.campaign.flights {
        return Err(Failure::usage(format!(
            "there is no flight {}: the campaign {} has the flights 0 to {}",
            args.flight,
            plan.campaign.name,
            plan.campaign.flights - 1
        ))
        .help("`ironbird campaign report DIR` lists the worst ones"));
    }
    let mut settings = plan.settings(args.flight, arm)?;
    let timing = plan.timing(args.flight, arm, &settings)?;
    let is_of_ticks_alone = is_of_ticks_alone(&settings, timing)?;
    settings.flight.pace = if is_of_ticks_alone {
        PaceName::Realtime
    } else {
        PaceName::Lockstep
    };
    if let Some(out) = &args.out {
        settings.recorder.out = out.to_string_lossy().into_owned();
    }
    if args.print_config {
        let timed = plan
            .recorded(args.flight, arm)
            .map(|run| format!("# with --timing {}\n", run.display()));
        print(&(timed.unwrap_or_default() + &settings.commented()?))?;
        return Ok(OK);
    }
    let row = row(&plan, &args.directory, args.flight, arm)?;
    if is_of_ticks_alone {
        return simulated(&plan, args, arm, &settings, timing, row.as_ref());
    }
    let held = tempfile::tempdir()
        .map_err(|e| Failure::failed(format!("cannot make a directory: {e}")))?;
    let file = held.path().join("settings.toml");
    fs::write(&file, settings.commented()?).in_file("write", &file)?;
    let code = cli::fly::fly(&asked(file, args.instance.clone()))?;
    if ![OK, GATE].contains(&code) {
        return Ok(code);
    }
    compare(Path::new(&settings.recorder.out), row.as_ref())
}

/// The arm of a name, or the first.
fn arm(plan: &Plan, name: Option<&str>) -> Result<usize, Failure> {
    let names = || {
        plan.campaign
            .arms
            .iter()
            .map(|arm| arm.name.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    };
    name.map_or(Ok(0), |name| {
        plan.campaign.arm(name).ok_or_else(|| {
            Failure::usage(format!(
                "--arm {name}: the campaign {} has no such arm",
                plan.campaign.name
            ))
            .help(format!("its arms are {}", names()))
        })
    })
}

/// Whether a flight is one that no processes can fly in lockstep, where nobody is late: with a recorded timing, or with
/// stages that are.
fn is_of_ticks_alone(settings: &Settings, timing: Option<&Timing>) -> Result<bool, Failure> {
    Ok(timing.is_some() || !settings.planned()?.stages.is_empty())
}

/// Simulates a flight, into a directory of its own.
fn simulated(
    plan: &Plan,
    args: &CampaignFlyArgs,
    arm: usize,
    settings: &Settings,
    timing: Option<&Timing>,
    row: Option<&Flown>,
) -> Result<u8, Failure> {
    let name = format!(
        "{}-{}-{}",
        plan.campaign.name, args.flight, plan.campaign.arms[arm].name
    );
    let directory = Path::new(&settings.recorder.out).join(name);
    fs::create_dir_all(&directory).in_file("make the directory", &directory)?;
    let [file, states, plot] =
        ["settings.toml", "states.csv", "flight.svg"].map(|name| directory.join(name));
    fs::write(&file, settings.commented()?).in_file("write", &file)?;
    let (flown, _) = report(
        settings,
        timing,
        &OutputFiles {
            states: Some(&states),
            plot: Some(&plot),
        },
    )?;
    print(&format!(
        "{}: settings.toml, states.csv, flight.svg\n",
        directory.display()
    ))?;
    against(&flown.outputs.to_string(), row)
}

/// `fly` with a settings file alone.
fn asked(settings: PathBuf, instance: Option<String>) -> FlyArgs {
    let mut rt = RtArgs {
        instance: "default".into(),
        ..RtArgs::default()
    };
    instance.into_iter().for_each(|name| rt.instance = name);
    FlyArgs {
        watch: false,
        floor: None,
        junit: None,
        open: false,
        print_config: false,
        on_death: OnDeath::End,
        flight: FlightArgs {
            course: TrajectoryArgs {
                config: Some(settings),
                ..TrajectoryArgs::default()
            },
            ..FlightArgs::default()
        },
        rt,
        recorder: RecorderArgs::default(),
    }
}

/// What is asked of a flight's row.
struct Flown {
    outputs: String,
    is_success: bool,
}

/// A flight's row, where it is there.
fn row(plan: &Plan, directory: &Path, flight: u64, arm: usize) -> Result<Option<Flown>, Failure> {
    let chunk = flight / plan.campaign.chunk;
    if chunk::state(directory, &plan.campaign, &plan.identity, chunk) != State::Whole {
        return Ok(None);
    }
    let row = Rows::new(directory, [chunk]).row(&plan.campaign, flight, arm)?;
    let row: BTreeMap<String, String> = row.into_iter().flatten().collect();
    let is_success = row.get("success").is_some_and(|success| success == "true");
    Ok(row.get("outputs").map(|outputs| Flown {
        outputs: outputs.clone(),
        is_success,
    }))
}

/// Holds the newest flight in a directory against a row.
fn compare(out: &Path, row: Option<&Flown>) -> Result<u8, Failure> {
    let log = find_log(Path::new("latest"), Some(out))?;
    against(
        &fly_again(&log, 0, false, &Moved::new())?
            .summary
            .outputs
            .to_string(),
        row,
    )
}

/// Holds the outputs of a flight against a row's.
fn against(outputs: &str, row: Option<&Flown>) -> Result<u8, Failure> {
    let (words, code) = match row {
        None => (
            format!("outputs {outputs}; the campaign has no row of this flight"),
            OK,
        ),
        Some(row) if row.outputs == outputs => {
            let success = if row.is_success {
                "a success"
            } else {
                "no success"
            };
            (
                format!(
                    "outputs {outputs}, as in the campaign's row, which is {success} by the campaign's gates"
                ),
                OK,
            )
        }
        Some(row) => (
            format!(
                "outputs {outputs}, but the campaign's row has {}",
                row.outputs
            ),
            GATE,
        ),
    };
    print(&format!("{words}\n"))?;
    Ok(code)
}
