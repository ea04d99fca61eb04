//! Fingerprints of layouts, and whether a layout has gaps.

use super::{Field, Kind};

/// FNV-1a over names, offsets, sizes and kinds; of a struct within, over its fields likewise.
#[must_use]
pub const fn fingerprint(fields: &[Field]) -> u64 {
    let mut hash = FNV_OFFSET;
    let mut i = 0;
    while i < fields.len() {
        hash = fnv1a(hash, fields[i].name.as_bytes());
        hash = fnv1a(hash, &fields[i].offset.to_le_bytes());
        hash = fnv1a(hash, &fields[i].size.to_le_bytes());
        hash = fnv1a(hash, fields[i].kind.word().as_bytes());
        if let Kind::Struct { fields: inner, .. } = fields[i].kind {
            hash = fnv1a(hash, &fingerprint(inner).to_le_bytes());
        }
        i += 1;
    }
    hash
}

impl Kind {
    /// A word that no other kind has; of a struct, its name.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I64 => "i64",
            Self::U64 => "u64",
            Self::F64 => "f64",
            Self::Struct { name, .. } => name,
        }
    }
}

/// Start value of [`fnv1a`].
pub const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;

/// Continues a 64-bit FNV-1a hash over more bytes.
#[must_use]
pub const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}

/// Whether the fields follow each other without padding and fill the struct.
#[must_use]
pub const fn is_dense(fields: &[Field], size: usize) -> bool {
    let mut end = 0;
    let mut i = 0;
    while i < fields.len() {
        if fields[i].offset != end {
            return false;
        }
        end += fields[i].size;
        i += 1;
    }
    end == size
}
