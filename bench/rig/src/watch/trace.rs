//! One quantity over the last minute: the largest value of each 0.1 s.

use std::collections::VecDeque;

/// Flight time of a point [s].
pub const POINT_S: f64 = 0.1;
/// Points that are kept.
pub const POINTS: usize = 600;

/// The last [`POINTS`] points.
#[derive(Clone, Debug, Default)]
pub struct ErrorTrace {
    points: VecDeque<f64>,
    /// The present point: its number, and the largest value so far.
    present: Option<(u64, f64)>,
}

impl ErrorTrace {
    /// Takes the value at a time of the flight [s].
    pub fn take(&mut self, time_s: f64, value: f64) {
        let number = (time_s / POINT_S) as u64;
        match &mut self.present {
            Some((present, largest)) if *present == number => *largest = largest.max(value),
            present => {
                if let Some((_, largest)) = present.replace((number, value)) {
                    self.points.push_back(largest);
                    if self.points.len() > POINTS {
                        self.points.pop_front();
                    }
                }
            }
        }
    }

    /// The newest points, the newest last; at most `most`.
    #[must_use]
    pub fn newest(&self, most: usize) -> Vec<f64> {
        let all = self.points.iter().copied().chain(self.present.map(|(_, largest)| largest));
        let skipped = (self.points.len() + usize::from(self.present.is_some())).saturating_sub(most);
        all.skip(skipped).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_the_largest_of_its_tenth_of_a_second() {
        let mut trace = ErrorTrace::default();
        for (time_s, value) in [(0.01, 1.0), (0.05, 3.0), (0.09, 2.0), (0.11, 5.0), (0.21, 4.0)] {
            trace.take(time_s, value);
        }
        assert_eq!(trace.newest(10), [3.0, 5.0, 4.0]);
        assert_eq!(trace.newest(2), [5.0, 4.0]);
    }

    #[test]
    fn old_points_go() {
        let mut trace = ErrorTrace::default();
        for i in 0..2 * POINTS {
            trace.take(i as f64 * POINT_S + 0.01, i as f64);
        }
        let points = trace.newest(usize::MAX);
        assert_eq!((points.len(), points.last()), (POINTS + 1, Some(&((2 * POINTS - 1) as f64))));
    }
}
