//! Faults that were injected into the running flight, as the plant publishes them.

use faults::live::{LIVE, LiveBlackboard, LiveFault};
use flight_log::facts::Record;
use ipc::error::Error;
use ipc::{BlackboardReader, Wire};

use analysis::faults::InjectedFault;
use faults::grammar::{Fault, joined, planned_again};

#[derive(Default)]
pub struct InjectedFaults {
    blackboard: Option<BlackboardReader<LiveBlackboard>>,
    pub faults: Vec<LiveFault>,
    is_new: bool,
}

impl InjectedFaults {
    pub fn open(wire: &Wire) -> Result<Self, Error> {
        let blackboard = wire.blackboard_reader::<LiveBlackboard>(LIVE)?;
        // Those from before this process joined the flight.
        let faults = blackboard.as_ref().map(BlackboardReader::get);
        let faults: Vec<LiveFault> = faults.iter().flat_map(LiveBlackboard::iter).collect();
        Ok(Self {
            blackboard,
            is_new: !faults.is_empty(),
            faults,
        })
    }

    /// Reads the blackboard; returns all faults of the flight if there are new ones.
    pub fn update(&mut self) -> Option<&[LiveFault]> {
        if let Some(published) = self.blackboard.as_mut()?.news() {
            self.faults = published.iter().collect();
            self.is_new = true;
        }
        std::mem::take(&mut self.is_new).then_some(&*self.faults)
    }
}

/// The faults by number, each as the text that would plan it.
pub fn injected_record(faults: &[LiveFault]) -> Record {
    (1..)
        .zip(planned_again(faults))
        .map(|(n, fault)| (format!("{n}"), fault.to_string()))
        .collect()
}

pub fn injected(live: &[LiveFault], period_s: f64) -> Vec<InjectedFault> {
    let mut ended = live.to_vec();
    for (place, end) in live.iter().enumerate().filter(|(_, fault)| fault.ends) {
        for fault in &mut ended[..place] {
            if !fault.ends && fault.kind.is_ended_by(&end.kind) {
                // One that is called off before it begins acts in no tick.
                fault.span.to = fault.span.to.min(end.span.from.max(fault.span.from));
            }
        }
    }
    let described = |fault: Fault| {
        let (from, to) = (
            fault.from.tick(period_s),
            fault.to.map(|to| to.tick(period_s)),
        );
        InjectedFault::new(joined(&fault.changes), from, to, period_s).in_flight()
    };
    planned_again(&ended).into_iter().map(described).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planned_fault_acts_until_it_is_called_off_in_flight() {
        let planned = vec![("flight.faults", vec!["state.drop=0.05@2s"].into())];
        let settings = config::Settings::resolve(None, &planned).unwrap();
        let off: Fault = "state.drop=off@tick5000".parse().unwrap();
        let off: Vec<LiveFault> = off.changes[0].faults(off.span(1e-3).unwrap()).collect();
        for (live, to_tick) in [(&off[..], Some(5000)), (&[], None)] {
            let planned = settings.planned_faults_beside(live).unwrap();
            assert_eq!(planned[0].to_tick, to_tick);
        }
    }

    #[test]
    fn a_fault_acts_until_it_is_called_off_and_in_no_tick_if_that_is_before_it_begins() {
        for (called_off_at, to_tick) in [(5, 10), (15, 15), (30, 20)] {
            let end = format!("state.drop=off@tick{called_off_at}");
            let live = ["state.drop=0.2@tick10..tick20", &end].map(|text| {
                let fault: Fault = text.parse().unwrap();
                let span = fault.span(1e-3).unwrap();
                fault.changes[0].faults(span).next().unwrap()
            });
            let first = injected(&live, 1e-3).remove(0);
            let acts = (first.tick, first.to_tick);
            assert_eq!(acts, (10, Some(to_tick)), "called off at {called_off_at}");
        }
    }
}
