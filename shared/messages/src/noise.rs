//! Random numbers as functions of (seed, tick, stream): nothing is drawn, and nothing shifts.
//!
//! The generator is counter-based and pure: it has no state, so a sample does not depend on earlier draws, and a skipped
//! tick shifts nothing. Splitmix64's finalizer makes the bits (Steele, Lea, Flood, "Fast splittable pseudorandom number
//! generators", 2014); Box-Muller makes the normal variate.

use std::f64::consts::TAU;

use crate::math::{cos, ln};

/// 2^64 divided by the golden ratio: the increment of splitmix64.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// 2^-53: the spacing of uniform numbers made of 53 bits.
const ULP: f64 = 1.0 / 9_007_199_254_740_992.0;

/// Finalizer of splitmix64: a bijection that spreads every input bit over the whole word.
const fn mixed(word: u64) -> u64 {
    let word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}

/// The word of a draw of a stream at a tick, in the flight of `seed`.
const fn word(seed: u64, tick: u64, stream: u64, draw: u64) -> u64 {
    let of_tick = mixed(mixed(seed.wrapping_add(GOLDEN)) ^ tick);
    mixed(of_tick.wrapping_add(GOLDEN.wrapping_mul(stream.wrapping_mul(2).wrapping_add(draw))))
}

pub fn standard_normal(seed: u64, tick: u64, stream: u64) -> f64 {
    // The radius needs a number in (0, 1], the angle one in [0, 1).
    let radius = ln(((word(seed, tick, stream, 1) >> 11) + 1) as f64 * ULP);
    let angle = (word(seed, tick, stream, 2) >> 11) as f64 * ULP;
    (-2.0 * radius).sqrt() * cos(TAU * angle)
}

/// A number in [0, 1), each as likely.
pub fn uniform(seed: u64, tick: u64, stream: u64) -> f64 {
    (word(seed, tick, stream, 1) >> 11) as f64 * ULP
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_uniform_numbers_is_below_it() {
        const TICKS: u64 = 100_000;
        for (seed, stream) in [(0, 0), (7, 1000), (u64::MAX, 3)] {
            let below = (0..TICKS)
                .filter(|tick| uniform(seed, *tick, stream) < 0.1)
                .count();
            // Ten thousand, with a standard deviation of 95.
            assert!(
                (9_500..10_500).contains(&below),
                "seed {seed}, stream {stream}: {below}"
            );
        }
    }
}
