//! Draws that cover their range evenly: Latin hypercube, Sobol's sequence.
//!
//! Both give the point of a flight from its number alone.

use crate::generator::Stream;

/// Direction numbers of Sobol's sequence by dimension, from the second on: degree, polynomial and the first m.
///
/// Joe and Kuo, "Constructing Sobol' sequences with better two-dimensional projections", SIAM J. Sci. Comput. 30
/// (2008); their file new-joe-kuo-6.
const DIRECTIONS: [(u32, u32, &[u32]); 15] = [
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
    (5, 4, &[1, 1, 5, 5, 5]),
    (5, 7, &[1, 1, 7, 11, 19]),
    (5, 11, &[1, 1, 5, 1, 1]),
    (5, 13, &[1, 1, 1, 3, 11]),
    (5, 14, &[1, 3, 5, 5, 31]),
    (6, 1, &[1, 3, 3, 9, 7, 49]),
    (6, 13, &[1, 1, 1, 15, 21, 21]),
    (6, 16, &[1, 3, 1, 13, 27, 49]),
];

/// Factors of one campaign at the most that Sobol's sequence covers.
pub const SOBOL_DIMENSIONS: usize = DIRECTIONS.len() + 1;
/// Flights at the most: the sequence has no more points of 32 bits.
pub const SOBOL_FLIGHTS: u64 = 1 << 32;

const POINTS: f64 = SOBOL_FLIGHTS as f64;

/// Bits of a point in a dimension of Sobol's sequence.
fn sobol_bits(dimension: usize, flight: u64) -> u32 {
    let gray = flight ^ (flight >> 1);
    let mut directions = [0_u32; 32];
    let place = dimension.checked_sub(1);
    match place.and_then(|place| DIRECTIONS.get(place)) {
        None => (0..32).for_each(|i| directions[i] = 1 << (31 - i)),
        Some((degree, polynomial, first)) => {
            let degree = *degree as usize;
            for i in 0..32 {
                directions[i] = if i < degree {
                    first[i] << (31 - i)
                } else {
                    let own = directions[i - degree];
                    let taken = (1..degree).filter(|k| polynomial >> (degree - 1 - k) & 1 == 1);
                    taken.fold(own ^ (own >> degree), |sum, k| sum ^ directions[i - k])
                };
            }
        }
    }
    (0..32)
        .filter(|i| gray >> i & 1 == 1)
        .fold(0, |bits, i| bits ^ directions[i])
}

/// A number above 0 and below 1: Sobol's point of a flight in a dimension, shifted by the factor's own random bits.
pub fn sobol(stream: Stream, dimension: usize, flight: u64) -> f64 {
    let shift = stream.words(0, 0)[0] as u32;
    (f64::from(sobol_bits(dimension, flight) ^ shift) + 0.5) / POINTS
}

/// A number from 0 to below 1: of `flights` flights, each has a stratum of its own.
pub fn latin(stream: Stream, flights: u64, flight: u64) -> f64 {
    let stratum = permuted(stream, flights, flight % flights);
    // The last of many strata may round up to 1.
    ((stratum as f64 + stream.units(flight, 0)[0]) / flights as f64).min(1.0_f64.next_down())
}

/// Where a permutation of 0 to `count` - 1 leads to: a Feistel network over a power of four, walked until inside.
fn permuted(stream: Stream, count: u64, number: u64) -> u64 {
    const ROUNDS: u32 = 6;
    let half = (64 - (count - 1).leading_zeros()).div_ceil(2).max(1);
    let mask = (1_u64 << half) - 1;
    let mut number = number;
    loop {
        let (mut left, mut right) = (number >> half, number & mask);
        for round in 1..=ROUNDS {
            (left, right) = (right, left ^ stream.words(right, round)[1] & mask);
        }
        number = left << half | right;
        if number < count {
            return number;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sobols_points_are_those_of_joe_and_kuo() {
        // scipy.stats.qmc.Sobol(16, scramble=False).random(8192)[5003] * 8192, and its first points in two dimensions.
        let point: Vec<u32> = (0..SOBOL_DIMENSIONS)
            .map(|dimension| sobol_bits(dimension, 5003) >> 19)
            .collect();
        let theirs = [
            3659, 4183, 7911, 5427, 5631, 6039, 789, 7503, 1407, 6061, 883, 6759, 3751, 6059, 8171,
            2299,
        ];
        assert_eq!(point, theirs);
        let first = |dimension| {
            [0, 1, 2, 3, 4, 5].map(|flight| f64::from(sobol_bits(dimension, flight)) / POINTS)
        };
        assert_eq!(first(0), [0.0, 0.5, 0.75, 0.25, 0.375, 0.875]);
        assert_eq!(first(2), [0.0, 0.5, 0.25, 0.75, 0.625, 0.125]);
    }

    #[test]
    fn a_latin_hypercube_has_one_flight_in_each_stratum() {
        for count in [1, 2, 3, 7, 64, 1000, 4097] {
            let stream = Stream::new(7, "x");
            let mut strata: Vec<u64> = (0..count)
                .map(|flight| (latin(stream, count, flight) * count as f64) as u64)
                .collect();
            let is_shuffled = count < 7 || strata.windows(2).any(|pair| pair[0] > pair[1]);
            strata.sort_unstable();
            assert!(is_shuffled && strata == Vec::from_iter(0..count), "{count}");
        }
    }
}
