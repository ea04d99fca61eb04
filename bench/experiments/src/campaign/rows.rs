//! The rows of a campaign: each flight flies as `ironbird simulate` does.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ::campaign::gates::{Gates, Outcome, SignalGate, UNSET};
use ::campaign::metrics::Metrics;
use ::campaign::table::Row;
use analysis::recovery::RecoveryBounds;
use analysis::tracking::Tracking;
use control_api::guard::Route;
use controller::ScaledTrajectory;
use errors::Failure;
use messages::content::Reference;
pub use messages::vectors::LANES;

use crate::campaign::flight_settings::Plan;
use crate::parallel::{check_stop, on_processors};
use config::Settings;
use sim::simulate::{SimulatedFlight, fly_batch, fly_with};
use sim::simulator::Simulator;

/// A flight of a campaign, and the place of the arm that flies it.
pub type Flight = (u64, usize);

/// Rows of flights, in the order of flights and arms, flown by so many `workers`; `look` gets the number of flights
/// flown so far.
pub fn fly_all(
    plan: &Plan,
    flights: &[Flight],
    workers: usize,
    stop: &AtomicBool,
    mut look: impl FnMut(u64),
) -> Result<Vec<Row>, Failure> {
    // Flights of one arm have most in common.
    let mut sorted = flights.to_vec();
    sorted.sort_by_key(|(flight, arm)| (*arm, *flight));
    let together = sorted.len().div_ceil(workers.max(1)).clamp(1, LANES);
    let groups: Vec<&[Flight]> = sorted.chunks(together).collect();
    let (ended, references) = (AtomicU64::new(0), References::default());
    let fly = |flights: &&[Flight]| {
        let rows = fly(plan, flights, &references, stop)?;
        ended.fetch_add(flights.len() as u64, Ordering::Relaxed);
        Ok(rows)
    };
    let rows = on_processors(&groups, workers, fly, |_| {
        look(ended.load(Ordering::Relaxed))
    })?;
    let mut rows = rows.concat();
    rows.sort_by_key(|row| (row.flight, row.arm));
    Ok(rows)
}

/// Ticks whose references are kept at most: 10 MB.
const MOST_KEPT: u64 = 1 << 16;

/// The references of the newest course, made once for all flights along it.
#[derive(Default)]
struct References(Mutex<Option<(Course, Route)>>);

/// A trajectory, its sample time [s] and its ticks.
type Course = (ScaledTrajectory, f64, u64);

impl References {
    fn route(&self, settings: &Settings) -> Result<Route, Failure> {
        let (period_s, ticks) = (settings.flight.period_s, settings.last_tick() + 1);
        let course = (settings.course()?, period_s, ticks.min(MOST_KEPT));
        let mut newest = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((of, route)) = newest.as_ref()
            && *of == course
        {
            return Ok(Arc::clone(route));
        }
        let own = course.0.route(period_s);
        let kept: Vec<OnceLock<Reference>> = (0..course.2).map(|_| OnceLock::new()).collect();
        let route: Route = Arc::new(move |tick, state| match kept.get(tick as usize) {
            Some(kept) => *kept.get_or_init(|| own(tick, state)),
            None => own(tick, state),
        });
        *newest = Some((course, Arc::clone(&route)));
        Ok(route)
    }
}

/// Flies a few flights until `stop` is set: in a batch, unless one has a recorded timing or a law of a file or firmware.
fn fly(
    plan: &Plan,
    flights: &[Flight],
    references: &References,
    stop: &AtomicBool,
) -> Result<Vec<Row>, Failure> {
    let gates = &plan.campaign.gates;
    let (mut settings, mut timings) = (Vec::new(), Vec::new());
    let (mut rigs, mut observed) = (Vec::new(), Vec::new());
    let mut is_batch = true;
    for (flight, arm) in flights {
        let (drawn, timing) = plan.flight(*flight, *arm)?;
        is_batch &= timing.is_none() && drawn.has_built_in_laws()?;
        rigs.push(Simulator::of(&drawn)?.along(references.route(&drawn)?));
        observed.push(Observed::new(&drawn, gates)?);
        timings.push(timing);
        settings.push(drawn);
    }
    let mut look = |place: usize, rig: &Simulator| {
        observed[place].take(rig, gates);
        check_stop(stop)
    };
    let flown = if is_batch {
        fly_batch(&mut rigs, &settings, look)?
    } else {
        // A law of another program ends with its flight, before the next one starts.
        let alone = (0..).zip(rigs).zip(settings.iter().zip(timings));
        let flown = alone.map(|((place, mut rig), (settings, timing))| {
            fly_with(&mut rig, settings, timing, |rig| look(place, rig))
        });
        flown.collect::<Result<Vec<_>, Failure>>()?
    };
    let rows = flights.iter().zip(flown.into_iter().zip(observed));
    let row = |(&(flight, arm), (flown, observed)): (&Flight, (SimulatedFlight, Observed))| Row {
        flight,
        arm,
        draws: plan.campaign.draws(flight),
        outcome: Outcome {
            is_faulted: plan.campaign.is_faulted(&plan.campaign.arms[arm], flight),
            lost: flown.departure,
            metrics: observed.metrics.values(),
            telemetry: observed.telemetry,
            outputs: flown.outputs.to_string(),
        },
    };
    Ok(rows.map(row).collect())
}

/// What a row has of the ticks of its flight.
struct Observed {
    metrics: Metrics,
    /// Per gate of telemetry, the place of its signal; none if the flight's law has no such signal.
    places: Vec<Option<usize>>,
    telemetry: Vec<Option<[f64; 2]>>,
}

