//! Flies in one process to the end, and judges every state on the way.

use model::output_hash::OutputHash;
use plant::Departure;
use plant::desk::swap_record;

use crate::in_process::InProcess;
use crate::in_process::timed::Timed;
use crate::settings::{FlightSettings, Settings};
use crate::timing::{Made, Timing};
use failure::Failure;
use report::swaps::AppliedSwap;
use report::tracking::{Tracking, TrackingError};

/// A flight in one process that has ended.
#[derive(Clone, Debug)]
pub struct Simulated {
    /// Ticks that were flown.
    pub ticks: u64,
    /// Hash over everything that the stages put out.
    pub outputs: OutputHash,
    /// How far the vehicle was from its reference.
    pub error: TrackingError,
    /// Swaps that took hold.
    pub swaps: Vec<AppliedSwap>,
    /// How the flight left its envelope; none where it was flown to its end.
    pub departure: Option<String>,
}

/// Flies from the next tick to the last one, or out of the envelope, and shows each tick that was flown.
///
/// # Errors
/// A usage [`Failure`], which settings that were resolved have ruled out; what `look` fails with ends the flight.
pub fn fly(
    rig: &mut InProcess,
    settings: &Settings,
    mut look: impl FnMut(&InProcess) -> Result<(), Failure>,
) -> Result<Simulated, Failure> {
    let mut judge = Judge::new(settings)?;
    while judge.goes_on(rig) {
        rig.tick();
        judge.take(rig, &mut look)?;
    }
    Ok(judge.end())
}

/// The same, with the timing of a recorded flight where there is one. Ticks that it skipped are not shown.
///
/// # Errors
/// As [`fly`].
pub fn fly_with(
    rig: &mut InProcess,
    settings: &Settings,
    timing: Option<&Timing>,
    look: impl FnMut(&InProcess) -> Result<(), Failure>,
) -> Result<Simulated, Failure> {
    let Some(timing) = timing else { return fly(rig, settings, look) };
    let mut judge = Judge::new(settings)?;
    follow(timing, rig, settings, &mut judge, look)?;
    Ok(judge.end())
}

/// Flies by a recorded timing, and leaves what is said of the flight with its judge.
///
/// # Errors
/// As [`fly`].
pub(crate) fn follow(
    timing: &Timing,
    rig: &mut InProcess,
    settings: &Settings,
    judge: &mut Judge,
    mut look: impl FnMut(&InProcess) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut timed = Timed::new(settings)?;
    let mut is_open = false;
    for event in timing.events.iter().filter(|event| event.tick <= settings.last_tick()) {
        if is_open && matches!(event.made, Made::State { .. }) {
            look(rig)?;
            judge.leaves(rig);
            is_open = false;
        }
        if judge.flown.departure.is_some() {
            break;
        }
        timed.play(event, rig, settings, &mut judge.flown.outputs)?;
        if matches!(event.made, Made::State { .. }) {
            if !judge.enters(rig) {
                break;
            }
            judge.flown.outputs.take(event.tick, rig.state());
            judge.flown.ticks += 1;
            is_open = true;
        }
    }
    if is_open {
        look(rig)?;
        judge.leaves(rig);
    }
    Ok(())
}

/// What is said of a flight while it is flown.
#[derive(Debug)]
pub(crate) struct Judge {
    last_tick: u64,
    period_s: f64,
    allowed_m: f64,
    ground_z_m: f64,
    tracking: Tracking,
    lowest_z_m: f64,
    flown: Simulated,
}

impl Judge {
    /// Of a flight that has not begun.
    ///
    /// # Errors
    /// As [`fly`].
    pub(crate) fn new(settings: &Settings) -> Result<Self, Failure> {
        let flown = Simulated {
            ticks: 0,
            outputs: OutputHash::default(),
            error: TrackingError::default(),
            swaps: Vec::new(),
            departure: None,
        };
        let &FlightSettings { period_s, position_error_max_m, ground_z_m, .. } = &settings.flight;
        Ok(Self {
            last_tick: settings.last_tick(),
            period_s,
            allowed_m: position_error_max_m,
            ground_z_m,
            tracking: Tracking::along(settings.course()?, period_s),
            lowest_z_m: f64::INFINITY,
            flown,
        })
    }

    /// Whether the flight has a next tick.
    pub(crate) fn goes_on(&self, rig: &InProcess) -> bool {
        self.flown.departure.is_none() && rig.next_tick() <= self.last_tick
    }

    /// Takes the tick that was flown last, and shows it.
    ///
    /// # Errors
    /// What `look` fails with.
    pub(crate) fn take(
        &mut self,
        rig: &InProcess,
        look: impl FnOnce(&InProcess) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let tick = rig.flown_tick();
        if rig.has_state() {
            if !self.enters(rig) {
                return Ok(());
            }
            self.flown.outputs.take(tick, rig.state());
            rig.setpoint().iter().for_each(|setpoint| self.flown.outputs.take(tick, *setpoint));
        }
        self.flown.ticks += 1;
        rig.new_wrench().into_iter().for_each(|wrench| self.flown.outputs.take(tick, wrench));
        rig.new_rotor_speeds().into_iter().for_each(|speeds| self.flown.outputs.take(tick, speeds));
        if rig.has_state() {
            look(rig)?;
            self.leaves(rig);
        }
        Ok(())
    }

    /// Looks at a new state; false where it is none.
    fn enters(&mut self, rig: &InProcess) -> bool {
        if let Err(departure) = rig.envelope() {
            self.flown.departure = Some(departure.to_string());
            // As in a flight of processes, what is no number is not published.
            if matches!(departure, Departure::NotFinite { .. }) {
                return false;
            }
        }
        self.lowest_z_m = self.lowest_z_m.min(rig.state().truth.position_w_m[2]);
        let (applied, period_s) = (rig.plant().applied().iter(), self.period_s);
        self.flown.swaps.extend(applied.map(|swap| AppliedSwap::new(swap.tick, period_s, &swap_record(swap))));
        true
    }

    /// Looks at a state with what was made of it.
    fn leaves(&mut self, rig: &InProcess) {
        let (tick, state, setpoint) = (rig.state_tick(), rig.state(), rig.setpoint());
        // A set-point carries the reference of its tick already.
        let error_m =
            setpoint.map_or_else(|| self.tracking.error_m(tick, state), |setpoint| setpoint.position_error_m(state));
        self.flown.error.take(error_m);
        let allowed_m = self.allowed_m;
        // It is the outer loop that ends a flight for this, where it works.
        if setpoint.is_some() && error_m > allowed_m {
            self.flown.departure = Some(format!(
                "the flight left its envelope: at tick {tick} the position error is {error_m:.2} m, allowed are \
                 {allowed_m} m"
            ));
        }
    }

    /// What is to be said of it.
    pub(crate) fn end(self) -> Simulated {
        let Self { mut flown, lowest_z_m, ground_z_m, .. } = self;
        if flown.departure.is_none() && lowest_z_m < ground_z_m {
            flown.departure = Some(format!(
                "the flight was below ground: down to z = {lowest_z_m:.2} m, the ground is at {ground_z_m} m"
            ));
        }
        flown
    }
}
