//! Scales of axes: where a number is placed, and which numbers are labelled.

#[derive(Clone, Debug, PartialEq)]
pub struct Scale {
    pub kind: Kind,
    pub low: f64,
    pub high: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    Linear,
    Log,
    /// Logarithmic to both sides of 0, linear up to a threshold above it.
    Symmetric(f64),
    /// Shares of values, from 0: equal distances from 0 to 90 %, to 99 %, to 99.9 %, as `HdrHistogram` draws them.
    Tail,
    /// Rows with names below each other: the first one lies from 0 to 1.
    Rows(Vec<String>),
    /// Stretches of time with gaps between them, in order, and named instants.
    Windows(Vec<(f64, f64)>, Vec<(f64, String)>),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    pub value: f64,
    pub label: String,
}

impl Tick {
    fn new(value: f64, label: impl Into<String>) -> Self {
        let label = label.into();
        Self { value, label }
    }
}

/// Free space beyond the smallest and the largest value, as a share of the axis.
const MARGIN: f64 = 0.06;
/// Space between two windows, as a share of the axis.
const GAP: f64 = 0.09;
/// Shortest linear axis, as a share of the largest number on it.
const LEAST_SHARE: f64 = 3e-3;
const SYMMETRIC_DECADES: f64 = 6.0;
/// Ticks of a logarithmic axis at the most.
const LOG_TICKS: f64 = 6.0;
/// Ticks of any other axis at the most: numbers at the ends of what a double holds have no end of round ones.
const TICKS_MOST: usize = 100;

impl Scale {
    pub const fn new(kind: Kind, low: f64, high: f64) -> Self {
        Self { kind, low, high }
    }

    /// An axis from the first to the last of some instants.
    pub fn time(begin: f64, end: f64) -> Self {
        Self::new(Kind::Linear, begin, end.max(begin + 1e-9))
    }

    /// A linear axis around some values that is at least `least` long, and a share of the numbers on it.
    pub fn linear(values: impl Iterator<Item = f64>, least: f64) -> Self {
        let (low, high) = extent(values).unwrap_or((0.0, least));
        let least = match least.max(LEAST_SHARE * low.abs().max(high.abs())) {
            0.0 => 1.0,
            least => least,
        };
        let missing = (least - (high - low)).max(0.0) / 2.0;
        let beyond = missing + (high - low + 2.0 * missing) * MARGIN;
        Self::new(Kind::Linear, low - beyond, high + beyond)
    }

    /// A logarithmic axis around those of some values that are above 0, and at least half a decade long.
    pub fn log(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = extent(values.filter(|value| *value > 0.0)).unwrap_or((1.0, 10.0));
        let decades = (high / low).log10();
        let missing = (0.5 - decades).max(0.0) / 2.0;
        let beyond = 10_f64.powf(missing + (decades + 2.0 * missing) * MARGIN);
        Self::new(Kind::Log, low / beyond, high * beyond)
    }

    /// An axis with 0 on it, which spans six decades of the values' sizes.
    pub fn symmetric(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = extent(values).unwrap_or((-1.0, 1.0));
        let largest = low.abs().max(high.abs());
        let largest = if largest > 0.0 { largest } else { 1.0 };
        let threshold = largest / 10_f64.powf(SYMMETRIC_DECADES);
        // Room for 0, and for its name, at both ends.
        let beyond = |value: f64| value * 2.0 + threshold * 2.0;
        let (low, high) = (-beyond((-low).max(0.0)), beyond(high.max(0.0)));
        Self::new(Kind::Symmetric(threshold), low, high)
    }

    /// An axis of the shares of a distribution that is known up to `share`.
    pub fn tail(share: f64) -> Self {
        Self::new(Kind::Tail, 0.0, share.clamp(0.99, 1.0 - 1e-9))
    }

    pub fn rows(names: Vec<String>) -> Self {
        let end = names.len() as f64;
        Self::new(Kind::Rows(names), end, 0.0)
    }

    pub fn windows(windows: Vec<(f64, f64)>, instants: Vec<(f64, String)>) -> Self {
        let first = windows.first().map_or(0.0, |window| window.0);
        let last = windows.last().map_or(1.0, |window| window.1);
        Self::new(Kind::Windows(windows, instants), first, last)
    }

    /// Place of a value, from 0 at the begin to 1 at the end of the axis, where what lies beyond stands too.
    pub fn place(&self, value: f64) -> f64 {
        let bent = |value: f64| match &self.kind {
            Kind::Linear | Kind::Rows(_) => value,
            Kind::Log => value.max(self.low).ln(),
            Kind::Symmetric(threshold) => value.signum() * (value.abs() / threshold).ln_1p(),
            Kind::Tail => -(-value.min(self.high)).ln_1p(),
            Kind::Windows(windows, _) => place_in_windows(windows, value),
        };
        let (low, high) = (bent(self.low), bent(self.high));
        ((bent(value) - low) / (high - low)).clamp(0.0, 1.0)
    }

