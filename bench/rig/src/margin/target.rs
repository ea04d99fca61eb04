//! What a margin refers to: a stage, all stages, or an input; and the corresponding faults.

use messages::fault::{PORTS, Port};
use messages::role::{Role, STAGES};
use report::schema::MACHINE;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    Stage(Role),
    /// All stages at once: the machine stood still.
    Machine,
    /// An input without messages.
    Input(Port),
}

/// All targets, in the order of the report.
#[must_use]
pub fn all() -> Vec<Target> {
    let stages = STAGES
        .into_iter()
        .map(Target::Stage)
        .chain([Target::Machine]);
    stages.chain(PORTS.into_iter().map(Target::Input)).collect()
}

/// Values of --only: stages, `machine`, topics.
#[must_use]
pub fn names() -> Vec<&'static str> {
    let mut names: Vec<&'static str> = STAGES
        .into_iter()
        .map(Role::name)
        .chain([MACHINE])
        .collect();
    for topic in PORTS.into_iter().map(Port::topic) {
        if !names.contains(&topic) {
            names.push(topic);
        }
    }
    names
}

impl Target {
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Stage(role) => role.name().into(),
            Self::Machine => MACHINE.into(),
            Self::Input(port) => port.to_string(),
        }
    }

    #[must_use]
    pub fn is_meant_by(self, word: &str) -> bool {
        match self {
            Self::Stage(role) => role.name() == word,
            Self::Machine => word == MACHINE,
            Self::Input(port) => port.topic() == word,
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
    use crate::fault::Fault;

    #[test]
    fn faults_are_those_that_are_typed() {
        for target in all() {
            let typed = target.outage(8000, 47, 1_000_000);
            let fault: Fault = typed.parse().expect(&typed);
            assert_eq!(fault.from.tick(0.001), 8000, "{typed}");
        }
        let outage = |target: Target| target.outage(10, 3, 2_000_000);
        assert_eq!(
            outage(Target::Stage(Role::Inner)),
            "inner.stop=6000000ns@tick10"
        );
        assert_eq!(
            outage(Target::Input(Port::InnerSetpoint)),
            "inner.setpoint.drop=1@tick10..tick13"
        );
        assert_eq!(
            outage(Target::Machine).matches(".stop=6000000ns").count(),
            4
        );
    }

    #[test]
    fn a_topic_means_all_inputs_of_it() {
        let meant = |word: &str| all().into_iter().filter(|it| it.is_meant_by(word)).count();
        assert_eq!(
            [
                meant("state"),
                meant("wrench"),
                meant("outer"),
                meant("machine"),
                meant("x")
            ],
            [2, 1, 1, 1, 0]
        );
        assert_eq!(names().len(), 9);
    }
}
