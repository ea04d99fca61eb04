//! What `fly` ends with: at most 30 lines of at most 80 columns, what matters first.

use std::collections::BTreeMap;

use crate::losses;
use crate::schema::Report;

/// Columns of a terminal that nobody has made wider.
const WIDTH: usize = 80;
/// What the lines of a sentence begin with after the first one.
const INDENT: &str = "          ";
/// The latencies that say how the loop did: those of the whole, then of each step.
const SERIES: [&str; 6] = ["loop", "slack", "wake.plant", "hop.plant_outer", "hop.outer_inner", "hop.inner_mixer"];

/// Renders the short report of a flight, with where the rest is.
#[must_use]
pub fn render(report: &Report, directory: &str) -> String {
    let mut lines = vec![super::pace(report)];
    lines
        .extend(report.words.each().map(|(subject, word, why)| format!("{subject:<9} {}: {why}", word.to_uppercase())));
    lines.extend(losses::sentences(report));
    if !matches!(report.run.ending.as_str(), "completed" | "") {
        lines.push(format!("Ended     {}", report.run.ending));
    }
    lines.extend(outages(report));
    lines.push(tracking(report));
    lines.extend(refused(report));
    lines.extend(gates(report));
    let wrapped = |line: &String| wrap(line);
    let head: Vec<String> = lines.iter().flat_map(wrapped).collect();
    let foot = [
        format!("Page      {directory}/report.html"),
        format!("Log       {directory}/flight.mcap"),
        "          everything: ironbird report --full".to_owned(),
    ];
    [head, latencies(report), foot.to_vec()].concat().join("\n") + "\n"
}

/// A sentence in lines that fit; a word that does not is left whole.
fn wrap(sentence: &str) -> Vec<String> {
    let options = textwrap::Options::new(WIDTH).subsequent_indent(INDENT).break_words(false);
    textwrap::wrap(sentence, options).into_iter().map(std::borrow::Cow::into_owned).collect()
}

fn latencies(report: &Report) -> Vec<String> {
    let mut lines = vec!["Latencies [us]        count        p50        p99      p99.9        max".to_owned()];
    for series in SERIES.iter().filter_map(|name| report.series(name)) {
        let rare = series.p999_us.map_or_else(|| "-".into(), |us| format!("{us:.1}"));
        lines.push(format!(
            "  {:<15} {:>9} {:>10.1} {:>10.1} {rare:>10} {:>10.1}",
            series.name, series.count, series.p50_us, series.p99_us, series.max_us
        ));
    }
    lines
}

/// How many outages there were, and the worst one.
fn outages(report: &Report) -> Option<String> {
    let autopsy = &report.autopsy;
    let (outages, missed) = autopsy
        .classes
        .iter()
        .fold((0, 0), |(outages, missed), count| (outages + count.outages, missed + count.missed));
    let worst = autopsy.worst.first()?;
    let many = if outages == 1 { "1, with".to_owned() } else { format!("{outages}, with") };
    Some(format!("Outages   {many} {missed} of the missed deadlines; the worst: {}", worst.line()))
}

fn tracking(report: &Report) -> String {
    let performance = &report.flight;
    format!(
        "Tracking  position error rms {:.4} m, largest {:.4} m, at the end {:.4} m{}",
        performance.position_error_rms_m,
        performance.position_error_max_m,
        performance.position_error_final_m,
        super::without_state(report)
    )
}

/// What the system refused, once for all processes that it refused it to.
fn refused(report: &Report) -> Vec<String> {
    let mut by_step = BTreeMap::<(&str, &str), Vec<&str>>::new();
    for (name, role) in &report.roles {
        for step in &role.realtime {
            if let Some(reason) = &step.refused {
                by_step.entry((&step.step, reason)).or_default().push(name);
            }
        }
    }
    let line = |((step, reason), roles): (&(&str, &str), &Vec<&str>)| {
        format!("Refused   {step} ({reason}): {}", roles.join(", "))
    };
    by_step.iter().map(line).collect()
}

/// The gates that were asked for, and those that did not hold.
fn gates(report: &Report) -> Vec<String> {
    let verdict = &report.verdict;
    let held = verdict.gates.iter().filter(|gate| gate.held).count();
    let mut lines = vec![format!("{:<9} {held} of {} gates held", verdict.status, verdict.gates.len())];
    let failed = verdict.gates.iter().filter(|gate| !gate.held);
    lines.extend(failed.map(|gate| format!("  FAIL    {}: {} (limit {})", gate.name, gate.value, gate.limit)));
    lines
}
