//! Finds the strongest fault survived, and checks monotonicity.

use errors::Failure;

/// Bisection for the largest number up to `most` that is survived. Assumes that 0 is survived, and nothing beyond a number
/// that is not.
pub fn largest(
    most: u64,
    mut survives: impl FnMut(u64) -> Result<bool, Failure>,
) -> Result<u64, Failure> {
    match most == 0 || survives(most)? {
        true => Ok(most),
        false => between(0, most, survives),
    }
}

/// The same between `low`, which is survived, and `high`, which is not.
fn between(
    mut low: u64,
    mut high: u64,
    mut survives: impl FnMut(u64) -> Result<bool, Failure>,
) -> Result<u64, Failure> {
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if survives(middle)? {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(low)
}

/// Checks numbers below and above the result of the bisection, up to `most`. Returns the largest number up to which every
/// tried one was survived, and the numbers that contradict monotonicity with their results.
pub fn checked(
    longest: u64,
    most: u64,
    mut survives: impl FnMut(u64) -> Result<bool, Failure>,
) -> Result<(u64, Vec<(u64, bool)>), Failure> {
    let mut exceptions = Vec::new();
    for beyond in [longest + longest / 4 + 2, 2 * longest + 3] {
        if longest < most && beyond <= most && survives(beyond)? {
            exceptions.push((beyond, true));
        }
    }
    let mut low = 0;
    for tried in (1..4).map(|quarters| longest * quarters / 4) {
        if low < tried && !survives(tried)? {
            exceptions.push((tried, false));
            return Ok((between(low, tried, survives)?, exceptions));
        }
        low = tried;
    }
    Ok((longest, exceptions))
}

/// Tries ascending steps until `misses` in a row fail; returns how many succeeded before the first failure.
pub fn climbed<T: Copy>(
    steps: impl IntoIterator<Item = T>,
    misses: u32,
    mut survives: impl FnMut(T) -> Result<bool, Failure>,
) -> Result<usize, Failure> {
    let (mut all, mut row) = (0, 0);
    let mut is_whole = true;
    for step in steps {
        if survives(step)? {
            row = 0;
            all += usize::from(is_whole);
        } else {
            is_whole = false;
            row += 1;
            if row == misses {
                break;
            }
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bisection_finds_the_last_survived_number_in_twelve_flights() {
        for (limit, most) in [
            (0, 2000),
            (1, 2000),
            (117, 2000),
            (118, 2000),
            (1999, 2000),
            (2000, 2000),
            (5000, 2000),
            (5, 0),
        ] {
            let mut flights = 0;
            let longest = largest(most, |it| {
                flights += 1;
                Ok(it <= limit)
            });
            assert_eq!(longest.unwrap(), limit.min(most));
            assert!(flights <= 12.min(most), "{limit}: {flights}");
        }
    }

    #[test]
    fn results_that_contradict_monotonicity_are_reported() {
        let survives = |name: &str, it: u64| match name {
            "island" => it <= 100 || it == 203,
            // The margin is below the hole.
            "hole" => it <= 100 && !(30..=60).contains(&it),
            "none" => false,
            _ => it <= 100,
        };
        for (name, longest, most, result) in [
            ("monotonic", 100, 2000, (100, vec![])),
            ("island", 100, 2000, (100, vec![(203, true)])),
            ("hole", 100, 2000, (29, vec![(50, false)])),
            ("longest", 100, 100, (100, vec![])),
            ("none", 0, 2000, (0, vec![])),
        ] {
            let tried = |it| {
                assert!(it <= most);
                Ok(survives(name, it))
            };
            assert_eq!(checked(longest, most, tried).unwrap(), result, "{name}");
        }
    }

    #[test]
    fn a_climb_ends_after_some_misses_and_counts_up_to_the_first_one() {
        for (lost, all, flights) in [(&[][..], 60, 60), (&[5, 6, 7], 4, 7), (&[3, 5, 6, 7], 2, 7)] {
            let mut flown = 0;
            let climb = climbed(1..=60, 3, |it| {
                flown += 1;
                Ok(!lost.contains(&it))
            });
            assert_eq!((climb.unwrap(), flown), (all, flights));
        }
    }
}
