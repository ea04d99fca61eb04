//! Prints a comparison of two groups of flights as text: what differs first, and at most 80 columns.

use crate::diff::{Conclusion, Diff, Difference, FigureDiff, Says, Side};
use crate::phrase::{count, wrapped};
use serde_json::Value;
use std::fmt::Write as _;

#[must_use]
pub fn render(diff: &Diff) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = write(&mut out, diff);
    out
}

fn write(out: &mut String, diff: &Diff) -> std::fmt::Result {
    conclusion(out, "Timing", &diff.timing)?;
    conclusion(out, "Tracking", &diff.tracking)?;
    let said = |figure: &&FigureDiff| matches!(figure.says, Says::More | Says::Less);
    if diff.figures.iter().any(|figure| said(&figure)) {
        heading(out, "What differs")?;
        diff.figures
            .iter()
            .filter(said)
            .try_for_each(|figure| row(out, figure))?;
    }
    differences(out, "Settings", &diff.settings)?;
    differences(out, "Machine", &diff.machine)?;
    writeln!(out, "\nBuilds: {}", diff.builds)?;
    sides(out, "A", &diff.a)?;
    sides(out, "B", &diff.b)?;
    heading(out, "Everything else")?;
    let rest = diff.figures.iter().filter(|figure| !said(figure));
    rest.clone()
        .filter(|figure| figure.says != Says::TooFewValues)
        .try_for_each(|figure| row(out, figure))?;
    let missing = rest
        .filter(|figure| figure.says == Says::TooFewValues)
        .count();
    if missing > 0 {
        writeln!(
            out,
            "  {} too few values in some flight",
            has(missing as u64)
        )?;
    }
    Ok(())
}

fn conclusion(out: &mut String, subject: &str, conclusion: &Conclusion) -> std::fmt::Result {
    let sentence = match conclusion {
        Conclusion::NotJudged { reason } => format!("{subject:<9} not judged: {reason}"),
        Conclusion::Judged {
            differ,
            judged,
            level,
        } => {
            let found = match differ {
                0 => format!("no difference in {judged} figures"),
                differ => format!("{differ} of {judged} figures DIFFER"),
            };
            format!(
                "{subject:<9} {found} (probability of even one false difference: {:.0} %)",
                level * 100.0
            )
        }
    };
    wrapped(&sentence)
        .iter()
        .try_for_each(|line| writeln!(out, "{line}"))
}

fn has(figures: u64) -> String {
    format!(
        "{} {}",
        count(figures, "figure"),
        if figures == 1 { "has" } else { "have" }
    )
}

fn heading(out: &mut String, title: &str) -> std::fmt::Result {
    writeln!(
        out,
        "\n{title:<33} {:>11} {:>11} {:>9}  {:>6}",
        "A", "B", "B over A", "p"
    )
}

fn row(out: &mut String, figure: &FigureDiff) -> std::fmt::Result {
    let word = match figure.says {
        Says::More => "MORE",
        Says::Less => "LESS",
        _ => "",
    };
    let [a, b] =
        [figure.median_a, figure.median_b].map(|value| value.map_or_else(|| "-".into(), number));
    let ratio = figure
        .ratio
        .map_or_else(|| "-".into(), |ratio| format!("{ratio:.3}"));
    let probability = figure
        .probability
        .map_or_else(String::new, |p| format!("{p:.3}"));
    let line = format!(
        "  {:<31} {a:>11} {b:>11} {ratio:>9}  {probability:>6} {word}",
        figure.name
    );
    writeln!(out, "{}", line.trim_end())
}

fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 1.0 => format!("{value:.2}"),
        size if size >= 1e-4 => format!("{value:.5}"),
        _ => format!("{value:.2e}"),
    }
}

fn sides(out: &mut String, name: &str, sides: &[Side]) -> std::fmt::Result {
    for (number, side) in (1..).zip(sides) {
        writeln!(out, "{name}{number}  {}  {}", side.run, side.status)?;
        writeln!(
            out,
            "    {}\n    ticks {} + {} skipped, {} missed, {:.2} % stolen, theorem {}",
            side.build, side.ticks, side.skipped, side.missed, side.steal_percent, side.theorem
        )?;
    }
    Ok(())
}

fn differences(out: &mut String, title: &str, differences: &[Difference]) -> std::fmt::Result {
    if differences.is_empty() {
        return writeln!(out, "\n{title}: the same");
    }
    writeln!(out, "\n{title}: what differs, A | B")?;
    for Difference { key, a, b } in differences {
        writeln!(out, "  {key}: {} | {}", values(a), values(b))?;
    }
    Ok(())
}

fn values(values: &[Value]) -> String {
    let one = |value: &Value| match value {
        Value::Null => "-".into(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    values.iter().map(one).collect::<Vec<_>>().join(", ")
}
