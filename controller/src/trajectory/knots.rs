//! Knots of a curve near many points: few points that a spline passes through instead.
//!
//! Points as planners export them are rounded. A spline of degree 9 through points h apart turns a rounding of r into a
//! snap of about 100 r/h^4, which no airframe can fly where the points are dense. So the curve passes through knots: some
//! of the points' times, with values that a least-squares fit gives them. An interval between two knots is halved until
//! all points in it are within the tolerance, or until its knots are so close that roundings would shape the curve.

use nalgebra::Vector4;

use crate::trajectory::spline::{AXES, COEFFICIENTS, Point};

/// Intervals of h between knots are too short for points of a tolerance if that is more than this times h^4 [m/s^4].
const SNAP_M_S4: f64 = 2.0;
const DEGREE: usize = COEFFICIENTS - 1;
/// B-splines that a rest up to snap makes one of, at each end, besides the first: their coefficients are equal.
const RESTING: usize = 4;
/// Weight of the first and the last point, through which the curve passes.
const END_WEIGHT: f64 = 1e8;
/// How often the fit is refined by what rounding has left of its residuals.
const REFINEMENTS: usize = 2;

/// Shortest interval between two knots [s] for points of this tolerance.
pub(super) fn shortest_s(points: &[Point], tolerance: &[f64; AXES]) -> f64 {
    let is_constant = |axis: usize| {
        points
            .iter()
            .all(|it| it.value[axis] == points[0].value[axis])
    };
    (0..AXES)
        .filter(|&axis| !is_constant(axis))
        .map(|axis| (tolerance[axis] / SNAP_M_S4).sqrt().sqrt())
        .fold(0.0, f64::max)
}

/// Points at which the curve rests: both ends, and those of every pause.
///
/// A pause is a run of equal positions of at least `shortest_s` that does not begin and end with a step of the last digit:
/// rounded points of a slow flight are equal, too.
pub(super) fn rests(points: &[Point], tolerance: &[f64; AXES], shortest_s: f64) -> Vec<usize> {
    let last = points.len() - 1;
    let is_step = |i: usize, digits: f64| {
        let (from, to) = (&points[i].value, &points[i + 1].value);
        (0..3).any(|axis| (to[axis] - from[axis]).abs() > digits * tolerance[axis])
    };
    let mut rests = vec![0];
    let mut begin = 0;
    for i in 0..=last {
        if i < last && !is_step(i, 0.0) {
            continue;
        }
        let is_left = begin > 0 && is_step(begin - 1, 1.5) || i < last && is_step(i, 1.5);
        if i > begin && is_left && points[i].t_s - points[begin].t_s >= shortest_s {
            rests.extend([begin, i]);
        }
        begin = i + 1;
    }
    rests.push(last);
    rests.dedup();
    rests
}

/// The knots of a curve that rests at both ends: the points themselves, where none of them are closer than `shortest_s`.
pub(super) fn knots(points: &[Point], tolerance: &[f64; AXES], shortest_s: f64) -> Vec<Point> {
    let is_long = |from: usize, to: usize| points[to].t_s - points[from].t_s >= shortest_s;
    let last = points.len() - 1;
    if (0..last).all(|i| is_long(i, i + 1)) {
        return points.to_vec();
    }
    let mut knots = vec![0, last];
    loop {
        let (values, is_off) = fit(points, tolerance, &knots);
        let halves = knots.windows(2).filter_map(|pair| {
            let [begin, end] = [pair[0], pair[1]];
            let middle_s = 0.5 * (points[begin].t_s + points[end].t_s);
            let later = points.partition_point(|point| point.t_s < middle_s);
            let is_half = |&it: &usize| is_long(begin, it) && is_long(it, end);
            let middle = [later - 1, later]
                .into_iter()
                .filter(|&it| begin < it && it < end)
                .find(is_half)?;
            is_off[begin..=end].contains(&true).then_some(middle)
        });
        let halves: Vec<usize> = halves.collect();
        if halves.is_empty() {
            let knot = |(&at, value): (&usize, &[f64; AXES])| Point {
                t_s: points[at].t_s,
                value: *value,
            };
            return knots.iter().zip(&values).map(knot).collect();
        }
        knots.extend(halves);
        knots.sort_unstable();
    }
}

