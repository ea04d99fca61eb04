//! `ironbird floor`: compares the rig's figures with the fastest that this machine can do.
//!
//! ```text
//! timer, ring, cyclictest, scalar laws --A--> pairs --> comparison --> docs/benchmarks.md
//! flights, lockstep, laws              --B-->
//! ```

pub mod benchmark_page;
pub mod comparison_sets;
pub mod flight_baseline;
pub mod flight_runner;
pub mod ring_stage;
pub mod system_calls;

use crate::wall_time::utc;
use std::path::Path;
use std::time::Duration;
use std::time::SystemTime;

use clap::ValueEnum as _;
use process::rt::fifo_refusal;

use crate::cli::{FloorArgs, Set};
use crate::floor::benchmark_page::{MeasuredSet, Page, set_name};
use crate::floor::comparison_sets::{MeasuringEffort, Stress};
use crate::floor::flight_runner::FlightRunner;
use crate::output::{print, say};
use errors::{Failure, InFile as _, OK, read_text};
use host::floor::cyclictest;

/// SCHED_FIFO priority of the plant in flights of this command; each stage has one more.
const PRIORITY: i32 = 80;
const STAGES: i32 = 3;

pub fn floor(args: &FloorArgs) -> Result<u8, Failure> {
    if let Some(directory) = &args.write {
        std::fs::create_dir_all(directory).map_err(|e| {
            Failure::usage(format!("cannot write into {}: {e}", directory.display()))
                .help("name a writable directory: --write DIR")
        })?;
    }
    let host = host::cpu_times::host();
    let mut page = match &args.write {
        Some(directory) => existing_page(&directory.join(NUMBERS), &host)?,
        None => Page::new(host),
    };
    let flights = FlightRunner::new()?;
    let effort = MeasuringEffort {
        pairs: args.pairs as usize,
        duration: Duration::from_secs(args.seconds),
        priority: PRIORITY,
    };
    // Read before anything is written: the new figures would mark the checkout as dirty.
    let version = format!("ironbird {}", crate::build::here());
    for set in Set::value_variants() {
        if args.only.is_empty() || args.only.contains(set) {
            say(&format!("measuring: {}\n", set_name(*set)));
            let mut measured = MeasuredSet::new(*set, now(), version.clone(), command(args, *set));
            match missing(*set) {
                Some(reason) => measured.left_out = Some(reason),
                None => measure(&flights, &effort, &mut measured)?,
            }
            page.take(measured);
            // Written after each set, so that a later failure does not lose it.
            if let Some(directory) = &args.write {
                write(directory, &page)?;
            }
        }
    }
    print(&page.markdown())?;
    Ok(OK)
}

/// Why a set cannot be measured here.
fn missing(set: Set) -> Option<String> {
    if matches!(set, Set::Flights | Set::Load | Set::KnownSlow)
        && let Some(refusal) = fifo_refusal(PRIORITY + STAGES)
    {
        return Some(format!("SCHED_FIFO is refused: {refusal}"));
    }
    let lacks =
        |is_there: bool, what: &str| (!is_there).then(|| format!("{what} is not installed"));
    match set {
        Set::Flights => lacks(cyclictest::is_installed(), "cyclictest (rt-tests)"),
        Set::Load => lacks(cyclictest::is_installed(), "cyclictest (rt-tests)")
            .or_else(|| lacks(Stress::is_installed(), "stress-ng")),
        Set::Calls => lacks(system_calls::is_installed(), "strace"),
        Set::Lockstep | Set::Laws | Set::Replay | Set::KnownSlow => None,
    }
}

fn measure(
    flights: &FlightRunner,
    effort: &MeasuringEffort,
    measured: &mut MeasuredSet,
) -> Result<(), Failure> {
    match measured.set {
        Set::Flights => measured.comparisons = comparison_sets::flights(flights, effort, None)?,
        Set::Load => {
            let mut load = Stress::start(flights)?;
            measured.comparisons = comparison_sets::flights(flights, effort, Some(&mut load))?;
        }
        Set::Lockstep => measured.comparisons = comparison_sets::lockstep(flights, effort)?,
        Set::Laws => measured.comparisons = comparison_sets::laws(effort)?,
        Set::Replay => measured.comparisons = comparison_sets::replay(flights, effort)?,
        Set::KnownSlow => measured.comparisons = comparison_sets::known_slow(flights, effort)?,
        Set::Calls => measured.calls = system_calls::measure(flights)?,
    }
    Ok(())
}

const NUMBERS: &str = "benchmarks.json";

/// The existing page, if it is of this machine.
fn existing_page(numbers: &Path, host: &report::host::Host) -> Result<Page, Failure> {
    if !numbers.exists() {
        return Ok(Page::new(host.clone()));
    }
    let text = read_text("read", numbers)?;
    let page: Page = serde_json::from_str(&text).map_err(|e| {
        Failure::usage(format!(
            "{} contains no figures of this version: {e}",
            numbers.display()
        ))
        .help("remove it, or name another directory: --write DIR")
    })?;
    if page.host == *host {
        return Ok(page);
    }
    say(&format!(
        "{} is from another machine; its figures are discarded\n",
        numbers.display()
    ));
    Ok(Page::new(host.clone()))
}

fn write(directory: &Path, page: &Page) -> Result<(), Failure> {
    let (text, numbers) = (directory.join("benchmarks.md"), directory.join(NUMBERS));
    // A missing or unreadable page has no notes to keep.
    let tried = std::fs::read_to_string(&text).unwrap_or_default();
    std::fs::write(&text, page.markdown() + tried_of(&tried)).in_file("write", &text)?;
    let json = serde_json::to_string_pretty(page).in_file("write", &numbers)?;
    std::fs::write(&numbers, json + "\n").in_file("write", &numbers)
}

/// The hand-written notes at the end of the page.
fn tried_of(page: &str) -> &str {
    page.find("\n## Tried\n").map_or("", |begin| &page[begin..])
}

fn command(args: &FloorArgs, set: Set) -> String {
    format!(
        "ironbird floor --only {} --pairs {} --seconds {}",
        set_name(set),
        args.pairs,
        args.seconds
    )
}

fn now() -> String {
    utc(SystemTime::now())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hand_written_notes_at_the_end_of_the_page_stay() {
        let page = "# Benchmarks\n\nfigures\n\n## Tried\n\n| try | ratio |\n";
        assert_eq!(tried_of(page), "\n## Tried\n\n| try | ratio |\n");
        assert_eq!(tried_of("# Benchmarks\n\nfigures, tried\n"), "");
    }
}
