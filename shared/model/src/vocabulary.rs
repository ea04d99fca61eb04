//! What numbers on the wire stand for: a hash over the words.
//!
//! Every layout's fingerprint carries the hash. Parameters and flags travel as numbers. Two builds that number them
//! differently would otherwise connect and swap the wrong parameter; with the words in the fingerprint they do not.

use crate::boards::{Ending, RolePhase, RunPhase};
use crate::fault::{self, NotTaken};
use crate::inspection::Reason;
use crate::layout::{FNV_OFFSET, fnv1a};
use crate::messages::Mode;
use crate::monitor::Cause;
use crate::parameters::SPECS;
use crate::realtime::RealtimeStep;

/// Gives an enum whose numbers stand on the wire a hash over its words and their numbers.
#[doc(hidden)]
#[macro_export]
macro_rules! words {
    ($type:ident { $($variant:ident),+ $(,)? }) => {
        impl $type {
            /// Hash over its words and their numbers: of two builds that count differently, neither believes the other.
            pub const WORDS: u64 = {
                let mut hash = $crate::layout::FNV_OFFSET;
                $(
                    hash = $crate::layout::fnv1a(hash, stringify!($variant).as_bytes());
                    hash = $crate::layout::fnv1a(hash, &(Self::$variant as u64).to_le_bytes());
                )+
                hash
            };
        }
    };
}
pub use words;

/// Hash over what numbers on the wire stand for: a parameter's place in the table, the variants of enums.
pub const VOCABULARY: u64 = {
    let enums = [
        RunPhase::WORDS,
        RolePhase::WORDS,
        Ending::WORDS,
        Mode::WORDS,
        Cause::WORDS,
        Reason::WORDS,
        RealtimeStep::WORDS,
        fault::live::WORDS,
        NotTaken::WORDS,
    ];
    let mut hash = FNV_OFFSET;
    let mut i = 0;
    while i < enums.len() {
        hash = fnv1a(hash, &enums[i].to_le_bytes());
        i += 1;
    }
    let mut i = 0;
    while i < SPECS.len() {
        hash = fnv1a(hash, SPECS[i].name.as_bytes());
        i += 1;
    }
    hash
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::envelope::Envelope;
    use crate::layout::{Layout as _, fingerprint};

    #[test]
    fn words_in_another_order_change_every_fingerprint() {
        mod here {
            #[allow(dead_code, reason = "known by its words alone")]
            pub(super) enum Step {
                Affinity,
                Scheduler,
            }
            crate::words!(Step { Affinity, Scheduler });
        }
        mod there {
            #[allow(dead_code, reason = "known by its words alone")]
            pub(super) enum Step {
                Scheduler,
                Affinity,
            }
            crate::words!(Step { Scheduler, Affinity });
        }
        assert_ne!(here::Step::WORDS, there::Step::WORDS);
        assert_eq!(Envelope::FINGERPRINT, fnv1a(fingerprint(Envelope::FIELDS), &VOCABULARY.to_le_bytes()));
    }
}
