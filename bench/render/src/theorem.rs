//! The section on the Lyapunov monitor.

use crate::document::{self, Block, Cell, Table, known, row, table};
use crate::figures::Figures;
use analysis::phrase::{count, name_of};
use analysis::schema::Explained;
use analysis::theorem::{NO_CAUSE, ResidualCause, Theorem, Watched};
use analysis::verdicts::stability_verdict;
use messages::monitor::Cause;
use std::collections::BTreeMap;

pub fn text(theorem: &Theorem) -> String {
    document::text(&blocks(theorem, None))
}

/// What the theorem leaves of an estimate's error: no more than it proves.
fn bound(theorem: &Theorem, estimate: &Watched) -> String {
    let (bound, allowed) = (estimate.error_bound, estimate.error_allowed);
    match theorem.broken.is_empty() {
        true => format!("by the theorem at most {bound:.2e} + {allowed:.2e}"),
        false => format!("no bound under {}", theorem.broken.join(", ")),
    }
}

/// The section; with charts where there are traces.
pub fn blocks(theorem: &Theorem, figures: Option<Figures<'_>>) -> Vec<Block> {
    let Explained { word, why, .. } = stability_verdict(theorem);
    let mut blocks = vec![Block::Fact("Theorem", format!("{}: {why}", name_of(&word)))];
    if theorem.inapplicable().is_some() || theorem.ticks_checked == 0 {
        return blocks;
    }
    let items = [watched(theorem), innovation(theorem)];
    blocks.push(Block::Items(items.concat()));
    blocks.push(Block::Table(causes(theorem)));
    blocks.push(estimates(theorem));
    if let Some(figures) = figures {
        let note =
            "The axis of the changes is logarithmic to both sides of 0, and linear in its middle.";
        blocks.push(Block::Figures(figures.theorem()));
        blocks.push(Block::Note(note.into()));
    }
    blocks
}

/// The figures of V_th, of the torque and of the rate error, a line each.
fn watched(theorem: &Theorem) -> Vec<String> {
    let moved = match (theorem.is_live, theorem.descent_predicted) {
        (true, 0.0) => "nothing to compare",
        (true, _) => "the estimates move as predicted",
        (false, _) => "THE ESTIMATES DO NOT MOVE AS PREDICTED",
    };
    let rms = format!(
        ", {:.2e} rms in the last second",
        theorem.rate_error_rms_rad_s
    );
    vec![
        format!(
            "V_th {:.3e} rad^2/s^2 at the start, {:.3e} at the end",
            theorem.v_th_start, theorem.v_th_end
        ),
        format!(
            "fell by {:.4e} where the theorem predicts {:.4e}: {moved}, in {}",
            theorem.descent,
            theorem.descent_predicted,
            count(theorem.steps_adapted, "step")
        ),
        format!(
            "largest excess of a step over what it owes: {:.3e} of what rounding is allowed",
            theorem.step_excess_max
        ),
        format!(
            "{} compared with (19) of their inputs, {} differ; {}",
            count(theorem.torque.wrenches, "wrench message"),
            theorem.torque.wrenches_wrong,
            theorem.torque()
        ),
        format!(
            "e {:.2e} rad/s at most, {:.2e} at the end{rms}; {}, {} with a stale input, {} of estimated parameters",
            theorem.rate_error_max_rad_s,
            theorem.rate_error_final_rad_s,
            count(theorem.ticks_saturated, "saturated tick"),
            theorem.ticks_stale,
            count(theorem.live_swaps, "change")
        ),
        format!(
            "excitation of the worst direction: {:.3e} e-folds of the error in the last window of at most \
             10 s, {:.3e} in the least exciting one",
            theorem.excitation, theorem.excitation_least
        ),
        theorem.convergence.clone(),
        format!(
            "V, with the rate error, was above its bound in {}: not judged, because its inequality is proven without \
             delay alone",
            count(theorem.v_above_bound.values().sum(), "step")
        ),
    ]
}

