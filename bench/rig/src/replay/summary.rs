//! What a replayed flight was like, in a few lines.

use model::messages::{Mode, RotorSpeeds, Setpoint, State, Wrench};

use crate::replay::survey::Survey;

/// Modes by number, as they are named.
const MODES: [(Mode, &str); 4] =
    [(Mode::Fresh, "fresh"), (Mode::Held, "held"), (Mode::Fallback, "fallback"), (Mode::Idle, "idle")];

/// Counts over a replay.
#[derive(Clone, Copy, Debug, Default)]
pub struct Summary {
    /// States replayed.
    pub ticks: u64,
    /// Processes of the inner loop that were started in flight.
    pub restarts: u64,
    newest: Option<(u64, State)>,
    errors: u64,
    error_squared_sum: f64,
    error_max_m: f64,
    inner: [u64; MODES.len()],
    mixer: [u64; MODES.len()],
    saturated: u64,
    estimate: [f64; 3],
}

impl Summary {
    /// Takes a state.
    pub fn state(&mut self, tick: u64, state: &State) {
        self.ticks += 1;
        self.newest = Some((tick, *state));
    }

    /// Takes a set-point.
    pub fn setpoint(&mut self, tick: u64, setpoint: Option<&Setpoint>) {
        if let (Some((_, state)), Some(setpoint)) = (self.newest.filter(|(newest, _)| *newest == tick), setpoint) {
            let error_m = setpoint.position_error_m(&state);
            self.errors += 1;
            self.error_squared_sum += error_m * error_m;
            self.error_max_m = self.error_max_m.max(error_m);
        }
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
        let rms_m = (self.error_squared_sum / self.errors.max(1) as f64).sqrt();
        text += &format!("position error rms {rms_m:.4} m, largest {:.4} m\n", self.error_max_m);
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
