//! The results of `ironbird floor`, as Markdown and as JSON.

use clap::ValueEnum as _;
use serde::{Deserialize, Serialize};

use crate::cli::Set;
use crate::floor::rates::{self, RateRow};
use analysis::host::Host;
use host::floor::comparison::{FloorComparison, GoalVerdict};
use render::document::{Cell, Table, known, row};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Page {
    pub host: Host,
    pub sets: Vec<MeasuredSet>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredSet {
    pub set: Set,
    pub started: String,
    pub version: String,
    pub command: String,
    pub comparisons: Vec<FloorComparison>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rates: Vec<RateRow>,
    pub left_out: Option<String>,
}

const LEGEND: &str = "\
* *wake*: from the start of a tick to the plant's wake-up, compared with `cyclictest` on the same processor at the same priority and period. It shows what early wake-up gains; *timer*, from the instant the timer was set to, shows the kernel alone.\n\
* *loop*: from sampling the state to publishing the rotor command, compared with a raw futex ring of four processes that compute as long. The ring has warm-up runs only in the lines *ring with warm-up runs*.\n\
* *2 CPUs*: flights with `--loop-cpus 2`, compared with a futex ring with warm-up runs on one CPU, a ring that polls on two, and flights on one.\n\
* *2 channels*: flights with `--channels 2`, compared with flights with one. A second flight with one channel shows what two equal flights differ by.\n\
* *misses*: missed deadlines, compared with ticks in which cyclictest woke too late for the median loop or not at all.\n\
* *lockstep tick*: a tick of `fly --pace lockstep`, compared with a lap of a raw eventfd ring of four processes under SCHED_OTHER.\n\
* *laws*: one tick of the four stages, compared with the same equations hand-written for one airframe, with constants that the compiler can fold.\n\
* *replay --verify*: a tick read from a log, flown again and compared bit for bit, against a tick of `simulate` of the same flight; whole processes.\n\
";

const CONDITIONS: &str = "
Both sides of a pair run back to back, alternating; *ours* and *floor* are \
medians over the pairs. The ratio is the median of the pairs' ratios, with an interval of at least \
95 % by order statistics. Misses are pooled, with a bootstrap over pairs. `met` and `missed`: the \
whole interval is on one side of the goal. Pairs during which the host stole more than 1 % of the \
processor are left out.

";

const RATES: &str = "
## Rates

Per tick [us], in short flights, where one stall changes a row; *loops*: all four together; *bare timer*: late wake-ups of cyclictest.

";

impl Page {
    pub const fn new(host: Host) -> Self {
        Self {
            host,
            sets: Vec::new(),
        }
    }

    /// Replaces an earlier measurement of the same set, unless the new one was left out.
    pub fn take(&mut self, measured: MeasuredSet) {
        let mut known = self.sets.iter().filter(|known| known.set == measured.set);
        if measured.left_out.is_some() && known.any(|known| known.left_out.is_none()) {
            return;
        }
        self.sets.retain(|known| known.set != measured.set);
        self.sets.push(measured);
        self.sets.sort_by_key(|known| known.set);
    }

    pub fn markdown(&self) -> String {
        let (host, under) = (&self.host, self.host.below());
        let (kernel, preemption, cpu, cpus) =
            (&host.kernel, &host.preemption, &host.cpu, host.cpus);
        let mut page = format!(
            "# Benchmarks\n\nWritten by `ironbird floor`; raw numbers in [benchmarks.json](benchmarks.json).\n\n\
             Machine: {cpus} x {cpu}{under}, Linux {kernel} ({preemption}).\n\n"
        );
        let comparisons = || self.sets.iter().flat_map(|set| &set.comparisons);
        if comparisons().next().is_some() {
            let columns = "figure;ours;floor;ratio;95 % interval;goal;pairs;verdict".split(';');
            page += &Table::new(columns, comparisons().map(compared)).markdown();
            page += CONDITIONS;
            page += LEGEND;
        }
        for set in self.sets.iter().filter(|set| !set.rates.is_empty()) {
            page += RATES;
            page += &rates::table(&set.rates).markdown();
        }
        let sets = self.sets.iter().map(|it| {
            let when = match &it.left_out {
                None => it.started.clone(),
                Some(reason) => format!("not measured: {reason}"),
            };
            let command = format!("`{}`", it.command);
            row([&set_name(it.set), &when, &it.version, &command])
        });
        let sets = Table::new(["set", "when", "version", "command"], sets);
        page + "\n## Measured\n\n" + &sets.markdown()
    }
}

fn compared(comparison: &FloorComparison) -> Vec<Cell> {
    let FloorComparison { name, unit, .. } = comparison;
    let (sides, (measured, disturbed)) = (comparison.sides(), comparison.measured());
    // Not a number where no pair counts.
    let shown = |value: f64| value.is_finite().then(|| format!("{value:.2}"));
    let [ours, floor] = sides.map(|side| known(shown(side).map(|it| format!("{it} {unit}"))));
    let verdict = match comparison.verdict() {
        GoalVerdict::Met => "met".to_owned(),
        GoalVerdict::Missed => "missed".to_owned(),
        GoalVerdict::Inconclusive(why) => format!("inconclusive: {why}"),
    };
    let interval = comparison.interval();
    let interval = known(interval.map(|i| format!("{:.2} to {:.2}", i.low, i.high)));
    let (ratio, pairs) = (known(shown(comparison.value())), measured - disturbed);
    row([
        name,
        &ours,
        &floor,
        &ratio,
        &interval,
        &format!("<= {}", comparison.goal()),
        &pairs,
        &verdict,
    ])
}

pub fn set_name(set: Set) -> String {
    set.to_possible_value()
        .map_or_else(String::new, |value| value.get_name().to_owned())
}
