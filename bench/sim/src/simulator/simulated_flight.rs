//! Runs a simulation to its end and checks every state.

use messages::output_hash::OutputHash;
use plant::EnvelopeViolation;
use plant::plant::batch;

use crate::recorded_timing::{Event, Source, Timing};
use crate::simulator::Simulator;
use crate::simulator::timed::Timed;
use analysis::faults::AppliedSwap;
use analysis::tracking::Tracking;
use analysis::verdicts::beyond;
use config::Settings;
use errors::Failure;

#[derive(Clone, Debug, Default)]
pub struct SimulatedFlight {
    /// Its length: skipped ticks are included.
    pub ticks: u64,
    pub outputs: OutputHash,
    pub swaps: Vec<AppliedSwap>,
    /// Why the flight left its envelope, if it did.
    pub departure: Option<String>,
    /// The first tick outside of it.
    pub departure_tick: Option<u64>,
}

impl SimulatedFlight {
    fn depart(&mut self, tick: u64, what: String) {
        self.departure = Some(what);
        self.departure_tick.get_or_insert(tick);
    }
}

/// Runs to the last tick or until the flight leaves its envelope, and calls `look` after each tick, also those without a
/// state.
pub fn fly(
    rig: &mut Simulator,
    settings: &Settings,
    look: impl FnMut(&Simulator) -> Result<(), Failure>,
) -> Result<SimulatedFlight, Failure> {
    fly_with(rig, settings, None, look)
}

/// The same, with recorded timing if given. `look` is not called for skipped ticks.
pub fn fly_with(
    rig: &mut Simulator,
    settings: &Settings,
    timing: Option<&Timing>,
    mut look: impl FnMut(&Simulator) -> Result<(), Failure>,
) -> Result<SimulatedFlight, Failure> {
    let mut judge = Judge::new(settings)?;
    rig.start()?;
    match timing {
        Some(timing) => follow(timing, rig, settings, &mut judge, look)?,
        None => {
            while judge.goes_on(rig) {
                rig.tick();
                judge.take(rig, &mut look)?;
            }
        }
    }
    let flown = judge.end();
    let is_of_last = |timing: &Timing| timing.last_tick == settings.last_tick();
    if flown.departure.is_none() && timing.is_none_or(is_of_last) {
        rig.end();
    }
    Ok(flown)
}

/// Runs a batch of flights tick by tick, each as [`fly_with`] does. `look` also gets the place of the flight.
pub fn fly_batch(
    rigs: &mut [Simulator],
    settings: &[Settings],
    mut look: impl FnMut(usize, &Simulator) -> Result<(), Failure>,
) -> Result<Vec<SimulatedFlight>, Failure> {
    let judges = settings.iter().map(Judge::new);
    let mut judges = judges.collect::<Result<Vec<_>, Failure>>()?;
    rigs.iter_mut().try_for_each(Simulator::start)?;
    let mut flying: Vec<usize> = (0..rigs.len()).collect();
    loop {
        flying.retain(|place| judges[*place].goes_on(&rigs[*place]));
        if flying.is_empty() {
            return Ok(judges.into_iter().map(Judge::end).collect());
        }
        flying.iter().for_each(|place| rigs[*place].stages());
        // Those that have ended have not begun another tick.
        batch::finish(rigs.iter_mut().map(|rig| &mut rig.plant));
        for place in &flying {
            judges[*place].take(&rigs[*place], |rig| look(*place, rig))?;
        }
    }
}

/// Runs with recorded timing and reports to `judge`. A simulation of the whole recorded flight includes what its stages
/// sent after the last state.
fn follow(
    timing: &Timing,
    rig: &mut Simulator,
    settings: &Settings,
    judge: &mut Judge,
    mut look: impl FnMut(&Simulator) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut timed = Timed::new();
    let last_tick = settings.last_tick();
    let is_flown = |event: &&Event| last_tick == timing.last_tick || event.tick <= last_tick;
    // The tick of the newest state, until an event of a later one.
    let mut open = None;
    for event in timing.events.iter().filter(is_flown) {
        if open.take_if(|tick| event.tick > *tick).is_some() {
            look(rig)?;
            judge.leaves(rig);
        }
        if judge.flown.departure.is_some() {
            break;
        }
        timed.play(event, rig, settings, &mut judge.flown.outputs)?;
        if matches!(event.source, Source::State) {
            if !judge.enters(rig) {
                break;
            }
            judge.flown.outputs.take(event.tick, rig.state());
            judge.flown.ticks = event.tick + 1;
            open = Some(event.tick);
        }
    }
    if open.is_some() {
        look(rig)?;
        judge.leaves(rig);
    }
    if judge.flown.departure.is_none() {
        judge.flown.ticks = last_tick + 1;
    }
    Ok(())
}

