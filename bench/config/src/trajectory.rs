//! What is flown: a built-in trajectory, or the points of a CSV file; and how it is stretched.
//!
//! The roles share the SHA-256 of the points, not the points: each reads the file itself, and one whose file differs is
//! refused by both hashes. The flight log keeps the file, so a replay needs no other.

use std::f64::consts::PI;
use std::fmt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use analysis::phrase::count;
use controller::trajectory::{AXES, Deviation, Point};
use controller::{ScaledTrajectory, Spline};
use errors::Failure;
use faults::grammar::begin_of;
use messages::parameters::shown;
use sha2::{Digest as _, Sha256};

use crate::declarations::{Allowed, section};
use crate::toml_access::bytes_of;

/// First line of a file of points.
pub const HEADER: &str = "t,x,y,z,yaw";
/// Points at the most: a curve through so many takes 6.7 MB, which each role locks in memory.
const MOST_POINTS: usize = 20_000;
/// Longest file [bytes].
const MOST_BYTES: u64 = 4 << 20;
/// Shortest time between two points [s]: a tick at 1 kHz.
const SHORTEST_S: f64 = 1e-3;
/// What rounding may take from it [s]: times that are written 1 ms apart are read as less at times.
const ROUNDING_S: f64 = 1e-9;
/// Latest point [s].
const LATEST_S: f64 = 1e6;
/// Furthest point [m], and most turned one [rad], inside of what messages may say.
const FURTHEST: f64 = 1e4;
/// Value of [`TrajectorySection::tolerance`] for the last digit in the file.
const LAST_DIGIT: f64 = -1.0;
/// Largest tolerance that a last digit makes [m], [rad]: a file of few digits has round numbers, not rounded ones.
const LAST_DIGIT_MAX: f64 = 0.01;
/// Yaw [rad], and its rate [rad/s], above which both together look like degrees: two turns, half a turn per second.
const DEGREES_RAD: f64 = 4.0 * PI;
const DEGREES_RAD_S: f64 = PI;
/// How often a curve is looked at for that.
const LOOKS: u32 = 10_000;

section! { "trajectory" "How the trajectory is stretched, and how its file is read."
    pub struct TrajectorySection {
        /// Factor on x, y and z.
        size: f64 = "1.0", in Allowed::Range(0.01, 100.0);
        /// Factor on time.
        period: f64 = "1.0", in Allowed::Range(0.01, 100.0);
        /// Largest distance of the curve from the points of the CSV file [m], [rad]; -1: one unit of the file's last digit.
        tolerance: f64 = "-1.0", in Allowed::Range(LAST_DIGIT, 10.0);
        /// SHA-256 of the CSV file, checked if not empty; recorded with each flight.
        sha256: String = "\"\"";
    }
}

#[derive(Clone, PartialEq)]
pub struct PointsFile {
    pub text: String,
    pub sha256: String,
    pub course: ScaledTrajectory,
    /// Where the curve is further from the points than its tolerance.
    pub deviation: Option<Deviation>,
}

impl fmt::Debug for PointsFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PointsFile")
            .field("sha256", &self.sha256)
            .finish_non_exhaustive()
    }
}

/// Whether a trajectory is a file, by its ending or a folder in its name.
pub fn is_file(trajectory: &str) -> bool {
    trajectory.contains('/') || Path::new(trajectory).extension().is_some()
}

impl PointsFile {
    pub fn read(path: &str, tolerance: f64) -> Result<Self, Failure> {
        let unread = |why: &dyn fmt::Display| {
            Failure::usage(format!("cannot read the trajectory file {path}: {why}"))
                .help("name a CSV file that you can read; `ironbird docs airframes` has the format")
        };
        let bytes = bytes_of(Path::new(path), MOST_BYTES).map_err(|e| unread(&e))?;
        let text = String::from_utf8(bytes).map_err(|e| {
            let line = 1 + e.as_bytes()[..e.utf8_error().valid_up_to()]
                .iter()
                .filter(|byte| **byte == b'\n')
                .count();
            unread(&format!("line {line} is not UTF-8"))
        })?;
        Self::of(text, tolerance).map_err(|why| {
            Failure::usage(format!("trajectory file {path}: {why}")).help(format!(
                "a first line {HEADER} and a line per point, in s, m and rad; see `ironbird docs airframes`"
            ))
        })
    }

