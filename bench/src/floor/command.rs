//! `ironbird floor`: every figure of the rig beside the machine's own limit, measured in the same minutes.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use clap::{Args, ValueEnum};
use shared::rt::fifo_refusal;

use super::calls;
use super::cyclictest;
use super::flight::Hangar;
use super::page::Measured;
use super::sets::{self, Effort, Stress};
use crate::failure::{Failure, InFile as _, OK};
use crate::output::print;
use crate::record::host::Host;

/// SCHED_FIFO priority of the plant in flights of this command; the stages have one more each.
const PRIORITY: i32 = 80;
/// How many stages there are after the plant.
const STAGES: i32 = 3;

/// Flags of `floor`.
#[derive(Clone, Debug, Args)]
pub struct FloorArgs {
    /// What to measure, more than one with commas [default: everything].
    #[arg(long, value_enum, value_delimiter = ',', value_name = "SET")]
    pub only: Vec<Set>,
    /// Pairs of each comparison.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub pairs: u32,
    /// How long each side of a pair is measured [s]; below 11 s a 99.9th percentile has too few values.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub seconds: u64,
    /// Write benchmarks.md and benchmarks.json into this directory.
    #[arg(long, value_name = "DIR")]
    pub write: Option<PathBuf>,
}

/// A set of comparisons.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Set {
    /// Wakes, loop and misses of flights.
    Flights,
    /// Wakes and misses of flights beside a load.
    Load,
    /// Ticks in lockstep.
    Lockstep,
    /// A tick of the laws, and of `simulate`.
    Laws,
    /// A ring that is known to be slower.
    KnownSlow,
    /// System calls, allocations and page faults.
    Calls,
}

/// Measures and prints the page.
///
/// # Errors
/// Usage; where SCHED_FIFO is refused; where a measurement fails.
pub fn floor(args: &FloorArgs) -> Result<u8, Failure> {
    if let Some(directory) = &args.write {
        std::fs::create_dir_all(directory).map_err(|e| {
            Failure::usage(format!("cannot write into {}: {e}", directory.display()))
                .help("name a directory that you can write: --write DIR")
        })?;
    }
    let hangar = Hangar::new()?;
    let effort = Effort { pairs: args.pairs as usize, duration: Duration::from_secs(args.seconds), priority: PRIORITY };
    let mut measured = Measured {
        started: now(),
        version: version(),
        command: command(args),
        host: Host::read(),
        comparisons: Vec::new(),
        calls: Vec::new(),
        left_out: Vec::new(),
    };
    for set in Set::value_variants() {
        if args.only.is_empty() || args.only.contains(set) {
            eprintln!("measuring: {}", name(*set));
            measure(*set, &hangar, &effort, &mut measured)?;
        }
    }
    if let Some(directory) = &args.write {
        write(directory, &measured)?;
    }
    print(&measured.markdown())?;
    Ok(OK)
}

fn measure(set: Set, hangar: &Hangar, effort: &Effort, measured: &mut Measured) -> Result<(), Failure> {
    if matches!(set, Set::Flights | Set::Load | Set::KnownSlow)
        && let Some(refusal) = fifo_refusal(PRIORITY + STAGES)
    {
        measured.left_out.push(format!("{}, because SCHED_FIFO is refused: {refusal}", name(set)));
        return Ok(());
    }
    if matches!(set, Set::Flights | Set::Load) && !cyclictest::is_installed() {
        measured.left_out.push(format!("{}, because cyclictest is not installed (rt-tests)", name(set)));
        return Ok(());
    }
    match set {
        Set::Flights => measured.comparisons.extend(sets::flights(hangar, effort, false)?),
        Set::Load => match Stress::start(hangar) {
            Some(_load) => measured.comparisons.extend(sets::flights(hangar, effort, true)?),
            None => measured.left_out.push("flights under load, because stress-ng is not installed".into()),
        },
        Set::Lockstep => measured.comparisons.extend(sets::lockstep(hangar, effort)?),
        Set::Laws => measured.comparisons.extend(sets::laws(effort)?),
        Set::KnownSlow => measured.comparisons.extend(sets::known_slow(hangar, effort)?),
        Set::Calls if calls::is_installed() => measured.calls = calls::measure(hangar)?,
        Set::Calls => measured.left_out.push("system calls, because strace is not installed".into()),
    }
    Ok(())
}

fn name(set: Set) -> String {
    set.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

fn write(directory: &Path, measured: &Measured) -> Result<(), Failure> {
    let (page, numbers) = (directory.join("benchmarks.md"), directory.join("benchmarks.json"));
    std::fs::write(&page, measured.markdown()).in_file("write", &page)?;
    let text = serde_json::to_string_pretty(measured).in_file("write", &numbers)?;
    std::fs::write(&numbers, text + "\n").in_file("write", &numbers)
}

/// What was typed, without the path of the executable.
fn command(args: &FloorArgs) -> String {
    let mut text = format!("ironbird floor --pairs {} --seconds {}", args.pairs, args.seconds);
    if !args.only.is_empty() {
        let sets: Vec<String> = args.only.iter().map(|set| name(*set)).collect();
        text += &format!(" --only {}", sets.join(","));
    }
    text
}

/// Version, and the commit where the working directory is a checkout of the project.
fn version() -> String {
    let version = concat!("ironbird ", env!("CARGO_PKG_VERSION"));
    let git = Command::new("git").args(["describe", "--always", "--dirty"]).output();
    match git {
        Ok(output) if output.status.success() && Path::new("bench/src/floor").is_dir() => {
            format!("{version}, commit {}", String::from_utf8_lossy(&output.stdout).trim())
        }
        _ => version.into(),
    }
}

fn now() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%d %H:%M UTC").to_string()
}
