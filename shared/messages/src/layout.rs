//! Layouts of the wire's structs, field by field: fingerprints and field walks.
//!
//! iceoryx2 compares only the name, size and alignment of a type. Two structs with the same name and size but swapped
//! fields would connect silently. A hash over every field's name, offset, size and kind prevents that
//! ([`crate::enum_registry::Fingerprint`]).
//!
//! Code that writes, reads or shows any message walks over its fields with a [`Visitor`].
//!
//! What has a layout may lie in shared memory: [`Plain`] promises it, and [`layout!`] checks it.

mod fingerprint;

pub use fingerprint::{FNV_OFFSET, fingerprint, fnv1a, is_dense};

/// What a field is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    U8,
    /// A whole number with a sign.
    I64,
    U64,
    F64,
    Struct {
        name: &'static str,
        fields: &'static [Field],
    },
}

/// A field of a wire struct.
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

/// A struct with a fixed layout, known field by field.
pub trait Layout: Plain {
    /// Its fields, in order and without a gap.
    const FIELDS: &'static [Field];
}

/// The words that a struct of numbers consists of.
#[must_use]
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
    #[must_use]
    fn is_same(&self, other: &Self) -> bool;
}

/// What is shown the fields of a struct: an array whole, a single value as an array of one.
///
/// Bytes and signed numbers stand on notice boards alone, in no message; who walks over messages need not care.
pub trait Visitor {
    fn integers(&mut self, field: &'static Field, values: &[u64]);
    fn numbers(&mut self, field: &'static Field, values: &[f64]);
    fn structs<L: Visit>(&mut self, field: &'static Field, values: &[L]);
}

/// What is lent the fields of a struct, to fill them in.
pub trait VisitorMut {
    fn integers(&mut self, field: &'static Field, values: &mut [u64]);
    fn numbers(&mut self, field: &'static Field, values: &mut [f64]);
    fn structs<L: Visit>(&mut self, field: &'static Field, values: &mut [L]);
}

/// A type of which there may be several in a field.
pub trait Element: Plain {
    const KIND: Kind;

    fn show<V: Visitor>(elements: &[Self], field: &'static Field, visitor: &mut V);

    fn lend<V: VisitorMut>(elements: &mut [Self], field: &'static Field, visitor: &mut V);

    /// Whether every bit is the same.
    fn same_bits(&self, other: &Self) -> bool;
}

/// The type of a field: an element, or an array of them.
pub trait FieldType: Plain {
    const KIND: Kind;
    /// How many there are, where it is an array.
    const LENGTH: Option<usize>;

    fn show<V: Visitor>(&self, field: &'static Field, visitor: &mut V);

    fn lend<V: VisitorMut>(&mut self, field: &'static Field, visitor: &mut V);

    /// Whether every bit is the same.
    fn same_bits(&self, other: &Self) -> bool;
}

impl<T: Element, const N: usize> FieldType for [T; N] {
    const KIND: Kind = T::KIND;
    const LENGTH: Option<usize> = Some(N);

    fn show<V: Visitor>(&self, field: &'static Field, visitor: &mut V) {
        T::show(self, field, visitor);
    }

    fn lend<V: VisitorMut>(&mut self, field: &'static Field, visitor: &mut V) {
        T::lend(self, field, visitor);
    }

    #[inline]
    fn same_bits(&self, other: &Self) -> bool {
        self.iter()
            .zip(other)
            .all(|(this, other)| Element::same_bits(this, other))
    }
}

/// Makes a type an [`Element`], and with it the type of a field.
#[macro_export]
#[doc(hidden)]
macro_rules! element {
    (
        $type:ty,
        $kind:expr,
        ($field:ident, $visitor:ident, $elements:ident) => $visit:block,
        ($this:ident, $other:ident) => $same:expr
    ) => {
        impl $crate::layout::Element for $type {
            const KIND: $crate::layout::Kind = $kind;

            fn show<V: $crate::layout::Visitor>(
                $elements: &[Self],
                $field: &'static $crate::layout::Field,
                $visitor: &mut V,
            ) {
                $visit
            }

            fn lend<V: $crate::layout::VisitorMut>(
                $elements: &mut [Self],
                $field: &'static $crate::layout::Field,
                $visitor: &mut V,
            ) {
                $visit
            }

            #[inline]
            fn same_bits(&self, other: &Self) -> bool {
                let ($this, $other) = (self, other);
                $same
            }
        }

        impl $crate::layout::FieldType for $type {
            const KIND: $crate::layout::Kind = $kind;
            const LENGTH: Option<usize> = None;

            fn show<V: $crate::layout::Visitor>(
                &self,
                field: &'static $crate::layout::Field,
                visitor: &mut V,
            ) {
                <Self as $crate::layout::Element>::show(std::slice::from_ref(self), field, visitor);
            }

            fn lend<V: $crate::layout::VisitorMut>(
                &mut self,
                field: &'static $crate::layout::Field,
                visitor: &mut V,
            ) {
                <Self as $crate::layout::Element>::lend(std::slice::from_mut(self), field, visitor);
            }

            #[inline]
            fn same_bits(&self, other: &Self) -> bool {
                <Self as $crate::layout::Element>::same_bits(self, other)
            }
        }
    };
}
pub use element;

element!(u64, Kind::U64, (field, visitor, elements) => { visitor.integers(field, elements); }, (a, b) => a == b);
element!(
    f64,
    Kind::F64,
    (field, visitor, elements) => { visitor.numbers(field, elements); },
    (a, b) => a.to_bits() == b.to_bits()
);
element!(u8, Kind::U8, (_field, _visitor, _elements) => {}, (a, b) => a == b);
element!(i64, Kind::I64, (_field, _visitor, _elements) => {}, (a, b) => a == b);

/// Describes a wire struct: `repr(C)`, every field listed, in order, each a number or made of numbers.
///
/// ```
/// # use messages::layout::layout;
/// #[derive(Clone, Copy)]
/// #[repr(C)]
/// struct Pose {
///     north_m: u64,
///     east_m: u64,
/// }
/// layout!(Pose { north_m, east_m });
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
                    $crate::layout::Field { name, offset, size: size_of::<T>(), kind: T::KIND, length: T::LENGTH }
                }
                &[$(describe(stringify!($field), std::mem::offset_of!($name, $field), |message| &message.$field)),+]
            };
        }

        impl $crate::layout::Visit for $name {
            const STRUCT: &'static str = $logged;

            fn visit<V: $crate::layout::Visitor>(&self, visitor: &mut V) {
                let mut fields = <Self as $crate::layout::Layout>::FIELDS.iter();
                $(if let Some(field) = fields.next() {
                    $crate::layout::FieldType::show(&self.$field, field, visitor);
                })+
            }

            fn visit_mut<V: $crate::layout::VisitorMut>(&mut self, visitor: &mut V) {
                let mut fields = <Self as $crate::layout::Layout>::FIELDS.iter();
                $(if let Some(field) = fields.next() {
                    $crate::layout::FieldType::lend(&mut self.$field, field, visitor);
                })+
            }

            #[inline]
            fn is_same(&self, other: &Self) -> bool {
                $($crate::layout::FieldType::same_bits(&self.$field, &other.$field))&&+
            }
        }
        $crate::layout::element!(
            $name,
            $crate::layout::Kind::Struct {
                name: $logged,
                fields: <$name as $crate::layout::Layout>::FIELDS,
            },
            (field, visitor, elements) => { visitor.structs(field, elements); },
            (this, other) => $crate::layout::Visit::is_same(this, other)
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

/// Gives an enum whose numbers are sent a hash over its variants and their numbers.
#[doc(hidden)]
#[macro_export]
macro_rules! enum_hash {
    ($type:ident { $($variant:ident),+ $(,)? }) => {
        impl $type {
            /// Hash over its variants and their numbers: two builds that number them differently do not connect.
            pub const ENUM_HASH: u64 = {
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
pub use enum_hash;

/// Gives an enum of the wire its way back from a number: flags travel as integers, because a forged enum
/// would be undefined behaviour.
#[macro_export]
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
        $crate::enum_hash!($type { $($variant),+ });
    };
}
pub use from_wire;

#[cfg(test)]
mod tests;
