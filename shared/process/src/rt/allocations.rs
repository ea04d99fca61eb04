//! Counts the allocations of each thread: the proof that a tick does not allocate.
#![allow(
    unsafe_code,
    reason = "the allocator's functions are passed on unchanged"
)]

use std::cell::Cell;
use std::hint::black_box;
use std::sync::OnceLock;

thread_local! {
    // Const-initialised and without a destructor: counting never allocates itself.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// Allocations (and re-allocations) of the calling thread so far; 0 where [`count_allocations!`] is not in force.
pub fn thread_allocations() -> u64 {
    ALLOCATIONS.get()
}

/// Whether this executable has [`count_allocations!`]. The first call allocates.
pub fn are_counted() -> bool {
    static COUNTED: OnceLock<bool> = OnceLock::new();
    *COUNTED.get_or_init(|| {
        let before = thread_allocations();
        drop(black_box(Box::new(0_u8)));
        thread_allocations() > before
    })
}

#[doc(hidden)]
#[inline]
pub fn count_allocation() {
    ALLOCATIONS.set(ALLOCATIONS.get() + 1);
}

/// Functions of the C library that count, and forward to it.
#[doc(hidden)]
#[macro_export]
macro_rules! count_and_forward {
    ($($name:ident($($argument:ident: $type:ty),+) => $forward:ident;)+) => {
        $(
            #[unsafe(no_mangle)]
            unsafe extern "C" fn $name($($argument: $type),+) -> *mut c_void {
                count_allocation();
                // SAFETY: promised by the caller.
                unsafe { $forward($($argument),+) }
            }
        )+
    };
}

/// Counts every call to malloc and its kin in this executable, from Rust or from a library that it loads. It is
/// written once, in an executable that proves that a tick does not allocate.
///
/// The functions are found before those of the C library, and forward to it. With another C library than glibc nothing is
/// counted.
#[macro_export]
macro_rules! count_allocations {
    () => {
        #[cfg(target_env = "gnu")]
        #[allow(unsafe_code, reason = "malloc and its kin, passed on unchanged")]
        mod counted {
            use std::ffi::{c_int, c_void};

            use $crate::rt::count_allocation;

            unsafe extern "C" {
                fn __libc_malloc(size: usize) -> *mut c_void;
                fn __libc_calloc(count: usize, size: usize) -> *mut c_void;
                fn __libc_realloc(pointer: *mut c_void, size: usize) -> *mut c_void;
                fn __libc_memalign(alignment: usize, size: usize) -> *mut c_void;
            }

            $crate::count_and_forward! {
                malloc(size: usize) => __libc_malloc;
                calloc(count: usize, size: usize) => __libc_calloc;
                realloc(pointer: *mut c_void, size: usize) => __libc_realloc;
                memalign(alignment: usize, size: usize) => __libc_memalign;
                aligned_alloc(alignment: usize, size: usize) => __libc_memalign;
            }

            #[unsafe(no_mangle)]
            unsafe extern "C" fn posix_memalign(
                memory: *mut *mut c_void,
                alignment: usize,
                size: usize,
            ) -> c_int {
                const EINVAL: c_int = 22;
                const ENOMEM: c_int = 12;
                if !alignment.is_power_of_two() || alignment % size_of::<usize>() != 0 {
                    return EINVAL;
                }
                count_allocation();
                // SAFETY: promised by the caller; its pointer is to a place for one.
                unsafe {
                    let made = __libc_memalign(alignment, size);
                    if made.is_null() {
                        return ENOMEM;
                    }
                    *memory = made;
                }
                0
            }
        }
    };
}
