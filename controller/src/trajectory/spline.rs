//! A curve through points in time: at rest at both ends, and smooth beyond snap.
//!
//! Between two points it is a polynomial of degree 9; its derivatives up to the 8th do not jump at a point. At both
//! ends velocity, acceleration, jerk and snap are 0. Of all curves through the points that rest at their ends, it is the
//! one with the least integral of the squared fifth derivative. That is the classic property of an interpolating spline,
//! one order above the minimum-snap trajectories of Mellinger and Kumar, "Minimum snap trajectory generation and control for
//! quadrotors", ICRA 2011, whose snap itself jumps.
//!
//! Unknown are the derivatives 1 to 4 at each inner point. They follow from the derivatives 5 to 8, which are the same
//! from both sides: a block-tridiagonal system, solved once, before the flight.

use messages::content::Reference;
use nalgebra::{Matrix4, SMatrix};
use thiserror::Error;

use crate::trajectory::{ORDERS, knots, reference_of};

/// Values with their axes: x, y, z [m] and psi [rad].
pub const AXES: usize = 4;
/// Coefficients of a polynomial of degree 9.
pub(super) const COEFFICIENTS: usize = 2 * ORDERS;
/// Largest jump at a point that rounding may leave, in units of what the curve does in the interval beside it.
const ROUNDING: f64 = 1e-6;

/// Value and derivatives (columns) of x, y, z [m] and psi [rad] (rows).
type Axes = [[f64; ORDERS]; AXES];

/// A point of the curve: when [s], and x, y, z [m] and psi [rad].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Time since the start of the flight [s].
    pub t_s: f64,
    /// x, y, z [m], world frame, and psi [rad], not wrapped.
    pub value: [f64; AXES],
}

/// A point from which a curve is further away than it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Time of the point [s].
    pub t_s: f64,
    /// 0 to 2: x, y, z [m]; 3: psi [rad].
    pub axis: usize,
    pub away: f64,
    pub allowed: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Spline {
    segments: Vec<Segment>,
    end: Point,
}

/// The curve between two points, as polynomials in u = (t - begin)/length.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment {
    begin_s: f64,
    length_s: f64,
    coefficients: [[f64; COEFFICIENTS]; AXES],
}

/// Why there is no curve through points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SplineError {
    #[error("a curve needs at least two points")]
    TooFew,
    /// Times that do not rise, or no number.
    #[error("point {0} is no later than the one before it, or no number")]
    NotLater(usize),
    /// Intervals so uneven that nothing but rounding is left.
    #[error(
        "the curve cannot be computed near point {0}: intervals of very different length meet there"
    )]
    Uneven(usize),
}

/// Derivatives 1 to 4 at a point (rows) of each axis (columns).
type Derivatives = SMatrix<f64, 4, AXES>;

impl Spline {
    /// The curve through points whose times rise.
    pub fn through(points: &[Point]) -> Result<Self, SplineError> {
        Self::near(points, &[0.0; AXES]).map(|(spline, _)| spline)
    }

    /// The curve near points whose times rise, which may be off by a tolerance: through them where they are far apart, and
    /// as near as it gets where they are so dense that their roundings would shape it. It rests where they pause.
    pub fn near(
        points: &[Point],
        tolerance: &[f64; AXES],
    ) -> Result<(Self, Option<Deviation>), SplineError> {
        let (Some(end), true) = (points.last(), points.len() >= 2) else {
            return Err(SplineError::TooFew);
        };
        for (i, pair) in points.windows(2).enumerate() {
            let is_finite = pair
                .iter()
                .all(|point| point.t_s.is_finite() && point.value.iter().all(|v| v.is_finite()));
            if !is_finite || pair[1].t_s <= pair[0].t_s {
                return Err(SplineError::NotLater(i + 1));
            }
        }
        let hermite = Hermite::new();
        let mut spline = Self {
            segments: Vec::new(),
            end: *end,
        };
        let shortest_s = knots::shortest_s(points, tolerance);
        for pair in knots::rests(points, tolerance, shortest_s).windows(2) {
            let knots = knots::knots(&points[pair[0]..=pair[1]], tolerance, shortest_s);
            let derivatives = hermite
                .solve(&knots)
                .map_err(|i| SplineError::Uneven(pair[0] + i))?;
            spline.segments.extend((1..knots.len()).map(|i| {
                hermite.segment(
                    [&knots[i - 1], &knots[i]],
                    [&derivatives[i - 1], &derivatives[i]],
                )
            }));
        }
        match spline.first_jump() {
            Some(point) => Err(SplineError::Uneven(point)),
            None => {
                let deviation = spline.deviation(points, tolerance);
                Ok((spline, deviation))
            }
        }
    }

