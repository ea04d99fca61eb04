//! A comparison of two groups of flights as text: what differs first, and at most 80 columns.

use crate::document::{self, Block, known, row, table};
use analysis::diff::{Conclusion, Diff, Difference, FigureDiff, LEVEL_OF_THREE, Says, Side};
use analysis::phrase::{count, list, wrap};
use analysis::schema::NOT_FRESH;
use serde_json::Value;
use std::ops::RangeInclusive;

pub fn render(diff: &Diff) -> String {
    let (said, rest): (Vec<_>, Vec<_>) = diff
        .figures
        .iter()
        .partition(|figure| matches!(figure.says, Says::More | Says::Less));
    let (few, rest): (Vec<_>, Vec<_>) = rest
        .into_iter()
        .partition(|figure| figure.says == Says::TooFewValues);
    let mut blocks = [("Timing", &diff.timing), ("Tracking", &diff.tracking)]
        .map(|(subject, it)| Block::Paragraph(conclusion(subject, it)))
        .to_vec();
    let blank = || Block::Paragraph(String::new());
    if !said.is_empty() {
        blocks.extend([blank(), figures("What differs", &said)]);
    }
    blocks.extend(differences("Settings", &diff.settings));
    blocks.extend(differences("Machine", &diff.machine));
    let builds = format!("Builds: {}", diff.builds);
    blocks.extend([blank(), Block::Paragraph(builds)]);
    blocks.extend([sides("A", &diff.a), sides("B", &diff.b)]);
    blocks.extend([blank(), figures("Everything else", &rest)]);
    if !few.is_empty() {
        let have = if few.len() == 1 { "has" } else { "have" };
        let few = count(few.len() as u64, "figure");
        let few = format!("{few} {have} too few values in some flight");
        blocks.push(Block::Items(vec![few]));
    }
    document::text(&blocks)
}

/// Ratios that need no word.
const NEAR: RangeInclusive<f64> = 0.5..=2.0;

fn conclusion(subject: &str, conclusion: &Conclusion) -> String {
    let sentence = match conclusion {
        Conclusion::NotJudged { reason } => format!("{subject:<9} not judged: {reason}"),
        Conclusion::Judged {
            differ,
            judged,
            level,
            largest,
        } => {
            let found = match differ {
                0 if *level >= LEVEL_OF_THREE => {
                    format!(
                        "too few flights to tell: no difference shown in {judged} figures; fly four a side or more"
                    )
                }
                0 => format!("no difference shown in {judged} figures"),
                differ => format!("{differ} of {judged} figures DIFFER"),
            };
            let large = largest.iter().filter(|(_, ratio)| !NEAR.contains(ratio));
            let large = large.map(|(name, ratio)| {
                format!("; the largest ratio, {ratio:.3} of {name}, may be chance")
            });
            let found = found + &large.collect::<String>();
            format!(
                "{subject:<9} {found} (probability of even one false difference: {:.0} %)",
                level * 100.0
            )
        }
    };
    wrap(&sentence).join("\n")
}

fn figures(title: &str, figures: &[&FigureDiff]) -> Block {
    let rows = figures.iter().map(|figure| {
        let word = match figure.says {
            Says::More => "MORE",
            Says::Less => "LESS",
            _ => "",
        };
        let [a, b] = [figure.median_a, figure.median_b].map(|value| known(value.map(number)));
        let ratio = known(figure.ratio.map(|ratio| format!("{ratio:.3}")));
        let probability = figure
            .probability
            .map(|p| format!("{p:.3}"))
            .unwrap_or_default();
        row([&figure.name, &a, &b, &ratio, &probability, &word])
    });
    table([title, "A", "B", "B over A", "p", ""], rows)
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

fn sides(name: &str, sides: &[Side]) -> Block {
    let side = |(number, side): (usize, &Side)| {
        format!(
            "{name}{number}  {}  {}\n    {}\n    ticks {} + {} skipped, {} {NOT_FRESH}\n    {:.2} % stolen, theorem {}",
            side.run,
            side.status,
            side.build,
            side.ticks,
            side.skipped,
            known(side.not_fresh),
            side.steal_percent,
            side.theorem
        )
    };
    let sides: Vec<String> = (1..).zip(sides).map(side).collect();
    Block::Paragraph(sides.join("\n"))
}

fn differences(title: &str, differences: &[Difference]) -> [Block; 2] {
    let what = match differences.is_empty() {
        true => "the same",
        false => "what differs, A | B",
    };
    let item = |it: &Difference| format!("{}: {} | {}", it.key, values(&it.a), values(&it.b));
    [
        Block::Paragraph(format!("\n{title}: {what}")),
        Block::Items(differences.iter().map(item).collect()),
    ]
}

fn values(values: &[Value]) -> String {
    let one = |value: &Value| match value {
        Value::Null => "-".into(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    list(values.iter().map(one))
}
