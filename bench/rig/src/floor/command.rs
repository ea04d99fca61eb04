//! `ironbird floor`: measures each figure of the rig beside the machine's own limit.

use crate::wall_time::utc;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::time::SystemTime;

use clap::{Args, ValueEnum};
use role::rt::fifo_refusal;
use serde::{Deserialize, Serialize};

use crate::floor::calls;
use crate::floor::flight::Hangar;
use crate::floor::page::{MeasuredSet, Page};
use crate::floor::sets::{self, MeasuringEffort, Stress};
use crate::output::{print, say};
use failure::{Failure, InFile as _, OK, read_text};
use machine::floor::cyclictest;

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
    /// Pairs of each comparison; below 6 there is no verdict.
    #[arg(long, default_value_t = 9, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub pairs: u32,
    /// How long each side of a pair is measured [s]; below 11 s a 99.9th percentile has too few values.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub seconds: u64,
    /// Write benchmarks.md and benchmarks.json into this directory; sets in them that are not measured now stay.
    #[arg(long, value_name = "DIR")]
    pub write: Option<PathBuf>,
}

/// A set of comparisons.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Set {
    /// Wakes, loop and misses of flights.
    Flights,
    /// Wakes and misses of flights beside a load.
    Load,
    /// Ticks in lockstep.
    Lockstep,
    /// A tick of the laws, and of `simulate`.
    Laws,
    /// A flight flown again from its log, and compared bit for bit.
    Replay,
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
    let host = machine::cpu_times::host();
    let mut page = match &args.write {
        Some(directory) => kept(&directory.join(NUMBERS), &host)?,
        None => Page::new(host),
    };
    let hangar = Hangar::new()?;
    let effort =
        MeasuringEffort { pairs: args.pairs as usize, duration: Duration::from_secs(args.seconds), priority: PRIORITY };
    // Before anything is written: figures do not make the checkout dirty that they are of.
    let version = format!("ironbird {}", crate::build::here());
    for set in Set::value_variants() {
        if args.only.is_empty() || args.only.contains(set) {
            say(&format!("measuring: {}\n", name(*set)));
            let mut measured = MeasuredSet::new(*set, now(), version.clone(), command(args, *set));
            match missing(*set) {
                Some(reason) => measured.left_out = Some(reason),
                None => measure(&hangar, &effort, &mut measured)?,
            }
            page.take(measured);
            // What is measured is not lost with what comes after it.
            if let Some(directory) = &args.write {
                write(directory, &page)?;
            }
        }
    }
    print(&page.markdown())?;
    Ok(OK)
}

/// What a set needs and is not there.
fn missing(set: Set) -> Option<String> {
    if matches!(set, Set::Flights | Set::Load | Set::KnownSlow)
        && let Some(refusal) = fifo_refusal(PRIORITY + STAGES)
    {
        return Some(format!("SCHED_FIFO is refused: {refusal}"));
    }
    let lacks = |is_there: bool, what: &str| (!is_there).then(|| format!("{what} is not installed"));
    match set {
        Set::Flights => lacks(cyclictest::is_installed(), "cyclictest (rt-tests)"),
        Set::Load => lacks(cyclictest::is_installed(), "cyclictest (rt-tests)")
            .or_else(|| lacks(Stress::is_installed(), "stress-ng")),
        Set::Calls => lacks(calls::is_installed(), "strace"),
        Set::Lockstep | Set::Laws | Set::Replay | Set::KnownSlow => None,
    }
}

fn measure(hangar: &Hangar, effort: &MeasuringEffort, measured: &mut MeasuredSet) -> Result<(), Failure> {
    match measured.set {
        Set::Flights => measured.comparisons = sets::flights(hangar, effort, None)?,
        Set::Load => {
            let mut load = Stress::start(hangar)?;
            measured.comparisons = sets::flights(hangar, effort, Some(&mut load))?;
        }
        Set::Lockstep => measured.comparisons = sets::lockstep(hangar, effort)?,
        Set::Laws => measured.comparisons = sets::laws(effort)?,
        Set::Replay => measured.comparisons = sets::replay(hangar, effort)?,
        Set::KnownSlow => measured.comparisons = sets::known_slow(hangar, effort)?,
        Set::Calls => measured.calls = calls::measure(hangar)?,
    }
    Ok(())
}

/// A set as it is named on the command line.
pub(super) fn name(set: Set) -> String {
    set.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// The numbers beside the page.
const NUMBERS: &str = "benchmarks.json";

/// The page that is there, where it is of this machine.
fn kept(numbers: &Path, host: &report::host::Host) -> Result<Page, Failure> {
    if !numbers.exists() {
        return Ok(Page::new(host.clone()));
    }
    let text = read_text("read", numbers)?;
    let page: Page = serde_json::from_str(&text).map_err(|e| {
        Failure::usage(format!("{} holds no figures of this version: {e}", numbers.display()))
            .help("remove it, or name another directory: --write DIR")
    })?;
    if page.host == *host {
        return Ok(page);
    }
    say(&format!("{} is of another machine: its figures are not kept\n", numbers.display()));
    Ok(Page::new(host.clone()))
}

fn write(directory: &Path, page: &Page) -> Result<(), Failure> {
    let (text, numbers) = (directory.join("benchmarks.md"), directory.join(NUMBERS));
    // A page that is not there yet, or cannot be read, has nothing to keep.
    let tried = std::fs::read_to_string(&text).unwrap_or_default();
    std::fs::write(&text, page.markdown() + tried_of(&tried)).in_file("write", &text)?;
    let json = serde_json::to_string_pretty(page).in_file("write", &numbers)?;
    std::fs::write(&numbers, json + "\n").in_file("write", &numbers)
}

/// What people write at the end of the page: what was tried and measured otherwise.
fn tried_of(page: &str) -> &str {
    page.find("\n## Tried\n").map_or("", |begin| &page[begin..])
}

/// What measures a set again.
fn command(args: &FloorArgs, set: Set) -> String {
    format!("ironbird floor --only {} --pairs {} --seconds {}", name(set), args.pairs, args.seconds)
}

fn now() -> String {
    utc(SystemTime::now())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_people_wrote_at_the_end_of_the_page_stays() {
        let page = "# Benchmarks\n\nfigures\n\n## Tried\n\n| try | ratio |\n";
        assert_eq!(tried_of(page), "\n## Tried\n\n| try | ratio |\n");
        assert_eq!(tried_of("# Benchmarks\n\nfigures, tried\n"), "");
    }
}
