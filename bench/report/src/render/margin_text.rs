//! Robustness margins as text: one row per combination of laws for each question.

use crate::margin::{LawMargins, Margins, SteadyMargin};
use crate::phrase::count;
use crate::render::comparison_text::millimetres;
use crate::render::table::{Part, Table};
use std::fmt::Display;

#[must_use]
pub fn render(margins: &Margins) -> String {
    let laws = &margins.laws;
    let mut out = format!(
        "{}\n{}\nsurvived: {}\n",
        margins.flown(),
        margins.phases(),
        margins.gate_words()
    );
    out += &table(
        margins,
        "Without a fault",
        &["error [mm]", "saturated [%]", "recovered below [mm]"],
        |law| {
            vec![
                millimetres(law.unfaulted_error_m),
                format!("{:.1}", law.unfaulted_saturated_percent),
                millimetres(law.recovered_below_m),
            ]
        },
    );
    let tick = format!("[ticks of {} ms]", margins.period_s * 1e3);
    let first = laws.first();
    for (title, is_input) in [
        ("Longest outage survived", false),
        ("Longest loss of all messages survived", true),
    ] {
        let is_it = |of: &str| of.contains('.') == is_input;
        let columns: Vec<&str> = first
            .into_iter()
            .flat_map(|law| &law.outages)
            .map(|it| it.of.as_str())
            .filter(|of| is_it(of))
            .collect();
        let phases = count(margins.phases_s.len() as u64, "phase");
        out += &table(
            margins,
            &format!("{title} {tick}: least / median of {phases}"),
            &columns,
            |law| {
                let of = law.outages.iter().filter(|it| is_it(&it.of));
                of.map(|it| {
                    format!(
                        "{} / {}",
                        ticks(it.least(), margins),
                        ticks(it.median(), margins)
                    )
                })
                .collect()
            },
        );
    }
    let sparse = count(
        margins.phases_s.len().div_ceil(margins.sparse) as u64,
        "phase",
    );
    let steady = |title: String, of: fn(&LawMargins) -> &[SteadyMargin]| {
        let columns: Vec<&str> = first
            .into_iter()
            .flat_map(of)
            .map(|it| it.input.as_str())
            .collect();
        table(margins, &title, &columns, |law| {
            let each = of(law).iter();
            each.map(|it| format!("{}{}", it.ticks, if it.is_most { " and more" } else { "" }))
                .collect()
        })
    };
    out += &steady(
        format!("Longest steady lag {tick}: in time, but so old (dead time); least of {sparse}"),
        |it| &it.lags,
    );
    out += &steady(
        format!("Longest steady delay {tick}: so late, and known as stale; least of {sparse}"),
        |it| &it.delays,
    );
    out += &losses(margins);
    let columns: Vec<&str> = first
        .into_iter()
        .flat_map(|law| &law.patterns)
        .map(|it| it.input.as_str())
        .collect();
    let title =
        format!("Weakest (m, k): m of any k messages may be lost, in a row; least of {sparse}");
    out += &table(margins, &title, &columns, |law| {
        law.patterns
            .iter()
            .map(|it| {
                it.weakest()
                    .map_or_else(|| "-".into(), |[m, k]| format!("({m}, {k})"))
            })
            .collect()
    });
    out + &exceptions(margins)
}

fn losses(margins: &Margins) -> String {
    let first = margins.laws.first();
    let columns: Vec<&str> = first
        .into_iter()
        .flat_map(|law| &law.losses)
        .map(|it| it.input.as_str())
        .collect();
    let flights = count(margins.phases_s.len() as u64, "flight");
    let title = format!(
        "Largest share of random losses [%]: all of {flights} survived (of as many with other seeds) / half did"
    );
    table(margins, &title, &columns, |law| {
        let each = law.losses.iter().map(|it| {
            format!(
                "{:.0} ({} of {}) / {:.0}",
                100.0 * it.share,
                it.survived,
                it.flights,
                100.0 * it.median_share
            )
        });
        each.collect()
    })
}

/// What was found against the order of things; says also that nothing was.
fn exceptions(margins: &Margins) -> String {
    const SHOWN: usize = 6;
    let mut all = Vec::new();
    for law in &margins.laws {
        for margin in &law.outages {
            for it in &margin.exceptions {
                let what = if it.survived {
                    "survived, where a shorter one was not"
                } else {
                    "lost, where a longer one was survived"
                };
                let name = margins.name_of(&law.laws);
                let at = format!("{} at {:.3} s", count(it.ticks, "tick"), it.phase_s);
                all.push(format!("  {name}: {} out for {at}: {what}\n", margin.of));
            }
        }
    }
    if all.is_empty() {
        return "\nNo outage that was tried beyond a margin was survived, and none within it was lost\n".into();
    }
    let shown: String = all.iter().take(SHOWN).map(String::as_str).collect();
    let more = all.len().saturating_sub(SHOWN);
    let more = if more == 0 {
        String::new()
    } else {
        format!("  and {more} more, in --format json\n")
    };
    format!(
        "\nAgainst the order of things (a margin is the longest outage up to which none that was tried was lost)\n{shown}{more}"
    )
}

/// A number of ticks, or that the longest that was tried was survived.
pub(super) fn ticks(ticks: u64, margins: &Margins) -> String {
    if ticks >= margins.longest_ticks {
        format!("> {ticks}")
    } else {
        ticks.to_string()
    }
}

/// A row for each combination of laws; nothing without a column.
fn table<C: Display>(
    margins: &Margins,
    title: &str,
    columns: &[C],
    cells: impl Fn(&LawMargins) -> Vec<String>,
) -> String {
    let row = |law: &LawMargins| (margins.name_of(&law.laws), cells(law));
    let part = Part {
        id: "",
        title: title.into(),
        note: String::new(),
        table: Table {
            columns: columns.iter().map(ToString::to_string).collect(),
            rows: margins.laws.iter().map(row).collect(),
        },
    };
    part.text(0)
}
