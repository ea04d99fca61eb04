//! Rows of marks above a chart: where the percentiles and the largest value of a series stand.

use maud::{Markup, html};

use crate::plot::tenths;

/// Height of a lane [pixels].
pub const LANE: f64 = 11.0;
/// Half the size of a mark [pixels].
const HALF: f64 = 3.0;

/// What stands at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// The median.
    P50,
    /// The 99th percentile.
    P99,
    /// The 99.9th percentile.
    P999,
    /// The largest value.
    Largest,
}

impl Mark {
    /// All of them, from the smallest to the largest.
    pub const ALL: [Self; 4] = [Self::P50, Self::P99, Self::P999, Self::Largest];

    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::P50 => "p50",
            Self::P99 => "p99",
            Self::P999 => "p99.9",
            Self::Largest => "max",
        }
    }

    /// The mark around a place in pixels.
    fn path(self, x: f64, y: f64) -> String {
        let [left, right, top, foot] = [x - HALF, x + HALF, y - HALF, y + HALF].map(tenths);
        let (x, y) = (tenths(x), tenths(y));
        match self {
            Self::P50 => format!("M{x} {}V{}", top - 1.0, foot + 1.0),
            Self::P99 => format!("M{left} {y}L{x} {top}L{right} {y}L{x} {foot}Z"),
            Self::P999 => format!("M{left} {top}H{right}V{foot}H{left}Z"),
            Self::Largest => format!("M{left} {top}L{right} {foot}M{left} {foot}L{right} {top}"),
        }
    }

    /// The mark alone, for a key.
    #[must_use]
    pub fn sample(self) -> Markup {
        html! {
            svg.sample viewBox="0 0 10 10" width="10" height="10" aria-hidden="true" {
                path.mark d=(self.path(5.0, 5.0)) {}
            }
        }
    }
}

/// The marks of a series, from the smallest to the largest.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Colour.
    pub class: &'static str,
    /// Each with its place on the horizontal axis, and a word for who points at it.
    pub marks: Vec<(Mark, f64, String)>,
}

impl Lane {
    /// The lane below `top`, where `at_x` places values.
    pub(super) fn draw(&self, top: f64, at_x: impl Fn(f64) -> f64) -> Markup {
        let y = top + LANE / 2.0;
        let places: Vec<f64> = self.marks.iter().map(|(_, value, _)| at_x(*value)).collect();
        html! {
            g.lane.(self.class) {
                @if let [first, .., last] = places[..] {
                    path.reach d=(format!("M{} {y}H{}", tenths(first), tenths(last))) {}
                }
                @for ((mark, _, word), x) in self.marks.iter().zip(places) {
                    path.mark d=(mark.path(x, y)) { title { (word) } }
                }
            }
        }
    }
}
