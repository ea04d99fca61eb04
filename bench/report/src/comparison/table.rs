//! Many comparisons as tables in Markdown: a row per fault, a column per inner law, a table per outer law.

use crate::comparison::{Comparison, Outcome, SETTLING_S, text};

/// A comparison with the name of its row.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What goes wrong, in words.
    pub name: String,
    /// How it went.
    pub comparison: Comparison,
}

/// Rows in which no law changes its commands by more are left out of what tells of that [rad/s].
const QUIET_RAD_S: f64 = 0.1;

/// A question that a table answers.
struct Question {
    title: String,
    cell: fn(&Outcome) -> Cell,
    /// Whether it tells a combination from another in some row.
    matters: fn(&Outcome) -> bool,
}

/// What a combination made of it.
struct Cell {
    text: String,
    /// What the best of a row has least of; a lost flight is no candidate.
    figure: Option<f64>,
}

/// The tables of some rows, whose comparisons are of the same laws; what is best in its row is bold.
#[must_use]
pub fn render(rows: &[Row]) -> String {
    let Some(Row { comparison, .. }) = rows.first() else { return String::new() };
    let bound_m = comparison.flight.bound_m;
    let questions = [
        Question {
            title: format!(
                "worst true position error from {SETTLING_S} s after the fault on [mm] / time until it stays below \
                 {bound_m} m [s]"
            ),
            cell: tracking,
            matters: |_| true,
        },
        Question {
            title: format!(
                "change of a rotor's command in a tick, rms of the flight [rad/s], where it is above {QUIET_RAD_S}"
            ),
            cell: agitation,
            matters: |outcome| outcome.lost.is_none() && outcome.figures.effort.agitation_rad_s > QUIET_RAD_S,
        },
    ];
    let group = |outcome: &Outcome| (outcome.laws.outer.clone(), outcome.laws.mixer.clone());
    let mut groups: Vec<_> = comparison.outcomes.iter().map(group).collect();
    groups.dedup();
    let tables = questions.iter().flat_map(|question| groups.iter().map(move |group| (question, group)));
    let tables: Vec<String> = tables
        .map(|(question, (outer, mixer))| {
            let mixer_named = if comparison.mixers_differ() { format!(", mixer `{mixer}`") } else { String::new() };
            let is_of = |outcome: &&Outcome| (&outcome.laws.outer, &outcome.laws.mixer) == (outer, mixer);
            format!("Outer law `{outer}`{mixer_named}: {}\n\n{}", question.title, table(rows, is_of, question))
        })
        .collect();
    tables.join("\n")
}

fn table(rows: &[Row], is_of: impl Fn(&&Outcome) -> bool, question: &Question) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let outcomes = |row: &Row| -> Vec<Outcome> { row.comparison.outcomes.iter().filter(&is_of).cloned().collect() };
    let Some(first) = rows.first().map(outcomes) else { return String::new() };
    let mut out =
        line(["fault".to_owned()].into_iter().chain(first.iter().map(|it| format!("`{}`", it.laws.inner))).collect());
    out += &format!("|{}\n", "---|".repeat(first.len() + 1));
    for row in rows.iter().filter(|row| outcomes(row).iter().any(question.matters)) {
        let cells: Vec<Cell> = outcomes(row).iter().map(question.cell).collect();
        let best = cells.iter().filter_map(|cell| cell.figure).min_by(f64::total_cmp).map(text::significant);
        // What prints alike is alike.
        let shown = cells.into_iter().map(|Cell { text, figure }| {
            match figure.map(text::significant) == best && figure.is_some() {
                true => format!("**{text}**"),
                false => text,
            }
        });
        out += &line([row.name.replace('|', "\\|")].into_iter().chain(shown).collect());
    }
    out
}

fn tracking(outcome: &Outcome) -> Cell {
    let figures = &outcome.figures;
    match (outcome.ended_early_s, &outcome.lost, &figures.error_after) {
        (Some(time_s), ..) => Cell { text: format!("lost at {time_s:.1} s"), figure: None },
        (None, Some(_), _) => Cell { text: "below ground".into(), figure: None },
        (None, None, after) => {
            // A row without a fault tells of the whole flight; one whose flight was over too soon, of nothing.
            let error = after.or_else(|| figures.recovery_s.is_empty().then_some(figures.error));
            let error_mm = error.map(|error| 1e3 * error.worst_m);
            let recovery_s = figures.recovery_s.last().copied().flatten();
            let recovery = recovery_s.map_or_else(|| "-".into(), |time_s| format!("{time_s:.2}"));
            let error = error_mm.map_or_else(|| "-".into(), text::significant);
            Cell { text: format!("{error} / {recovery}"), figure: error_mm }
        }
    }
}