    /// The curve near the points of a text, with the tolerance of [`TrajectorySection::tolerance`].
    pub fn of(text: String, tolerance: f64) -> Result<Self, String> {
        let sha256 = sha256_of(&text);
        // A curve stays for as long as the process does, and a campaign flies the same one a million times.
        static CURVES: Mutex<Vec<(f64, PointsFile)>> = Mutex::new(Vec::new());
        let mut curves = CURVES.lock().unwrap_or_else(PoisonError::into_inner);
        let is_known = |known: &&(f64, Self)| known.0 == tolerance && known.1.sha256 == sha256;
        if let Some((_, known)) = curves.iter().find(is_known) {
            return Ok(known.clone());
        }
        if tolerance < 0.0 && tolerance != LAST_DIGIT {
            return Err(format!(
                "trajectory.tolerance = {tolerance}: write 0 or more, or {LAST_DIGIT} for the last digit in the file"
            ));
        }
        let points = points(&text)?;
        let tolerances = match tolerance {
            given if given >= 0.0 => [given; AXES],
            _ => last_digits(&text, &points),
        };
        let (spline, deviation) = Spline::near(&points, &tolerances).map_err(|e| e.to_string())?;
        let file = Self {
            text,
            sha256,
            course: ScaledTrajectory::along(spline),
            deviation,
        };
        curves.push((tolerance, file.clone()));
        Ok(file)
    }

    /// Warnings of a curve that is far from its points, and of a yaw that looks like degrees.
    pub fn warnings(&self) -> Vec<String> {
        let deviation = self.deviation.map(|it| {
            let axis = HEADER.split(',').nth(it.axis + 1).unwrap_or_default();
            format!(
                "is {:.4} from the {axis} of its point at {} s: allowed are {} (trajectory.tolerance)",
                it.away, it.t_s, it.allowed
            )
        });
        let end_s = self.course.end_s().unwrap_or_default();
        let is_in_degrees = |t_s: &f64| {
            let reference = self.course.reference(*t_s);
            reference.yaw_rad.abs() > DEGREES_RAD
        };
        let times = || (0..=LOOKS).map(|i| end_s * f64::from(i) / f64::from(LOOKS));
        let turns_fast =
            times().any(|t_s| self.course.reference(t_s).yaw_rate_rad_s.abs() > DEGREES_RAD_S);
        let degrees = times().find(is_in_degrees).filter(|_| turns_fast).map(|t_s| {
            format!("has more than two turns of yaw at {t_s:.2} s: yaw is in rad, and these look like degrees")
        });
        deviation.into_iter().chain(degrees).collect()
    }
}

/// The unit of the last digit in each column, as far as its larger numbers show it: those of `%g` have fewer decimals than
/// the small ones.
fn last_digits(text: &str, points: &[Point]) -> [f64; AXES] {
    let rows: Vec<&str> = text
        .lines()
        .skip(1)
        .filter(|line| !line.trim().is_empty())
        .collect();
    std::array::from_fn(|axis| {
        let largest = points
            .iter()
            .fold(0.0, |most, it| it.value[axis].abs().max(most));
        let is_large = |point: &Point| point.value[axis].abs() >= 0.5 * largest;
        let large = rows.iter().zip(points).filter(|(_, point)| is_large(point));
        let fields = large.filter_map(|(row, _)| row.split(',').nth(axis + 1));
        let decimals = fields.map(decimals).max().unwrap_or_default();
        let unit = format!("1e{}", -decimals).parse().unwrap_or(LAST_DIGIT_MAX);
        LAST_DIGIT_MAX.min(unit)
    })
}

/// Decimals of a number: -2 of `1e2`.
fn decimals(field: &str) -> i64 {
    let field = field.trim();
    let (digits, exponent) = field.split_once(['e', 'E']).unwrap_or((field, "0"));
    let after_point = digits
        .split_once('.')
        .map_or(0, |(_, decimals)| decimals.len());
    after_point as i64 - exponent.parse::<i64>().unwrap_or_default()
}

/// The SHA-256 of a text, as `sha256sum` writes it.
pub fn sha256_of(text: &str) -> String {
    format!("{:x}", Sha256::digest(text))
}

/// Reads points: a first line [`HEADER`], then a line per point.
fn points(text: &str) -> Result<Vec<Point>, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, line));
    let header = lines.next().map_or("", |(_, line)| line);
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    if names.join(",") != HEADER {
        return Err(format!(
            "line 1 is `{}`: expected {HEADER}",
            begin_of(header)
        ));
    }
    let mut points: Vec<Point> = Vec::new();
    for (line, text) in lines.filter(|(_, text)| !text.trim().is_empty()) {
        if points.len() == MOST_POINTS {
            return Err(format!("line {line}: more than {MOST_POINTS} points"));
        }
        let point = point(line, text)?;
        match points.last() {
            None if point.t_s != 0.0 => {
                return Err(format!(
                    "line {line}, column t: the first point is at {} s: expected 0",
                    point.t_s
                ));
            }
            Some(before) if point.t_s - before.t_s < SHORTEST_S - ROUNDING_S => {
                let (t_s, before_s) = (point.t_s, before.t_s);
                return Err(format!(
                    "line {line}, column t: {t_s} s follows {before_s} s: expected at least {SHORTEST_S} s later"
                ));
            }
            _ => points.push(point),
        }
    }
    match points.len() {
        0 => Err("it has no point: expected at least 2".into()),
        1 => Err("it has 1 point: expected at least 2".into()),
        _ => Ok(points),
    }
}

