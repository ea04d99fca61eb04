//! The result of `ironbird floor`, as Markdown and as JSON.

use serde::Serialize;

use analysis::host::Host;
use host::floor::comparison::FloorComparison;
use render::document::{Cell, Table, known, row};

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Page {
    pub host: Host,
    pub started: String,
    pub version: String,
    pub command: String,
    pub comparisons: Vec<FloorComparison>,
    /// Why ironbird's own timer stood in for cyclictest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_timer: Option<String>,
}

const LEGEND: &str = "\
* *wake*: from the start of a tick to the plant's wake-up, compared with `cyclictest` on the same processor at the same priority and period. It shows what early wake-up gains; *timer*, from the instant the timer was set to, shows the kernel alone.\n\
* *loop*: from sampling the state to publishing the rotor command, compared with a raw futex ring of four processes that compute as long. The ring has warm-up runs only in the lines *ring with warm-up runs*.\n\
* *misses*: missed deadlines, compared with ticks in which cyclictest woke too late for the median loop or not at all. Where cyclictest cannot run, ironbird's own timer stands in for it, as the page then says.\n\
";

const CONDITIONS: &str = "
Both sides of a pair run back to back, alternating; *ours* and *floor* are \
medians over the pairs. The ratio is the median of the pairs' ratios, with an interval of at least \
95 % by order statistics. Misses are pooled, with a bootstrap over pairs. Pairs during which the host stole more than 1 % of the \
processor are left out.

";

impl Page {
    pub fn markdown(&self) -> String {
        let (host, under) = (&self.host, self.host.below());
        let (kernel, preemption, cpu, cpus) =
            (&host.kernel, &host.preemption, &host.cpu, host.cpus);
        let columns = "figure;ours;floor;ratio;95 % interval;pairs".split(';');
        let table = Table::new(columns, self.comparisons.iter().map(compared)).markdown();
        let Self {
            started,
            version,
            command,
            own_timer,
            ..
        } = self;
        let timer = own_timer.as_ref();
        let timer = timer.map_or(String::new(), |reason| format!(" Own timer: {reason}."));
        format!(
            "# Benchmarks\n\nWritten by `{command}` ({version}) on {started}; raw numbers in \
             [benchmarks.json](benchmarks.json).{timer}\n\n\
             Machine: {cpus} x {cpu}{under}, Linux {kernel} ({preemption}).\n\n\
             {table}{CONDITIONS}{LEGEND}"
        )
    }
}

fn compared(comparison: &FloorComparison) -> Vec<Cell> {
    let FloorComparison { name, unit, .. } = comparison;
    let (sides, (measured, disturbed)) = (comparison.sides(), comparison.measured());
    // Not a number where no pair counts.
    let shown = |value: f64| value.is_finite().then(|| format!("{value:.2}"));
    let [ours, floor] = sides.map(|side| known(shown(side).map(|it| format!("{it} {unit}"))));
    let interval = comparison.interval();
    let interval = known(interval.map(|i| format!("{:.2} to {:.2}", i.low, i.high)));
    let ratio = known(shown(comparison.value()));
    let pairs = format!("{} of {measured}", measured - disturbed);
    row([name, &ours, &floor, &ratio, &interval, &pairs])
}
