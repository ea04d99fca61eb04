//! Prints a comparison of two flights as text.

use std::fmt::Write as _;

use serde_json::Value;

use crate::diff::{Diff, Difference, PercentileDiff, Says, SeriesDiff, Side};
use crate::tally::distribution::PERCENTS;

/// Renders a comparison for people.
#[must_use]
pub fn render(diff: &Diff) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = write(&mut out, diff);
    out
}

fn write(out: &mut String, diff: &Diff) -> std::fmt::Result {
    side(out, "A", &diff.a)?;
    side(out, "B", &diff.b)?;
    writeln!(out, "\nBuilds: {} and {}: {}", diff.a.build, diff.b.build, diff.builds)?;
    differences(out, "Settings", &diff.settings)?;
    differences(out, "Machine", &diff.machine)?;
    writeln!(out, "\nLatencies [us]           A         B  B over A  with 95 %")?;
    for of_series in &diff.series {
        series(out, of_series)?;
    }
    writeln!(out, "\n{} of {} ratios are apart from 1 by more than their spread.", diff.ratios_apart, diff.ratios)?;
    for note in &diff.notes {
        writeln!(out, "{note}")?;
    }
    Ok(())
}

fn side(out: &mut String, name: &str, side: &Side) -> std::fmt::Result {
    writeln!(out, "{name}  {}  {}  {}", side.run, side.started, side.status)?;
    writeln!(
        out,
        "   ticks {} + {} skipped, {} missed ({:.1} per million), {:.2} % stolen, position error rms {:.4} m, theorem {}",
        side.ticks,
        side.skipped,
        side.missed,
        side.missed_ppm,
        side.steal_percent,
        side.position_error_rms_m,
        side.theorem
    )
}

fn differences(out: &mut String, title: &str, differences: &[Difference]) -> std::fmt::Result {
    if differences.is_empty() {
        return writeln!(out, "\n{title}: the same");
    }
    writeln!(out, "\n{title}: what differs, A | B")?;
    for Difference { key, a, b } in differences {
        writeln!(out, "  {key}: {} | {}", value(a), value(b))?;
    }
    Ok(())
}

fn value(value: &Value) -> String {
    match value {
        Value::Null => "-".into(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn series(out: &mut String, series: &SeriesDiff) -> std::fmt::Result {
    writeln!(out, "  {:<15} {:>9} {:>9}  values", series.name, series.count_a, series.count_b)?;
    for percentile in &series.percentiles {
        writeln!(out, "    {}", line(percentile, series))?;
    }
    Ok(())
}

fn line(percentile: &PercentileDiff, series: &SeriesDiff) -> String {
    let name = format!("p{}", percentile.percent);
    let us = |side: &Option<_>, pick: fn(&crate::tally::distribution::Percentile) -> f64| {
        side.as_ref().map_or_else(|| "-".into(), |found| format!("{:.1}", pick(found)))
    };
    let values =
        format!("{name:<13} {:>9} {:>9}", us(&percentile.a, |p| p.value_us), us(&percentile.b, |p| p.value_us));
    let says = match percentile.says {
        Says::TooFewValues => {
            let needed = PERCENTS.into_iter().find(|(percent, _)| *percent == percentile.percent).map_or(0, |p| p.1);
            let least = series.count_a.min(series.count_b);
            return if least < needed {
                format!("{values}  too few values: {least}, {name} needs {needed}")
            } else {
                format!("{values}  too few values: {least}")
            };
        }
        Says::WithinTheSpread => "within the spread",
        Says::More => "MORE",
        Says::Less => "LESS",
    };
    let ratio = |ratio: Option<f64>| ratio.map_or_else(|| "-".into(), |ratio| format!("{ratio:.3}"));
    format!(
        "{values} {:>9}  {} to {}  {says}",
        ratio(percentile.ratio),
        ratio(percentile.ratio_low),
        ratio(percentile.ratio_high)
    )
}
