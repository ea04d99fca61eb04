//! Prints a comparison for people.

use crate::comparison::{Comparison, ErrorFigures, Outcome, STAYING_S};

/// The comparison as text: what was flown, then a row per combination for each question.
#[must_use]
pub fn render(comparison: &Comparison) -> String {
    let flight = &comparison.flight;
    let mut out = format!("{flight}\n");
    for fault in &flight.faults {
        out += &format!("  {:>8.3} s  {}\n", fault.time_s, fault.what);
    }
    let table = Table::of(comparison);
    out += &errors(comparison, &table);
    if !flight.faults.is_empty() {
        out += &recoveries(comparison, &table);
    }
    out += &efforts(&table);
    out + &endings(comparison, &table)
}

/// Combinations by name, in a column as wide as the longest.
struct Table<'a> {
    rows: Vec<(String, &'a Outcome)>,
    width: usize,
}

impl<'a> Table<'a> {
    fn of(comparison: &'a Comparison) -> Self {
        let rows: Vec<_> = comparison.outcomes.iter().map(|it| (comparison.name_of(&it.laws), it)).collect();
        let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        Self { rows, width }
    }

    /// A line for the columns and one for each combination.
    fn print(&self, columns: &str, row: impl Fn(&Outcome) -> String) -> String {
        let width = self.width;
        let mut out = format!("  {:width$}{columns}\n", "");
        for (name, outcome) in &self.rows {
            out += &format!("  {name:width$}{}\n", row(outcome));
        }
        out
    }
}

fn errors(comparison: &Comparison, table: &Table<'_>) -> String {
    const COLUMNS: &str = "       rms       p99     worst";
    let cells = |figures: Option<&ErrorFigures>| match figures {
        Some(it) => [it.rms_m, it.p99_m, it.worst_m].map(|error_m| format!("{:>10}", millimetres(error_m))).concat(),
        None => format!("{:>10}{:>10}{:>10}", "-", "-", "-"),
    };
    let flight = &comparison.flight;
    let (Some(first), Some(settled)) = (flight.faults.first(), flight.settled_tick()) else {
        return String::from("\nTrue position error [mm]\n")
            + &table.print(COLUMNS, |it| cells(Some(&it.figures.error)));
    };
    let (before_s, after_s) = (first.time_s, flight.time_s(settled));
    let over = |words: String| format!("{words:>30}");
    let spans = over(format!("before {before_s:.3} s")) + &over(format!("from {after_s:.3} s on"));
    format!("\nTrue position error [mm]\n  {:1$}{spans}\n", "", table.width)
        + &table.print(&COLUMNS.repeat(2), |Outcome { figures, .. }| {
            cells(figures.error_before.as_ref()) + &cells(figures.error_after.as_ref())
        })
}

fn recoveries(comparison: &Comparison, table: &Table<'_>) -> String {
    let flight = &comparison.flight;
    let columns: String =
        flight.faults.iter().map(|fault| format!("{:>20}", format!("{:.3} s", fault.time_s))).collect();
    let cells = |outcome: &Outcome| recoveries_of(outcome).map(|words| format!("{words:>20}")).collect();
    format!("\nRecovered from the fault at: true error below {} m for good, {STAYING_S} s at least\n", flight.bound_m)
        + &table.print(&columns, cells)
}

/// Per fault, when a flight had recovered from it, in words.
pub fn recoveries_of(outcome: &Outcome) -> impl Iterator<Item = String> {
    let recovery_s = &outcome.figures.recovery_s;
    recovery_s.iter().enumerate().map(|(i, time_s)| match time_s {
        Some(0.0) => "never above".into(),
        Some(time_s) => format!("after {time_s:.3} s"),
        None if i + 1 == recovery_s.len() => "not in this flight".into(),
        None => "not before the next".into(),
    })
}

fn efforts(table: &Table<'_>) -> String {
    let columns =
        format!("{:>14}{:>24}{:>14}  {}", "power [hover]", "change a tick [rad/s]", "saturated [%]", "outputs");
    String::from("\nEffort\n")
        + &table.print(&columns, |Outcome { figures, outputs, .. }| {
            let effort = &figures.effort;
            format!(
                "{:>14.4}{:>24}{:>14.2}  {outputs}",
                effort.power,
                significant(effort.agitation_rad_s),
                effort.saturated_percent
            )
        })
}

fn endings(comparison: &Comparison, table: &Table<'_>) -> String {
    let lost: String =
        table.rows.iter().filter_map(|(name, outcome)| Some(format!("  {name}: {}\n", ending(outcome)?))).collect();
    let endings = match lost.is_empty() {
        true => format!("\nAll {} flew to the end\n", comparison.outcomes.len()),
        false => format!("\nLost\n{lost}"),
    };
    let unusable = table.rows.iter().flat_map(|(name, outcome)| outcome.unusable.iter().map(move |it| (name, it)));
    let unusable: String = unusable.map(|(name, sentence)| format!("  {name}: {sentence}\n")).collect();
    if unusable.is_empty() { endings } else { format!("{endings}\nAnswers that could not be used\n{unusable}") }
}

/// How a flight was lost; none where it was not.
#[must_use]
pub fn ending(outcome: &Outcome) -> Option<String> {
    let why = outcome.lost.as_ref()?;
    Some(match outcome.ended_early_s {
        Some(time_s) => format!("ended at {time_s:.3} s: {why}"),
        None => why.clone(),
    })
}

/// A length in millimetres [mm], with three digits that count.
#[must_use]
pub fn millimetres(length_m: f64) -> String {
    significant(1e3 * length_m)
}

/// A number with about three digits that count, and without an exponent.
#[must_use]
pub fn significant(value: f64) -> String {
    let digits = match value.abs() {
        100.0.. => 0,
        10.0.. => 1,
        1.0.. => 2,
        _ => 3,
    };
    format!("{value:.digits$}")
}
