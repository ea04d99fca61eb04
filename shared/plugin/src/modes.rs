//! How a thread computes: rounding, numbers that are almost zero, and floating-point exceptions that trap.
//!
//! A law may change that, and so may a library that was built with -ffast-math, as it is loaded. What it leaves behind
//! would be in all that is computed after it in its thread: other bits in one process than in four.
#![allow(
    unsafe_code,
    reason = "reads and writes the processor's control registers"
)]

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Modes(processor::Modes);

impl Modes {
    pub(crate) fn now() -> Self {
        Self(processor::read())
    }

    /// Puts them back where they are others now; says whether they were.
    pub(crate) fn put_back(self) -> bool {
        let were_changed = Self::now() != self;
        if were_changed {
            processor::write(self.0);
        }
        were_changed
    }
}

#[cfg(target_arch = "x86_64")]
mod processor {
    use std::arch::asm;

    /// What computing leaves in the register of SSE, and is no mode: the exceptions so far.
    const EXCEPTIONS: u32 = 0x3f;

    /// Of SSE, and of the x87, which computes with `long double`.
    pub(super) type Modes = (u32, u16);

    pub(super) fn read() -> Modes {
        let (mut sse, mut x87) = (0_u32, 0_u16);
        // SAFETY: each writes a control register into a live word of its size.
        unsafe {
            asm!("stmxcsr [{}]", in(reg) &raw mut sse, options(nostack, preserves_flags));
            asm!("fnstcw [{}]", in(reg) &raw mut x87, options(nostack, preserves_flags));
        }
        (sse & !EXCEPTIONS, x87)
    }

    pub(super) fn write((sse, x87): Modes) {
        // SAFETY: each reads a control register from a live word of its size, which `read` gave. Exceptions are
        // forgotten first: the x87 would trap on them as soon as it may.
        unsafe {
            asm!("fnclex", "fldcw [{}]", in(reg) &raw const x87, options(nostack, readonly, preserves_flags));
            asm!("ldmxcsr [{}]", in(reg) &raw const sse, options(nostack, readonly, preserves_flags));
        }
    }
}

#[cfg(target_arch = "aarch64")]
mod processor {
    use std::arch::asm;

    pub(super) type Modes = u64;

    pub(super) fn read() -> Modes {
        let modes;
        // SAFETY: reads a register.
        unsafe { asm!("mrs {}, fpcr", out(reg) modes, options(nomem, nostack, preserves_flags)) };
        modes
    }

    pub(super) fn write(modes: Modes) {
        // SAFETY: writes what `read` gave.
        unsafe { asm!("msr fpcr, {}", in(reg) modes, options(nomem, nostack, preserves_flags)) };
    }
}

/// Other processors' registers are not looked after.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
mod processor {
    pub(super) type Modes = ();

    pub(super) const fn read() -> Modes {}

    pub(super) const fn write((): Modes) {}
}
