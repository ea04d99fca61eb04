//! What a replayed flight was like, in a few lines.

use model::messages::{Mode, RotorSpeeds, State, Wrench};

use crate::replay::survey::Survey;
use report::tracking::{Tracking, TrackingError};

/// Modes by number, as they are named.
const MODES: [(Mode, &str); 4] =
    [(Mode::Fresh, "fresh"), (Mode::Held, "held"), (Mode::Fallback, "fallback"), (Mode::Idle, "idle")];

/// Counts over a replay.
#[derive(Clone, Copy, Debug)]
pub struct Summary {
    tracking: Tracking,
    /// States replayed.
    pub ticks: u64,
    /// Processes of the inner loop that were started in flight.
    pub restarts: u64,
    newest: Option<(u64, State)>,
    error: TrackingError,
    inner: [u64; MODES.len()],
    mixer: [u64; MODES.len()],
    saturated: u64,
    estimate: [f64; 3],
}

impl Summary {
    /// Of a flight with this reference.
    #[must_use]
    pub fn new(tracking: Tracking) -> Self {
        Self {
            tracking,
            ticks: 0,
            restarts: 0,
            newest: None,
            error: TrackingError::default(),
            inner: [0; MODES.len()],
            mixer: [0; MODES.len()],
            saturated: 0,
            estimate: [0.0; 3],
        }
    }

    /// Takes a state.
    pub fn state(&mut self, tick: u64, state: &State) {
        self.ticks += 1;
        self.newest = Some((tick, *state));
        self.error.take(self.tracking.error_m(tick, state));
    }

    /// Takes a wrench.
    pub fn wrench(&mut self, wrench: &Wrench) {
        count(&mut self.inner, wrench.mode);
        self.estimate = wrench.estimate;
    }

    /// Takes a rotor command.
    pub fn rotor_speeds(&mut self, speeds: &RotorSpeeds) {
        count(&mut self.mixer, speeds.mode);
        self.saturated += speeds.saturated;
    }

    /// In words.
    #[must_use]
    pub fn text(&self, survey: &Survey) -> String {
        let flight = &survey.settings.flight;
        let (tick, state) = self.newest.unwrap_or_default();
        let mut text = format!(
            "{} with gains {}: {} ticks replayed, to tick {tick} ({:.3} s); {} skipped, {} deadlines missed\n",
            flight.trajectory,
            flight.preset,
            self.ticks,
            tick as f64 * flight.period_s,
            state.ticks_skipped,
            state.deadlines_missed
        );
        text += &format!("position error {}\n", self.error);
        text += &format!("inner loop {}; started {} times in flight\n", modes(&self.inner), self.restarts);
        text += &format!("mixer      {}; rotors saturated in {} ticks\n", modes(&self.mixer), self.saturated);
        let [i_r, k_r, delta] = self.estimate;
        text += &format!("estimates  I_R {i_r:.6e} kg m^2, k_r {k_r:.6e} N m s, delta {delta:.6e} rad/s^2\n");
        for swap in &survey.swaps {
            let changes: Vec<String> = swap
                .content
                .changes()
                .map(|(parameter, old, new)| format!("{} {old} -> {new}", parameter.name()))
                .collect();
            let (epoch, tick) = (swap.content.parameter_epoch, swap.envelope.tick);
            text += &format!("swap {epoch} at tick {tick}: {}\n", changes.join(", "));
        }
        text
    }
}

fn count(counts: &mut [u64; MODES.len()], mode: u64) {
    if let Some(place) = MODES.iter().position(|(known, _)| *known as u64 == mode) {
        counts[place] += 1;
    }
}

fn modes(counts: &[u64; MODES.len()]) -> String {
    MODES.iter().zip(counts).map(|((_, name), count)| format!("{name} {count}")).collect::<Vec<_>>().join(", ")
}
