//! What a margin refers to: a stage, all stages, or an input; and the corresponding faults.

use analysis::schema::MACHINE;
use faults::{PORTS, Port};
use messages::role::{Role, STAGES};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    Stage(Role),
    /// All stages at once: the machine stood still.
    Machine,
    /// An input without messages.
    Input(Port),
}

/// All targets, in the order of the report.
pub fn all() -> impl Iterator<Item = Target> {
    let stages = STAGES.into_iter().map(Target::Stage);
    let inputs = PORTS.into_iter().map(Target::Input);
    stages.chain([Target::Machine]).chain(inputs)
}

/// Values of --only: stages, `machine`, topics.
#[must_use]
pub fn names() -> Vec<&'static str> {
    let mut names: Vec<&'static str> = Vec::new();
    for name in all().map(Target::group) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

impl Target {
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Input(port) => port.to_string(),
            Self::Stage(_) | Self::Machine => self.group().into(),
        }
    }

    /// The value of --only that selects it.
    #[must_use]
    pub fn group(self) -> &'static str {
        match self {
            Self::Stage(role) => role.name(),
            Self::Machine => MACHINE,
            Self::Input(port) => port.topic(),
        }
    }

    /// The fault for an outage of `ticks` ticks from a tick on.
    #[must_use]
    pub fn outage(self, from: u64, ticks: u64, tick_ns: u64) -> String {
        let stop = |role: Role| format!("{role}.stop={}ns", ticks * tick_ns);
        match self {
            Self::Stage(role) => format!("{}@tick{from}", stop(role)),
            Self::Machine => format!("{}@tick{from}", STAGES.map(stop).join(",")),
            Self::Input(port) => format!("{port}.drop=1@tick{from}..tick{}", from + ticks),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outage_is_a_fault_as_a_user_types_it() {
        let stop = |role: &str| format!("{role}.stop=6000000ns");
        let machine = ["plant", "outer", "inner", "mixer"].map(stop).join(",");
        let input = Target::Input(Port::InnerSetpoint);
        for (target, fault) in [
            (Target::Stage(Role::Inner), stop("inner") + "@tick10"),
            (Target::Machine, machine + "@tick10"),
            (input, "inner.setpoint.drop=1@tick10..tick13".into()),
        ] {
            assert_eq!(target.outage(10, 3, 2_000_000), fault);
        }
    }
}
