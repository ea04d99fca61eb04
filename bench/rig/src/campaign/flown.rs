//! One flight of a campaign.

use std::sync::atomic::{AtomicBool, Ordering};

use campaign::gates::Gates;
use campaign::metrics::Metrics;
use campaign::outcome::{Outcome, Shown};
use campaign::table::Row;
use failure::{Failure, INTERRUPTED};
use report::tracking::Tracking;

use super::plan::Plan;
use crate::in_process::InProcess;
use crate::settings::Settings;
use crate::simulate;
use crate::timing::Timing;

/// Flies a flight by an arm, unless it is told to stop.
///
/// # Errors
/// As of [`Plan::settings`]; an interruption.
pub(super) fn row(plan: &Plan, flight: u64, arm: usize, stop: &AtomicBool) -> Result<Row, Failure> {
    let settings = plan.settings(flight, arm)?;
    let timing = plan.timing(flight, arm, &settings)?;
    let outcome = outcome(&settings, timing, &plan.campaign.gates, stop)?;
    Ok(Row { flight, arm, draws: plan.campaign.draws(flight), outcome })
}

/// Flies as `ironbird simulate` does, and sums up.
fn outcome(settings: &Settings, timing: Option<&Timing>, gates: &Gates, stop: &AtomicBool) -> Result<Outcome, Failure> {
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let last_tick = settings.last_tick();
    let (period_s, bound_m) = (settings.flight.period_s, gates.recovered_below_m);
    let typed = settings.typed_faults().map_err(|e| Failure::usage(format!("fault: {e}")))?;
    let faults = typed.iter().map(|fault| fault.from.tick(period_s)).collect();
    let mut metrics = Metrics::new(period_s, &settings.airframe()?, faults, last_tick, bound_m);
    let signals = settings.flown_laws()?.signals;
    let place =
        |gate: &campaign::gates::SignalGate| signals.of(gate.role).iter().position(|signal| signal.name == gate.signal);
    let places: Vec<Option<usize>> = gates.telemetry.iter().map(place).collect();
    let mut telemetry: Vec<Shown> =
        places.iter().map(|place| place.map_or(Shown::NotOfThisLaw, |_| Shown::Never)).collect();
    let mut rig = InProcess::of(settings)?;
    let flown = simulate::fly_with(&mut rig, settings, timing, |rig| {
        if stop.load(Ordering::Relaxed) {
            return Err(Failure::new(INTERRUPTED, "interrupted"));
        }
        let (tick, state, setpoint) = (rig.flown_tick(), rig.state(), rig.setpoint());
        let error_m = setpoint.map_or_else(|| tracking.error_m(tick, state), |it| it.position_error_m(state));
        metrics.take(tick, state, error_m, rig.rotor_speeds());
        for ((gate, place), shown) in gates.telemetry.iter().zip(&places).zip(&mut telemetry) {
            let value = place.and_then(|place| gate.value(place, setpoint, rig.wrench(), rig.rotor_speeds()));
            value.into_iter().for_each(|value| *shown = shown.and(value));
        }
        Ok(())
    })?;
    Ok(Outcome { lost: flown.departure, metrics: metrics.values(), telemetry, outputs: flown.outputs.to_string() })
}
