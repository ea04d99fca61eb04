//! A quantile that follows its samples one by one, and that no single sample moves far.

/// The share of itself by which a quantile grows with a sample beyond it: one part in so many.
const GROWS_BY: u64 = 16;

/// The value that one sample in so many exceeds, of those that came last.
///
/// A sample beyond it lets it grow by a sixteenth, and any other one lets it shrink by so much less that the two are in
/// balance at the asked share. So a value twice as large is reached after a dozen samples beyond the present one, and a
/// stall is one step, however long it was. Below some microseconds it no longer shrinks, because it counts in
/// nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrackedQuantile {
    value_ns: u64,
    one_in: u64,
    most_ns: u64,
}

impl TrackedQuantile {
    /// One that begins at `start_ns`, is exceeded by one sample in `one_in`, which is at least two, and never exceeds
    /// `most_ns`.
    #[must_use]
    pub const fn new(start_ns: u64, one_in: u64, most_ns: u64) -> Self {
        assert!(one_in >= 2, "every sample beyond it is no quantile");
        let value_ns = if start_ns < most_ns {
            start_ns
        } else {
            most_ns
        };
        Self {
            value_ns,
            one_in,
            most_ns,
        }
    }

    /// Where it is [ns].
    #[must_use]
    pub const fn value_ns(&self) -> u64 {
        self.value_ns
    }

    /// Takes a sample [ns].
    pub fn follow(&mut self, sample_ns: u64) {
        self.value_ns = if sample_ns > self.value_ns {
            (self.value_ns + self.value_ns.div_ceil(GROWS_BY)).min(self.most_ns)
        } else {
            self.value_ns - self.value_ns / (GROWS_BY * (self.one_in - 1))
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that repeat after a prime number of them, evenly spread over 0 to 1.
    fn spread(i: u64) -> f64 {
        (i * 7919 % 9973) as f64 / 9973.0
    }

    #[test]
    fn it_settles_so_that_the_asked_share_lies_below_wherever_it_began() {
        // Even, with a long tail, and of two kinds.
        let series: [fn(f64) -> u64; 3] = [
            |x| (100_000.0 * x) as u64,
            |x| (8_000.0 / (1.0 - x).sqrt()) as u64,
            |x| {
                if x < 0.9 {
                    12_000
                } else {
                    30_000 + (40_000.0 * x) as u64
                }
            },
        ];
        for (which, sample) in series.iter().enumerate() {
            for (one_in, start_ns) in [
                (50, 1_000),
                (50, 4_000_000),
                (100, 1_000),
                (100, 4_000_000),
                (10, 30_000),
            ] {
                let mut tracked = TrackedQuantile::new(start_ns, one_in, 5_000_000);
                (0..20_000).for_each(|i| tracked.follow(sample(spread(i))));
                let beyond = (20_000..70_000)
                    .filter(|i| {
                        let sample_ns = sample(spread(*i));
                        let is_beyond = sample_ns > tracked.value_ns();
                        tracked.follow(sample_ns);
                        is_beyond
                    })
                    .count();
                let one_in_so_many = 50_000.0 / beyond as f64;
                let asked = one_in as f64;
                assert!(
                    one_in_so_many > 0.9 * asked && one_in_so_many < 1.2 * asked,
                    "series {which} from {start_ns}: one in {one_in_so_many:.1} instead of {one_in}"
                );
            }
        }
    }

    #[test]
    fn a_single_stall_is_one_step_and_forgotten_after_as_many_samples_as_it_is_one_of() {
        for one_in in [50, 100] {
            let mut tracked = TrackedQuantile::new(40_000, one_in, 250_000);
            tracked.follow(20_000_000);
            assert_eq!(tracked.value_ns(), 42_500);
            (0..one_in).for_each(|_| tracked.follow(10_000));
            assert!(
                (39_000..40_500).contains(&tracked.value_ns()),
                "{tracked:?}"
            );
        }
    }

    #[test]
    fn it_doubles_with_a_dozen_samples_and_stops_at_its_most() {
        let mut tracked = TrackedQuantile::new(40_000, 100, 250_000);
        (0..12).for_each(|_| tracked.follow(200_000));
        assert!(tracked.value_ns() > 80_000, "{tracked:?}");
        (0..1_000).for_each(|_| tracked.follow(u64::MAX));
        assert_eq!(tracked.value_ns(), 250_000);
        assert_eq!(
            TrackedQuantile::new(300_000, 100, 250_000).value_ns(),
            250_000
        );
    }

    #[test]
    fn one_of_nothing_stays_nothing() {
        let mut tracked = TrackedQuantile::new(0, 100, 250_000);
        tracked.follow(10_000);
        assert_eq!(tracked.value_ns(), 0);
        let mut least = TrackedQuantile::new(1, 100, 250_000);
        (0..200).for_each(|_| least.follow(10_000));
        assert!(
            least.value_ns() > 9_000,
            "and what is something grows: {least:?}"
        );
    }
}
