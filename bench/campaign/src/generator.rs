//! Philox4x32-10: random bits of a key and a counter, without a state.
//!
//! Salmon, Moraes, Dror, Shaw, "Parallel Random Numbers: As Easy as 1, 2, 3" (SC 2011), figure 2 and table 2. The draws
//! of a flight follow from its number, so that a campaign can be cut into shards anywhere, and flown twice.

use sha2::{Digest as _, Sha256};

const MULTIPLIERS: [u32; 2] = [0xd251_1f53, 0xcd9e_8d57];
const WEYL: [u32; 2] = [0x9e37_79b9, 0xbb67_ae85];
const ROUNDS: usize = 10;

pub fn philox(key: [u32; 2], counter: [u32; 4]) -> [u32; 4] {
    let (mut key, mut bits) = (key, counter);
    for _ in 0..ROUNDS {
        let [(high_0, low_0), (high_1, low_1)] =
            [(0, 0), (1, 2)].map(|(i, word): (usize, usize)| {
                let product = u64::from(MULTIPLIERS[i]) * u64::from(bits[word]);
                ((product >> 32) as u32, product as u32)
            });
        bits = [
            high_1 ^ bits[1] ^ key[0],
            low_1,
            high_0 ^ bits[3] ^ key[1],
            low_0,
        ];
        key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
    }
    bits
}

/// The draws of one factor: by flight, and by attempt where a flight needs more than one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    key: [u32; 2],
}

impl Stream {
    /// Of a campaign's seed and a factor's name: other factors can come and go, and these draws stay.
    pub fn new(seed: u64, factor: &str) -> Self {
        let sum = Sha256::new()
            .chain_update(seed.to_le_bytes())
            .chain_update(factor)
            .finalize();
        let word = |i: usize| u32::from_le_bytes([sum[i], sum[i + 1], sum[i + 2], sum[i + 3]]);
        Self {
            key: [word(0), word(4)],
        }
    }

    pub fn words(self, flight: u64, attempt: u32) -> [u64; 2] {
        let [a, b, c, d] = philox(self.key, [flight as u32, (flight >> 32) as u32, attempt, 0]);
        [
            u64::from(a) | u64::from(b) << 32,
            u64::from(c) | u64::from(d) << 32,
        ]
    }

    /// Two numbers from 0 to below 1, in steps of 2^-53.
    pub fn units(self, flight: u64, attempt: u32) -> [f64; 2] {
        self.words(flight, attempt)
            .map(|word| (word >> 11) as f64 * (1.0 / (1_u64 << 53) as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bits_are_those_of_the_authors() {
        for (key, counter, bits) in [
            (
                [0; 2],
                [0; 4],
                [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8],
            ),
            (
                [u32::MAX; 2],
                [u32::MAX; 4],
                [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd],
            ),
            (
                [0xa409_3822, 0x299f_31d0],
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ] {
            assert_eq!(philox(key, counter), bits, "key {key:x?}");
        }
    }
}