fn estimates(theorem: &Theorem) -> Block {
    let columns = [
        "estimate",
        "error, last step watched",
        "first",
        "at most",
        "excitation",
        "found",
    ];
    let rows = theorem.estimates.iter().map(|it| {
        let [error, first, excitation] =
            [it.error, it.error_start, it.identifiability].map(|it| format!("{it:.2e}"));
        let found = if it.found { "yes" } else { "no" };
        let (name, bound) = (&it.name, bound(theorem, it));
        row([name, &error, &first, &bound, &excitation, &found])
    });
    table(columns, rows)
}

/// What the estimates leave unexplained, and which of them a bound held back: both are known without ground truth.
fn innovation(theorem: &Theorem) -> Vec<String> {
    let it = &theorem.innovation;
    let says = match it.says {
        ResidualCause::NotKnown => "not known",
        ResidualCause::Explained => "the estimates explain it",
        ResidualCause::Noise => "the rest is noise",
        ResidualCause::MissingCause => {
            "the three parameters do not explain it, or are not learned yet"
        }
    };
    let residual = (it.sample_rms_rad_s2 > 0.0).then(|| format!(
        "residual |Y - X th_hat| is {:.2} % of |Y|, {:.2e} rad/s^2, in the last second, correlation {:.2}: {says}",
        100.0 * it.rms_rad_s2 / it.sample_rms_rad_s2, it.sample_rms_rad_s2, it.correlation
    ));
    let bounded = it.steps_at_bound.iter();
    let bounded = bounded.map(|(name, steps)| format!("{name} in {}", count(*steps, "step")));
    let bounded: Vec<String> = bounded.collect();
    let bounded = (!bounded.is_empty()).then(|| format!("at a bound: {}", bounded.join(", ")));
    residual.into_iter().chain(bounded).collect()
}

/// Every cause in force at some rise, with its counts; V above its bound is not judged.
fn causes(theorem: &Theorem) -> Table {
    let unexplained = Cause::Unexplained.name();
    let rises = theorem.largest_rise.keys().map(String::as_str);
    let rises = rises.map(|cause| {
        if cause == NO_CAUSE {
            unexplained
        } else {
            cause
        }
    });
    let counted = theorem.violations.keys();
    let counted = counted.chain(theorem.v_above_bound.keys());
    let mut names: Vec<&str> = counted.map(String::as_str).chain(rises).collect();
    names.sort_unstable();
    names.dedup();
    let rows = names.into_iter().map(|cause| {
        let of = |counts: &BTreeMap<String, u64>| counts.get(cause).copied().unwrap_or(0);
        let key = if cause == unexplained {
            NO_CAUSE
        } else {
            cause
        };
        let rise = theorem.largest_rise.get(key);
        let rise = rise.map(|it| format!("{:.1e} ({:.1e} of the start)", it.absolute, it.relative));
        let (violations, above) = (of(&theorem.violations), of(&theorem.v_above_bound));
        let mut cells = row([&cause, &violations, &known(rise), &above]);
        cells.push(Cell::from(explanation(cause)));
        cells
    });
    let columns = ["rises by cause", "steps", "largest", "V above bound", ""];
    Table::new(columns, rows)
}

fn explanation(cause: &str) -> &'static str {
    match cause {
        "live_swap" => "samples from before a parameter change had not faded",
        "out_of_bounds" => "a true value lies outside the bounds of its estimate",
        "broken_model" => "a parameter that is not estimated is not the model's",
        "gyro_noise" => "the measured rates are noisy",
        "motor_lag" => "the motors lag",
        "saturation" => "the rotors could not deliver the demand; excuses V and the torque",
        "stale_input" => {
            "a state, a setpoint or a command was not of its tick; excuses V and the torque"
        }
        "delay" => {
            "the chain's delay and the low-pass excuse V alone, `command_delay_s` also the torque"
        }
        _ => "no cause is known",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_claimed_of_an_estimate_than_the_theorem_proves() {
        let estimate = Watched {
            error_bound: 0.5,
            error_allowed: 0.25,
            ..Watched::default()
        };
        let mut theorem = Theorem::default();
        let proven = "by the theorem at most 5.00e-1 + 2.50e-1";
        assert_eq!(bound(&theorem, &estimate), proven);
        theorem.broken = vec!["broken_model".into()];
        assert_eq!(bound(&theorem, &estimate), "no bound under broken_model");
    }
}