    /// Where it is furthest from points, in tolerances, if that is more than one.
    fn deviation(&self, points: &[Point], tolerance: &[f64; AXES]) -> Option<Deviation> {
        let mut worst = 1.0;
        let mut deviation = None;
        for point in points {
            let axes = self.axes(point.t_s);
            for axis in 0..AXES {
                let away = (axes[axis][0] - point.value[axis]).abs();
                if away > worst * tolerance[axis] && tolerance[axis] > 0.0 {
                    worst = away / tolerance[axis];
                    deviation = Some(Deviation {
                        t_s: point.t_s,
                        axis,
                        away,
                        allowed: tolerance[axis],
                    });
                }
            }
        }
        deviation
    }

    /// When it comes to rest [s].
    pub const fn end_s(&self) -> f64 {
        self.end.t_s
    }

    /// Value and derivatives at a time [s]; before its first point and after its last one, at rest there.
    pub fn reference(&self, t_s: f64) -> Reference {
        reference_of(&self.axes(t_s))
    }

    /// The same as value and derivatives up to the fourth (columns) of x, y, z [m] and psi [rad] (rows).
    pub fn axes(&self, t_s: f64) -> [[f64; ORDERS]; AXES] {
        if t_s >= self.end.t_s {
            return self.end.value.map(at_rest);
        }
        let next = self
            .segments
            .partition_point(|segment| segment.begin_s <= t_s);
        match next.checked_sub(1).and_then(|i| self.segments.get(i)) {
            Some(segment) => segment.at((t_s - segment.begin_s) / segment.length_s),
            None => self.segments[0].coefficients.map(|c| at_rest(c[0])),
        }
    }

    /// The first point at which value or derivatives jump by more than rounding.
    fn first_jump(&self) -> Option<usize> {
        let rest = self.end.value.map(at_rest);
        let after = self
            .segments
            .iter()
            .skip(1)
            .map(|segment| segment.at(0.0))
            .chain([rest]);
        self.segments
            .iter()
            .zip(after)
            .position(|(segment, after)| {
                let before = segment.at(1.0);
                let size = segment
                    .coefficients
                    .map(|axis| axis.iter().skip(1).map(|c| c.abs()).fold(1e-3, f64::max));
                (0..AXES).any(|axis| {
                    let mut unit = 1.0;
                    (0..ORDERS).any(|order| {
                        let jump = (before[axis][order] - after[axis][order]).abs() * unit;
                        unit *= segment.length_s;
                        jump.is_nan() || jump > ROUNDING * size[axis] * COEFFICIENTS as f64
                    })
                })
            })
            .map(|segment| segment + 1)
    }
}

const fn at_rest(value: f64) -> [f64; ORDERS] {
    [value, 0.0, 0.0, 0.0, 0.0]
}

/// n (n - 1) ... over `count` factors: what the derivative of that order makes of u^n.
const fn falling(n: usize, count: usize) -> f64 {
    let (mut product, mut i) = (1.0, 0);
    while i < count {
        product *= n as f64 - i as f64;
        i += 1;
    }
    product
}

/// [`falling`] for the orders and coefficients that a tick evaluates.
const FALLING: [[f64; COEFFICIENTS]; ORDERS] = {
    let mut table = [[0.0; COEFFICIENTS]; ORDERS];
    let mut order = 0;
    while order < ORDERS {
        let mut n = order;
        while n < COEFFICIENTS {
            table[order][n] = falling(n, order);
            n += 1;
        }
        order += 1;
    }
    table
};

impl Segment {
    fn at(&self, u: f64) -> Axes {
        let per_length = 1.0 / self.length_s;
        self.coefficients.map(|c| {
            let mut unit = 1.0;
            std::array::from_fn(|order| {
                let sum = (order..COEFFICIENTS)
                    .rev()
                    .fold(0.0, |sum, n| sum * u + FALLING[order][n] * c[n]);
                let derivative = sum * unit;
                unit *= per_length;
                derivative
            })
        })
    }
}

/// What the two ends of an interval of length 1 say of the polynomial between them.
struct Hermite {
    /// Coefficients 5 to 9, of the derivatives 0 to 4 at the begin and at the end.
    from_begin: SMatrix<f64, 5, 5>,
    from_end: SMatrix<f64, 5, 5>,
    /// Derivatives 5 to 8 at the begin, of coefficients 5 to 9; and at the end.
    at_begin: SMatrix<f64, 4, 5>,
    at_end: SMatrix<f64, 4, 5>,
}

