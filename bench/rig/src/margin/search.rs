//! Finds the strongest fault survived, and checks monotonicity.

use errors::Failure;

/// Bisection for the largest number up to `most` that is survived. Assumes that 0 is survived, and nothing beyond a number
/// that is not.
pub fn largest(
    most: u64,
    mut survives: impl FnMut(u64) -> Result<bool, Failure>,
) -> Result<u64, Failure> {
    if most == 0 || survives(most)? {
        Ok(most)
    } else {
        between(0, most, survives)
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
    found: u64,
    most: u64,
    mut survives: impl FnMut(u64) -> Result<bool, Failure>,
) -> Result<(u64, Vec<(u64, bool)>), Failure> {
    let mut exceptions = Vec::new();
    for beyond in [found + found / 4 + 2, 2 * found + 3] {
        if found < most && beyond <= most && survives(beyond)? {
            exceptions.push((beyond, true));
        }
    }
    let mut within: Vec<u64> = (1..4)
        .map(|quarters| found * quarters / 4)
        .filter(|it| (1..found).contains(it))
        .collect();
    within.dedup();
    for (i, tried) in within.iter().enumerate() {
        if !survives(*tried)? {
            exceptions.push((*tried, false));
            let low = if i == 0 { 0 } else { within[i - 1] };
            return Ok((between(low, *tried, survives)?, exceptions));
        }
    }
    Ok((found, exceptions))
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

    fn counted<R>(
        survives: impl Fn(u64) -> bool,
        ask: impl FnOnce(&mut dyn FnMut(u64) -> Result<bool, Failure>) -> R,
    ) -> (R, u32) {
        let mut flights = 0;
        let answer = ask(&mut |number| {
            flights += 1;
            Ok(survives(number))
        });
        (answer, flights)
    }

    #[test]
    fn bisection_finds_the_last_one_in_eleven_flights() {
        for limit in [0, 1, 117, 118, 1999, 2000, 5000] {
            let (found, flights) = counted(|it| it <= limit, |survives| largest(2000, survives));
            assert_eq!(found.unwrap(), limit.min(2000));
            assert!(flights <= 12, "{limit}: {flights}");
        }
        let (found, flights) = counted(|_| true, |survives| largest(0, survives));
        assert_eq!((found.unwrap(), flights), (0, 0));
    }

    #[test]
    fn what_is_against_the_order_of_things_is_told() {
        let (orderly, _) = counted(|it| it <= 100, |survives| checked(100, 2000, survives));
        assert_eq!(orderly.unwrap(), (100, vec![]));
        let (island, _) = counted(
            |it| it <= 100 || it == 203,
            |survives| checked(100, 2000, survives),
        );
        assert_eq!(island.unwrap(), (100, vec![(203, true)]));
        let (hole, _) = counted(
            |it| it <= 100 && !(30..=60).contains(&it),
            |survives| checked(100, 2000, survives),
        );
        assert_eq!(
            hole.unwrap(),
            (29, vec![(50, false)]),
            "the margin is what lies below the hole"
        );
        let (capped, _) = counted(|it| it <= 2000, |survives| checked(2000, 2000, survives));
        assert_eq!(
            capped.unwrap(),
            (2000, vec![]),
            "nothing beyond the longest is tried"
        );
        let (none, flights) = counted(|_| false, |survives| checked(0, 2000, survives));
        assert_eq!((none.unwrap(), flights), ((0, vec![]), 2));
    }

    #[test]
    fn a_climb_ends_behind_some_misses() {
        let climb = |lost: &[u64]| {
            let (all, flights) = counted(
                |it| !lost.contains(&it),
                |survives| climbed(1..=60, 3, survives),
            );
            (all.unwrap(), flights)
        };
        assert_eq!(climb(&[]), (60, 60));
        assert_eq!(climb(&[5, 6, 7]), (4, 7));
        assert_eq!(
            climb(&[3, 5, 6, 7]),
            (2, 7),
            "what is survived behind a miss does not count"
        );
    }

    #[test]
    fn a_failure_ends_a_search() {
        let broken = |_: u64| Err(Failure::failed("no"));
        assert!(
            largest(9, broken).is_err()
                && checked(9, 20, broken).is_err()
                && climbed([1], 1, broken).is_err()
        );
    }
}
