//! Fingerprints of message layouts, so that processes of different builds refuse each other.
//!
//! iceoryx2 compares a type's name, size and alignment. Two structs of one name and size with swapped fields
//! would connect silently; a hash over every field's name, offset and size does not let them.

/// A field of a wire struct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name; nested structs join theirs with a dot.
    pub name: &'static str,
    /// Offset from the start of the struct [bytes].
    pub offset: usize,
    /// Size [bytes].
    pub size: usize,
}

/// A struct with a fixed layout, known field by field.
pub trait Layout {
    /// Its fields, in order and without a gap.
    const FIELDS: &'static [Field];
    /// Hash over [`Self::FIELDS`].
    const FINGERPRINT: u64 = fingerprint(Self::FIELDS);
}

/// FNV-1a over names, offsets and sizes.
#[must_use]
pub const fn fingerprint(fields: &[Field]) -> u64 {
    let mut hash = FNV_OFFSET;
    let mut i = 0;
    while i < fields.len() {
        hash = fnv1a(hash, fields[i].name.as_bytes());
        hash = fnv1a(hash, &fields[i].offset.to_le_bytes());
        hash = fnv1a(hash, &fields[i].size.to_le_bytes());
        i += 1;
    }
    hash
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

/// Describes a wire struct: every field must be listed, in order; padding does not compile.
macro_rules! layout {
    ($name:ident { $($field:ident),+ $(,)? }) => {
        impl $crate::layout::Layout for $name {
            const FIELDS: &'static [$crate::layout::Field] = {
                const fn size_of_field<T>(_: fn(&$name) -> &T) -> usize {
                    size_of::<T>()
                }
                &[$($crate::layout::Field {
                    name: stringify!($field),
                    offset: std::mem::offset_of!($name, $field),
                    size: size_of_field(|message| &message.$field),
                }),+]
            };
        }
        const _: () = {
            assert!(
                $crate::layout::is_dense(<$name as $crate::layout::Layout>::FIELDS, size_of::<$name>()),
                concat!(stringify!($name), " has padding, or a field is missing from its layout")
            );
        };
    };
}
pub(crate) use layout;

/// Gives an enum of the wire its way back from a number: flags travel as integers, because a forged enum
/// would be undefined behaviour.
macro_rules! from_wire {
    ($type:ident { $($variant:ident),+ $(,)? }) => {
        impl $type {
            /// The variant of a number on the wire, if there is one.
            #[must_use]
            pub const fn from_wire(number: u64) -> Option<Self> {
                $(if number == Self::$variant as u64 { return Some(Self::$variant); })+
                None
            }
        }
    };
}
pub(crate) use from_wire;

#[cfg(test)]
mod tests {
    use super::*;

    const A: Field = Field { name: "a", offset: 0, size: 8 };
    const B: Field = Field { name: "b", offset: 8, size: 8 };

    #[test]
    fn swapped_renamed_or_resized_fields_change_the_fingerprint() {
        let known = fingerprint(&[A, B]);
        let swapped = [Field { offset: 0, ..B }, Field { offset: 8, ..A }];
        let renamed = [A, Field { name: "c", ..B }];
        let resized = [A, Field { size: 4, ..B }];
        for other in [swapped, renamed, resized] {
            assert_ne!(fingerprint(&other), known);
        }
    }

    #[test]
    fn gaps_are_seen() {
        assert!(is_dense(&[A, B], 16));
        assert!(!is_dense(&[A, B], 24));
        assert!(!is_dense(&[A, Field { offset: 12, ..B }], 20));
    }
}