    /// Ticks, about as many as requested if the scale leaves a choice.
    pub fn ticks(&self, about: usize) -> Vec<Tick> {
        let (low, high) = (self.low, self.high);
        let row = |(i, name): (usize, &String)| Tick::new(i as f64 + 0.5, name.clone());
        match &self.kind {
            Kind::Linear => linear_ticks(low, high, about),
            Kind::Log => log_ticks(low, high),
            Kind::Symmetric(threshold) => symmetric_ticks(self, *threshold, low, high),
            Kind::Tail => tail_ticks(high),
            Kind::Rows(names) => names.iter().enumerate().map(row).collect(),
            Kind::Windows(_, instants) => self.instant_ticks(instants),
        }
    }

    /// All instants, and the names of those that have the room.
    fn instant_ticks(&self, instants: &[(f64, String)]) -> Vec<Tick> {
        const CHARACTER: f64 = 0.02;
        /// Share of the axis that is free beyond its end.
        const BEYOND: f64 = 0.05;
        let mut free_from = f64::NEG_INFINITY;
        let tick = |(value, name): &(f64, String)| {
            let (place, half) = (self.place(*value), CHARACTER * name.len() as f64 / 2.0);
            if place - half < free_from || place + half > 1.0 + BEYOND {
                return Tick::new(*value, "");
            }
            free_from = place + half;
            Tick::new(*value, name.clone())
        };
        instants.iter().map(tick).collect()
    }
}

/// All that lies between two windows stands in the middle between them.
fn place_in_windows(windows: &[(f64, f64)], instant: f64) -> f64 {
    let shown: f64 = windows.iter().map(|(from, to)| to - from).sum();
    let scale = (1.0 - GAP * windows.len().saturating_sub(1) as f64) / shown;
    let mut place = 0.0;
    for (i, (from, to)) in windows.iter().enumerate() {
        if instant < *from {
            return if i == 0 { 0.0 } else { place - GAP / 2.0 };
        }
        place += (instant.min(*to) - from) * scale;
        if instant <= *to || i + 1 == windows.len() {
            return place;
        }
        place += GAP;
    }
    place
}

fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |range, v| {
        Some(range.map_or((v, v), |(low, high): (f64, f64)| (low.min(v), high.max(v))))
    })
}

fn linear_ticks(low: f64, high: f64, about: usize) -> Vec<Tick> {
    let rough = (high - low) / about.max(1) as f64;
    let decade = 10_f64.powf(rough.log10().floor());
    // A few ticks more than requested are better than half as many.
    let mut steps = [1.0, 2.0, 5.0].into_iter();
    let step = decade * steps.find(|s| s * decade >= rough * 0.95).unwrap_or(10.0);
    let first = (low / step - 1e-6).ceil() as i64;
    let last = (high / step + 1e-6).floor() as i64;
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let largest = low.abs().max(high.abs());
    // All of an axis have the power of ten of the largest, so that they can be compared at a glance.
    let furthest = first.saturating_abs().max(last.saturating_abs()) as f64 * step;
    let exponent = furthest.log10().floor();
    let digits = (exponent - step.log10().floor()).max(0.0) as usize;
    let tick = |i: i64| {
        let value = i as f64 * step;
        let label = match i {
            0 => "0".into(),
            _ if decimals > 4 || largest >= 1e6 => {
                format!("{:.digits$}e{exponent}", value / 10_f64.powf(exponent))
            }
            _ => format!("{value:.decimals$}"),
        };
        Tick::new(value, label)
    };
    (first..=last).take(TICKS_MOST).map(tick).collect()
}

fn log_ticks(low: f64, high: f64) -> Vec<Tick> {
    let (first, last) = (low.log10().ceil() as i32, high.log10().floor() as i32);
    let tick = |value: f64| Tick::new(value, short(value));
    let decades = i64::from(last) - i64::from(first);
    if decades < 2 {
        let steps = (first.saturating_sub(1)..=last)
            .flat_map(|i| [1.0, 2.0, 5.0].map(|step| step * 10_f64.powi(i)));
        let inside = steps.filter(|value| (low..=high).contains(value));
        return inside.map(tick).collect();
    }
    let every = (decades as f64 / LOG_TICKS).ceil() as usize;
    let shown = (first..=last).rev().step_by(every);
    shown.map(|i| tick(10_f64.powi(i))).collect()
}

/// 0 and decades to both sides of it, or what lies between where there are not two, as far apart as labels need.
fn symmetric_ticks(scale: &Scale, threshold: f64, low: f64, high: f64) -> Vec<Tick> {
    const APART: f64 = 0.12;
    let multiples = |end: f64, steps: &[f64]| -> Vec<f64> {
        let (first, last) = (threshold.log10().ceil() as i32, end.log10().floor() as i32);
        let downwards = (first..=last).rev().take(TICKS_MOST);
        let all = downwards.flat_map(|i| steps.iter().map(move |step| step * 10_f64.powi(i)));
        all.filter(|value| *value <= end).collect()
    };
    let mut kept = vec![0.0];
    for (sign, end) in [(-1.0, -low), (1.0, high)] {
        let decades = multiples(end, &[1.0]);
        let all = match decades.len() {
            0 | 1 => multiples(end, &[5.0, 2.0, 1.0]),
            _ => decades,
        };
        for value in all.into_iter().map(|value| sign * value) {
            let apart = |other: &f64| (scale.place(*other) - scale.place(value)).abs();
            if kept.iter().all(|other| apart(other) >= APART) {
                kept.push(value);
            }
        }
    }
    kept.sort_by(f64::total_cmp);
    let ticks = kept.into_iter().map(|value| Tick::new(value, short(value)));
    ticks.collect()
}

