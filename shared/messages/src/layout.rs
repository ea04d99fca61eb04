//! Layouts of the wire's structs, field by field: fingerprints and field walks.
//!
//! iceoryx2 compares only the name, size and alignment of a type. Two structs with the same name and size but swapped
//! fields would connect silently. A hash over every field's name, offset, size and kind prevents that
//! ([`crate::enum_registry::Fingerprint`]).
//!
//! Code that writes, reads or shows any message walks over its fields with a [`Visitor`].
//!
//! What has a layout may lie in shared memory: [`Plain`] promises it, and [`layout!`] checks it.

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    U8,
    I64,
    U64,
    F64,
    Struct {
        name: &'static str,
        fields: &'static [Field],
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    pub name: &'static str,
    /// Offset from the start of the struct [bytes].
    pub offset: usize,
    /// Size [bytes].
    pub size: usize,
    pub kind: Kind,
    /// How many there are, where it is an array.
    pub length: Option<usize>,
}

/// What consists of numbers alone. It may lie in memory that other processes read and write.
///
/// # Safety
/// No pointer, no handle, nothing to drop, and every bit pattern is a value. [`layout!`] sees to that for a struct, and
/// is the way to implement this.
#[allow(
    unsafe_code,
    reason = "a promise that the wire relies on; it is kept by the compiler's checks in `layout!`"
)]
pub unsafe trait Plain: Copy + 'static {}

macro_rules! plain {
    ($($number:ident),+) => {
        $(#[allow(unsafe_code, reason = "see the trait")]
        // SAFETY: a number.
        unsafe impl Plain for $number {})+
    };
}
plain!(u8, i64, u64, f64);

#[allow(unsafe_code, reason = "see the trait")]
// SAFETY: it consists of what its elements consist of.
unsafe impl<T: Plain, const N: usize> Plain for [T; N] {}

/// A value whose bits are all 0.
#[allow(unsafe_code, reason = "an array of any length has no `Default`")]
pub const fn zeroed<T: Plain>() -> T {
    // SAFETY: of what is `Plain`, every bit pattern is a value.
    unsafe { std::mem::zeroed() }
}

/// A struct with a fixed layout, known field by field.
pub trait Layout: Plain {
    /// Its fields, in order and without a gap.
    const FIELDS: &'static [Field];
}

/// The words that a struct of numbers consists of.
#[inline]
#[allow(
    unsafe_code,
    reason = "there is no other way to see a struct as its words"
)]
pub fn words<T: Layout>(value: &T) -> &[u64] {
    const {
        assert!(
            align_of::<T>() == align_of::<u64>() && size_of::<T>().is_multiple_of(size_of::<u64>())
        );
        assert!(is_dense(T::FIELDS, size_of::<T>()));
    }
    // SAFETY: it is as long, aligned, and without padding, as has just been checked of it, and as `layout!` has checked
    // of each struct in it; what is `Plain` may be read as any number.
    unsafe {
        std::slice::from_raw_parts(
            std::ptr::from_ref(value).cast(),
            size_of::<T>() / size_of::<u64>(),
        )
    }
}

/// A struct whose fields can be walked over.
pub trait Visit: Layout {
    const STRUCT: &'static str;

    fn visit<V: Visitor>(&self, visitor: &mut V);

    fn visit_mut<V: VisitorMut>(&mut self, visitor: &mut V);

    /// Whether every bit of every field is the same: `==` takes two zeros for one, and no number for another.
    #[inline]
    fn is_same(&self, other: &Self) -> bool {
        words(self) == words(other)
    }
}

