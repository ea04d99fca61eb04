//! Simulates a flight and prints the result: the report of `ironbird simulate`.

use std::path::Path;
use std::time::Instant;

use controller::laws::adaptive;
use messages::parameters::ESTIMATED;

use crate::recorded_timing::Timing;
use crate::simulator::Simulator;
pub use crate::simulator::simulated_flight::{Judge, SimulatedFlight, fly, fly_with, follow};
use analysis::laws::NotFinite;
use analysis::phrase::count;
use analysis::schema::{FlightStatus, Gate};
use analysis::states::StatesWriter;
use analysis::theorem::TheoremStatistics;
use analysis::tracer::Tracer;
use analysis::tracking::{RecentStates, Tracking};
use config::Settings;
use config::law_settings::Chosen;
use errors::output::print;
use errors::{Failure, GATE, OK, write_text};
use flight_log::wall_time::speed;
use render::figures::Figures;
use render::picture;

#[derive(Clone, Copy, Debug, Default)]
pub struct OutputFiles<'a> {
    pub states: Option<&'a Path>,
    pub plot: Option<&'a Path>,
}

/// Simulates a flight, optionally with recorded timing, and prints the result. Returns the flight and the exit code.
pub fn report(
    settings: &Settings,
    timing: Option<&Timing>,
    leaves: &OutputFiles<'_>,
) -> Result<(SimulatedFlight, u8), Failure> {
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let laws = settings.flown_laws()?;
    let every = settings.recorder.states_every_ticks;
    let create = |path| StatesWriter::create(path, tracking, laws, every, false);
    let mut states = leaves.states.map(create).transpose()?;
    let mut rig = Simulator::of(settings)?.with_monitor(settings.theorem()?, settings.rt.channels);
    let mut observations = Observations::new(settings, tracking)?;
    let start = Instant::now();
    let mut tracer = leaves.plot.map(|_| Tracer::new(tracking));
    tracer.iter_mut().for_each(|tracer| tracer.set_laws(laws));
    let look = |rig: &Simulator| -> Result<(), Failure> {
        if let Some(states) = &mut states {
            states.write(&rig.joined())?;
        }
        if let Some(tracer) = &mut tracer {
            tracer.take(&rig.joined());
        }
        observations.take(rig);
        Ok(())
    };
    let flown = fly_with(&mut rig, settings, timing, look)?;
    let wall_s = start.elapsed().as_secs_f64();
    if let (Some(path), Some(tracer)) = (leaves.plot, &tracer) {
        let title = format!("{}, simulated", settings.conditions());
        let figures = Figures {
            traces: &tracer.traces(),
            swaps: &flown.swaps,
            faults: &settings.injected()?,
            late: &[],
            period_s: settings.flight.period_s,
        };
        write_text(path, &picture::render(&figures, &title))?;
    }
    if let Some(states) = &mut states {
        states.flush()?;
    }
    let theorem = observations.theorem.section();
    let gate = settings.recorder.theorem_gate();
    let gate = gate.map(|gate| Gate::theorem(&theorem, gate));
    let passes = flown.departure.is_none() && gate.as_ref().is_none_or(|gate| gate.held);
    let mut lines = observations.unusable.sentences(settings)?;
    lines.extend(observations.off_track(settings));
    for fault in settings.injected()? {
        lines.push(format!("fault {}", render::sentences::fault(&fault)));
    }
    if timing.is_some() || !settings.planned()?.has_no_loop_faults() {
        lines.push(outages(&rig));
    }
    lines.extend(flown.departure.clone());
    lines.extend(
        gate.iter()
            .filter(|gate| !gate.held)
            .map(render::sentences::gate),
    );
    let mut text = summary(&flown, settings, wall_s)
        + &observations.estimates()
        + "\n"
        + &render::theorem::text(&theorem);
    for line in lines {
        text += &(line + "\n");
    }
    let status = match (passes, &gate) {
        (true, Some(_)) => FlightStatus::Pass,
        (true, None) => FlightStatus::Completed,
        (false, _) => FlightStatus::Fail,
    };
    let held = usize::from(gate.as_ref().is_some_and(|gate| gate.held));
    text += &format!(
        "RESULT status={status} gates={held}/{} ticks={} outputs={} run=none\n",
        gate.iter().len(),
        flown.ticks,
        flown.outputs
    );
    print(&text)?;
    Ok((flown, if passes { OK } else { GATE }))
}

