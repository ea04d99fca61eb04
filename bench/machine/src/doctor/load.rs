//! Findings about load: how much of the machine's time others take.

use crate::Machine;
use crate::cpu_times::CpuTimes;
use report::finding::Finding;
use report::host::Steal;

/// Share of the time from which on figures say more about the host than about anything here [%].
pub const STEAL_MAX_PERCENT: f64 = 1.0;

const WHY: &str = "time that the host gave to other virtual machines, while a loop here wanted to run";
const FIX: &str = "ask whoever runs the host for processors of your own, or fly elsewhere";

/// Findings about load.
#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    vec![stolen("steal since boot", &CpuTimes::default().steal_until(&CpuTimes::of(machine, None)))]
}

/// What was stolen in a stretch of time.
#[must_use]
pub fn stolen(subject: &str, steal: &Steal) -> Finding {
    let found = format!("{:.2} % of all processors' time ({} ms)", steal.percent, steal.stolen_ms);
    let finding = Finding::ok(subject, found, WHY);
    if steal.percent > STEAL_MAX_PERCENT { finding.softens(FIX) } else { finding }
}
