//! Flights with a fault that begins at a phase. The part before the fault is flown once and copied, if the laws allow it.

use std::mem::replace;
use std::sync::atomic::AtomicBool;

use analysis::margin::{Bounds, Cause, Point};
use analysis::recovery::STAYING_S;
use analysis::tracking::Tracking;
use faults::LONGEST_DELAY_TICKS;
use nalgebra::Vector3;
use plant::EnvelopeViolation;

use crate::parallel::check_stop;
use config::Settings;
use errors::Failure;
use sim::simulate::Judge;
use sim::simulator::Simulator;

/// A flight ends when its errors have been below their bounds for this time after an outage [s].
const RECOVERED_FOR_S: f64 = 5.0;

/// From when on after the beginning of a fault the change of the body rate is taken [s].
const SETTLED_S: f64 = 1.0;

/// How many ticks before the fault the copy is made: delayed inputs look back this far.
const LEAD_TICKS: u64 = LONGEST_DELAY_TICKS + 4;

/// Flights whose faults begin at the same tick.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct Flights<'a> {
    settings: Settings,
    tracking: Tracking,
    bounds: Bounds,
    stop: &'a AtomicBool,
    pub from: u64,
    /// The flight up to shortly before the fault; none if its laws cannot be copied.
    base: Option<Box<Simulator>>,
    pub unfaulted: Point,
}

/// A flight up to shortly before the faults that begin at tick `from`; none if its laws cannot be copied.
pub fn base(
    settings: &Settings,
    from: u64,
    stop: &AtomicBool,
) -> Result<Option<Box<Simulator>>, Failure> {
    let mut base = Box::new(Simulator::of(settings)?);
    if base.branch(settings)?.is_none() {
        return Ok(None);
    }
    while base.next_tick() + LEAD_TICKS < from {
        check_stop(stop)?;
        base.tick();
    }
    Ok(Some(base))
}

/// A flight with the faults of its settings: a copy of the base, or one from the ground.
pub fn rig(base: Option<&Simulator>, settings: &Settings) -> Result<Box<Simulator>, Failure> {
    let branch = base.map(|base| base.branch(settings)).transpose()?;
    let Some(mut rig) = branch.flatten() else {
        return Ok(Box::new(Simulator::of(settings)?));
    };
    for swap in settings.planned()?.swaps {
        let scheduled = rig.plant_mut().schedule(swap);
        scheduled.map_err(|e| Failure::usage(format!("fault: {e}")))?;
    }
    Ok(rig)
}

impl<'a> Flights<'a> {
    /// Flies without a fault.
    pub fn new(
        settings: &Settings,
        bounds: Bounds,
        from: u64,
        stop: &'a AtomicBool,
    ) -> Result<Self, Failure> {
        let mut flights = Self {
            settings: settings.clone(),
            tracking: Tracking::along(settings.course()?, settings.flight.period_s),
            bounds,
            stop,
            from,
            base: base(settings, from, stop)?,
            unfaulted: Point::default(),
        };
        flights.unfaulted = flights.point(0, Vec::new(), from, f64::INFINITY)?;
        Ok(flights)
    }

    /// Flies with a fault for `ticks` ticks, or with a steady one.
    pub fn fly(&self, at: u64, fault: String, ticks: Option<u64>) -> Result<Point, Failure> {
        let calm_s = ticks.map_or(f64::INFINITY, |_| RECOVERED_FOR_S);
        self.point(at, vec![fault], self.from + ticks.unwrap_or(0), calm_s)
    }