#[derive(Debug)]
pub struct Judge {
    last_tick: u64,
    period_s: f64,
    allowed_m: f64,
    ground_z_m: f64,
    tracking: Tracking,
    lowest_z_m: f64,
    error_max_m: f64,
    flown: SimulatedFlight,
}

impl Judge {
    pub fn new(settings: &Settings) -> Result<Self, Failure> {
        let flight = &settings.flight;
        Ok(Self {
            last_tick: settings.last_tick(),
            period_s: flight.period_s,
            allowed_m: flight.position_error_max_m,
            ground_z_m: flight.ground_z_m,
            tracking: Tracking::along(settings.course()?, flight.period_s),
            lowest_z_m: f64::INFINITY,
            error_max_m: 0.0,
            flown: SimulatedFlight::default(),
        })
    }

    pub fn goes_on(&self, rig: &Simulator) -> bool {
        self.flown.departure.is_none() && rig.next_tick() <= self.last_tick
    }

    /// Checks the last tick and calls `look`.
    pub fn take(
        &mut self,
        rig: &Simulator,
        look: impl FnOnce(&Simulator) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let tick = rig.flown_tick();
        if rig.has_state() {
            if !self.enters(rig) {
                return Ok(());
            }
            self.flown.outputs.take(tick, rig.state());
            if let Some(setpoint) = rig.setpoint() {
                self.flown.outputs.take(tick, setpoint);
            }
        }
        self.flown.ticks += 1;
        if let Some(wrench) = rig.new_wrench() {
            self.flown.outputs.take(tick, wrench);
        }
        if let Some(speeds) = rig.new_rotor_speeds() {
            self.flown.outputs.take(tick, speeds);
        }
        look(rig)?;
        if rig.has_state() {
            self.leaves(rig);
        }
        Ok(())
    }

    /// Checks a new state; false if it is not finite.
    fn enters(&mut self, rig: &Simulator) -> bool {
        if let Err(departure) = rig.envelope() {
            self.flown.depart(rig.state.tick, departure.to_string());
            // As in a flight of processes, what is no number is not published.
            if matches!(departure, EnvelopeViolation::NotFinite { .. }) {
                return false;
            }
        }
        let z_m = rig.state().truth.position_w_m[2];
        self.lowest_z_m = self.lowest_z_m.min(z_m);
        if z_m < self.ground_z_m {
            self.flown.departure_tick.get_or_insert(rig.state.tick);
        }
        let (applied, period_s) = (rig.plant().applied().iter(), self.period_s);
        self.flown
            .swaps
            .extend(applied.map(|swap| AppliedSwap::new(swap.tick, period_s, &swap.record())));
        true
    }

    /// Checks the state with the outputs of the stages.
    fn leaves(&mut self, rig: &Simulator) {
        let (tick, state, setpoint) = (rig.state.tick, rig.state(), rig.setpoint());
        let error_m = self.tracking.error_m(tick, state, setpoint);
        let allowed_m = self.allowed_m;
        self.error_max_m = self.error_max_m.max(error_m);
        if error_m > allowed_m {
            self.flown.departure_tick.get_or_insert(tick);
        }
        // It is the outer loop that ends a flight for this, where it works.
        if setpoint.is_some() && error_m > allowed_m {
            let what = format!(
                "the flight left its envelope: at tick {tick} the position error is {error_m:.2} m, allowed are \
                 {allowed_m} m"
            );
            self.flown.depart(tick, what);
        }
    }

    pub fn end(mut self) -> SimulatedFlight {
        let (lowest_z_m, ground_z_m) = (self.lowest_z_m, self.ground_z_m);
        let (error_max_m, allowed_m) = (self.error_max_m, self.allowed_m);
        if self.flown.departure.is_none() && lowest_z_m < ground_z_m {
            self.flown.departure = Some(format!(
                "the flight was below ground: down to z = {lowest_z_m:.2} m, the ground is at {ground_z_m} m"
            ));
        } else if self.flown.departure.is_none() && error_max_m > allowed_m {
            let how = beyond(error_max_m, allowed_m);
            self.flown.departure = Some(format!("the flight {how}"));
        }
        self.flown
    }
}
