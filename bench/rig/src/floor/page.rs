//! The results of `ironbird floor`: a page for people, numbers for programs.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::floor::calls::RoleCalls;
use crate::floor::command::{Set, name};
use machine::floor::comparison::{FloorComparison, GoalVerdict};
use report::host::Host;

/// Figures beside their floors, of one machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Page {
    /// The machine.
    pub host: Host,
    /// What was measured on it, in the order of [`Set`].
    pub sets: Vec<MeasuredSet>,
}

/// A set of figures, measured in one go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredSet {
    /// Which.
    pub set: Set,
    /// When, on the wall clock.
    pub started: String,
    /// Version of ironbird, and the commit where the working directory is a checkout.
    pub version: String,
    /// What measures it again.
    pub command: String,
    /// Figures beside their floors.
    pub comparisons: Vec<FloorComparison>,
    /// System calls per role.
    pub calls: Vec<RoleCalls>,
    /// Why it was left out, where it was.
    pub left_out: Option<String>,
}

impl MeasuredSet {
    /// Nothing yet.
    #[must_use]
    pub const fn new(set: Set, started: String, version: String, command: String) -> Self {
        Self { set, started, version, command, comparisons: Vec::new(), calls: Vec::new(), left_out: None }
    }
}

/// How the name of a comparison's floor is explained.
const LEGEND: &str = "\
* *wake*: from a tick's begin to the plant's waking, beside `cyclictest` on the same processor with the same priority and period: what the lead buys.\n\
* *timer*: from the instant that the plant's timer was set to, which is a lead before its tick, to the plant's waking, beside the same: what the kernel does, in either.\n\
* *loop*: from the sampling of the state to the publishing of the rotor command, beside a raw futex ring of four processes that compute as long. A flight rehearses its tick, the ring does not; the ring of the lines *the ring rehearses too* does, with the flight's lead.\n\
* *misses*: missed deadlines, beside ticks for which cyclictest woke later than a period less the loop's median; ticks that it slept through count as ours do, with their whole lateness.\n\
* *lockstep tick*: a tick of `fly --pace lockstep`, beside a lap of a raw eventfd ring of four processes, SCHED_OTHER; the line below says what 25 times real time would take.\n\
* *laws*: one tick of plant, outer loop, inner loop and mixer, beside the same written by hand in scalars; *simulate* is beside what 500 times real time would take.\n\
* *replay --verify*: a tick of a lockstep flight that is read from its log, flown again and compared bit for bit, beside a tick of `simulate` of the same flight; whole processes, begin and end included.\n\
* *20 us put into a hop*: the instrument's own test, a ring with that much more to do beside one without. Ratio of what was seen to what was put in.\n";

/// What is said of all comparisons.
const CONDITIONS: &str = "
Ours and floor are medians over pairs whose sides were measured one right after the other, ours first in one pair and last in the next. \
The ratio is the median of the pairs' ratios, which is not the ratio of the medians. Its interval is that of order statistics: between the k-th smallest \
and the k-th largest ratio, the median lies with at least 95 %. Misses are pooled, and their interval is a bootstrap over pairs. \
`met` and `missed`: the whole interval lies on one side of the goal. Pairs during which the host stole more than 1 % of the measured \
processor are left out.

";

/// What is said of system calls.
const CALLS_LEGEND: &str = "
Of a flight without a lead (`--lead 0`): a rehearsal has a wait, and a notify where a stage follows, of its own. The least is one \
wait, and one notify where a stage follows. The mixer sets its timer by a call of its own, when its command is out, \
so that no timer is cancelled while the loop runs (decision 5). The one allocation is iceoryx2's, a loan of 48 bytes. Page faults are \
of the whole flight.
";

impl Page {
    /// A page without figures.
    #[must_use]
    pub const fn new(host: Host) -> Self {
        Self { host, sets: Vec::new() }
    }

    /// Takes a set in place of an earlier measurement of it. One that was left out replaces none that was not.
    pub fn take(&mut self, measured: MeasuredSet) {
        let is_known = self.sets.iter().any(|known| known.set == measured.set && known.left_out.is_none());
        if measured.left_out.is_some() && is_known {
            return;
        }
        self.sets.retain(|known| known.set != measured.set);
        self.sets.push(measured);
        self.sets.sort_by_key(|known| known.set);
    }

    /// The page, in Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut page = String::from("# Benchmarks\n\n");
        // Writing into a string cannot fail.
        let _ = writeln!(page, "Written by `ironbird floor`; raw numbers in [benchmarks.json](benchmarks.json).\n");
        let _ = writeln!(page, "{}\n", self.machine());
        let comparisons: Vec<&FloorComparison> = self.sets.iter().flat_map(|set| &set.comparisons).collect();
        if !comparisons.is_empty() {
            let _ = writeln!(
                page,
                "| figure | ours | floor | ratio | 95 % interval | goal | pairs | verdict |\n|---|---|---|---|---|---|---|---|"
            );
            for comparison in comparisons {
                let _ = writeln!(page, "{}", row(comparison));
            }
            page += CONDITIONS;
            page += LEGEND;
        }
        let calls: Vec<&RoleCalls> = self.sets.iter().flat_map(|set| &set.calls).collect();
        if !calls.is_empty() {
            page += &calls_per_tick(&calls);
        }
        page += "\n## Measured\n\n| set | when | version | measured again by |\n|---|---|---|---|\n";
        for MeasuredSet { set, started, version, command, left_out, .. } in &self.sets {
            let _ = match left_out {
                None => writeln!(page, "| {} | {started} | {version} | `{command}` |", name(*set)),
                Some(reason) => writeln!(page, "| {} | not measured: {reason} | {version} | `{command}` |", name(*set)),
            };
        }
        page
    }

    fn machine(&self) -> String {
        let Host { kernel, preemption, cpu, cpus, .. } = &self.host;
        let under = self.host.below();
        format!("Machine: {cpus} x {cpu}{under}, Linux {kernel} ({preemption}).")
    }
}

fn calls_per_tick(roles: &[&RoleCalls]) -> String {
    let mut text = String::from(
        "\n## Per tick and role\n\n| role | system calls | of which | least | allocations | page faults |\n|---|---|---|---|---|---|\n",
    );
    for RoleCalls { role, calls, total, least, allocations, faults } in roles {
        let calls: Vec<String> = calls.iter().map(|(name, calls)| format!("{name} {calls:.2}")).collect();
        let calls = calls.join(", ");
        text += &format!("| {role} | {total:.2} | {calls} | {least} | {allocations:.3} | {faults} |\n");
    }
    text + CALLS_LEGEND
}

fn row(comparison: &FloorComparison) -> String {
    let FloorComparison { name, unit, .. } = comparison;
    let ([ours, floor], (measured, disturbed)) = (comparison.sides(), comparison.measured());
    let verdict = match comparison.verdict() {
        GoalVerdict::Met => "met".to_owned(),
        GoalVerdict::Missed => "missed".to_owned(),
        GoalVerdict::Inconclusive(why) => format!("inconclusive: {why}"),
    };
    let interval = comparison.interval().map_or_else(|| "-".into(), |i| format!("{:.2} to {:.2}", i.low, i.high));
    let goal = comparison.goal();
    let pairs = measured - disturbed;
    format!(
        "| {name} | {ours:.2} {unit} | {floor:.2} {unit} | {:.2} | {interval} | {goal} | {pairs} | {verdict} |",
        comparison.value(),
    )
}
