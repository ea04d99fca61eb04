//! `ironbird floor`: compares flights with the best that this machine can do.

pub mod comparisons;
pub mod flight_baseline;
pub mod flight_runner;
pub mod loop_cpus;

use std::time::{Duration, SystemTime};

use analysis::host::Host;
use analysis::statistics::median;
use errors::output::print;
use errors::{Failure, NO_REAL_TIME, OK};
use flight_log::wall_time::utc;
use host::floor::ring::{END, Link, Work};
use ipc::clock::now_ns;
use process::rt::{fifo_refusal, take_stand};
use render::document::{Cell, Table, known, row};
use serde::Serialize;

use crate::cli::{FloorArgs, HopArgs};
use crate::floor::comparisons::{Comparison, Pair, compare};
use crate::floor::flight_runner::FlightRunner;

/// SCHED_FIFO priority of the mixer, the highest of a flight's by default.
const PRIORITY: i32 = 83;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Page {
    host: Host,
    started: String,
    version: String,
    command: String,
    comparisons: Vec<Comparison>,
}

pub fn floor(args: &FloorArgs) -> Result<u8, Failure> {
    let (pairs, seconds) = (args.pairs, args.seconds);
    if let Some(refusal) = fifo_refusal(PRIORITY) {
        let refused = format!("SCHED_FIFO is refused: {refusal}");
        return Err(Failure::new(NO_REAL_TIME, refused)
            .help("run `ironbird doctor`: it names what to change"));
    }
    let runner = FlightRunner::new()?;
    let started = utc(SystemTime::now());
    let mut command = format!("ironbird floor --pairs {pairs} --seconds {seconds}");
    if !args.flags.is_empty() {
        command += &format!(" -- {}", args.flags.join(" "));
    }
    let page = Page {
        host: host::cpu_times::host(),
        started,
        version: format!("ironbird {}", crate::build::here()),
        command,
        comparisons: compare(&runner, &args.flags, pairs, Duration::from_secs(seconds))?,
    };
    if args.json {
        let json = serde_json::to_string_pretty(&page);
        print(&(json.map_err(|e| Failure::failed(e.to_string()))? + "\n"))?;
    } else {
        print(&page.markdown())?;
    }
    Ok(OK)
}

const LEGEND: &str = "
Both sides of a pair run back to back, alternating; *ours* and *floor* are \
medians over the pairs, of misses means. The ratio is the median of the pairs' ratios, with an interval of at least \
95 % by order statistics. Pairs during which the host stole more than 1 % of the processor are left out.

* *wake*: from the start of a tick to the plant's wake-up, compared with a bare timer on the same processor at the same priority and period. It shows what early wake-up gains; *timer*, from the instant the timer was set to, shows the kernel alone.
* *loop*: from sampling the state to publishing the rotor command, compared with a raw futex ring of four processes that compute as long.
* *misses*: missed deadlines, compared with ticks in which the bare timer woke too late for the median loop or not at all.
";

impl Page {
    fn markdown(&self) -> String {
        let (host, under) = (&self.host, self.host.below());
        let (kernel, preemption, cpu, cpus) =
            (&host.kernel, &host.preemption, &host.cpu, host.cpus);
        let columns = "figure;ours;floor;ratio;95 % interval;pairs".split(';');
        let table = Table::new(columns, self.comparisons.iter().map(compared)).markdown();
        let Self {
            started,
            version,
            command,
            ..
        } = self;
        format!(
            "# Benchmarks\n\nWritten by `{command}` ({version}) on {started}.\n\n\
             Machine: {cpus} x {cpu}{under}, Linux {kernel} ({preemption}).\n\n\
             {table}{LEGEND}"
        )
    }
}

fn compared(comparison: &Comparison) -> Vec<Cell> {
    let Comparison { name, unit, pairs } = comparison;
    // Not a number where no pair counts.
    let shown = |value: f64| value.is_finite().then(|| format!("{value:.2}"));
    let is_count = unit == "per million";
    let side = |of: fn(&Pair) -> f64| {
        let values: Vec<f64> = comparison.undisturbed().map(of).collect();
        let middle = match is_count {
            true => values.iter().sum::<f64>() / values.len() as f64,
            false => median(&values),
        };
        known(shown(middle).map(|it| format!("{it} {unit}")))
    };
    let (ours, floor) = (side(|pair| pair.ours), side(|pair| pair.floor));
    // Of rare events, few pairs have no ratio.
    let ratio = known(shown(comparison.ratio()).filter(|_| !is_count));
    let interval = comparison.interval().filter(|_| !is_count);
    let interval = known(interval.map(|i| format!("{:.2} to {:.2}", i.low, i.high)));
    let pairs = format!("{} of {}", comparison.undisturbed().count(), pairs.len());
    row([name, &ours, &floor, &ratio, &interval, &pairs])
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