    /// Flies until the errors have been below their bounds for `calm_s`, or until it can no longer be in time. The recovery is
    /// measured from tick `end` on.
    fn point(&self, at: u64, faults: Vec<String>, end: u64, calm_s: f64) -> Result<Point, Failure> {
        let mut settings = self.settings.clone();
        let flight = &mut settings.flight;
        let period_s = flight.period_s;
        let last_s = self.bounds.survival_max_s + STAYING_S;
        flight.duration_s = end as f64 * period_s + last_s;
        flight.faults = faults;
        let mut rig = rig(self.base.as_deref(), &settings)?;
        let mut judge = Judge::new(&settings)?;
        rig.start()?;
        let bounds = self.bounds.recovered();
        let (mut peak_m, mut peak_yaw_rad) = (0.0_f64, 0.0_f64);
        // From when on the errors have been below their bounds, and which one was above last.
        let (mut back, mut above) = (end, Cause::Error);
        let (mut rate, mut steps, mut sum) = (Vector3::zeros(), 0, 0.0);
        let settled = self.from + (SETTLED_S / period_s).round() as u64;
        let mut is_low = false;
        let is_calm = |back: u64, tick: u64| tick.saturating_sub(back) as f64 * period_s > calm_s;
        while judge.goes_on(&rig) && !is_low && !is_calm(back, rig.next_tick()) {
            check_stop(self.stop)?;
            rig.tick();
            judge.take(&rig, |rig| {
                let (tick, state) = (rig.flown_tick(), rig.state());
                if tick < self.from || !rig.has_state() {
                    return Ok(());
                }
                let [error_m, yaw_rad, _] = self.tracking.errors(tick, state, rig.setpoint());
                peak_m = peak_m.max(error_m);
                peak_yaw_rad = peak_yaw_rad.max(yaw_rad);
                if !bounds.hold(error_m, yaw_rad) {
                    back = back.max(tick + 1);
                    above = match error_m > bounds.position_m {
                        true => Cause::Error,
                        false => Cause::Yaw,
                    };
                }
                let last = replace(&mut rate, state.truth.rate_b_rad_s.into());
                if tick >= settled {
                    steps += 1;
                    sum += (rate - last).norm_squared();
                }
                is_low = state.truth.position_w_m[2] < settings.flight.ground_z_m;
                Ok(())
            })?;
        }
        let recovery_s = (back - end) as f64 * period_s;
        let unfaulted = self.unfaulted.rate_step_increase_rad_s;
        let is_back = recovery_s <= self.bounds.survival_max_s;
        let lost = match rig.envelope() {
            Err(EnvelopeViolation::Tilt { .. }) => Some(Cause::Tilt),
            Err(EnvelopeViolation::NotFinite { .. }) => Some(Cause::Diverged),
            Err(EnvelopeViolation::Crash(_)) => Some(Cause::Ground),
            Ok(()) if is_low => Some(Cause::Ground),
            Ok(()) => judge.end().departure.map(|_| Cause::Position),
        };
        Ok(Point {
            at,
            peak_m: lost.is_none().then_some(peak_m),
            peak_yaw_rad: lost.is_none().then_some(peak_yaw_rad),
            recovery_s: (lost.is_none() && is_back).then_some(recovery_s),
            rate_step_increase_rad_s: (sum / f64::from(steps.max(1)) - unfaulted * unfaulted)
                .max(0.0)
                .sqrt(),
            cause: lost.or((!is_back).then_some(above)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::margin::limits::bounds;
    use toml::Value;

    /// The point of a flight, to the bit.
    fn end(flights: &Flights<'_>, fault: &str) -> String {
        format!("{:?}", flights.fly(1, fault.to_owned(), Some(100)).unwrap())
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
            let bounds = bounds(&[], &settings).unwrap();
            let branched = Flights::new(&settings, bounds, 2000, &stop).unwrap();
            let base = branched.base.as_ref().unwrap();
            assert_eq!(base.next_tick(), 2000 - LEAD_TICKS);
            let mut whole = Flights::new(&settings, bounds, 2000, &stop).unwrap();
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
                "inertia_x_kg_m2=0.001@tick2000",
            ] {
                assert_eq!(end(&branched, fault), end(&whole, fault), "{laws}, {fault}");
            }
            let [one, other] = [20, 21].map(|ms| format!("inner.stop={ms}ms@tick2000"));
            assert_ne!(end(&whole, &one), end(&whole, &other));
        }
    }
}