/// Effects of message and stage faults or of recorded timing.
fn outages(rig: &Simulator) -> String {
    let state = rig.state();
    format!(
        "{} skipped, {} missed, {} refused",
        count(state.ticks_skipped, "tick"),
        count(state.deadlines_missed, "deadline"),
        count(rig.rejections().total(), "message")
    )
}

fn summary(flown: &SimulatedFlight, settings: &Settings, wall_s: f64) -> String {
    let flown_s = flown.ticks as f64 * settings.flight.period_s;
    format!(
        "{}: {}, {flown_s:.3} s simulated in {}\nposition error {}\n",
        settings.conditions(),
        count(flown.ticks, "tick"),
        speed(flown_s, wall_s),
        flown.error
    )
}

/// The theorem, the last estimates, and law outputs that could not be used.
struct Observations {
    theorem: TheoremStatistics,
    has_estimates: bool,
    /// Estimate and true value of each parameter.
    newest: Option<[(f64, f64); ESTIMATED.len()]>,
    unusable: InvalidOutputs,
    tracking: Tracking,
    recent: RecentStates,
}

impl Observations {
    fn new(settings: &Settings, tracking: Tracking) -> Result<Self, Failure> {
        let mut theorem = TheoremStatistics::default();
        theorem.set_airframe(&settings.airframe()?);
        let law_without = settings.law_without_theorem()?;
        if let Some(law) = law_without {
            theorem.does_not_apply(law);
        }
        Ok(Self {
            theorem,
            has_estimates: law_without.is_none(),
            newest: None,
            unusable: InvalidOutputs::default(),
            tracking,
            recent: RecentStates::new(tracking.period_s()),
        })
    }

    /// Where the flight was at its end, if that was off its track.
    fn off_track(&self, settings: &Settings) -> Option<String> {
        let limit_m = settings.flight.tracking_error_max_m;
        let (error_m, recent_s) = (self.recent.error_max_m(), self.recent.length_s());
        (error_m > limit_m).then(|| {
            format!("off track: position error up to {error_m:.4} m in the last {recent_s:.1} s, limit {limit_m} m")
        })
    }

    fn take(&mut self, rig: &Simulator) {
        self.unusable.take(rig);
        let (tick, state) = (rig.flown_tick(), rig.state());
        let error_m = self.tracking.setpoint_error_m(tick, state, rig.setpoint());
        self.recent.take(tick, state.truth.position_w_m[2], error_m);
        let actual = rig.state().truth.theta();
        self.theorem.truth(actual);
        let Some(wrench) = rig.new_wrench() else {
            return;
        };
        match rig.monitor() {
            Some(monitor) => {
                self.theorem.take(rig.theorem().epoch(), monitor);
                self.theorem.innovation(&rig.theorem().innovation());
            }
            None if self.has_estimates => self.theorem.count_unwatched(),
            None => {}
        }
        if self.has_estimates {
            let estimate = adaptive::estimate(&wrench.telemetry);
            self.newest = Some(std::array::from_fn(|i| (estimate[i], actual[i])));
        }
    }

    fn estimates(&self) -> String {
        let mut text = String::new();
        let newest = self.newest.into_iter().flatten();
        for (parameter, (estimated, actual)) in ESTIMATED.into_iter().zip(newest) {
            let name = parameter.name();
            text += &format!("  {name:<24} estimated {estimated:>12.6e}  true {actual:>12.6e}\n");
        }
        text
    }
}

/// Law outputs that could not be used (not finite), by law: outer, inner, mixer.
#[derive(Clone, Copy, Debug, Default)]
pub struct InvalidOutputs([NotFinite; 3]);

impl InvalidOutputs {
    /// Counts the outputs of the last tick.
    pub fn take(&mut self, rig: &Simulator) {
        let modes = [
            rig.setpoint().map_or(0, |setpoint| setpoint.mode),
            rig.new_wrench().map_or(0, |wrench| wrench.mode),
            rig.new_rotor_speeds().map_or(0, |speeds| speeds.mode),
        ];
        self.0
            .iter_mut()
            .zip(modes)
            .for_each(|(counted, mode)| counted.take(rig.flown_tick(), mode));
    }

    /// A sentence for each law with unusable outputs.
    pub fn sentences(self, settings: &Settings) -> Result<Vec<String>, Failure> {
        let counted = settings.chosen_laws()?.into_iter().zip(self.0);
        let sentence = |(law, counted): (Chosen, NotFinite)| {
            let section = law.section(counted, Vec::new());
            render::sentences::not_finite(&section, law.description().role.name())
        };
        Ok(counted.filter_map(sentence).collect())
    }
}
