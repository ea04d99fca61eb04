//! Flights with a fault that begins at a phase. The part before the fault is flown once and copied, if the laws allow it.

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use campaign::gates::METRICS;
use campaign::gates::Outcome;
use campaign::metrics::Metrics;
use messages::fault::LONGEST_DELAY;
use messages::parameters::Airframe;
use report::tracking::Tracking;

use crate::settings::Settings;
use crate::simulate;
use crate::simulator::Simulator;
use errors::{Failure, INTERRUPTED};

/// How many ticks before the fault the copy is made: delayed inputs look back this far.
const LEAD_TICKS: u64 = LONGEST_DELAY + 4;

#[derive(Clone, Debug)]
pub struct Flown {
    /// Metrics cover the ticks since the fault began.
    pub outcome: Outcome,
}

impl Flown {
    /// Largest position error of the last 5 s [m]; none if the flight was lost.
    pub fn error_m(&self) -> Option<f64> {
        let place = METRICS
            .iter()
            .position(|metric| metric.name == "tracking_error_max_m");
        place
            .and_then(|place| self.outcome.metrics[place])
            .filter(|_| self.outcome.lost.is_none())
    }
}

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
    count: Cell<u64>,
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
                flights.heed()?;
                base.tick();
            }
            flights.base = Some(base);
        }
        Ok(flights)
    }

    pub fn count(&self) -> u64 {
        self.count.get()
    }

    fn heed(&self) -> Result<(), Failure> {
        if self.stop.load(Ordering::Relaxed) {
            Err(Failure::new(INTERRUPTED, "interrupted"))
        } else {
            Ok(())
        }
    }

    /// Flies with faults up to `last_tick`. Recovery below `bound_m` is measured from tick `recovers_from` on.
    pub fn fly(
        &self,
        faults: &[String],
        recovers_from: u64,
        last_tick: u64,
        bound_m: f64,
    ) -> Result<Flown, Failure> {
        self.count.set(self.count.get() + 1);
        let mut settings = self.settings.clone();
        let period_s = settings.flight.period_s;
        settings.flight.faults = faults.to_vec();
        settings.flight.duration_s = last_tick as f64 * period_s;
        let branched = self
            .base
            .as_ref()
            .map(|base| base.branch(&settings))
            .transpose()?
            .flatten();
        let mut rig = match branched {
            Some(rig) => rig,
            None => Box::new(Simulator::of(&settings)?),
        };
        let mut metrics = Metrics::new(
            period_s,
            &self.airframe,
            vec![recovers_from],
            last_tick,
            bound_m,
        );
        let flown = simulate::fly(&mut rig, &settings, |rig| {
            self.heed()?;
            let (tick, state, setpoint) = (rig.flown_tick(), rig.state(), rig.setpoint());
            if tick >= self.from {
                let error_m = setpoint.map_or_else(
                    || self.tracking.error_m(tick, state),
                    |it| it.position_error_m(state),
                );
                metrics.take(tick, state, error_m, rig.rotor_speeds());
            }
            Ok(())
        })?;
        let outputs = flown.outputs.to_string();
        Ok(Flown {
            outcome: Outcome {
                lost: flown.departure,
                metrics: metrics.values(),
                telemetry: Vec::new(),
                outputs,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::Value;

    /// Bits of the last state, and of how the flight was judged.
    fn end(flights: &Flights<'_>, fault: &str) -> String {
        let flown = flights.fly(&[fault.to_owned()], 2100, 4000, 0.05).unwrap();
        let metrics = flown.outcome.metrics.map(|metric| metric.map(f64::to_bits));
        format!("{metrics:?} {:?}", flown.outcome.lost)
    }

    #[test]
    fn a_flight_that_branches_off_is_the_whole_flight_bit_for_bit() {
        let stop = AtomicBool::new(false);
        for (outer, inner) in [
            ("pd", "adaptive"),
            ("estimating", "indi"),
            ("pd", "geometric"),
            ("pd", "pid"),
        ] {
            let laws = vec![
                ("outer.law", Value::from(outer)),
                ("inner.law", Value::from(inner)),
            ];
            let noise = toml::toml! {
                [plant]
                gyro_noise_rad_s = 0.001
                motor_time_constant_s = 0.01
            };
            let settings = Settings::of(noise, &laws).unwrap();
            let branched = Flights::new(&settings, 2000, &stop).unwrap();
            assert!(
                branched
                    .base
                    .as_ref()
                    .is_some_and(|base| base.next_tick() == 2000 - LEAD_TICKS)
            );
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
                assert_eq!(
                    end(&branched, fault),
                    end(&whole, fault),
                    "{outer} + {inner}, {fault}"
                );
            }
            assert_ne!(
                end(&whole, "inner.stop=20ms@tick2000"),
                end(&whole, "inner.stop=21ms@tick2000")
            );
        }
    }

    #[test]
    fn whoever_is_told_to_stop_stops() {
        let settings = Settings::resolve(None, &Vec::new()).unwrap();
        let flights = Flights::new(&settings, 0, &AtomicBool::new(false)).map(|it| it.count());
        assert_eq!(flights.unwrap(), 0);
        let stop = AtomicBool::new(true);
        assert_eq!(
            Flights::new(&settings, 2000, &stop)
                .err()
                .map(|failure| failure.code),
            Some(INTERRUPTED)
        );
        let flights = Flights::new(&settings, 0, &stop).unwrap();
        assert_eq!(
            flights
                .fly(&[], 0, 10, 0.1)
                .err()
                .map(|failure| failure.code),
            Some(INTERRUPTED)
        );
    }
}
