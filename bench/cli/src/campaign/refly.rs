//! `ironbird campaign fly`: repeats one flight of a campaign, with its log and report.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use campaign::chunk::{self, Rows, State};
use errors::{Failure, GATE, InFile as _, OK};

use crate::cli::{self, CampaignFlyArgs, FlyArgs};
use analysis::phrase::list;
use config::{PaceName, Settings, utf8};
use errors::output::print;
use experiments::campaign::flight_settings::{Plan, plan_of};
use recorder::run_directory::find_log;
use replay::fly_again;
use sim::recorded_timing::Timing;
use sim::simulate::{OutputFiles, report};

type Row = BTreeMap<String, String>;

/// Flies a flight again; in lockstep its outputs must be those of its row.
pub(super) fn fly(args: &CampaignFlyArgs) -> Result<u8, Failure> {
    let plan = plan_of(&args.directory)?;
    let arm = arm(&plan, args.arm.as_deref())?;
    if args.flight >= plan.campaign.flights {
        let (name, last) = (&plan.campaign.name, plan.campaign.flights - 1);
        return Err(Failure::usage(format!(
            "there is no flight {}: the campaign {name} has the flights 0 to {last}",
            args.flight
        ))
        .help("`ironbird campaign report DIR` lists the worst ones"));
    }
    let (mut settings, timing) = plan.flight(args.flight, arm)?;
    // A flight with a recorded timing or with late stages: processes in lockstep cannot fly it, as no stage is late there.
    let is_of_ticks_alone = timing.is_some() || !settings.planned()?.stages.is_empty();
    settings.flight.pace = match is_of_ticks_alone {
        true => PaceName::Realtime,
        false => PaceName::Lockstep,
    };
    if let Some(out) = &args.out {
        settings.recorder.out = utf8(out)?;
    }
    if args.print_config {
        let recorded = plan.recorded(args.flight, arm);
        let timed = recorded.map(|run| format!("# with --timing {}\n", run.display()));
        print(&(timed.unwrap_or_default() + &settings.commented()?))?;
        return Ok(OK);
    }
    let row = row(&plan, &args.directory, args.flight, arm)?;
    if is_of_ticks_alone {
        return simulated(&plan, args, arm, &settings, timing, &row);
    }
    let held = tempfile::tempdir()
        .map_err(|e| Failure::failed(format!("cannot make a directory: {e}")))?;
    let file = held.path().join("settings.toml");
    fs::write(&file, settings.commented()?).in_file("write", &file)?;
    let mut flown = FlyArgs::default();
    flown.flight.course.config = Some(file);
    flown.rt.instance = args.instance.clone().unwrap_or_else(|| "default".into());
    let (code, directory) = cli::fly::flown(&flown)?;
    let Some(directory) = directory.filter(|_| [OK, GATE].contains(&code)) else {
        return Ok(code);
    };
    let flown = fly_again(&find_log(&directory, None)?, 0, false, &[])?;
    compare(&flown.summary.outputs.to_string(), &row)
}

fn arm(plan: &Plan, name: Option<&str>) -> Result<usize, Failure> {
    let campaign = &plan.campaign;
    name.map_or(Ok(0), |name| {
        campaign.arm(name).ok_or_else(|| {
            let arms = list(campaign.arms.iter().map(|arm| &arm.name));
            let campaign = &campaign.name;
            Failure::usage(format!(
                "--arm {name}: the campaign {campaign} has no such arm"
            ))
            .help(format!("its arms are {arms}"))
        })
    })
}

fn simulated(
    plan: &Plan,
    args: &CampaignFlyArgs,
    arm: usize,
    settings: &Settings,
    timing: Option<&Timing>,
    row: &Row,
) -> Result<u8, Failure> {
    let (campaign, arm) = (&plan.campaign.name, &plan.campaign.arms[arm].name);
    let name = format!("{campaign}-{}-{arm}", args.flight);
    let directory = Path::new(&settings.recorder.out).join(name);
    fs::create_dir_all(&directory).in_file("make the directory", &directory)?;
    let [file, states, plot] =
        ["settings.toml", "states.csv", "flight.svg"].map(|name| directory.join(name));
    fs::write(&file, settings.commented()?).in_file("write", &file)?;
    let outputs = OutputFiles {
        states: Some(&states),
        plot: Some(&plot),
    };
    let (flown, _) = report(settings, timing, &outputs)?;
    let place = directory.display();
    print(&format!("{place}: settings.toml, states.csv, flight.svg\n"))?;
    compare(&flown.outputs.to_string(), row)
}

/// The row of a flight; none if its chunk is not whole.
fn row(plan: &Plan, directory: &Path, flight: u64, arm: usize) -> Result<Row, Failure> {
    let chunk = flight / plan.campaign.chunk;
    if chunk::state(directory, &plan.campaign, &plan.identity, chunk) != State::Whole {
        return Ok(Row::new());
    }
    let row = Rows::new(directory, [chunk]).row(&plan.campaign, flight, arm)?;
    Ok(row.into_iter().flatten().collect())
}

/// Compares the outputs of a flight with those of its row.
fn compare(outputs: &str, row: &Row) -> Result<u8, Failure> {
    let (comparison, code) = match row.get("outputs") {
        None => ("; the campaign has no row of this flight".into(), OK),
        Some(row) if row != outputs => (format!(", but the campaign's row has {row}"), GATE),
        Some(_) => {
            let no = if row["success"] == "true" { "a" } else { "no" };
            let row = format!(", as in the campaign's row, which is {no} success");
            (row + " by the campaign's gates", OK)
        }
    };
    print(&format!("outputs {outputs}{comparison}\n"))?;
    Ok(code)
}
