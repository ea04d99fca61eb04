//! Simulates a flight and prints the result: the report of `ironbird simulate`.

use std::path::Path;
use std::time::Instant;

use controller::laws::adaptive;
use messages::parameters::ESTIMATED;

use crate::recorded_timing::Timing;
use crate::simulator::Simulator;
pub use crate::simulator::simulated_flight::{Judge, SimulatedFlight, fly, fly_batch, fly_with};
use analysis::firmware::FirmwareStatistics;
use analysis::laws::NotFinite;
use analysis::phrase::count;
use analysis::schema::{AcceptanceResult, ControlPerformance, FlightVerdict, Gate};
use analysis::states::StatesWriter;
use analysis::theorem::TheoremStatistics;
use analysis::tracer::Tracer;
use analysis::tracking::{Tracking, TrackingStatistics};
use analysis::verdicts::flight_verdict;
use config::Settings;
use config::law_settings::Chosen;
use errors::output::print;
use errors::{Failure, write_text};
use flight_log::wall_time::speed;
use render::figures::Figures;
use render::picture;

#[derive(Clone, Copy, Debug, Default)]
pub struct OutputFiles<'a> {
    pub states: Option<&'a Path>,
    pub plot: Option<&'a Path>,
}

/// Simulates a flight, optionally with recorded timing, and prints the result. Returns the flight and its result.
pub fn report(
    settings: &Settings,
    timing: Option<&Timing>,
    leaves: &OutputFiles<'_>,
) -> Result<(SimulatedFlight, AcceptanceResult), Failure> {
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let laws = settings.flown_laws()?;
    let every = settings.recorder.states_every_ticks;
    let create = |path| StatesWriter::create(path, tracking, laws, every, false);
    let mut states = leaves.states.map(create).transpose()?;
    let mut rig = Simulator::of(settings)?.with_monitor(settings.theorem()?);
    let mut observations = Observations::new(settings, tracking)?;
    let start = Instant::now();
    let mut tracer = leaves.plot.map(|_| Tracer::new(tracking));
    tracer.iter_mut().for_each(|tracer| tracer.set_laws(laws));
    let look = |rig: &Simulator| -> Result<(), Failure> {
        if rig.has_state() {
            if let Some(states) = &mut states {
                states.write(&rig.joined())?;
            }
            if let Some(tracer) = &mut tracer {
                tracer.take(&rig.joined());
            }
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
            channel_outages: &[],
            period_s: settings.flight.period_s,
        };
        write_text(path, &picture::render(&figures, &title))?;
    }
    if let Some(states) = &mut states {
        states.flush()?;
    }
    let theorem = observations.theorem.section();
    let performance = observations.statistics.performance();
    let result = AcceptanceResult::of(Gate::of_simulation(
        &settings.requested_gates(),
        flown.departure.as_deref(),
        &performance,
        &theorem,
    ));
    let mut lines = observations.unusable.sentences(settings)?;
    let firmware = observations.firmware.section();
    lines.extend(firmware.map(|it| format!("Firmware  {}", render::sentences::firmware(&it))));
    for fault in settings.injected()? {
        lines.push(format!("fault {}", render::sentences::fault(&fault)));
    }
    if timing.is_some() || !settings.planned()?.has_no_loop_faults() {
        lines.push(outages(&rig));
    }
    let verdict = flight_verdict(&performance, None, &settings.flight_limits());
    let (word, why) = match &flown.departure {
        Some(how) => (FlightVerdict::Lost, how),
        None => (verdict.word, &verdict.why),
    };
    let word = render::sentences::name_of(&word).to_uppercase();
    lines.push(format!("Flight    {word}: {why}"));
    let failed = result.gates.iter().filter(|gate| gate.asked && !gate.held);
    lines.extend(failed.map(render::sentences::gate));
    let mut text = summary(&flown, &performance, settings, wall_s)
        + &observations.estimates()
        + "\n"
        + &render::theorem::text(&theorem);
    for line in lines {
        text += &(line + "\n");
    }
    let (status, (held, all)) = (result.status, result.requested());
    text += &format!(
        "RESULT status={status} gates={held}/{all} ticks={} outputs={} {} run=none\n",
        flown.ticks,
        flown.outputs,
        render::sentences::error_tokens(&performance)
    );
    print(&text)?;
    Ok((flown, result))
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

fn summary(
    flown: &SimulatedFlight,
    performance: &ControlPerformance,
    settings: &Settings,
    wall_s: f64,
) -> String {
    let flown_s = flown.ticks as f64 * settings.flight.period_s;
    let errors = render::sentences::errors(performance).into_iter();
    let errors = errors.chain(render::sentences::large_effort(performance));
    format!(
        "{}: {}, {flown_s:.3} s simulated in {}\n{}\n",
        settings.conditions(),
        count(flown.ticks, "tick"),
        speed(flown_s, wall_s),
        errors.collect::<Vec<_>>().join("\n")
    )
}

/// The theorem, the last estimates, and law outputs that could not be used.
struct Observations {
    theorem: TheoremStatistics,
    has_estimates: bool,
    /// Estimate and true value of each parameter.
    newest: Option<[(f64, f64); ESTIMATED.len()]>,
    unusable: InvalidOutputs,
    firmware: FirmwareStatistics,
    tracking: Tracking,
    statistics: TrackingStatistics,
}

impl Observations {
    fn new(settings: &Settings, tracking: Tracking) -> Result<Self, Failure> {
        let mut theorem = TheoremStatistics::default();
        theorem.set_airframe(&settings.airframe()?);
        let law_without = settings.law_without_theorem()?;
        let mut firmware = FirmwareStatistics::new(tracking.period_s())?;
        firmware.set_signals(&settings.flown_laws()?.signals);
        if let Some(law) = law_without {
            theorem.does_not_apply(law);
        }
        Ok(Self {
            theorem,
            has_estimates: law_without.is_none(),
            newest: None,
            unusable: InvalidOutputs::default(),
            firmware,
            tracking,
            statistics: TrackingStatistics::new(tracking.period_s()),
        })
    }

    fn take(&mut self, rig: &Simulator) {
        self.unusable.take(rig);
        let (tick, state) = (rig.flown_tick(), rig.state());
        if rig.has_state() {
            let errors = self.tracking.errors(tick, state, rig.setpoint());
            self.statistics.take(tick, state, &errors);
        }
        if let Some(speeds) = rig.new_rotor_speeds() {
            self.statistics.effort.take(speeds);
        }
        let actual = rig.state().truth.theta();
        self.theorem.truth(actual);
        let Some(wrench) = rig.new_wrench() else {
            return;
        };
        self.firmware.take(tick, wrench);
        match rig.monitor() {
            Some(monitor) => {
                self.theorem.take(rig.theorem().number(), monitor);
                self.theorem.monitored(rig.theorem());
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
            render::sentences::not_finite(&section, law.description().role.name(), &[])
        };
        Ok(counted.filter_map(sentence).collect())
    }
}
