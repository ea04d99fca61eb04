//! What changes in flight, as bytes: another instance of the same law continues from them, bit for bit.
//!
//! A law lists its fields once, and [`Fields`] writes or reads them.

use ironbird_law::abi::IRONBIRD_STATE_BYTES;
use messages::content::{Desired, Reference};
use messages::layout::{Field as Described, Visit, VisitorMut};
use nalgebra::SMatrix;

pub const SAVED_STATE_BYTES: usize = IRONBIRD_STATE_BYTES;

/// What the guard adds to the bytes of a law at most.
pub const GUARD_BYTES: usize = 400;

pub type SavedState = heapless::Vec<u8, SAVED_STATE_BYTES>;

/// Where fields are written to, or read from, one after another.
#[derive(Debug)]
pub enum Fields<'a> {
    Write(&'a mut SavedState),
    Read(&'a [u8]),
    /// There is no room for the fields, the bytes are those of others, or the law cannot be saved.
    Refused,
}

impl Fields<'_> {
    pub fn all<const N: usize>(&mut self, fields: [&mut dyn Field; N]) {
        fields.into_iter().for_each(|field| field.transfer(self));
    }

    /// Whether all fields were written, or read and no byte is left.
    pub const fn is_complete(&self) -> bool {
        match self {
            Self::Write(_) => true,
            Self::Read(rest) => rest.is_empty(),
            Self::Refused => false,
        }
    }
}

/// A field that can be saved. Its number of bytes depends on its type alone.
pub trait Field {
    /// Writes the field, or reads it.
    fn transfer(&mut self, fields: &mut Fields);
}

/// Has a struct save the fields that change in flight.
#[macro_export]
macro_rules! saved_fields {
    ($type:ty: $($field:tt),*) => {
        impl $crate::saved_state::Field for $type {
            fn transfer(&mut self, fields: &mut $crate::saved_state::Fields) {
                fields.all([$(&mut self.$field),*]);
            }
        }
    };
}
pub use saved_fields;

impl Field for u64 {
    #[inline]
    fn transfer(&mut self, fields: &mut Fields) {
        match fields {
            Fields::Write(state) => {
                if state.extend_from_slice(&self.to_le_bytes()).is_err() {
                    *fields = Fields::Refused;
                }
            }
            Fields::Read(state) => match state.split_first_chunk() {
                Some((bytes, rest)) => (*self, *state) = (Self::from_le_bytes(*bytes), rest),
                None => *fields = Fields::Refused,
            },
            Fields::Refused => {}
        }
    }
}

impl Field for f64 {
    #[inline]
    fn transfer(&mut self, fields: &mut Fields) {
        let mut bits = self.to_bits();
        bits.transfer(fields);
        *self = Self::from_bits(bits);
    }
}

impl<const R: usize, const C: usize> Field for SMatrix<f64, R, C> {
    fn transfer(&mut self, fields: &mut Fields) {
        self.iter_mut().for_each(|number| number.transfer(fields));
    }
}

impl<A: Field, B: Field> Field for (A, B) {
    fn transfer(&mut self, fields: &mut Fields) {
        fields.all([&mut self.0, &mut self.1]);
    }
}

impl<T: Field + Default + Copy> Field for Option<T> {
    fn transfer(&mut self, fields: &mut Fields) {
        let (mut is_some, mut value) = (u64::from(self.is_some()), self.unwrap_or_default());
        fields.all([&mut is_some, &mut value]);
        *self = (is_some != 0).then_some(value);
    }
}

impl Field for Desired {
    fn transfer(&mut self, fields: &mut Fields) {
        self.visit_mut(fields);
    }
}

impl Field for Reference {
    fn transfer(&mut self, fields: &mut Fields) {
        self.visit_mut(fields);
    }
}

impl VisitorMut for Fields<'_> {
    fn integers(&mut self, _: &'static Described, values: &mut [u64]) {
        values.iter_mut().for_each(|value| value.transfer(self));
    }

    fn numbers(&mut self, _: &'static Described, values: &mut [f64]) {
        values.iter_mut().for_each(|value| value.transfer(self));
    }
}
