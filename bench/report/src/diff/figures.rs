//! What two groups of flights are compared by: a number a flight, by name with unit.

use crate::schema::Report;
use crate::tally::distribution::PERCENTS;

/// What a figure tells of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// How late the loops were: nothing, where they did not fly by the clock or the host stole from them.
    Timing,
    /// How well the flight went.
    Tracking,
}

/// A number of a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Name, with its unit where it is no ratio.
    pub name: String,
    /// What it tells of.
    pub subject: Subject,
    /// Nothing where the flight has too few values for it.
    pub value: Option<f64>,
}

/// The figures of a flight; every flight has the same names in the same order, as long as it has the series.
#[must_use]
pub fn figures(report: &Report) -> Vec<Figure> {
    let performance = &report.flight;
    let ticks = (report.ticks.run + report.ticks.skipped) as f64;
    let per_million = |count: u64| (ticks > 0.0).then(|| count as f64 / ticks * 1e6);
    let figure = |subject, name: &str, value| Figure { name: name.to_owned(), subject, value };
    let mut all = vec![
        figure(Subject::Tracking, "position error, rms [m]", Some(performance.position_error_rms_m)),
        figure(Subject::Tracking, "position error, largest [m]", Some(performance.position_error_max_m)),
        figure(Subject::Tracking, "position error, at the end [m]", Some(performance.position_error_final_m)),
        figure(Subject::Tracking, "rate error, at the end [rad/s]", performance.rate_error_final_rad_s),
        figure(Subject::Timing, "deadlines missed [per million]", per_million(report.deadlines.missed)),
        figure(Subject::Timing, "ticks skipped [per million]", per_million(report.ticks.skipped)),
    ];
    for distribution in &report.distributions {
        for (percent, _) in PERCENTS {
            let value = distribution.percentile(percent).map(|percentile| percentile.value_us);
            all.push(figure(Subject::Timing, &format!("{} p{percent} [us]", distribution.name), value));
        }
    }
    all
}