impl Observed {
    fn new(settings: &Settings, gates: &Gates) -> Result<Self, Failure> {
        let period_s = settings.flight.period_s;
        let bounds = RecoveryBounds {
            position_m: gates.recovered_below_m,
            yaw_rad: gates.recovered_yaw_below_rad,
        };
        let typed = settings.typed_faults();
        let typed = typed.map_err(|e| Failure::usage(format!("fault: {e}")))?;
        let faults = typed.iter().map(|fault| fault.from.tick(period_s));
        let tracking = Tracking::along(settings.course()?, period_s);
        let (airframe, last_tick) = (settings.airframe()?, settings.last_tick());
        let signals = settings.flown_laws()?.signals;
        let place = |gate: &SignalGate| {
            let mut signals = signals.of(gate.role).iter();
            signals.position(|signal| signal.name == gate.signal)
        };
        let places: Vec<Option<usize>> = gates.telemetry.iter().map(place).collect();
        Ok(Self {
            metrics: Metrics::new(tracking, &airframe, faults.collect(), last_tick, bounds),
            telemetry: places.iter().map(|place| place.map(|_| UNSET)).collect(),
            places,
        })
    }

    fn take(&mut self, rig: &Simulator, gates: &Gates) {
        let (setpoint, wrench) = (rig.setpoint(), rig.new_wrench());
        let speeds = rig.new_rotor_speeds();
        if rig.has_state() {
            self.metrics.state(rig.flown_tick(), rig.state(), setpoint);
        }
        if let Some(speeds) = speeds {
            self.metrics.command(speeds);
        }
        let gates = gates.telemetry.iter().zip(&self.places);
        for ((gate, place), range) in gates.zip(&mut self.telemetry) {
            let value = place.and_then(|place| gate.value(place, setpoint, wrench, speeds));
            if let (Some([low, high]), Some(value)) = (range, value) {
                (*low, *high) = (low.min(value), high.max(value));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::*;
    use sim::simulate;

    /// A campaign whose flights differ in all that a plant has branches for: some are lost, some saturate, some land.
    fn text(seed: u64, ground: bool, lag: bool, heavy: f64) -> String {
        let (contact, lag_s) = (
            ["off", "plane"][usize::from(ground)],
            f64::from(u8::from(lag)) * 0.02,
        );
        let mut text = format!(
            r#"
            campaign = {{ name = "drawn", flights = 9, seed = {seed} }}
            flight = {{ trajectory = "fast", duration_s = 0.6, position_error_max_m = 1.5 }}
            ground.contact = "{contact}"
            success.position_error_max_m = 0.5
            [factors]
            "plant.mass_kg" = {{ uniform = [0.3, {heavy}] }}
            "plant.inertia_x_kg_m2" = {{ uniform = [0.004, 0.01] }}
            "plant.motor_time_constant_s" = {{ choice = [0.0, {lag_s:?}] }}
            "plant.substeps" = {{ choice = [2, 4, 4, 4] }}
            "plant.gyro_noise_rad_s" = {{ choice = [0.0, 0.01] }}
            "plant.position_noise_m" = {{ choice = [0.0, 0.02] }}
            "trajectory.size" = {{ choice = [1.0, 1.0, 20.0] }}
            "initial.attitude_rad" = {{ choice = [[0.0, 0.0, 0.0], [0.5, -1.2, 3.1], [3.1, 0.2, 0.0]] }}
            "flight.faults" = {{ choice = [[], [], ["rotor_speeds.drop=3/10@0.1s"]] }}
            [[fault]]
            what = {{ choice = ["rotor_efficiency_1", "drag_factor_nm_s2", "command_delay_s"] }}
            value = {{ choice = [0.0, 1e-6] }}
            at_s = {{ uniform = [0.0, 0.5] }}
            over_s = {{ uniform = [0.001, 0.1] }}
            "#
        );
        for outer in ["pd", "estimating"] {
            for inner in ["adaptive", "fixed", "geometric", "indi", "pid"] {
                let laws = format!("outer.law = \"{outer}\"\ninner.law = \"{inner}\"\n");
                text += &format!("[arms.{outer}_{inner}]\n{laws}");
            }
        }
        text
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

        #[test]
        fn rows_are_those_of_simulate(
            seed in 0..u64::from(u32::MAX),
            ground in prop::bool::weighted(0.2),
            lag: bool,
            heavy in 0.6..2.0_f64,
        ) {
            let plan = Plan::of(text(seed, ground, lag, heavy), Path::new("drawn.toml")).unwrap();
            let stop = AtomicBool::new(false);
            for arm in 0..plan.campaign.arms.len() {
                let flights: Vec<Flight> = (0..plan.campaign.flights).map(|flight| (flight, arm)).collect();
                let rows = fly_all(&plan, &flights, 1, &stop, |_| ()).unwrap();
                for (row, (flight, arm)) in rows.iter().zip(&flights) {
                    let settings = plan.flight(*flight, *arm).unwrap().0;
                    prop_assert_eq!((row.flight, row.arm), (*flight, *arm));
                    let mut rig = Simulator::of(&settings).unwrap();
                    let simulated = simulate::fly(&mut rig, &settings, |_| Ok(())).unwrap();
                    prop_assert_eq!(&row.outcome.outputs, &simulated.outputs.to_string());
                    prop_assert_eq!(&row.outcome.lost, &simulated.departure);
                }
            }
        }
    }
}