fn point(line: usize, text: &str) -> Result<Point, String> {
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    let names: Vec<&str> = HEADER.split(',').collect();
    if fields.len() != names.len() {
        let found = count(fields.len() as u64, "column");
        return Err(format!(
            "line {line} has {found}: expected {}, as in {HEADER}",
            names.len()
        ));
    }
    let mut numbers = [0.0; 5];
    for ((number, field), name) in numbers.iter_mut().zip(&fields).zip(&names) {
        let place = format!("line {line}, column {name}");
        let value: f64 = field
            .parse()
            .map_err(|_| format!("{place}: `{}` is not a number", begin_of(field)))?;
        let most = if *name == "t" { LATEST_S } else { FURTHEST };
        if !(-most..=most).contains(&value) {
            return Err(format!(
                "{place}: {} is out of range: allowed are -{most} to {most}",
                shown(value)
            ));
        }
        *number = value;
    }
    let [t_s, value @ ..] = numbers;
    Ok(Point { t_s, value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_read_from_what_spreadsheets_write() {
        let plain = points("t,x,y,z,yaw\n0,0,0,0,0\n1.5,1e0,-2,0.5,3\n").unwrap();
        assert_eq!((plain[1].t_s, plain[1].value), (1.5, [1.0, -2.0, 0.5, 3.0]));
        let marked = "\u{feff}t, x, y, z, yaw\r\n0,0,0,0,0\r\n 1.5 , 1 ,-2,0.5,3";
        assert_eq!(points(marked).unwrap(), plain);
    }

    #[test]
    fn the_last_digit_of_each_column_is_the_tolerance() {
        for (columns, expected) in [
            (
                "1.000,2.5,1e-3,0 -0.500,2.25,9e-3,1",
                [1e-3, 0.01, 1e-3, 0.01],
            ),
            // Six significant digits: small numbers have more decimals.
            (
                "123.456,1.23457,3,0.5 0.00123456,0.123457,3,0.5",
                [1e-3, 1e-5, 0.01, 0.01],
            ),
        ] {
            let rows = columns.split(' ').enumerate();
            let rows: String = rows.map(|(t, row)| format!("\n{t},{row}")).collect();
            let text = format!("{HEADER}{rows}\n");
            assert_eq!(last_digits(&text, &points(&text).unwrap()), expected);
        }
    }

    #[test]
    fn every_mistake_is_reported_with_line_and_column() {
        for (rows, expected) in [
            ("", "it has no point"),
            ("0,0,0,0,0", "it has 1 point"),
            ("0,0,0,0,0 1,2,3", "line 3 has 3 columns: expected 5"),
            ("0,0,0,0,0 1", "line 3 has 1 column: expected 5"),
            (
                "0,0,0,0,0 1,a,3,4,5",
                "line 3, column x: `a` is not a number",
            ),
            (
                "0,0,0,0,0 1,2,3,nan,5",
                "line 3, column z: NaN is out of range",
            ),
            (
                "0,0,0,0,0 1,2,3,4,inf",
                "line 3, column yaw: inf is out of range",
            ),
            (
                "0,0,0,0,0 1,2,2e4,4,0",
                "line 3, column y: 20000 is out of range",
            ),
            (
                "1,0,0,0,0",
                "line 2, column t: the first point is at 1 s: expected 0",
            ),
            (
                "0,0,0,0,0 1,0,0,0,0 1,0,0,0,0",
                "line 4, column t: 1 s follows 1 s: expected at least",
            ),
        ] {
            let error = points(&format!("{HEADER}\n{}\n", rows.replace(' ', "\n"))).unwrap_err();
            assert!(error.contains(expected), "{rows}: {error}");
        }
        for header in ["", "0,0,0,0,0", "t,x,y,z"] {
            let error = points(&format!("{header}\n1,1,1,1,1\n")).unwrap_err();
            assert_eq!(error, format!("line 1 is `{header}`: expected {HEADER}"));
        }
        let many: String = (0..=MOST_POINTS)
            .map(|i| format!("{i},0,0,0,0\n"))
            .collect();
        let error = points(&format!("{HEADER}\n{many}")).unwrap_err();
        let line = MOST_POINTS + 2;
        assert_eq!(
            error,
            format!("line {line}: more than {MOST_POINTS} points")
        );
    }

    #[test]
    fn points_of_every_millisecond_are_far_enough_apart() {
        for from_s in [0, 999_980] {
            let line = |i: usize| format!("{}.{:03},0,0,0,0\n", from_s + i / 1000, i % 1000);
            let every_ms: String = (1..MOST_POINTS).map(line).collect();
            let read = points(&format!("{HEADER}\n0,0,0,0,0\n{every_ms}"));
            assert_eq!(read.map(|points| points.len()), Ok(MOST_POINTS));
        }
        let error = points(&format!("{HEADER}\n0,0,0,0,0\n0.00099,0,0,0,0\n")).unwrap_err();
        assert_eq!(
            error,
            "line 3, column t: 0.00099 s follows 0 s: expected at least 0.001 s later"
        );
    }
}
