//! Page 2: deadlines, all latencies, and the histogram of the selected one.

use hdrhistogram::Histogram;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::text::Line;

use crate::watch::dashboard_model::WatchedFlight;
use crate::watch::screen::drawing::{Paint, bars, first_row, put};
use report::series::{Series, Statistics};

/// Height of the histogram with its heading and its axis.
const HISTOGRAM: u16 = 7;

pub(super) fn draw(
    flight: &WatchedFlight,
    selected: usize,
    paint: Paint,
    frame: &mut Frame<'_>,
    area: Rect,
) {
    let below = put(frame, area, deadlines(flight, area.width, paint));
    let all = Series::all();
    let series = all[selected.min(all.len() - 1)];
    let is_high = below.height >= HISTOGRAM + 5;
    let histogram_height = if is_high {
        HISTOGRAM.max(below.height / 3)
    } else {
        0
    };
    let room = usize::from(below.height - histogram_height).saturating_sub(1);
    let first = first_row(selected, all.len(), room);
    let mut lines = vec![heading(area.width, paint)];
    for (row, shown) in all.iter().enumerate().skip(first).take(room) {
        let text = row_text(*shown, flight.tally.series.flight(*shown), area.width);
        lines.push(Line::styled(
            text,
            if row == selected {
                paint.selected()
            } else {
                ratatui::style::Style::new()
            },
        ));
    }
    put(frame, below, lines);
    if let Some(histogram) = flight.tally.series.flight(series)
        && is_high
    {
        let y = below.y + below.height - histogram_height;
        draw_histogram(
            series,
            histogram,
            paint,
            frame,
            Rect {
                y,
                height: histogram_height,
                ..below
            },
        );
    }
}

fn deadlines<'a>(flight: &WatchedFlight, width: u16, paint: Paint) -> Vec<Line<'a>> {
    let run = &flight.run;
    let missed = run.deadlines_missed;
    let per_million = missed as f64 * 1e6 / (run.ticks_run + run.ticks_skipped).max(1) as f64;
    let runs = flight.tally.miss_runs.lengths();
    let longest = runs.last_key_value().map_or(0, |(length, _)| *length);
    let (in_all, here) = if is_roomy(width) {
        (
            format!(
                "deadlines missed {missed} ({per_million:.1} per million ticks), ticks skipped {}",
                run.ticks_skipped
            ),
            format!(
                "since you watch: {} late by their stamps, at most {longest} in a row",
                flight.tally.late_commands.count
            ),
        )
    } else {
        (
            format!("missed {missed}, {per_million:.1} per million"),
            format!(
                "since you watch: {}, {longest} in a row",
                flight.tally.late_commands.count
            ),
        )
    };
    vec![
        Line::styled(
            in_all,
            if missed == 0 {
                paint.good()
            } else {
                paint.bad()
            },
        ),
        Line::styled(here, paint.faint()),
    ]
}

/// Whether there is room for all columns.
const fn is_roomy(width: u16) -> bool {
    width >= 76
}

fn heading<'a>(width: u16, paint: Paint) -> Line<'a> {
    let text = if is_roomy(width) {
        format!(
            "{:<18}{:>9}{:>10}{:>10}{:>10}{:>10}{:>10}",
            "[us]", "count", "p50", "p90", "p99", "p99.9", "max"
        )
    } else {
        format!("{:<18}{:>7}{:>7}", "[us]", "p50", "p99")
    };
    Line::styled(text, paint.heading())
}

fn row_text(series: Series, histogram: Option<&Histogram<u64>>, width: u16) -> String {
    let name = series.name();
    let Some(histogram) = histogram.filter(|histogram| !histogram.is_empty()) else {
        return format!("{name:<18}{:>9}", if is_roomy(width) { "-" } else { "" });
    };
    let s = Statistics::of(&name, histogram);
    if !is_roomy(width) {
        return format!("{name:<18}{:>7.1}{:>7.1}", s.p50_us, s.p99_us);
    }
    let rare = s
        .p999_us
        .map_or_else(|| "-".into(), |us| format!("{us:.1}"));
    format!(
        "{name:<18}{:>9}{:>10.1}{:>10.1}{:>10.1}{rare:>10}{:>10.1}",
        s.count, s.p50_us, s.p90_us, s.p99_us, s.max_us
    )
}

