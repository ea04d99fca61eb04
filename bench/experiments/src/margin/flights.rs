//! Flights with a fault that begins at a phase. The part before the fault is flown once and copied, if the laws allow it.

use std::cell::Cell;
use std::sync::atomic::AtomicBool;

use analysis::tracking::Tracking;
use campaign::gates::Outcome;
use campaign::metrics::Metrics;
use faults::LONGEST_DELAY;
use messages::parameters::Airframe;

use crate::parallel::check_stop;
use config::Settings;
use errors::Failure;
use sim::simulate;
use sim::simulator::Simulator;

/// How many ticks before the fault the copy is made: delayed inputs look back this far.
const LEAD_TICKS: u64 = LONGEST_DELAY + 4;

/// Flights whose faults begin at the same tick.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct Flights<'a> {
    settings: Settings,
    tracking: Tracking,
    airframe: Airframe,
    stop: &'a AtomicBool,
    pub from: u64,
    /// The flight up to shortly before the fault; none if its laws cannot be copied.
    base: Option<Box<Simulator>>,
    pub count: Cell<u64>,
}

impl<'a> Flights<'a> {
    /// Flies without a fault up to shortly before tick `from`.
    pub fn new(settings: &Settings, from: u64, stop: &'a AtomicBool) -> Result<Self, Failure> {
        let mut flights = Self {
            settings: settings.clone(),
            tracking: Tracking::along(settings.course()?, settings.flight.period_s),
            airframe: settings.airframe()?,
            stop,
            from,
            base: None,
            count: Cell::new(0),
        };
        let mut base = Box::new(Simulator::of(settings)?);
        // Skip this flight if its laws cannot be copied.
        if base.branch(settings)?.is_some() {
            while base.next_tick() + LEAD_TICKS < from {
                check_stop(stop)?;
                base.tick();
            }
            flights.base = Some(base);
        }
        Ok(flights)
    }

    /// Flies with faults up to `last_tick`. Metrics cover the ticks since the fault began; recovery below `bound_m` is
    /// measured from tick `recovers_from` on.
    pub fn fly(
        &self,
        faults: &[String],
        recovers_from: u64,
        last_tick: u64,
        bound_m: f64,
    ) -> Result<Outcome, Failure> {
        self.count.update(|count| count + 1);
        let mut settings = self.settings.clone();
        let period_s = settings.flight.period_s;
        settings.flight.faults = faults.to_vec();
        settings.flight.duration_s = last_tick as f64 * period_s;
        let branch = match &self.base {
            Some(base) => base.branch(&settings)?,
            None => None,
        };
        let mut rig = match branch {
            Some(rig) => rig,
            None => Box::new(Simulator::of(&settings)?),
        };
        let recovers_from = vec![recovers_from];
        let mut metrics = Metrics::new(
            self.tracking,
            &self.airframe,
            recovers_from,
            last_tick,
            bound_m,
        );
        let flown = simulate::fly(&mut rig, &settings, |rig| {
            check_stop(self.stop)?;
            let (tick, state) = (rig.flown_tick(), rig.state());
            if tick >= self.from {
                metrics.take(tick, state, rig.setpoint(), rig.rotor_speeds());
            }
            Ok(())
        })?;
        Ok(Outcome {
            lost: flown.departure,
            metrics: metrics.values(),
            telemetry: Vec::new(),
            outputs: flown.outputs.to_string(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::Value;

    /// Bits of the metrics, and why the flight was lost.
    fn end(flights: &Flights<'_>, fault: &str) -> String {
        let outcome = flights.fly(&[fault.to_owned()], 2100, 4000, 0.05).unwrap();
        let metrics = outcome.metrics.map(|metric| metric.map(f64::to_bits));
        format!("{metrics:?} {:?}", outcome.lost)
    }

    #[test]
    fn a_flight_that_branches_off_is_the_whole_flight_bit_for_bit() {
        let stop = AtomicBool::new(false);
        let combinations = "pd adaptive, estimating indi, pd geometric, pd pid";
        for laws in combinations.split(", ") {
            let (outer, inner) = laws.split_once(' ').unwrap();
            let laws_set = vec![
                ("outer.law", Value::from(outer)),
                ("inner.law", Value::from(inner)),
            ];
            let noise = toml::toml! {
                [plant]
                gyro_noise_rad_s = 0.001
                motor_time_constant_s = 0.01
            };
            let settings = Settings::of(noise, &laws_set).unwrap();
            let branched = Flights::new(&settings, 2000, &stop).unwrap();
            let base = branched.base.as_ref().unwrap();
            assert_eq!(base.next_tick(), 2000 - LEAD_TICKS);
            let mut whole = Flights::new(&settings, 2000, &stop).unwrap();
            whole.base = None;
            for fault in [
                "inner.stop=20ms@tick2000",
                "plant.stop=9ms,outer.stop=9ms,inner.stop=9ms,mixer.stop=9ms@tick2000",
                "state.drop=1@tick2000..tick2030",
                "inner.state.lag=5@tick2000",
                "plant.rotor_speeds.lag=4@tick2000",
                "setpoint.lag=60@tick2000",
                "inner.state.delay=2@tick2000..tick2500",
                "plant.rotor_speeds.delay=3@tick2000",
                "wrench.drop=0.3@tick2000",
                "plant.rotor_speeds.drop=3/5@tick2000",
            ] {
                assert_eq!(end(&branched, fault), end(&whole, fault), "{laws}, {fault}");
            }
            let [one, other] = [20, 21].map(|ms| format!("inner.stop={ms}ms@tick2000"));
            assert_ne!(end(&whole, &one), end(&whole, &other));
        }
    }
}
