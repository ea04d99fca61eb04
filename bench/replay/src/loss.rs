//! Why a flight was lost: the same flight, with its faults and parameter changes, simulated with and without the delays
//! that it had.

use std::path::Path;

use analysis::schema::{LossSection, SimulatedLoss};
use config::Settings;
use config::law_settings::LAW;
use errors::Failure;
use faults::Target;
use faults::grammar::{Change, Fault};
use flight_log::entry::LogEntry;
use flight_log::fault_record::injected;
use flight_log::reader::LogReader;
use messages::grid::Pace;
use sim::recorded_timing::{Timing, first_of};
use sim::simulate::{SimulatedFlight, fly_with};
use sim::simulator::Simulator;

use crate::airframe::swap_of;
use crate::log_check::settings_of;

/// The outer law with integral action.
const ESTIMATING: &str = "estimating";

/// Simulates the flight of a log, which was lost, without delays, with those that it had, and with an outer law that
/// has integral action.
pub fn examine(log: &Path) -> Result<LossSection, Failure> {
    let mut reader = LogReader::open(log)?;
    let mut next = Some(first_of(&mut reader)?);
    let mut settings = settings_of(&reader)?;
    if settings.has_several_laws() {
        return Err(Failure::failed(
            "its channels flew different laws, of which a simulation has one",
        ));
    }
    let inner = settings.laws()?[1].name;
    if firmware::is_program(inner) {
        return Err(Failure::failed(format!(
            "its inner law `{inner}` is another program, whose answers differ from flight to flight"
        )));
    }
    let is_lockstep = reader.pace()? == Pace::Lockstep;
    settings.flight.faults = loop_faults(&settings, &injected(log)?)?;
    let mut swaps = Vec::new();
    while let Some(entry) = next {
        if let LogEntry::Swap(message) = &entry {
            swaps.push(swap_of(message)?);
        }
        next = reader.next_entry()?.copied();
    }
    let timing = match (is_lockstep, settings.planned()?.loops.messages.is_empty()) {
        (true, _) => Err("it was flown in lockstep, which has no delays".to_owned()),
        (_, false) => Err("recorded delays cannot be combined with message faults".to_owned()),
        _ => Timing::read(log).map_err(|failure| failure.to_string()),
    };
    let lost = |settings: &Settings, timing: Option<&Timing>| -> Result<SimulatedLoss, Failure> {
        let mut rig = Simulator::of(settings)?;
        for swap in &swaps {
            rig.plant_mut()
                .schedule(swap.clone())
                .map_err(|e| Failure::failed(e.to_string()))?;
        }
        let flown = fly_with(&mut rig, settings, timing, |_| Ok(()))?;
        Ok(loss(&flown, settings))
    };
    let without_delays = lost(&settings, None)?;
    let (with_delays, why_not) = match timing {
        Ok(timing) => {
            // The delays of stages that were stopped are in the record.
            let mut delayed = settings.clone();
            delayed.flight.faults.clear();
            delayed.flight.duration_s = timing.last_tick as f64 * settings.flight.period_s;
            (Some(lost(&delayed, Some(&timing))?), None)
        }
        Err(why_not) => (None, Some(why_not)),
    };
    let flown = settings.outer.get(LAW).and_then(|law| law.as_str());
    let held_by = if without_delays.lost_at_s.is_some() && flown != Some(ESTIMATING) {
        let mut other = settings.clone();
        other.outer = toml::Table::from_iter([(LAW.to_owned(), ESTIMATING.into())]);
        let held = lost(&other, None)?.lost_at_s.is_none();
        held.then(|| format!("--outer {ESTIMATING}"))
    } else {
        None
    };
    Ok(LossSection {
        without_delays,
        with_delays,
        why_not,
        held_by,
    })
}

/// The faults of messages and stages, planned and injected. Stages of several channels are left out: another channel flew
/// meanwhile. Parameter changes are taken from the log.
fn loop_faults(settings: &Settings, injected: &[String]) -> Result<Vec<String>, Failure> {
    let has_channels = settings.rt.channels > 1;
    let is_simulated = |change: &Change| match change {
        Change::Parameter(_) => false,
        Change::Loop(change) => match change.kind.target {
            Target::Message(..) | Target::Number(..) => true,
            Target::Processor(_) | Target::Channel(..) => false,
            Target::Stage(..) => !has_channels,
        },
    };
    let mut faults = Vec::new();
    for text in settings.flight.faults.iter().chain(injected) {
        let mut fault: Fault = text
            .parse()
            .map_err(|e| Failure::failed(format!("fault `{text}`: {e}")))?;
        fault.changes.retain(is_simulated);
        if !fault.changes.is_empty() {
            faults.push(fault.to_string());
        }
    }
    Ok(faults)
}

fn loss(flown: &SimulatedFlight, settings: &Settings) -> SimulatedLoss {
    let tick = flown.departure_tick.filter(|_| flown.departure.is_some());
    SimulatedLoss {
        lost_at_s: tick.map(|tick| tick as f64 * settings.flight.period_s),
        how: flown.departure.clone(),
    }
}