impl Hermite {
    fn new() -> Self {
        // The derivative j at u = 1 is the sum over n of n!/(n - j)! c_n; c_n is the n-th derivative at 0 by n!.
        let of_high = SMatrix::<f64, 5, 5>::from_fn(|j, n| falling(n + ORDERS, j));
        let of_low = SMatrix::<f64, 5, 5>::from_fn(|j, n| {
            if n >= j {
                1.0 / falling(n - j, n - j)
            } else {
                0.0
            }
        });
        // Column j holds whole numbers by j!: so rounding is undone.
        let exact =
            |matrix: SMatrix<f64, 5, 5>| matrix.map(|number| (24.0 * number).round() / 24.0);
        let from_end = exact(of_high.try_inverse().unwrap_or_default());
        Self {
            from_begin: exact(-from_end * of_low),
            from_end,
            at_begin: SMatrix::from_fn(|m, n| {
                if m == n {
                    falling(n + ORDERS, n + ORDERS)
                } else {
                    0.0
                }
            }),
            at_end: SMatrix::from_fn(|m, n| {
                if n >= m {
                    falling(n + ORDERS, m + ORDERS)
                } else {
                    0.0
                }
            }),
        }
    }

    /// Derivatives 1 to 4 at every point; or the point at which they cannot be computed.
    ///
    /// Each row is written in the length of the shorter interval at its point, so that its numbers are near 1.
    fn solve(&self, points: &[Point]) -> Result<Vec<Derivatives>, usize> {
        let last = points.len() - 1;
        let length = |i: usize| points[i].t_s - points[i - 1].t_s;
        // Of each inner point, what is left of its row when the points before it are eliminated: x_i = g - h x_(i+1).
        let mut left: Vec<(Derivatives, Matrix4<f64>)> =
            vec![(Derivatives::zeros(), Matrix4::zeros())];
        let (end_begin, end_end) = (self.at_end * self.from_begin, self.at_end * self.from_end);
        let (begin_begin, begin_end) = (
            self.at_begin * self.from_begin,
            self.at_begin * self.from_end,
        );
        for i in 1..last {
            let (before, after) = (length(i), length(i + 1));
            let unit = before.min(after);
            let row = |m: usize, length: f64| power(unit / length, m + ORDERS);
            // Column 0 belongs to the values, the others to the derivatives.
            let term = |matrix: &SMatrix<f64, 4, 5>, length: f64| {
                SMatrix::<f64, 4, 5>::from_fn(|m, j| {
                    matrix[(m, j)] * row(m, length) * power(length, j)
                })
            };
            let (low, here_low) = (term(&end_begin, before), term(&end_end, before));
            let (here_high, high) = (term(&begin_begin, after), term(&begin_end, after));
            let here = here_low - here_high;
            let values = |i: usize| SMatrix::<f64, 1, AXES>::from_row_slice(&points[i].value);
            let known = -(low.column(0) * values(i - 1) + here.column(0) * values(i)
                - high.column(0) * values(i + 1));
            let (low, here, high): (Matrix4<f64>, Matrix4<f64>, Matrix4<f64>) = (
                low.fixed_columns::<4>(1).into(),
                here.fixed_columns::<4>(1).into(),
                high.fixed_columns::<4>(1).into(),
            );
            let (g, h) = left[i - 1];
            // Derivatives in units of the interval, or the columns would be of very different size.
            let scale = Matrix4::from_diagonal(&nalgebra::Vector4::from_fn(|j, _| {
                power(1.0 / unit, j + 1)
            }));
            let pivot = ((here - low * h) * scale).lu();
            let solved =
                |right: &Matrix4<f64>| pivot.solve(right).map(|solved| scale * solved).ok_or(i);
            left.push((solved(&(known - low * g))?, -solved(&high)?));
        }
        let mut derivatives = vec![Derivatives::zeros(); points.len()];
        for i in (1..last).rev() {
            derivatives[i] = left[i].0 - left[i].1 * derivatives[i + 1];
        }
        Ok(derivatives)
    }

    fn segment(&self, points: [&Point; 2], derivatives: [&Derivatives; 2]) -> Segment {
        let length_s = points[1].t_s - points[0].t_s;
        let coefficients = std::array::from_fn(|axis| {
            let [begin, end] = [0, 1].map(|side| {
                SMatrix::<f64, 5, 1>::from_fn(|j, _| match j {
                    0 => points[side].value[axis],
                    _ => derivatives[side][(j - 1, axis)] * power(length_s, j),
                })
            });
            let high = self.from_begin * begin + self.from_end * end;
            std::array::from_fn(|n| {
                if n < ORDERS {
                    begin[n] / falling(n, n)
                } else {
                    high[n - ORDERS]
                }
            })
        });
        Segment {
            begin_s: points[0].t_s,
            length_s,
            coefficients,
        }
    }
}

/// x^n by multiplication alone, which has the same bits on every machine.
fn power(x: f64, n: usize) -> f64 {
    (0..n).fold(1.0, |product, _| product * x)
}