fn tail_ticks(high: f64) -> Vec<Tick> {
    let nines = [
        (0.0, "0"),
        (0.9, "90"),
        (0.99, "99"),
        (0.999, "99.9"),
        (0.9999, "99.99"),
        (0.99999, "99.999"),
    ];
    let below = nines.into_iter().filter(|(share, _)| *share <= high);
    below
        .map(|(value, label)| Tick::new(value, label))
        .collect()
}

fn short(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_decades_or_what_lies_between() {
        let linear = |low, high| Scale::new(Kind::Linear, low, high);
        let log = |low, high| Scale::new(Kind::Log, low, high);
        let symmetric = |low, high| Scale::new(Kind::Symmetric(10.0), low, high);
        for (scale, names) in [
            (linear(0.0, 30.0), "0 10 20 30"),
            (linear(0.0, 10.0), "0 2 4 6 8 10"),
            (linear(-0.31, 0.32), "-0.2 0 0.2"),
            (linear(0.0, 4.1e-5), "0 1e-5 2e-5 3e-5 4e-5"),
            (linear(1e-5, 1.15e-5), "1.00e-5 1.05e-5 1.10e-5 1.15e-5"),
            // As of the Crazyflie's I_R: one power of ten, and as many digits.
            (linear(-7e-9, 1.2e-7), "0 0.5e-7 1.0e-7"),
            (linear(-1e-6, 2.1e-5), "0 0.5e-5 1.0e-5 1.5e-5 2.0e-5"),
            (linear(-1.2e6, 1.1e6), "-1.0e6 -0.5e6 0 0.5e6 1.0e6"),
            (log(0.5, 2e3), "1000 100 10 1"),
            (log(18.0, 130.0), "20 50 100"),
            (log(1e-12, 1.0), "1 0.01 1e-4 1e-6 1e-8 1e-10 1e-12"),
            (symmetric(-60.0, 70.0), "-50 -20 0 20 50"),
            (symmetric(-1e3, 2e5), "-1000 -100 0 100 1000 10000 100000"),
            (Scale::tail(0.9999), "0 90 99 99.9 99.99"),
        ] {
            let labels: Vec<String> = scale.ticks(5).into_iter().map(|it| it.label).collect();
            assert_eq!(labels.join(" "), names);
        }
    }

    #[test]
    fn numbers_at_the_ends_of_a_double_have_an_end_of_ticks() {
        let ends = [f64::MAX, -f64::MAX, 5e-324, -5e-324, 1e308, 0.0];
        for pair in ends.iter().flat_map(|low| ends.map(|high| [*low, high])) {
            for scale in [
                Scale::time(pair[0], pair[1]),
                Scale::linear(pair.into_iter(), 0.0),
                Scale::log(pair.into_iter()),
                Scale::symmetric(pair.into_iter()),
            ] {
                assert!(scale.ticks(5).len() <= 2 * TICKS_MOST + 1, "{scale:?}");
            }
        }
    }

    #[test]
    fn axes_of_nothing_and_of_one_value_have_a_length() {
        for scale in [
            Scale::linear(std::iter::empty(), 1.0),
            Scale::linear([2.0].into_iter(), 0.5),
            Scale::log([0.0, 3.0].into_iter()),
            Scale::symmetric([0.0].into_iter()),
        ] {
            let places = scale
                .ticks(4)
                .into_iter()
                .map(|tick| scale.place(tick.value));
            let places: Vec<f64> = places.collect();
            assert!(!places.is_empty() && places.windows(2).all(|pair| pair[0] != pair[1]));
        }
        let Scale { low, high, .. } = Scale::linear([2.0].into_iter(), 0.5);
        assert!(high - low >= 0.5 && low < 2.0 && 2.0 < high);
    }

    #[test]
    fn instants_between_two_windows_stand_between_them() {
        let scale = Scale::windows(vec![(-1.0, 3.0), (96.0, 100.0)], Vec::new());
        let places = [-9.0, -1.0, 0.0, 3.0, 50.0, 96.0, 100.0, 9e9].map(|at| scale.place(at));
        assert!(places.windows(2).all(|pair| pair[0] <= pair[1]));
        assert_eq!(
            (places[0], places[1], places[6], places[7]),
            (0.0, 0.0, 1.0, 1.0)
        );
        assert!((places[5] - places[3] - GAP).abs() < 1e-9, "{places:?}");
        assert!((places[4] - places[3] - GAP / 2.0).abs() < 1e-9);
    }
}