fn agitation(outcome: &Outcome) -> Cell {
    let agitation_rad_s = outcome.figures.effort.agitation_rad_s;
    let is_lost = outcome.lost.is_some();
    let text = if is_lost { "lost".into() } else { text::significant(agitation_rad_s) };
    Cell { text, figure: (!is_lost).then_some(agitation_rad_s) }
}

#[cfg(test)]
mod tests {
    use flight_log::build::Build;

    use super::*;
    use crate::comparison::{Effort, ErrorFigures, Figures, Flight, Laws, SCHEMA};
    use crate::traces::Group;

    fn outcome(inner: &str, mixer: &str, worst_m: f64, agitation_rad_s: f64) -> Outcome {
        let error = ErrorFigures { rms_m: 0.0, p99_m: 0.0, worst_m };
        let figures = Figures {
            error,
            error_before: Some(error),
            error_after: Some(error),
            recovery_s: vec![Some(0.5)],
            effort: Effort { power: 1.0, agitation_rad_s, saturated_percent: 0.0 },
            trace: Group::default(),
        };
        let laws = Laws { outer: "pd".into(), inner: inner.into(), mixer: mixer.into() };
        Outcome {
            laws,
            ticks: 1,
            ended_early_s: None,
            lost: None,
            unusable: Vec::new(),
            figures,
            outputs: String::new(),
        }
    }

    fn row(name: &str, outcomes: Vec<Outcome>) -> Row {
        let flight = Flight {
            trajectory: "hover".into(),
            airframe: "paper".into(),
            preset: "flight".into(),
            seed: 1,
            last_tick: 0,
            period_s: 0.001,
            bound_m: 0.05,
            faults: Vec::new(),
        };
        let build = Build::default();
        Row { name: name.into(), comparison: Comparison { schema: SCHEMA, build, flight, outcomes } }
    }

    #[test]
    fn the_best_of_a_row_is_bold_and_what_prints_alike_too() {
        let lost = Outcome { ended_early_s: Some(9.87), lost: Some("crash".into()), ..outcome("c", "m", 0.001, 0.5) };
        let low = Outcome { lost: Some("below ground".into()), ..outcome("d", "m", 0.001, 0.5) };
        let text =
            render(&[row("a|b", vec![outcome("a", "m", 0.0123, 0.2), outcome("b", "m", 0.01232, 0.3), lost, low])]);
        let tracking = "| a\\|b | **12.3 / 0.50** | **12.3 / 0.50** | lost at 9.9 s | below ground |\n";
        assert!(text.contains("| fault | `a` | `b` | `c` | `d` |\n|---|---|---|---|---|\n"), "{text}");
        assert!(text.contains(tracking) && text.contains("| a\\|b | **0.200** | 0.300 | lost | lost |\n"), "{text}");
        assert!(text.starts_with("Outer law `pd`: worst true position error"), "{text}");
    }

    #[test]
    fn the_error_of_another_stretch_does_not_stand_for_that_after_the_fault() {
        let with = |recovery_s: Vec<Option<f64>>| {
            let mut outcome = outcome("a", "m", 0.5, 0.2);
            (outcome.figures.error_after, outcome.figures.recovery_s) = (None, recovery_s);
            outcome
        };
        let text = render(&[row("late", vec![with(vec![None])]), row("none", vec![with(Vec::new())])]);
        assert!(text.contains("| late | - / - |\n") && text.contains("| none | **500 / -** |\n"), "{text}");
    }

    #[test]
    fn a_row_in_which_no_command_is_agitated_is_left_out_of_what_tells_of_that() {
        let text = render(&[
            row("calm", vec![outcome("a", "m", 0.01, 0.1)]),
            row("wild", vec![outcome("a", "m", 0.01, 0.11)]),
        ]);
        assert_eq!((text.matches("| calm |").count(), text.matches("| wild |").count()), (1, 2), "{text}");
    }

    #[test]
    fn each_mixer_has_its_tables() {
        let text = render(&[row("x", vec![outcome("a", "m", 0.01, 0.2), outcome("a", "n", 0.02, 0.2)])]);
        assert_eq!(text.matches("Outer law `pd`, mixer `n`: ").count(), 2, "{text}");
        assert_eq!(text.matches("| x | **20.0 / 0.50** |\n").count(), 1, "{text}");
    }
}
