//! Functions that are compiled for wider vectors too, and prefetches: used where the processor has them.
//!
//! Releases are built for every x86-64. Where many numbers go through the same arithmetic, wider registers pay. They
//! change no bit: each lane rounds as a scalar does, and nothing is contracted to fused operations.

use nalgebra::SVector;

/// Defines a function whose body is also compiled for AVX2 and for AVX-512; each call takes the widest that is there.
///
/// What the body calls takes part as far as it is inlined.
#[macro_export]
macro_rules! vectorised {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) $(-> $ret)? {
            #[inline(always)]
            fn each_lane($($arg: $type),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512dq,avx512vl")]
                fn avx512($($arg: $type),*) $(-> $ret)? {
                    each_lane($($arg),*)
                }

                if is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
                {
                    #[allow(unsafe_code, reason = "the compiler cannot know what was detected")]
                    // SAFETY: the processor has what it is compiled for, as has just been seen.
                    return unsafe { avx512($($arg),*) };
                }
            }
            $crate::vectorised_by_four! {
                #[inline(always)]
                fn narrower($($arg: $type),*) $(-> $ret)? { each_lane($($arg),*) }
            }
            narrower($($arg),*)
        }
    };
}
pub use vectorised;

/// As [`vectorised!`], for AVX2 alone: where there are four numbers, wider vectors would be left half empty.
#[macro_export]
macro_rules! vectorised_by_four {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) $(-> $ret)? {
            #[inline(always)]
            fn anywhere($($arg: $type),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2($($arg: $type),*) $(-> $ret)? {
                    anywhere($($arg),*)
                }

                if is_x86_feature_detected!("avx2") {
                    #[allow(unsafe_code, reason = "the compiler cannot know what was detected")]
                    // SAFETY: as in `vectorised!`.
                    return unsafe { avx2($($arg),*) };
                }
            }
            anywhere($($arg),*)
        }
    };
}
pub use vectorised_by_four;

/// Values that are computed together: as many numbers as the widest vectors hold.
pub const LANES: usize = 8;

/// A value that consists of numbers, so that [`Columns`] can hold one for each lane.
pub trait Numbers: Copy + Default {
    /// Calls `look` with every number, always in the same order.
    fn each(&mut self, look: &mut impl FnMut(&mut f64));
}

impl Numbers for f64 {
    #[inline(always)]
    fn each(&mut self, look: &mut impl FnMut(&mut f64)) {
        look(self);
    }
}

impl<const N: usize> Numbers for SVector<f64, N>
where
    Self: Default,
{
    #[inline(always)]
    fn each(&mut self, look: &mut impl FnMut(&mut f64)) {
        self.as_mut_slice().iter_mut().for_each(look);
    }
}

/// Implements [`Numbers`] for a struct of such fields.
#[macro_export]
macro_rules! numbers {
    ($type:ty: $($field:ident),+) => {
        impl $crate::vectors::Numbers for $type {
            #[inline(always)]
            fn each(&mut self, look: &mut impl FnMut(&mut f64)) {
                $($crate::vectors::Numbers::each(&mut self.$field, look);)+
            }
        }
    };
}
pub use numbers;

/// A value of up to N numbers for each lane, with corresponding numbers side by side: the compiler turns a loop over the
/// lanes into vector instructions.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Columns<const N: usize>([[f64; LANES]; N]);

impl<const N: usize> Columns<N> {
    pub const ZERO: Self = Self([[0.0; LANES]; N]);

    /// The value of a lane. Panics if it has more than N numbers.
    #[inline(always)]
    pub fn of<T: Numbers>(&self, lane: usize) -> T {
        let (mut value, mut column) = (T::default(), 0..N);
        value.each(&mut |number| *number = self.0[column.next().unwrap_or(N)][lane]);
        value
    }

    /// Sets the value of a lane to `value`, which does not change. Panics if it has more than N numbers.
    #[inline(always)]
    pub fn put<T: Numbers>(&mut self, lane: usize, value: &mut T) {
        let mut column = 0..N;
        value.each(&mut |number| self.0[column.next().unwrap_or(N)][lane] = *number);
    }
}

const CACHE_LINE: usize = 64;

/// Asks the processor for the cache lines of a value, and does not wait for them.
#[cfg_attr(not(target_arch = "x86_64"), allow(unused_variables))]
pub fn prefetch<T>(value: &T) {
    for offset in (0..size_of::<T>()).step_by(CACHE_LINE) {
        let line = std::ptr::from_ref(value).cast::<i8>().wrapping_add(offset);
        #[cfg(target_arch = "x86_64")]
        #[allow(unsafe_code, reason = "there is no safe function for it")]
        // SAFETY: a prefetch changes nothing, and every address is allowed.
        unsafe {
            std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(line);
        }
    }
}
