//! What a campaign has shown, as text.

use crate::bins::short;
use crate::gates::METRICS;
use crate::metric_distribution::Distribution;
use crate::results::{CampaignResults, Of, Pair, VariantResults, Worst};
use std::fmt::Write as _;

/// Renders findings; `directory` is named in the command that flies the worst flights again.
#[must_use]
pub fn render(findings: &CampaignResults, directory: &str) -> String {
    let CampaignResults {
        name,
        flights,
        planned,
        arms,
        pairs,
        worst,
        ..
    } = findings;
    let part = if flights == planned {
        String::new()
    } else {
        format!(" of {planned}")
    };
    let mut text = format!(
        "{name}: {flights} flights{part}, each by {}\n",
        crate::results::counted(arms.len(), "arm")
    );
    text += &format!(
        "\nSuccess, with its {} interval at 95 %\n",
        findings.intervals
    );
    let width = arms
        .iter()
        .map(|arm| arm.name.len())
        .max()
        .unwrap_or_default()
        .max(6);
    for arm in arms {
        text += &format!("  {}\n", success(arm, width));
    }
    text += &metrics(arms, width);
    if !pairs.is_empty() {
        text += "\nArms on the same draws: first less second\n";
        pairs.iter().for_each(|pair| text += &paired(pair));
    }
    text += &effects(findings);
    if let Some(audit) = &findings.audit {
        text += &format!("\nAudit: {}\n", audit.words());
        audit
            .differences
            .iter()
            .for_each(|it| text += &format!("  {}\n", it.words()));
    }
    text += "\nWorst flights\n";
    for flight in worst {
        text += &format!("  {}\n", worst_line(flight));
    }
    if let Some(Worst { flight, arm, .. }) = worst.first() {
        text +=
            &format!("  fly one again: ironbird campaign fly {directory} {flight} --arm {arm}\n");
    }
    text
}

fn success(arm: &VariantResults, width: usize) -> String {
    let VariantResults {
        name,
        flights,
        successes,
        interval,
        lost,
        gates,
        ..
    } = arm;
    let rate = *successes as f64 / (*flights).max(1) as f64;
    let mut line = format!(
        "{name:<width$}  {successes} of {flights}  {}  {} to {}; {lost} lost",
        percent(rate),
        percent(interval.low),
        percent(interval.high)
    );
    for gate in gates.iter().filter(|gate| gate.held < gate.asked) {
        // Writing into a string cannot fail.
        let _ = write!(line, "; {} failed in {}", gate.name, gate.asked - gate.held);
    }
    line
}

/// A share with as many digits as it needs near 0 and 1.
#[must_use]
pub fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    let nearest = percent.min(100.0 - percent);
    let digits = if nearest == 0.0 {
        0
    } else {
        (1 - nearest.log10().floor() as i32).clamp(1, 5) as usize
    };
    format!("{percent:.digits$} %")
}

fn metrics(arms: &[VariantResults], width: usize) -> String {
    let mut text = String::new();
    for (i, metric) in METRICS.iter().enumerate() {
        let known: Vec<(&str, &Distribution)> = arms
            .iter()
            .map(|arm| (arm.name.as_str(), &arm.metrics[i].is))
            .filter(|(_, it)| it.count > 0)
            .collect();
        // What is the same in every flight says nothing.
        if known.iter().all(|(_, it)| it.min == it.max) {
            continue;
        }
        text += &format!("\n{} ({})\n", metric.name, metric.meaning);
        for (name, it) in known {
            let quantiles: Vec<String> = it
                .quantiles
                .iter()
                .map(|q| format!("p{} {}", (1e4 * q.share).round() / 1e2, short(q.value)))
                .collect();
            text += &format!(
                "  {name:<width$}  {}  max {}  ({} flights)\n",
                quantiles.join("  "),
                short(it.max),
                it.count
            );
        }
    }
    text
}

fn paired(pair: &Pair) -> String {
    let it = pair.difference;
    let mut text = format!(
        "  {} - {}: success {:+.2} points ({:+.2} to {:+.2}); {} and {} flights that one alone flew, p = {}\n",
        pair.first,
        pair.second,
        100.0 * it.mean,
        100.0 * it.interval.low,
        100.0 * it.interval.high,
        pair.discordant.first,
        pair.discordant.second,
        short(pair.p_value)
    );
    for Of { name, is: it } in pair
        .metrics
        .iter()
        .filter(|metric| metric.is.interval.low != 0.0 || metric.is.interval.high != 0.0)
    {
        text += &format!(
            "    {name} {} ({} to {}), mean of {} flights that neither lost\n",
            short_signed(it.mean),
            short_signed(it.interval.low),
            short_signed(it.interval.high),
            it.count
        );
    }
    text
}

fn short_signed(value: f64) -> String {
    let sign = if value < 0.0 { "-" } else { "+" };
    format!("{sign}{}", short(value.abs()))
}

fn effects(findings: &CampaignResults) -> String {
    if findings.factors.is_empty() {
        return String::new();
    }
    let mut text =
        "\nWhat matters: share of the variance of success (of the largest error) that a factor alone accounts \
                    for\n"
            .to_owned();
    let width = findings
        .factors
        .iter()
        .map(|factor| factor.name.len())
        .max()
        .unwrap_or_default();
    for factor in &findings.factors {
        let share = |share: Option<f64>| {
            share.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share))
        };
        let of_arm = |(arm, effect): (&VariantResults, &crate::results::Effect)| {
            let rates = effect.bins.iter().filter(|bin| bin.flights > 0);
            let rate = |bin: &crate::bins::Bin| bin.successes as f64 / bin.flights as f64;
            let least = rates.clone().min_by(|a, b| rate(a).total_cmp(&rate(b)));
            let most = rates.max_by(|a, b| rate(a).total_cmp(&rate(b)));
            let spread = match (least, most) {
                (Some(least), Some(most)) if rate(least) < rate(most) => {
                    let [low, high] = [least, most]
                        .map(|bin| format!("{:.0} % at {}", 100.0 * rate(bin), bin.name));
                    format!(", {low}, {high}")
                }
                _ => String::new(),
            };
            format!(
                "{} {} ({}){spread}",
                arm.name,
                share(effect.of_success),
                share(effect.of_error)
            )
        };
        let arms: Vec<String> = findings.arms.iter().zip(&factor.arms).map(of_arm).collect();
        text += &format!("  {:<width$}  {}\n", factor.name, arms.join("; "));
    }
    text
}

/// A drawn value, a number in few digits.
pub(super) fn drawn(value: &str) -> String {
    value.parse().map_or_else(|_| value.to_owned(), short)
}

fn worst_line(flight: &Worst) -> String {
    let Worst {
        flight,
        arm,
        success,
        position_error_max_m,
        lost,
        drew,
    } = flight;
    let how = match (lost.is_empty(), success) {
        (false, _) => format!("lost: {lost}"),
        (true, false) => "failed".into(),
        (true, true) => "success".into(),
    };
    let drew: Vec<String> = drew
        .iter()
        .filter(|(name, _)| name != "flight.seed")
        .map(|(name, value)| format!("{name}={}", drawn(value)))
        .collect();
    format!(
        "{flight} by {arm}: largest error {} m, {how}; {}",
        short(*position_error_max_m),
        drew.join(" ")
    )
}
