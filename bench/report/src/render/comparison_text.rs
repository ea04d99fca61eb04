//! A comparison as text and as Markdown, and the tables that its page shows.

use crate::comparison::{Comparison, ErrorFigures, Fault, Figures, Outcome, SETTLING_S, STAYING_S};
use crate::render::table::{Part, Table};

/// The comparison as text: what was flown, then a row per combination for each question.
#[must_use]
pub fn render(comparison: &Comparison) -> String {
    const COLUMN: usize = 10;
    let flight = &comparison.flight;
    let mut out = format!("{flight}\n");
    for fault in &flight.faults {
        out += &format!("  {:>8.3} s  {}\n", fault.time_s, fault.what);
    }
    out.extend(parts(comparison).iter().map(|part| part.text(COLUMN)));
    out + &endings(comparison)
}

/// The questions that a comparison answers, each with a row per combination.
#[must_use]
pub fn parts(comparison: &Comparison) -> Vec<Part> {
    let flight = &comparison.flight;
    let mut parts = match (flight.faults.first(), flight.settled_tick()) {
        (Some(first), Some(settled)) => {
            let before = format!("before {:.3} s", first.time_s);
            let after = format!("from {:.3} s on", flight.time_s(settled));
            vec![
                errors(comparison, "error-before", &before, |it| it.error_before),
                errors(comparison, "error-after", &after, |it| it.error_after),
            ]
        }
        _ => vec![errors(comparison, "error", "", |it| Some(it.error))],
    };
    if !flight.faults.is_empty() {
        let column = |fault: &Fault| format!("{:.3} s", fault.time_s);
        parts.push(Part {
            id: "recovery",
            title: format!(
                "Recovered from the fault at: true error below {} m for good, {STAYING_S} s at least",
                flight.bound_m
            ),
            note: String::new(),
            table: table(
                comparison,
                flight.faults.iter().map(column).collect(),
                |outcome| recoveries_of(outcome).collect(),
            ),
        });
    }
    let columns = [
        "power [hover]",
        "change of a command in a tick, rms [rad/s]",
        "saturated [%]",
        "outputs",
    ];
    let effort = |outcome: &Outcome| {
        let effort = &outcome.figures.effort;
        vec![
            format!("{:.4}", effort.power),
            significant(effort.agitation_rad_s),
            format!("{:.2}", effort.saturated_percent),
            outcome.outputs.clone(),
        ]
    };
    parts.push(Part {
        id: "effort",
        title: "Effort".into(),
        note: String::new(),
        table: table(comparison, columns.map(str::to_owned).into(), effort),
    });
    parts
}

fn table(
    comparison: &Comparison,
    columns: Vec<String>,
    cells: impl Fn(&Outcome) -> Vec<String>,
) -> Table {
    let row = |outcome: &Outcome| (comparison.name_of(&outcome.laws), cells(outcome));
    Table {
        columns,
        rows: comparison.outcomes.iter().map(row).collect(),
    }
}

/// The true position errors of a part of the flight, `when`.
fn errors(
    comparison: &Comparison,
    id: &'static str,
    when: &str,
    of: fn(&Figures) -> Option<ErrorFigures>,
) -> Part {
    let cells = |outcome: &Outcome| match of(&outcome.figures) {
        Some(it) => [it.rms_m, it.p99_m, it.worst_m].map(millimetres).into(),
        None => vec!["-".to_owned(); 3],
    };
    let columns = ["rms", "p99", "worst"].map(str::to_owned).into();
    Part {
        id,
        title: format!("True position error {when} [mm]").replace("  ", " "),
        note: String::new(),
        table: table(comparison, columns, cells),
    }
}

/// Per fault, when a flight had recovered from it, in words.
pub fn recoveries_of(outcome: &Outcome) -> impl Iterator<Item = String> {
    let recovery_s = &outcome.figures.recovery_s;
    recovery_s
        .iter()
        .enumerate()
        .map(|(i, time_s)| match time_s {
            Some(0.0) => "never above".into(),
            Some(time_s) => format!("after {time_s:.3} s"),
            None if i + 1 == recovery_s.len() => "not in this flight".into(),
            None => "not before the next".into(),
        })
}

