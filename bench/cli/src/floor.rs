//! `ironbird floor`: compares flights with the best that this machine can do.
//!
//! ```text
//! timer, ring --A--> pairs --> comparison --> docs/benchmarks.md
//! flight      --B-->
//! ```

pub mod benchmark_page;
pub mod comparisons;
pub mod flight_baseline;
pub mod flight_runner;
pub mod loop_cpus;

use flight_log::wall_time::utc;
use std::cell::RefCell;
use std::path::Path;
use std::time::{Duration, SystemTime};

use ipc::clock::now_ns;
use process::rt::{fifo_refusal, take_stand};

use crate::cli::{FloorArgs, HopArgs};
use crate::export::create_for;
use crate::floor::benchmark_page::Page;
use crate::floor::comparisons::MeasuringEffort;
use crate::floor::flight_runner::FlightRunner;
use errors::output::print;
use errors::{Failure, InFile as _, NO_REAL_TIME, OK};
use host::floor::ring::{END, Link, Work};

/// SCHED_FIFO priority of the plant in flights of this command; each stage has one more.
const PRIORITY: i32 = 80;
const STAGES: i32 = 3;

pub fn floor(args: &FloorArgs) -> Result<u8, Failure> {
    if let Some(directory) = &args.write {
        create_for("write", directory, "--write")?;
    }
    let (pairs, seconds) = (args.pairs, args.seconds);
    if let Some(refusal) = fifo_refusal(PRIORITY + STAGES) {
        let refused = format!("SCHED_FIFO is refused: {refusal}");
        return Err(Failure::new(NO_REAL_TIME, refused)
            .help("run `ironbird doctor`: it names what to change"));
    }
    let effort = MeasuringEffort {
        pairs: pairs as usize,
        duration: Duration::from_secs(seconds),
        priority: PRIORITY,
        own_timer: RefCell::default(),
    };
    // Read before anything is written: the new figures would mark the checkout as dirty.
    let version = format!("ironbird {}", crate::build::here());
    let started = utc(SystemTime::now());
    let page = Page {
        host: host::cpu_times::host(),
        started,
        version,
        command: format!("ironbird floor --pairs {pairs} --seconds {seconds}"),
        comparisons: comparisons::compare(&FlightRunner::new()?, &effort)?,
        own_timer: effort.own_timer.take(),
    };
    if let Some(directory) = &args.write {
        write(directory, &page)?;
    }
    print(&page.markdown())?;
    Ok(OK)
}

fn write(directory: &Path, page: &Page) -> Result<(), Failure> {
    let [text, numbers] = ["md", "json"].map(|it| directory.join(format!("benchmarks.{it}")));
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
    let mut link = Link::inherited(args.position, args.processes)?;
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
