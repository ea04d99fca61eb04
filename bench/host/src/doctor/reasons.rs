//! Why each check matters, and the finding that several checks make.

use analysis::finding::{Finding, RealtimeClass};
use analysis::host::Steal;

/// Makes the finding of a check from what was found.
pub(super) type MakeFinding<'a> = &'a dyn Fn(&str) -> Finding;

/// Why each check matters: a line per subject.
const REASONS: &str = include_str!("reasons.txt");

pub fn reason(subject: &str) -> &'static str {
    let of = |line: &'static str| line.strip_prefix(subject)?.strip_prefix(": ");
    REASONS.lines().find_map(of).unwrap_or_default()
}

/// Steal above which latencies describe the host, not this machine [%].
const STEAL_MAX_PERCENT: f64 = 1.0;

pub(super) fn steal_finding(steal: &Steal, found: MakeFinding) -> Finding {
    let (percent, ms) = (steal.percent, steal.stolen_ms);
    if steal.of_ms == 0 {
        return found("the kernel counts no processor time").unknown(RealtimeClass::Hard);
    }
    let finding = found(&format!("{percent:.2} % of all processors' time ({ms} ms)"));
    if percent <= STEAL_MAX_PERCENT {
        return finding;
    }
    finding.softens("ask the host's operator for dedicated processors, or use another machine")
}
