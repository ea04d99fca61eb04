//! Flights of a campaign, flown in batches: one flight in each SIMD lane.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use ::campaign::gates::{Gates, Outcome, SignalGate, UNSET};
use ::campaign::metrics::Metrics;
use ::campaign::table::Row;
use analysis::tracking::Tracking;
use controller::ScaledTrajectory;
use errors::Failure;
use plant::{LANES, PlantBatch};

use crate::campaign::flight_settings::Plan;
use crate::parallel::{check_stop, on_processors};
use config::Settings;
use sim::recorded_timing::Timing;
use sim::simulate::{Judge, follow};
use sim::simulator::Simulator;

/// A flight of a campaign, and the place of the arm that flies it.
pub type Flight = (u64, usize);

/// Rows of flights, in the order of flights and arms, flown by so many `workers`; `look` gets the number of flights
/// flown so far.
pub fn rows(
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
    let groups: Vec<&[Flight]> = sorted
        .chunk_by(|(_, arm), (_, next)| arm == next)
        .flat_map(|of_arm| of_arm.chunks(together))
        .collect();
    let ended = AtomicU64::new(0);
    let fly = |flights: &&[Flight]| {
        let rows = group(plan, flights, stop)?;
        ended.fetch_add(flights.len() as u64, Ordering::Relaxed);
        Ok(rows)
    };
    let flown = on_processors(&groups, workers, fly, |_| {
        look(ended.load(Ordering::Relaxed))
    })?;
    let mut rows = flown.concat();
    rows.sort_by_key(|row| (row.flight, row.arm));
    Ok(rows)
}

/// Flies flights of an arm, each as `ironbird simulate` does, until `stop` is set.
fn group(plan: &Plan, flights: &[Flight], stop: &AtomicBool) -> Result<Vec<Row>, Failure> {
    let gates = &plan.campaign.gates;
    let begun = |&(flight, arm): &Flight| {
        let (settings, timing) = plan.flight(flight, arm)?;
        Flown::new(&settings, timing, gates)
    };
    let flown = flights.iter().map(begun);
    let mut flown = flown.collect::<Result<Vec<_>, Failure>>()?;
    let (alone, mut batch): (Vec<_>, Vec<_>) = flown.iter_mut().partition(|it| it.is_alone);
    for flown in alone {
        fly_alone(flown, gates, stop)?;
    }
    fly_batch(&mut batch, gates, stop)?;
    let row = |(&(flight, arm), flown): (&Flight, Flown<'_>)| Row {
        flight,
        arm,
        draws: plan.campaign.draws(flight),
        outcome: flown.end(),
    };
    Ok(flights.iter().zip(flown).map(row).collect())
}

fn fly_alone(flown: &mut Flown<'_>, gates: &Gates, stop: &AtomicBool) -> Result<(), Failure> {
    if let Some((timing, settings)) = flown.timing.take() {
        return follow(timing, &mut flown.rig, &settings, &mut flown.judge, |rig| {
            flown.observed.take(rig, gates);
            check_stop(stop)
        });
    }
    while flown.judge.goes_on(&flown.rig) {
        check_stop(stop)?;
        flown.rig.tick();
        flown.take(gates)?;
    }
    Ok(())
}

