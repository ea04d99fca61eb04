//! What `ironbird floor` measured, as a page for people and as numbers for programs.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::calls::RoleCalls;
use super::comparison::{Comparison, Kind, Verdict};
use crate::record::host::Host;

/// Everything that was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// When, on the wall clock.
    pub started: String,
    /// Version of ironbird, and the commit where the working directory is a checkout.
    pub version: String,
    /// What was typed.
    pub command: String,
    /// The machine.
    pub host: Host,
    /// Figures beside their floors.
    pub comparisons: Vec<Comparison>,
    /// System calls per role; empty where nobody could count them.
    pub calls: Vec<RoleCalls>,
    /// What was left out, and why.
    pub left_out: Vec<String>,
}

/// How the name of a comparison's floor is explained.
const LEGEND: &str = "\
* *wake*: from a tick's begin to the plant's waking, beside `cyclictest` on the same processor with the same priority and period.\n\
* *loop*: from the sampling of the state to the publishing of the rotor command, beside a raw futex ring of four processes that compute as long.\n\
* *misses*: missed deadlines, beside samples of cyclictest later than a period less the loop's median. Ratio of all events; spread with any one pair left out.\n\
* *lockstep tick*: a tick of `fly --pace lockstep`, beside a lap of a raw eventfd ring of four processes, SCHED_OTHER; the line below says what 25 times real time would take.\n\
* *laws*: one tick of plant, outer loop, inner loop and mixer, beside the same written by hand in scalars; *simulate* is beside what 500 times real time would take.\n\
* *20 us put into a hop*: the instrument's own test, a ring beside one with that much more to do. Ratio of what was seen to what was put in.\n";

impl Measured {
    /// The page, in Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut page = String::from("# Benchmarks\n\n");
        // Writing into a string cannot fail.
        let _ = writeln!(
            page,
            "Written by `{}` on {}, {}; raw numbers in [benchmarks.json](benchmarks.json).\n",
            self.command, self.started, self.version
        );
        let _ = writeln!(page, "{}\n", self.machine());
        let _ = writeln!(
            page,
            "| figure | ours | floor | ratio | spread | goal | verdict |\n|---|---|---|---|---|---|---|"
        );
        for comparison in &self.comparisons {
            let _ = writeln!(page, "{}", row(comparison));
        }
        let _ = writeln!(
            page,
            "\nOurs and floor are medians over pairs measured one right after the other; the ratio is the pairs' median and the \
             spread its extremes. INCONCLUSIVE: the host stole more than 1 %, or the spread is wider than twice the distance to the goal.\n"
        );
        page += LEGEND;
        if !self.calls.is_empty() {
            let _ = writeln!(
                page,
                "\n## Per tick and role\n\n| role | system calls | of which | least | allocations | page faults |\n|---|---|---|---|---|---|"
            );
            for role in &self.calls {
                let calls: Vec<String> = role.calls.iter().map(|(name, calls)| format!("{name} {calls:.2}")).collect();
                let _ = writeln!(
                    page,
                    "| {} | {:.2} | {} | {} | {:.3} | {} |",
                    role.role,
                    role.total,
                    calls.join(", "),
                    role.least,
                    role.allocations,
                    role.faults
                );
            }
            let _ = writeln!(
                page,
                "\nThe least is one wait, and one notify where a stage follows. The one allocation is iceoryx2's, a loan of 48 bytes. Page faults \
                 are of the whole flight."
            );
        }
        for left_out in &self.left_out {
            let _ = writeln!(page, "\nNot measured: {left_out}.");
        }
        page
    }

    fn machine(&self) -> String {
        let Host { kernel, preemption, cpu, cpus, hypervisor, .. } = &self.host;
        let under = if *hypervisor { ", under a hypervisor" } else { "" };
        format!("Machine: {cpus} x {cpu}{under}, Linux {kernel} ({preemption}).")
    }
}

fn row(comparison: &Comparison) -> String {
    let Comparison { name, unit, kind, goal, pairs } = comparison;
    let ((ours, floor), (least, most)) = (comparison.sides(), comparison.spread());
    let steal = pairs.iter().map(|pair| pair.steal_percent).fold(0.0, f64::max);
    let verdict = match comparison.verdict() {
        Verdict::Met => "met".to_owned(),
        Verdict::Missed => "missed".to_owned(),
        Verdict::Inconclusive(why) => format!("INCONCLUSIVE: {why}"),
    };
    let goal = if *kind == Kind::Difference { "1 +- 0.1".to_owned() } else { format!("<= {goal}") };
    format!(
        "| {name} | {ours:.2} {unit} | {floor:.2} {unit} | {:.2} | {least:.2} to {most:.2} | {goal} | {verdict} ({} pairs, steal {steal:.2} %) |",
        comparison.ratio(),
        pairs.len()
    )
}
