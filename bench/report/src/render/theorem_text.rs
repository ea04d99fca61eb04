//! The section on the Lyapunov monitor, as text.

use crate::laws::no_theorem;
use crate::phrase::count;
use crate::theorem::{NO_CAUSE, Theorem, Watched};
use messages::monitor::Cause;
use std::collections::BTreeMap;
use std::fmt::Write as _;

impl Theorem {
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing into a string cannot fail.
        let _ = self.write(&mut out);
        out
    }

    /// Why it says nothing of a flight whose inner law has no theorem.
    #[must_use]
    pub fn inapplicable(&self) -> Option<String> {
        self.law_without.as_deref().map(no_theorem)
    }

    #[must_use]
    pub fn unexplained(&self) -> u64 {
        self.violations
            .get(Cause::Unexplained.name())
            .copied()
            .unwrap_or(0)
    }

    /// How many steps were checked, and how often V rose in one.
    #[must_use]
    pub fn counts(&self) -> String {
        let violations = self
            .violations
            .values()
            .fold(0, |sum: u64, count| sum.saturating_add(*count));
        let unexplained = self.unexplained();
        let mut checked = format!("{} checked", count(self.ticks_checked, "step"));
        if self.ticks_unwatched > 0 {
            checked += &format!(
                ", {} not watched after a lost message",
                self.ticks_unwatched
            );
        }
        match violations {
            0 => format!("{checked}, V rose in none"),
            _ => format!("{checked}, V rose in {violations}, {unexplained} of them unexplained"),
        }
    }

    #[must_use]
    pub fn found(&self) -> String {
        let unexplained = self.unexplained();
        format!(
            "{unexplained} unexplained, estimates {}",
            if self.is_live {
                "live"
            } else {
                "do not move as predicted"
            }
        )
    }

    #[must_use]
    pub fn verdict(&self) -> &'static str {
        match (self.holds, self.violations.values().sum::<u64>()) {
            _ if self.law_without.is_some() => "not applicable",
            _ if self.ticks_checked == 0 => "not watched",
            (false, _) => "DOES NOT HOLD",
            (true, 0) => "holds",
            (true, _) => "holds where its assumptions do",
        }
    }

    /// What the theorem leaves of an estimate's error: no more than it proves.
    fn bound(&self, estimate: &Watched) -> String {
        let bound = estimate.error_bound;
        if !self.broken.is_empty() {
            format!("no bound under {}", self.broken.join(", "))
        } else if estimate.error.abs() <= bound {
            format!("by the theorem at most {bound:.2e}")
        } else {
            format!("by the theorem at most {bound:.2e} beside the trapezoidal rule")
        }
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        if let Some(why) = self.inapplicable() {
            return writeln!(out, "\nTheorem   not applicable: {why}");
        }
        if self.ticks_checked == 0 {
            let why = match self.ticks_unwatched {
                0 => "no step of the estimates was seen".into(),
                ticks => format!(
                    "a message before the first step was lost, and {} went by",
                    count(ticks, "tick")
                ),
            };
            return writeln!(out, "\nTheorem   not watched: {why}");
        }
        writeln!(out, "\nTheorem   {}: {}", self.verdict(), self.counts())?;
        for (cause, count) in self
            .violations
            .iter()
            .filter(|(cause, _)| *cause != Cause::Unexplained.name())
        {
            writeln!(
                out,
                "  explained rises of V_th: {count}, {}",
                explained(cause)
            )?;
        }
        write!(
            out,
            "  V_th {:.3e} at the start, {:.3e} at the end; largest rise in a step",
            self.v_th_start, self.v_th_end
        )?;
        for (cause, rise) in self.largest_rise.iter().rev() {
            let when = if cause == NO_CAUSE {
                String::new()
            } else {
                format!(", under {cause}")
            };
            write!(
                out,
                "{when} {:.1e} rad^2/s^2 ({:.1e} of the start)",
                rise.absolute, rise.relative
            )?;
        }
        writeln!(out)?;
        writeln!(
            out,
            "  fell by {:.4e} where the theorem predicts {:.4e}{}",
            self.descent,
            self.descent_predicted,
            if self.is_live {
                ""
            } else {
                ": THE ESTIMATES DO NOT MOVE AS PREDICTED"
            }
        )?;
        let above: u64 = self.v_above_bound.values().sum();
        writeln!(
            out,
            "  V above its bound in {above} steps{}",
            list(&self.v_above_bound)
        )?;
        writeln!(
            out,
            "  e {:.2e} rad/s at most, {:.2e} at the end; {}, {} with a stale input, {}",
            self.rate_error_max_rad_s,
            self.rate_error_final_rad_s,
            count(self.ticks_saturated, "saturated tick"),
            self.ticks_stale,
            count(self.live_swaps, "live swap")
        )?;
        for estimate in &self.estimates {
            writeln!(
                out,
                "  {:<24} error {:>9.2e}, first {:.2e}, {}; excitation {:.2e}",
                estimate.name,
                estimate.error,
                estimate.error_start,
                self.bound(estimate),
                estimate.identifiability
            )?;
        }
        writeln!(out, "  {}", self.convergence)
    }
}

/// What a cause of a violation is, in words.
#[must_use]
pub fn explained(cause: &str) -> &'static str {
    match cause {
        "live_swap" => "samples from before a live swap had not faded",
        "out_of_bounds" => "a true value lies outside the bounds of its estimate",
        "broken_model" => "a parameter that is not estimated is not the model's",
        "gyro_noise" => "the gyro is noisy",
        "motor_lag" => "the motors lag",
        "saturation" => "the rotors could not do what was asked; excuses V alone",
        "stale_input" => "a state, a set-point or a command was not of its tick; excuses V alone",
        "delay" => "the chain's delay and the low-pass, in every flight; excuses V alone",
        _ => "no cause is known",
    }
}

fn list(counts: &BTreeMap<String, u64>) -> String {
    let all: Vec<String> = counts
        .iter()
        .filter(|(_, count)| **count > 0)
        .map(|(cause, count)| format!("{cause} {count}"))
        .collect();
    if all.is_empty() {
        String::new()
    } else {
        format!(" ({}); not judged", all.join(", "))
    }
}