/// Flies flights tick by tick: their plants integrate together, and a reference that all follow is computed once.
fn fly_batch(
    flown: &mut [&mut Flown<'_>],
    gates: &Gates,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let route = route(flown);
    let mut plants = PlantBatch::default();
    loop {
        check_stop(stop)?;
        for it in flown.iter_mut() {
            it.is_flying = it.judge.goes_on(&it.rig);
        }
        let mut flying = flown.iter_mut().filter(|it| it.is_flying).peekable();
        let Some(first) = flying.peek() else {
            return Ok(());
        };
        let reference = route
            .map(|(course, period_s)| course.reference(first.rig.next_tick() as f64 * period_s));
        flying.for_each(|it| it.rig.stages(reference));
        let flying = flown.iter_mut().filter(|it| it.is_flying);
        plants.finish(flying.map(|it| it.rig.plant_mut()));
        for it in flown.iter_mut().filter(|it| it.is_flying) {
            it.take(gates)?;
        }
    }
}

/// The trajectory and the tick [s] that all flights share; none where they differ.
fn route(flown: &[&mut Flown<'_>]) -> Option<(ScaledTrajectory, f64)> {
    let first = flown.first()?.route;
    flown.iter().all(|it| it.route == first).then_some(first)
}

struct Flown<'a> {
    rig: Box<Simulator>,
    judge: Judge,
    /// The recorded timing that it has, and its settings; none once it was flown.
    timing: Option<(&'a Timing, Settings)>,
    /// Laws of files may have memory of their own; faults of messages and stages, and recorded timings, have ticks of
    /// their own.
    is_alone: bool,
    is_flying: bool,
    route: (ScaledTrajectory, f64),
    observed: Observed,
}

impl<'a> Flown<'a> {
    fn new(
        settings: &Settings,
        timing: Option<&'a Timing>,
        gates: &Gates,
    ) -> Result<Self, Failure> {
        let rig = Box::new(Simulator::of(settings)?);
        Ok(Self {
            is_alone: rig.is_faulted() || timing.is_some() || settings.has_own_laws()?,
            is_flying: true,
            rig,
            judge: Judge::new(settings)?,
            timing: timing.map(|timing| (timing, settings.clone())),
            route: (settings.course()?, settings.flight.period_s),
            observed: Observed::new(settings, gates)?,
        })
    }

    fn take(&mut self, gates: &Gates) -> Result<(), Failure> {
        self.judge.take(&self.rig, |rig| {
            self.observed.take(rig, gates);
            Ok(())
        })
    }

    fn end(self) -> Outcome {
        let flown = self.judge.end();
        Outcome {
            lost: flown.departure,
            metrics: self.observed.metrics.values(),
            telemetry: self.observed.telemetry,
            outputs: flown.outputs.to_string(),
        }
    }
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
        let (period_s, bound_m) = (settings.flight.period_s, gates.recovered_below_m);
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
            metrics: Metrics::new(tracking, &airframe, faults.collect(), last_tick, bound_m),
            telemetry: places.iter().map(|place| place.map(|_| UNSET)).collect(),
            places,
        })
    }

    fn take(&mut self, rig: &Simulator, gates: &Gates) {
        let (setpoint, speeds) = (rig.setpoint(), rig.rotor_speeds());
        self.metrics
            .take(rig.flown_tick(), rig.state(), setpoint, speeds);
        let gates = gates.telemetry.iter().zip(&self.places);
        for ((gate, place), range) in gates.zip(&mut self.telemetry) {
            let value = place.and_then(|place| gate.value(place, setpoint, rig.wrench(), speeds));
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
        fn rows_of_a_batch_are_those_of_simulate(
            seed in 0..u64::from(u32::MAX),
            ground in prop::bool::weighted(0.2),
            lag: bool,
            heavy in 0.6..2.0_f64,
        ) {
            let plan = Plan::of(text(seed, ground, lag, heavy), Path::new("drawn.toml")).unwrap();
            let (gates, stop) = (&plan.campaign.gates, AtomicBool::new(false));
            for arm in 0..plan.campaign.arms.len() {
                let flights: Vec<Flight> = (0..plan.campaign.flights).map(|flight| (flight, arm)).collect();
                let rows = rows(&plan, &flights, 1, &stop, |_| ()).unwrap();
                for (row, (flight, arm)) in rows.iter().zip(&flights) {
                    let settings = plan.flight(*flight, *arm).unwrap().0;
                    let mut alone = Flown::new(&settings, None, gates).unwrap();
                    fly_alone(&mut alone, gates, &stop).unwrap();
                    prop_assert_eq!((row.flight, row.arm), (*flight, *arm));
                    prop_assert_eq!(format!("{:?}", &row.outcome), format!("{:?}", alone.end()));
                    let mut rig = Simulator::of(&settings).unwrap();
                    let simulated = simulate::fly(&mut rig, &settings, |_| Ok(())).unwrap();
                    prop_assert_eq!(&row.outcome.outputs, &simulated.outputs.to_string());
                    prop_assert_eq!(&row.outcome.lost, &simulated.departure);
                }
            }
        }
    }
}