fn endings(comparison: &Comparison) -> String {
    let named = |outcome: &Outcome| comparison.name_of(&outcome.laws);
    let outcomes = || comparison.outcomes.iter();
    let lost: String = outcomes()
        .filter_map(|it| Some(format!("  {}: {}\n", named(it), ending(it)?)))
        .collect();
    let endings = if lost.is_empty() {
        format!("\nAll {} flew to the end\n", comparison.outcomes.len())
    } else {
        format!("\nLost\n{lost}")
    };
    let unusable: String = outcomes()
        .flat_map(|it| it.unusable.iter().map(move |sentence| (it, sentence)))
        .map(|(it, sentence)| format!("  {}: {sentence}\n", named(it)))
        .collect();
    if unusable.is_empty() {
        endings
    } else {
        format!("{endings}\nOutputs that could not be used\n{unusable}")
    }
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

/// A comparison with the name of its row.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub name: String,
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
pub fn render_rows(rows: &[Row]) -> String {
    let Some(Row { comparison, .. }) = rows.first() else {
        return String::new();
    };
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
            matters: |outcome| {
                outcome.lost.is_none() && outcome.figures.effort.agitation_rad_s > QUIET_RAD_S
            },
        },
    ];
    let group = |outcome: &Outcome| (outcome.laws.outer.clone(), outcome.laws.mixer.clone());
    let mut groups: Vec<_> = comparison.outcomes.iter().map(group).collect();
    groups.dedup();
    let tables = questions
        .iter()
        .flat_map(|question| groups.iter().map(move |group| (question, group)));
    let tables: Vec<String> = tables
        .map(|(question, (outer, mixer))| {
            let mixer_named = if comparison.mixers_differ() {
                format!(", mixer `{mixer}`")
            } else {
                String::new()
            };
            let is_of =
                |outcome: &&Outcome| (&outcome.laws.outer, &outcome.laws.mixer) == (outer, mixer);
            format!(
                "Outer law `{outer}`{mixer_named}: {}\n\n{}",
                question.title,
                markdown(rows, is_of, question)
            )
        })
        .collect();
    tables.join("\n")
}

fn markdown(rows: &[Row], is_of: impl Fn(&&Outcome) -> bool, question: &Question) -> String {
    let outcomes = |row: &Row| -> Vec<Outcome> {
        let outcomes = row.comparison.outcomes.iter();
        outcomes.filter(&is_of).cloned().collect()
    };
    let Some(first) = rows.first().map(outcomes) else {
        return String::new();
    };
    let cells = |outcomes: &[Outcome]| {
        let cells: Vec<Cell> = outcomes.iter().map(question.cell).collect();
        let figures = cells.iter().filter_map(|cell| cell.figure);
        let best = figures.min_by(f64::total_cmp).map(significant);
        // Figures that print alike are both the best.
        let shown = |Cell { text, figure }| match figure.map(significant) {
            Some(figure) if Some(&figure) == best.as_ref() => format!("**{text}**"),
            _ => text,
        };
        cells.into_iter().map(shown).collect()
    };
    let rows = rows.iter().filter_map(|row| {
        let outcomes = outcomes(row);
        let matters = outcomes.iter().any(question.matters);
        matters.then(|| (row.name.replace('|', "\\|"), cells(&outcomes)))
    });
    let table = Table {
        columns: first
            .iter()
            .map(|it| format!("`{}`", it.laws.inner))
            .collect(),
        rows: rows.collect(),
    };
    table.markdown("fault")
}

fn tracking(outcome: &Outcome) -> Cell {
    let figures = &outcome.figures;
    match (outcome.ended_early_s, &outcome.lost, &figures.error_after) {
        (Some(time_s), ..) => Cell {
            text: format!("lost at {time_s:.1} s"),
            figure: None,
        },
        (None, Some(_), _) => Cell {
            text: "below ground".into(),
            figure: None,
        },
        (None, None, after) => {
            // A row without a fault tells of the whole flight; one whose flight was over too soon, of nothing.
            let error = after.or_else(|| figures.recovery_s.is_empty().then_some(figures.error));
            let error_mm = error.map(|error| 1e3 * error.worst_m);
            let recovery_s = figures.recovery_s.last().copied().flatten();
            let recovery = recovery_s.map_or_else(|| "-".into(), |time_s| format!("{time_s:.2}"));
            let error = error_mm.map_or_else(|| "-".into(), significant);
            Cell {
                text: format!("{error} / {recovery}"),
                figure: error_mm,
            }
        }
    }
}

