//! The comparison with the baseline of the machine, as text.

use crate::baseline::{Baseline, SeriesBaseline};
use crate::schema::Report;
use crate::series::Statistics;

pub type Row<'a> = (&'a str, [Option<f64>; 3], usize);

/// A series of the flight beside its floor, at p50, p99 and p99.9.
#[derive(Clone, Copy, Debug)]
pub struct Compared<'a> {
    pub series: &'a str,
    /// What was measured as its floor.
    pub floor: &'a str,
    ours_us: [Option<f64>; 3],
    floor_us: [Option<f64>; 3],
    /// How many times its floor it is.
    pub times: [Option<f64>; 3],
}

/// Every floor that was measured, with the series of the flight that it is of.
pub fn compared<'a>(
    beside: &'a Baseline,
    report: &'a Report,
) -> impl Iterator<Item = Compared<'a>> {
    beside
        .floors
        .iter()
        .filter_map(|floor: &'a SeriesBaseline| {
            let [ours_us, floor_us] =
                [report.series(&floor.series)?, &floor.statistics].map(percentiles);
            let times = std::array::from_fn(|i| Some(ours_us[i]? / floor_us[i]?));
            Some(Compared {
                series: &floor.series,
                floor: &floor.what,
                ours_us,
                floor_us,
                times,
            })
        })
}

/// The flight's percentiles, the floor's, and how many times its floor the flight's are; each with its name and the
/// decimals that it deserves.
pub fn rows<'a>(beside: &'a Baseline, report: &'a Report) -> impl Iterator<Item = Row<'a>> {
    compared(beside, report).flat_map(|it| {
        [
            (it.series, it.ours_us, 1),
            (it.floor, it.floor_us, 1),
            ("times its floor", it.times, 2),
        ]
    })
}

/// The section of the report for people.
#[must_use]
pub fn section(beside: &Baseline, report: &Report) -> String {
    let mut out = format!(
        "\nCompared with the machine's baseline, {} s each right after the flight ({}, stolen by the host {:.2} %)\n  \
         {:<32} {:>9} {:>9} {:>9}\n",
        beside.seconds, beside.scheduling, beside.steal.percent, "us", "p50", "p99", "p99.9"
    );
    for (name, values, digits) in rows(beside, report) {
        let cells = values.map(|value| {
            format!(
                " {:>9}",
                value.map_or_else(|| "-".into(), |it| format!("{it:.digits$}"))
            )
        });
        out += &format!("  {name:<32}{}\n", cells.concat());
    }
    for refused in &beside.refused {
        out += &format!("  refused: {refused}\n");
    }
    out
}

/// The percentiles that are put beside each other.
fn percentiles(statistics: &Statistics) -> [Option<f64>; 3] {
    [
        Some(statistics.p50_us),
        Some(statistics.p99_us),
        statistics.p999_us,
    ]
}
