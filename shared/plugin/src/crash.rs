//! Names the law in whose call a process dies.
//!
//! A law of a library can do what code in C can do: read where nothing is, divide by zero, abort, exit. The system then
//! ends the process with no word of the law. Here a handler writes one line first, and the process dies as it would
//! have.
#![allow(unsafe_code, reason = "signal handlers; each use says why it is sound")]

use std::ffi::c_void;
use std::mem::MaybeUninit;
use std::process;
use std::ptr;
use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::call::{Call, call};
use crate::code::{interrupted_at, law_at};
use crate::process_exit::end_now;

/// What kills a process from within.
const DEADLY: [i32; 6] = [
    libc::SIGSEGV,
    libc::SIGBUS,
    libc::SIGFPE,
    libc::SIGILL,
    libc::SIGABRT,
    libc::SIGXCPU,
];

/// How long a call may compute under real-time scheduling [us]: a loop without an end would keep the other stages from
/// their processor for good. After twice as long the system kills the process, which a law cannot keep from itself.
const RUNAWAY_US: u64 = 500_000;

/// The process that names laws; 0 before it does. One that a law has forked is none of ours.
static PROCESS: AtomicU32 = AtomicU32::new(0);

unsafe extern "C" {
    fn at_quick_exit(function: extern "C" fn()) -> i32;
}

pub(crate) fn names_laws() -> bool {
    PROCESS.load(Ordering::Relaxed) != 0
}

pub(crate) fn name_laws() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        PROCESS.store(process::id(), Ordering::Relaxed);
        for signal in DEADLY {
            let mut action = MaybeUninit::<libc::sigaction>::zeroed();
            let handler: extern "C" fn(i32, *const libc::siginfo_t, *const c_void) = tell_and_die;
            // SAFETY: all zeroes are a valid sigaction. The handler reads words that no longer change, and makes system
            // calls that a handler may make.
            unsafe {
                let action = action.assume_init_mut();
                action.sa_sigaction = handler as usize;
                // Where the stack is used up, on the other one that Rust has made.
                action.sa_flags = libc::SA_ONSTACK | libc::SA_SIGINFO;
                libc::sigaction(signal, action, ptr::null_mut());
            }
        }
        let mut limit = libc::rlimit {
            rlim_cur: 0,
            rlim_max: 0,
        };
        // SAFETY: the pointers are to a live rlimit; the functions live as long as the process. Where the system
        // refuses, a law without an end is met by the launcher, later.
        unsafe {
            if libc::getrlimit(libc::RLIMIT_RTTIME, &raw mut limit) == 0 {
                limit.rlim_max = limit.rlim_max.min(2 * RUNAWAY_US);
                limit.rlim_cur = limit.rlim_cur.min(RUNAWAY_US);
                libc::setrlimit(libc::RLIMIT_RTTIME, &raw const limit);
            }
            libc::atexit(tell_of_exit);
            at_quick_exit(tell_of_quick_exit);
        }
    });
}

extern "C" fn tell_and_die(signal: i32, info: *const libc::siginfo_t, context: *const c_void) {
    // SAFETY: the system hands over a siginfo that lives as long as the handler runs.
    let code = unsafe { (*info).si_code };
    // A thread that the law has started is in no call.
    let outside =
        || law_at(interrupted_at(context)).map(|law| Call::new(law, "outside of its calls"));
    if !tell_of(call().or_else(outside), meaning(signal, code)) && signal == libc::SIGXCPU {
        return;
    }
    // SAFETY: both calls are allowed here; the signal is delivered, with its default action, as this handler returns.
    unsafe {
        libc::signal(signal, libc::SIG_DFL);
        libc::raise(signal);
    }
}

/// What a signal means; its code says more of it, and is not above zero where a process has sent it.
const fn meaning(signal: i32, code: i32) -> &'static str {
    const FPE_INTDIV: i32 = 1;
    match (signal, code) {
        (libc::SIGABRT, _) => "SIGABRT: it aborted",
        (libc::SIGXCPU, _) => "SIGXCPU: it computed for half a second without an end",
        (libc::SIGSEGV, 1..) => "SIGSEGV: it read or wrote where no memory is",
        (libc::SIGBUS, 1..) => "SIGBUS: it read or wrote where memory has no content",
        (libc::SIGFPE, FPE_INTDIV) => {
            "SIGFPE: it divided an integer by zero, or the smallest one by -1"
        }
        (libc::SIGFPE, 1..) => "SIGFPE: it had floating-point exceptions trap, and met one",
        (libc::SIGILL, 1..) => "SIGILL: it ran what is no instruction",
        (libc::SIGSEGV, _) => "SIGSEGV: the signal was sent to it",
        (libc::SIGBUS, _) => "SIGBUS: the signal was sent to it",
        (libc::SIGFPE, _) => "SIGFPE: the signal was sent to it",
        (libc::SIGILL, _) => "SIGILL: the signal was sent to it",
        _ => "a signal",
    }
}

/// A law that ends the process has not landed.
extern "C" fn tell_of_exit() {
    if tell("it called exit()") {
        end_now(1);
    }
}

extern "C" fn tell_of_quick_exit() {
    if tell("it called quick_exit()") {
        end_now(1);
    }
}

/// Writes who was called and why it dies; false where no law was.
pub(crate) fn tell(meaning: &str) -> bool {
    tell_of(call(), meaning)
}

/// The same of a call; false also where only a child dies that a law has forked.
fn tell_of(call: Option<Call>, meaning: &str) -> bool {
    let Some(call) = call.filter(|_| PROCESS.load(Ordering::Relaxed) == process::id()) else {
        return false;
    };
    let mut digits = [0_u8; 20];
    let tick = match call.of_tick() {
        Some(tick) => decimal(tick, &mut digits),
        None => &[][..],
    };
    let parts = [
        "error: ".as_bytes(),
        call.law.as_bytes(),
        b" failed ",
        call.doing.as_bytes(),
        tick,
        b": ",
    ];
    for part in parts.into_iter().chain([meaning.as_bytes(), b"\n"]) {
        // SAFETY: the bytes live; that standard error takes no more changes nothing about what follows.
        unsafe { libc::write(libc::STDERR_FILENO, part.as_ptr().cast(), part.len()) };
    }
    true
}

fn decimal(mut number: u64, digits: &mut [u8; 20]) -> &[u8] {
    let mut at = digits.len();
    loop {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            return &digits[at..];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_they_are_read() {
        for number in [0, 7, 10, 4_000, u64::MAX] {
            assert_eq!(decimal(number, &mut [0; 20]), number.to_string().as_bytes());
        }
    }
}