fn agitation(outcome: &Outcome) -> Cell {
    let agitation_rad_s = outcome.figures.effort.agitation_rad_s;
    let is_lost = outcome.lost.is_some();
    let text = if is_lost {
        "lost".into()
    } else {
        significant(agitation_rad_s)
    };
    Cell {
        text,
        figure: (!is_lost).then_some(agitation_rad_s),
    }
}

#[cfg(test)]
mod tests {
    use flight_log::build::Build;

    use super::*;
    use crate::comparison::{Effort, ErrorFigures, Figures, Flight, Laws, SCHEMA};
    use crate::traces::Group;

    fn outcome(inner: &str, mixer: &str, worst_m: f64, agitation_rad_s: f64) -> Outcome {
        let error = ErrorFigures {
            rms_m: 0.0,
            p99_m: 0.0,
            worst_m,
        };
        let figures = Figures {
            error,
            error_before: Some(error),
            error_after: Some(error),
            recovery_s: vec![Some(0.5)],
            effort: Effort {
                power: 1.0,
                agitation_rad_s,
                saturated_percent: 0.0,
            },
            trace: Group::default(),
        };
        let laws = Laws {
            outer: "pd".into(),
            inner: inner.into(),
            mixer: mixer.into(),
        };
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
        Row {
            name: name.into(),
            comparison: Comparison {
                schema: SCHEMA,
                build,
                flight,
                outcomes,
            },
        }
    }

    #[test]
    fn the_best_of_a_row_is_bold_and_what_prints_alike_too() {
        let lost = Outcome {
            ended_early_s: Some(9.87),
            lost: Some("crash".into()),
            ..outcome("c", "m", 0.001, 0.5)
        };
        let low = Outcome {
            lost: Some("below ground".into()),
            ..outcome("d", "m", 0.001, 0.5)
        };
        let text = render_rows(&[row(
            "a|b",
            vec![
                outcome("a", "m", 0.0123, 0.2),
                outcome("b", "m", 0.01232, 0.3),
                lost,
                low,
            ],
        )]);
        let tracking =
            "| a\\|b | **12.3 / 0.50** | **12.3 / 0.50** | lost at 9.9 s | below ground |\n";
        assert!(
            text.contains("| fault | `a` | `b` | `c` | `d` |\n|---|---|---|---|---|\n"),
            "{text}"
        );
        assert!(
            text.contains(tracking)
                && text.contains("| a\\|b | **0.200** | 0.300 | lost | lost |\n"),
            "{text}"
        );
        assert!(
            text.starts_with("Outer law `pd`: worst true position error"),
            "{text}"
        );
    }

    #[test]
    fn the_error_of_another_stretch_does_not_stand_for_that_after_the_fault() {
        let with = |recovery_s: Vec<Option<f64>>| {
            let mut outcome = outcome("a", "m", 0.5, 0.2);
            (outcome.figures.error_after, outcome.figures.recovery_s) = (None, recovery_s);
            outcome
        };
        let text = render_rows(&[
            row("late", vec![with(vec![None])]),
            row("none", vec![with(Vec::new())]),
        ]);
        assert!(
            text.contains("| late | - / - |\n") && text.contains("| none | **500 / -** |\n"),
            "{text}"
        );
    }

    #[test]
    fn a_row_in_which_no_command_is_agitated_is_left_out_of_what_tells_of_that() {
        let text = render_rows(&[
            row("calm", vec![outcome("a", "m", 0.01, 0.1)]),
            row("wild", vec![outcome("a", "m", 0.01, 0.11)]),
        ]);
        assert_eq!(
            (
                text.matches("| calm |").count(),
                text.matches("| wild |").count()
            ),
            (1, 2),
            "{text}"
        );
    }

    #[test]
    fn each_mixer_has_its_tables() {
        let text = render_rows(&[row(
            "x",
            vec![outcome("a", "m", 0.01, 0.2), outcome("a", "n", 0.02, 0.2)],
        )]);
        assert_eq!(
            text.matches("Outer law `pd`, mixer `n`: ").count(),
            2,
            "{text}"
        );
        assert_eq!(
            text.matches("| x | **20.0 / 0.50** |\n").count(),
            1,
            "{text}"
        );
    }
}