/// What is shown the fields of a struct: an array whole, a single value as an array of one.
///
/// Bytes and signed numbers stand on notice blackboards alone, in no message; who walks over messages need not care.
pub trait Visitor: Sized {
    fn integers(&mut self, field: &'static Field, values: &[u64]);
    fn numbers(&mut self, field: &'static Field, values: &[f64]);
    fn structs<L: Visit>(&mut self, _: &'static Field, values: &[L]) {
        values.iter().for_each(|value| value.visit(self));
    }
}

/// What is lent the fields of a struct, to fill them in.
pub trait VisitorMut: Sized {
    fn integers(&mut self, field: &'static Field, values: &mut [u64]);
    fn numbers(&mut self, field: &'static Field, values: &mut [f64]);
    fn structs<L: Visit>(&mut self, _: &'static Field, values: &mut [L]) {
        values.iter_mut().for_each(|value| value.visit_mut(self));
    }
}

/// Replaces each word of a struct by what `change` makes of it and its field: whole numbers, and the bits of the others.
/// Only tests do so.
pub fn change_words<T: Visit>(value: &mut T, change: impl FnMut(&'static Field, u64) -> u64) {
    struct Change<F>(F);
    impl<F: FnMut(&'static Field, u64) -> u64> VisitorMut for Change<F> {
        fn integers(&mut self, field: &'static Field, values: &mut [u64]) {
            values.iter_mut().for_each(|it| *it = (self.0)(field, *it));
        }
        fn numbers(&mut self, field: &'static Field, values: &mut [f64]) {
            let change = |it: &mut f64| *it = f64::from_bits((self.0)(field, it.to_bits()));
            values.iter_mut().for_each(change);
        }
    }
    value.visit_mut(&mut Change(change));
}

/// A type of which there may be several in a field.
pub trait Element: Plain {
    const KIND: Kind;

    fn visit_all<V: Visitor>(elements: &[Self], field: &'static Field, visitor: &mut V);

    fn visit_all_mut<V: VisitorMut>(elements: &mut [Self], field: &'static Field, visitor: &mut V);
}

/// The type of a field: an element, or an array of them.
pub trait FieldType: Plain {
    type Item: Element;
    /// How many there are, where it is an array.
    const LENGTH: Option<usize>;

    fn items(&self) -> &[Self::Item];

    fn items_mut(&mut self) -> &mut [Self::Item];
}

impl<T: Element, const N: usize> FieldType for [T; N] {
    type Item = T;
    const LENGTH: Option<usize> = Some(N);

    #[inline]
    fn items(&self) -> &[T] {
        self
    }

    #[inline]
    fn items_mut(&mut self) -> &mut [T] {
        self
    }
}

/// Makes a type an [`Element`], and with it the type of a field.
#[macro_export]
#[doc(hidden)]
macro_rules! element {
    (
        $type:ty,
        $kind:expr,
        ($field:ident, $visitor:ident, $elements:ident) => $visit:block
    ) => {
        impl $crate::layout::Element for $type {
            const KIND: $crate::layout::Kind = $kind;

            #[inline(always)]
            fn visit_all<V: $crate::layout::Visitor>(
                $elements: &[Self],
                $field: &'static $crate::layout::Field,
                $visitor: &mut V,
            ) {
                $visit
            }

            #[inline(always)]
            fn visit_all_mut<V: $crate::layout::VisitorMut>(
                $elements: &mut [Self],
                $field: &'static $crate::layout::Field,
                $visitor: &mut V,
            ) {
                $visit
            }
        }

        impl $crate::layout::FieldType for $type {
            type Item = Self;
            const LENGTH: Option<usize> = None;

            #[inline]
            fn items(&self) -> &[Self] {
                std::slice::from_ref(self)
            }

            #[inline]
            fn items_mut(&mut self) -> &mut [Self] {
                std::slice::from_mut(self)
            }
        }
    };
}
pub use element;

element!(u64, Kind::U64, (field, visitor, elements) => { visitor.integers(field, elements); });
element!(f64, Kind::F64, (field, visitor, elements) => { visitor.numbers(field, elements); });
element!(u8, Kind::U8, (_field, _visitor, _elements) => {});
element!(i64, Kind::I64, (_field, _visitor, _elements) => {});

/// Declares a wire struct, which is `repr(C)`, or describes one that is declared elsewhere: every field listed, in order,
/// each a number or made of numbers. `pub struct Name as "Logged"` is called `Logged` in logs.
///
/// ```
/// # use messages::layout::layout;
/// layout! {
///     #[derive(Clone, Copy)]
///     pub struct Pose {
///         pub north_m: u64,
///         pub east_m: u64,
///     }
/// }
/// ```
///
/// What is not laid out like that does not compile: a struct without `repr(C)`,
///
/// ```compile_fail
/// # use messages::layout::layout;
/// #[derive(Clone, Copy)]
/// struct Pose {
///     north_m: u64,
///     east_m: u64,
/// }
/// layout!(Pose { north_m, east_m });
/// ```
///
/// one with padding, or with a field that is not listed,
///
/// ```compile_fail
/// # use messages::layout::layout;
/// #[derive(Clone, Copy)]
/// #[repr(C)]
/// struct Pose {
///     north_m: u64,
///     mode: u8,
/// }
/// layout!(Pose { north_m, mode });
/// ```
///
/// or one with a pointer.
///
/// ```compile_fail
/// # use messages::layout::layout;
/// #[derive(Clone, Copy)]
/// #[repr(C)]
/// struct Pose {
///     north_m: &'static u64,
/// }
/// layout!(Pose { north_m });
/// ```
#[macro_export]
macro_rules! layout {
    ($(#[$meta:meta])* pub struct $name:ident $(as $logged:literal)? {
        $($(#[$doc:meta])* $vis:vis $field:ident: $type:ty),+ $(,)?
    }) => {
        $(#[$meta])*
        #[repr(C)]
        pub struct $name {
            $($(#[$doc])* $vis $field: $type),+
        }
        $crate::layout!(@name $name $(as $logged)?, { $($field),+ });
    };
    (@name $name:tt as $logged:literal, $fields:tt) => {
        $crate::layout!($name as $logged, $fields);
    };
    (@name $name:tt, $fields:tt) => {
        $crate::layout!($name as stringify!($name), $fields);
    };
    ($name:tt { $($field:ident),+ $(,)? }) => {
        $crate::layout!($name as stringify!($name), { $($field),+ });
    };
    // As a token tree the name keeps its place in the source: a lint that speaks of another crate's macro is not heard.
    // `$logged` is what logs call the struct.
    ($name:tt as $logged:expr, { $($field:ident),+ $(,)? }) => {
        #[allow(unsafe_code, reason = "what it promises is checked below")]
        // SAFETY: the fields are all there are, and each is `Plain`, as `FieldType` demands.
        unsafe impl $crate::layout::Plain for $name {}

        impl $crate::layout::Layout for $name {
            const FIELDS: &'static [$crate::layout::Field] = {
                const fn describe<T: $crate::layout::FieldType>(
                    name: &'static str,
                    offset: usize,
                    _: fn(&$name) -> &T,
                ) -> $crate::layout::Field {
                    $crate::layout::Field { name, offset, size: size_of::<T>(), kind: <T::Item as $crate::layout::Element>::KIND, length: T::LENGTH }
                }
                &[$(describe(stringify!($field), std::mem::offset_of!($name, $field), |message| &message.$field)),+]
            };
        }

        impl $crate::layout::Visit for $name {
            const STRUCT: &'static str = $logged;

            #[inline(always)]
            fn visit<V: $crate::layout::Visitor>(&self, visitor: &mut V) {
                let mut fields = <Self as $crate::layout::Layout>::FIELDS.iter();
                $(if let Some(field) = fields.next() {
                    $crate::layout::Element::visit_all($crate::layout::FieldType::items(&self.$field), field, visitor);
                })+
            }

            #[inline(always)]
            fn visit_mut<V: $crate::layout::VisitorMut>(&mut self, visitor: &mut V) {
                let mut fields = <Self as $crate::layout::Layout>::FIELDS.iter();
                $(if let Some(field) = fields.next() {
                    $crate::layout::Element::visit_all_mut($crate::layout::FieldType::items_mut(&mut self.$field), field, visitor);
                })+
            }
        }
        $crate::layout::element!(
            $name,
            $crate::layout::Kind::Struct {
                name: $logged,
                fields: <$name as $crate::layout::Layout>::FIELDS,
            },
            (field, visitor, elements) => { visitor.structs(field, elements); }
        );
        const _: () = {
            assert!(
                $crate::layout::is_dense(<$name as $crate::layout::Layout>::FIELDS, size_of::<$name>()),
                concat!(stringify!($name), " has padding, or a field is missing from its layout")
            );
            // Nothing else says of a struct that it is `repr(C)`: the lint of functions that C may call does.
            #[deny(improper_ctypes_definitions)]
            #[allow(dead_code)]
            extern "C" fn is_repr_c(_: $name) {}
        };
    };
}
pub use layout;

/// Declares an enum whose numbers are sent: its variants with their numbers, and names where it has them. Flags travel as
/// integers, because a forged enum would be undefined behaviour. Derives `Clone`, `Copy`, `Debug`, `PartialEq`, `Eq`.
#[macro_export]
macro_rules! wire_enum {
    ($(#[$meta:meta])* pub enum $type:ident {
        $($(#[$doc:meta])* $variant:ident = $number:literal $(=> $name:literal)?),+ $(,)?
    }) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u64)]
        $(#[$meta])*
        pub enum $type {
            $($(#[$doc])* $variant = $number),+
        }

        impl $type {
            pub const ALL: [Self; [$($number),+].len()] = [$(Self::$variant),+];

            /// Hash over its variants and their numbers: two builds that number them differently do not connect.
            pub const ENUM_HASH: u64 = {
                let mut hash = $crate::layout::FNV_OFFSET;
                $(
                    hash = $crate::layout::fnv1a(hash, stringify!($variant).as_bytes());
                    hash = $crate::layout::fnv1a(hash, &(Self::$variant as u64).to_le_bytes());
                )+
                hash
            };

            /// The variant of a number on the wire, if there is one.
            pub const fn from_wire(number: u64) -> Option<Self> {
                $(if number == Self::$variant as u64 { return Some(Self::$variant); })+
                None
            }
        }
        $crate::layout::wire_enum!(@names $type { $($variant $(=> $name)?),+ });
    };
    (@names $type:ident { $($variant:ident => $name:literal),+ }) => {
        impl $type {
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name),+
                }
            }
        }

        impl ::std::fmt::Display for $type {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
    (@names $type:ident { $($variant:ident),+ }) => {};
}
pub use wire_enum;

/// FNV-1a over names, offsets, sizes and kinds; of a struct within, over its fields likewise.
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
pub const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}

/// FNV-1a over hashes.
pub const fn hash_of(hashes: &[u64]) -> u64 {
    let (mut hash, mut i) = (FNV_OFFSET, 0);
    while i < hashes.len() {
        hash = fnv1a(hash, &hashes[i].to_le_bytes());
        i += 1;
    }
    hash
}

/// Whether the fields follow each other without padding and fill the struct.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::State;

    const A: Field = Field {
        name: "a",
        offset: 0,
        size: 8,
        kind: Kind::U64,
        length: None,
    };
    const B: Field = Field {
        name: "b",
        offset: 8,
        ..A
    };

    #[test]
    fn swapped_renamed_or_resized_fields_change_the_fingerprint() {
        let known = fingerprint(&[A, B]);
        let swapped = [Field { offset: 0, ..B }, Field { offset: 8, ..A }];
        let renamed = [A, Field { name: "c", ..B }];
        let resized = [A, Field { size: 4, ..B }];
        let kind = Kind::F64;
        let number = [A, Field { kind, ..B }];
        for other in [swapped, renamed, resized, number] {
            assert_ne!(fingerprint(&other), known);
        }
    }

    #[test]
    fn a_struct_within_is_known_by_its_fields_and_not_by_its_name_alone() {
        let holder = |fields| {
            let name = "Grants";
            let kind = Kind::Struct { name, fields };
            fingerprint(&[Field { kind, ..A }])
        };
        const SWAPPED: [Field; 2] = [Field { offset: 0, ..B }, Field { offset: 8, ..A }];
        assert_ne!(holder(&[A, B]), holder(&SWAPPED));
    }

    #[test]
    fn gaps_are_seen() {
        assert!(is_dense(&[A, B], 16));
        assert!(!is_dense(&[A, B], 24));
        assert!(!is_dense(&[A, Field { offset: 12, ..B }], 20));
    }

    #[test]
    fn what_differs_in_one_bit_is_not_the_same() {
        let mut state = State::default();
        assert!(state.is_same(&state));
        for place in 0..size_of::<State>() / size_of::<u64>() {
            let (mut other, mut places) = (state, 0..);
            // The highest bit, or the sign: zeros of either sign are equal.
            change_words(&mut other, |_, word| {
                word ^ (u64::from(places.next() == Some(place)) << 63)
            });
            assert!(!state.is_same(&other), "word {place}");
        }
        state.truth.parameter[1] = f64::NAN;
        assert!(state.is_same(&state), "no number is the same as itself");
    }
}