/// The points' least-squares fit, a spline with knots at some of their times: its values there, and which points are
/// further from it than the tolerance.
fn fit(
    points: &[Point],
    tolerance: &[f64; AXES],
    knots: &[usize],
) -> (Vec<[f64; AXES]>, Vec<bool>) {
    let times: Vec<f64> = knots.iter().map(|&i| points[i].t_s).collect();
    // The basis of each point: its first unknown, and the B-splines that are not 0 there.
    let basis: Vec<Basis> = (points.iter())
        .map(|point| Basis::at(&times, point.t_s))
        .collect();
    let weight = |i: usize| match i == 0 || i + 1 == points.len() {
        true => END_WEIGHT,
        false => 1.0,
    };
    // The normal equations, a symmetric band: row u has the columns u to u + DEGREE.
    let mut band = vec![[0.0; COEFFICIENTS]; knots.len()];
    for (i, it) in basis.iter().enumerate() {
        for a in 0..COEFFICIENTS {
            for b in 0..COEFFICIENTS {
                let (row, column) = (it.unknown(a, knots.len()), it.unknown(b, knots.len()));
                if column >= row {
                    band[row][column - row] += weight(i) * it.values[a] * it.values[b];
                }
            }
        }
    }
    factorise(&mut band);
    let mut coefficients = vec![Vector4::zeros(); knots.len()];
    let value = |coefficients: &[Vector4<f64>], i: usize| {
        let unknowns = (0..COEFFICIENTS).map(|a| basis[i].unknown(a, knots.len()));
        (basis[i].values.iter().zip(unknowns)).fold(Vector4::zeros(), |sum, (value, unknown)| {
            sum + *value * coefficients[unknown]
        })
    };
    for _ in 0..=REFINEMENTS {
        let mut change = vec![Vector4::zeros(); knots.len()];
        for (i, it) in basis.iter().enumerate() {
            let rest = weight(i) * (Vector4::from(points[i].value) - value(&coefficients, i));
            for a in 0..COEFFICIENTS {
                change[it.unknown(a, knots.len())] += it.values[a] * rest;
            }
        }
        solve(&band, &mut change);
        for (coefficient, change) in coefficients.iter_mut().zip(&change) {
            *coefficient += change;
        }
    }
    let is_off = |i: usize| {
        let away = value(&coefficients, i) - Vector4::from(points[i].value);
        away.iter()
            .zip(tolerance)
            .any(|(away, tolerance)| away.abs() > *tolerance)
    };
    let at_knot = |&at: &usize| match at == 0 || at + 1 == points.len() {
        true => points[at].value,
        false => value(&coefficients, at).into(),
    };
    (
        knots.iter().map(at_knot).collect(),
        (0..points.len()).map(is_off).collect(),
    )
}

/// The B-splines of degree 9 that are not 0 at a time, from the interval of that time on.
struct Basis {
    interval: usize,
    values: [f64; COEFFICIENTS],
}

impl Basis {
    /// By de Boor's recursion; the first and the last knot count tenfold.
    fn at(times: &[f64], t_s: f64) -> Self {
        let last = times.len() - 1;
        let later = times.partition_point(|knot_s| *knot_s <= t_s);
        let interval = (later - 1).min(last - 1);
        let after = |i: usize| times[(interval + i).min(last)];
        let before = |i: usize| times[(interval + 1).saturating_sub(i)];
        let mut values = [0.0; COEFFICIENTS];
        values[0] = 1.0;
        for degree in 1..=DEGREE {
            let mut saved = 0.0;
            for (i, value) in values.iter_mut().enumerate().take(degree) {
                let (left_s, right_s) = (t_s - before(degree - i), after(i + 1) - t_s);
                let share = *value / (right_s + left_s);
                *value = saved + right_s * share;
                saved = left_s * share;
            }
            values[degree] = saved;
        }
        Self { interval, values }
    }

    /// The unknown that is the coefficient of its B-spline `i`: one for each knot, as the curve rests at both ends.
    fn unknown(&self, i: usize, knots: usize) -> usize {
        (self.interval + i).saturating_sub(RESTING).min(knots - 1)
    }
}

/// L D L^T of a symmetric band: D in column 0, the columns of L after it.
fn factorise(band: &mut [[f64; COEFFICIENTS]]) {
    for row in 0..band.len() {
        let pivot = band[row];
        let reach = DEGREE.min(band.len() - 1 - row);
        for a in 1..=reach {
            let factor = pivot[a] / pivot[0];
            for b in a..=reach {
                band[row + a][b - a] -= factor * pivot[b];
            }
            band[row][a] = factor;
        }
    }
}

/// Solves for a right side, in place.
fn solve(band: &[[f64; COEFFICIENTS]], right: &mut [Vector4<f64>]) {
    let reach = |row: usize| 1..=DEGREE.min(band.len() - 1 - row);
    for row in 0..band.len() {
        for a in reach(row) {
            let known = right[row];
            right[row + a] -= band[row][a] * known;
        }
    }
    for row in (0..band.len()).rev() {
        right[row] /= band[row][0];
        for a in reach(row) {
            let known = right[row + a];
            right[row] -= band[row][a] * known;
        }
    }
}
