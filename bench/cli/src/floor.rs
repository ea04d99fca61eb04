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
pub mod loop_cpus;
pub mod rates;

use flight_log::wall_time::utc;
use std::path::Path;
use std::time::{Duration, SystemTime};

use clap::ValueEnum as _;
use ipc::clock::now_ns;
use process::rt::{fifo_refusal, loop_processors, loops_cpu, take_stand};
use process::signals::end_with_launcher;

use crate::cli::{FloorArgs, HopArgs, Set};
use crate::export::create_for;
use crate::floor::benchmark_page::{MeasuredSet, Page, set_name};
use crate::floor::comparison_sets::{MeasuringEffort, Stress};
use crate::floor::flight_runner::FlightRunner;
use crate::floor::rates::RateRow;
use analysis::host::Host;
use errors::output::{print, say};
use errors::{Failure, InFile as _, OK, read_text};
use host::floor::comparison::FloorComparison;
use host::floor::cyclictest;
use host::floor::ring::{END, Link, Work};

/// SCHED_FIFO priority of the plant in flights of this command; each stage has one more.
const PRIORITY: i32 = 80;
const STAGES: i32 = 3;

pub fn floor(args: &FloorArgs) -> Result<u8, Failure> {
    if let Some(directory) = &args.write {
        create_for("write", directory, "--write")?;
    }
    let host = host::cpu_times::host();
    let mut page = match &args.write {
        Some(directory) => existing_page(&directory.join(NUMBERS), host)?,
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
            let (pairs, seconds, name) = (args.pairs, args.seconds, set_name(*set));
            let started = utc(SystemTime::now());
            let left_out = missing(*set);
            let (comparisons, rates) = match left_out {
                None => measure(&flights, &effort, *set)?,
                Some(_) => Default::default(),
            };
            page.take(MeasuredSet {
                set: *set,
                started,
                version: version.clone(),
                command: format!(
                    "ironbird floor --only {name} --pairs {pairs} --seconds {seconds}"
                ),
                comparisons,
                rates,
                left_out,
            });
            // Written after each set, so that a later failure does not lose it.
            if let Some(directory) = &args.write {
                write(directory, &page)?;
            }
        }
    }
    print(&page.markdown())?;
    Ok(OK)
}

fn missing(set: Set) -> Option<String> {
    if !matches!(
        set,
        Set::Flights | Set::Cpus | Set::Channels | Set::Rates | Set::Load
    ) {
        return None;
    }
    if let Some(refusal) = fifo_refusal(PRIORITY + STAGES) {
        return Some(format!("SCHED_FIFO is refused: {refusal}"));
    }
    if set == Set::Cpus {
        let is_one = loop_processors(loops_cpu(), 2).len() < 2;
        return is_one.then(|| "this process may use one CPU alone".into());
    }
    if set != Set::Channels && !cyclictest::is_installed() {
        return Some("cyclictest (rt-tests) is not installed".into());
    }
    (set == Set::Load && !Stress::is_installed()).then(|| "stress-ng is not installed".into())
}

fn measure(
    flights: &FlightRunner,
    effort: &MeasuringEffort,
    set: Set,
) -> Result<(Vec<FloorComparison>, Vec<RateRow>), Failure> {
    let comparisons = match set {
        Set::Rates => return rates::rates(flights, effort),
        Set::Flights => comparison_sets::flights(flights, effort, None),
        Set::Cpus => comparison_sets::cpus(flights, effort),
        Set::Channels => comparison_sets::channels(flights, effort),
        Set::Load => comparison_sets::flights(flights, effort, Some(&mut Stress::start(flights)?)),
        Set::Lockstep => comparison_sets::lockstep(flights, effort),
        Set::Laws => comparison_sets::laws(effort),
        Set::Replay => comparison_sets::replay(flights, effort),
    }?;
    Ok((comparisons, Vec::new()))
}

const NUMBERS: &str = "benchmarks.json";

fn existing_page(numbers: &Path, host: Host) -> Result<Page, Failure> {
    if !numbers.exists() {
        return Ok(Page::new(host));
    }
    let (text, place) = (read_text("read", numbers)?, numbers.display());
    let page: Page = serde_json::from_str(&text).map_err(|e| {
        Failure::usage(format!("{place} contains no figures of this version: {e}"))
            .help("remove it, or name another directory: --write DIR")
    })?;
    if page.host == host {
        return Ok(page);
    }
    say(&format!(
        "{place} is from another machine; its figures are discarded\n"
    ));
    Ok(Page::new(host))
}

fn write(directory: &Path, page: &Page) -> Result<(), Failure> {
    let (text, numbers) = (directory.join("benchmarks.md"), directory.join(NUMBERS));
    // A missing or unreadable page has no notes to keep.
    let old = std::fs::read_to_string(&text).unwrap_or_default();
    let notes = old.find("\n## Per tick and role\n");
    let notes = notes.map_or("", |begin| &old[begin..]);
    std::fs::write(&text, page.markdown() + notes).in_file("write", &text)?;
    let json = serde_json::to_string_pretty(page).in_file("write", &numbers)?;
    std::fs::write(&numbers, json + "\n").in_file("write", &numbers)
}

/// `ironbird ring-hop`: one process of the ring, started by the measuring process. Passes the token on until the ring
/// ends.
pub fn ring_hop(args: &HopArgs) -> Result<u8, Failure> {
    end_with_launcher(Some(args.launcher))?;
    let mut link = Link::inherited(
        args.by_eventfd,
        args.position,
        args.processes,
        args.polls_ns,
    )?;
    let work = Work {
        iterations: args.work,
    };
    let standing = take_stand(args.cpu, args.priority);
    if standing.priority != args.priority {
        let refused = standing.refused.join(", ");
        return Err(Failure::failed(format!("a process of the ring: {refused}")));
    }
    while link.wait(None)? != END {
        work.run();
        link.notify(now_ns())?;
    }
    Ok(OK)
}
