//! The check word of what travels through shared memory: whatever changes on the way is noticed.
//!
//! It finds damage. It proves nothing of who wrote a message: anybody can compute it.

/// Sums that are kept side by side: a product takes the processor longer than until it can begin the next one.
const LANES: usize = 4;

/// Odd, so that multiplying by it loses nothing: the golden ratio.
const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;

/// A word over all words, in their order.
///
/// Each step is one-to-one in the word that it takes in, and in the sum so far. Two messages that differ in one word,
/// in one bit of it or in all, therefore never have the same check word. Of those that differ in more words, one in
/// 2^64 or so does.
#[inline]
pub fn check_word(words: &[u64]) -> u64 {
    let mut sums = [1, 2, 3, 4];
    let mut rows = words.chunks_exact(LANES);
    for row in &mut rows {
        for (sum, word) in sums.iter_mut().zip(row) {
            *sum = step(*sum, *word);
        }
    }
    let rest = rows
        .remainder()
        .iter()
        .fold(words.len() as u64, |sum, word| step(sum, *word));
    sums.into_iter().fold(rest, step)
}

const fn step(sum: u64, word: u64) -> u64 {
    let product = (sum ^ word).wrapping_mul(FACTOR);
    // Brings what is above down: without it, a difference in the highest bit would stay alone, and a second one undo it.
    product ^ (product >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words that look like messages: numbers, small counts, zeros.
    fn words(length: usize, seed: u64) -> Vec<u64> {
        (0..length as u64)
            .map(|i| match (i + seed) % 3 {
                0 => ((i * seed) as f64 * 0.37 - 40.0).to_bits(),
                1 => i * seed,
                _ => 0,
            })
            .collect()
    }

    #[test]
    fn every_pair_of_flipped_bits_is_noticed() {
        let words = words(20, 3);
        let check = check_word(&words);
        for one in 0..20 * 64 {
            for other in 0..one {
                let mut changed = words.clone();
                changed[one / 64] ^= 1 << (one % 64);
                changed[other / 64] ^= 1 << (other % 64);
                assert_ne!(check_word(&changed), check, "bits {one} and {other}");
            }
        }
    }

    #[test]
    fn words_that_change_places_or_are_missing_are_noticed() {
        let right = words(37, 5);
        let check = check_word(&right);
        for one in 0..right.len() {
            for other in 0..one {
                let mut changed = right.clone();
                changed.swap(one, other);
                let is_seen = changed == right || check_word(&changed) != check;
                assert!(is_seen, "words {one} and {other}");
            }
            assert_ne!(check_word(&right[..one]), check);
        }
        assert_ne!(check_word(&[0; 36]), check_word(&[0; 37]), "zeros count");
        // Memory that was never written is no message.
        assert_ne!(check_word(&[0; 100]), 0);
    }
}
