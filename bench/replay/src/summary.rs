//! Summarises a replayed flight in a few lines.

use controller::laws::adaptive;
use messages::content::{Mode, RotorSpeeds, State, Wrench};
use messages::header::Message;
use messages::output_hash::OutputHash;

use crate::log_check::LogCheck;
use analysis::faults::AppliedSwap;
use analysis::phrase::{count, list};
use analysis::tracking::{Tracking, TrackingStatistics};

/// How many ticks a stage was in each mode.
type Modes = [u64; Mode::ALL.len()];

#[derive(Clone, Debug)]
pub struct Summary {
    tracking: Tracking,
    from_tick: u64,
    pub ticks: u64,
    pub restarts: u64,
    pub takeovers: u64,
    /// Ticks skipped and deadlines missed before the first counted tick.
    before: [u64; 2],
    newest: Option<(u64, State)>,
    statistics: TrackingStatistics,
    inner: Modes,
    mixer: Modes,
    estimate: [f64; 3],
    /// Over all replayed outputs.
    pub outputs: OutputHash,
}

impl Summary {
    pub fn new(tracking: Tracking, from_tick: u64) -> Self {
        Self {
            tracking,
            from_tick,
            ticks: 0,
            restarts: 0,
            takeovers: 0,
            before: [0; 2],
            newest: None,
            statistics: TrackingStatistics::new(tracking.period_s()),
            inner: [0; Mode::ALL.len()],
            mixer: [0; Mode::ALL.len()],
            estimate: [0.0; 3],
            outputs: OutputHash::default(),
        }
    }

    pub fn state(&mut self, tick: u64, state: &State) {
        if tick < self.from_tick {
            self.before = [state.ticks_skipped, state.deadlines_missed];
            return;
        }
        self.ticks += 1;
        self.newest = Some((tick, *state));
        let errors = self.tracking.errors(tick, state, None);
        self.statistics.take(tick, state, &errors);
    }

    /// Takes all missed deadlines of a flight that is over.
    pub const fn end(&mut self, deadlines_missed: u64) {
        if let Some((_, state)) = &mut self.newest {
            state.deadlines_missed = deadlines_missed;
        }
    }

    pub fn wrench(&mut self, wrench: &Wrench) {
        take(&mut self.inner, wrench.mode);
        self.estimate = adaptive::estimate(&wrench.telemetry);
    }

    pub fn rotor_speeds(&mut self, speeds: &RotorSpeeds) {
        take(&mut self.mixer, speeds.mode);
        self.statistics.effort.take(speeds);
    }

    /// Ticks from the first to the newest one, including skipped ones.
    pub fn flown_ticks(&self) -> u64 {
        self.newest.map_or(0, |(tick, _)| tick + 1)
    }

    pub fn text(&self, survey: &LogCheck) -> String {
        let flight = &survey.settings.flight;
        let (tick, state) = self.newest.unwrap_or_default();
        let [skipped, missed] = [
            state.ticks_skipped - self.before[0],
            state.deadlines_missed - self.before[1],
        ];
        let from = match self.from_tick {
            0 => String::new(),
            from => format!("from tick {from} "),
        };
        let replayed = count(self.ticks, "tick");
        let performance = self.statistics.performance();
        let errors = render::sentences::errors(&performance).join("\n");
        let effort = render::sentences::effort(&performance);
        let effort = effort.unwrap_or_else(|| "no rotor command".into());
        let mut text = format!(
            "{}: {replayed} replayed, {from}to tick {tick} ({:.3} s); {skipped} skipped, {} missed\n\
             {errors}\n\
             inner loop {}; started {} in flight\n\
             mixer      {}; {effort}\n\
             outputs    {}\n",
            survey.settings.conditions(),
            tick as f64 * flight.period_s,
            count(missed, "deadline"),
            modes(&self.inner),
            count(self.restarts, "time"),
            modes(&self.mixer),
            self.outputs
        );
        if survey.settings.rt.channels > 1 {
            let taken = count(self.takeovers, "state");
            text += &format!("channels   {taken} taken over from another channel or process\n");
        }
        let law_without_theorem = survey.settings.law_without_theorem();
        if law_without_theorem.is_ok_and(|law| law.is_none()) {
            let [i_r, k_r, delta] = self.estimate;
            text += &format!(
                "estimates  I_R {i_r:.6e} kg m^2, k_r {k_r:.6e} N m s, delta {delta:.6e} rad/s^2\n"
            );
        }
        for Message { envelope, content } in &survey.swaps {
            if envelope.tick >= self.from_tick {
                let swap = AppliedSwap::new(envelope.tick, flight.period_s, content);
                let (epoch, tick) = (swap.parameter_epoch, swap.tick);
                text += &format!(
                    "parameter change {epoch} at tick {tick}: {}\n",
                    render::sentences::swap(&swap)
                );
            }
        }
        text
    }
}

fn take(counts: &mut Modes, mode: u64) {
    if let Some(mode) = Mode::from_wire(mode) {
        counts[mode as usize] += 1;
    }
}

fn modes(counts: &Modes) -> String {
    let modes = Mode::ALL.iter().zip(counts);
    list(modes.map(|(mode, count)| format!("{} {count}", mode.name())))
}