fn draw_histogram(
    series: Series,
    histogram: &Histogram<u64>,
    paint: Paint,
    frame: &mut Frame<'_>,
    area: Rect,
) {
    let title = format!("{} [us], counts on a logarithmic scale", series.name());
    let inside = put(
        frame,
        area,
        vec![Line::default(), Line::styled(title, paint.heading())],
    );
    if histogram.is_empty() || inside.height < 2 {
        return;
    }
    let scale = Scale::of(histogram, usize::from(inside.width));
    let counts = scale.counts(histogram);
    let heights: Vec<f64> = counts
        .iter()
        .map(|count| (*count as f64 + 1.0).log10())
        .collect();
    let most = heights.iter().copied().fold(0.0, f64::max);
    let plot = Rect {
        height: inside.height - 1,
        ..inside
    };
    bars(frame, plot, &heights, (0.0, most), paint.actual());
    let axis = Rect {
        y: plot.y + plot.height,
        height: 1,
        ..plot
    };
    put(frame, axis, vec![Line::styled(scale.axis(), paint.faint())]);
}

/// Bins of equal width on a logarithmic axis, over whole decades of microseconds.
#[derive(Clone, Copy, Debug)]
struct Scale {
    /// Exponent of ten at which the axis starts [us].
    first_decade: i32,
    decades: i32,
    bins: usize,
}

impl Scale {
    fn of(histogram: &Histogram<u64>, bins: usize) -> Self {
        let decade = |ns: u64| (ns.max(1) as f64 / 1e3).log10();
        let first_decade = decade(histogram.min()).floor().max(-1.0) as i32;
        let last = decade(histogram.max()).ceil() as i32;
        Self {
            first_decade,
            decades: (last - first_decade).max(1),
            bins,
        }
    }

    fn bin(&self, ns: u64) -> usize {
        let place = ((ns.max(1) as f64 / 1e3).log10() - f64::from(self.first_decade))
            / f64::from(self.decades);
        ((place * self.bins as f64).max(0.0) as usize).min(self.bins - 1)
    }

    fn counts(&self, histogram: &Histogram<u64>) -> Vec<u64> {
        let mut counts = vec![0; self.bins];
        for value in histogram.iter_recorded() {
            counts[self.bin(value.value_iterated_to())] += value.count_at_value();
        }
        counts
    }

    /// Labels of the decades below the bars.
    fn axis(&self) -> String {
        let mut axis = String::new();
        for decade in 0..self.decades {
            let place = self.bins * decade as usize / self.decades as usize;
            let label = match self.first_decade + decade {
                power @ 6.. => format!("|{} s", 10_u64.pow(power.unsigned_abs() - 6)),
                power @ 3.. => format!("|{} ms", 10_u64.pow(power.unsigned_abs() - 3)),
                power @ 0.. => format!("|{} us", 10_u64.pow(power.unsigned_abs())),
                _ => "|100 ns".into(),
            };
            axis = format!("{axis:<place$}{label}");
        }
        axis
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_and_axis_agree() {
        let mut histogram = Histogram::<u64>::new_with_bounds(1, 10_000_000_000, 3).unwrap();
        for ns in [2_000, 2_001, 20_000, 900_000] {
            histogram.record(ns).unwrap();
        }
        let scale = Scale::of(&histogram, 30);
        let counts = scale.counts(&histogram);
        assert_eq!(scale.axis(), "|1 us     |10 us    |100 us");
        assert_eq!(
            (
                counts[3],
                counts[13],
                counts[29],
                counts.iter().sum::<u64>()
            ),
            (2, 1, 1, 4)
        );
    }
}
