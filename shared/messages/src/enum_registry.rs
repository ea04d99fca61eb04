//! The fingerprint of a message: its layout, and what the numbers in it stand for.
//!
//! Every layout's fingerprint carries the hash. Parameters and flags travel as numbers. Two builds that number them
//! differently would otherwise connect and swap the wrong parameter; with the words in the fingerprint they do not.

use crate::blackboards::{EndReason, RolePhase, RunPhase};
use crate::content::Mode;
use crate::fault_kinds::{FaultId, FaultRefusal};
use crate::layout::{Layout, fingerprint, fnv1a, hash_of};
use crate::monitor::Cause;
use crate::parameters::SPECS;
use crate::realtime::RealtimeStep;
use crate::rejections::Reason;

const ENUMS: [u64; 9] = [
    RunPhase::ENUM_HASH,
    RolePhase::ENUM_HASH,
    EndReason::ENUM_HASH,
    Mode::ENUM_HASH,
    Cause::ENUM_HASH,
    Reason::ENUM_HASH,
    RealtimeStep::ENUM_HASH,
    FaultId::ENUM_HASH,
    FaultRefusal::ENUM_HASH,
];

/// Hash over what numbers on the wire stand for: a parameter's place in the table, the variants of enums.
pub const VOCABULARY: u64 = {
    let mut hash = hash_of(&ENUMS);
    let mut i = 0;
    while i < SPECS.len() {
        hash = fnv1a(hash, SPECS[i].name.as_bytes());
        i += 1;
    }
    hash
};

pub trait Fingerprint: Layout {
    /// Hash over [`Layout::FIELDS`] and over the variants that numbers in them stand for.
    const FINGERPRINT: u64 = fnv1a(fingerprint(Self::FIELDS), &VOCABULARY.to_le_bytes());
}

impl<T: Layout> Fingerprint for T {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_builds_that_number_faults_or_refusals_differently_do_not_connect() {
        assert!(ENUMS.contains(&FaultId::ENUM_HASH) && ENUMS.contains(&FaultRefusal::ENUM_HASH));
    }

    #[test]
    fn variants_in_another_order_change_the_hash() {
        #[allow(dead_code, reason = "known by its hash alone")]
        mod here {
            crate::layout::wire_enum! {
                pub enum Step {
                    Affinity = 0,
                    Scheduler = 1,
                }
            }
        }
        #[allow(dead_code, reason = "known by its hash alone")]
        mod there {
            crate::layout::wire_enum! {
                pub enum Step {
                    Scheduler = 0,
                    Affinity = 1,
                }
            }
        }
        assert_ne!(here::Step::ENUM_HASH, there::Step::ENUM_HASH);
    }
}
