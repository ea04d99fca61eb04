//! The end of a process that has loaded laws.
//!
//! A law of a library can do what code in C can do: read where nothing is, divide by zero, abort, exit. The system then
//! ends the process without naming the law. Here a handler writes one line first, and the process dies as it would
//! have. A law decides neither the exit code of the process nor what runs at its exit.
#![allow(
    unsafe_code,
    reason = "signal handlers and system calls; each use says why it is sound"
)]

use std::ffi::c_void;
use std::fs;
use std::io::{self, Write as _};
use std::mem::MaybeUninit;
use std::ops::Range;
use std::process::{self, ExitCode};
use std::ptr;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Once, OnceLock};

use crate::call::{Call, call};
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

/// Takes over the C library's ways to end a process at once, so that a law that calls one is named, and its code is not
/// taken for a success. To be written once, in the executable: its functions are found before those of the C library.
#[macro_export]
macro_rules! name_exits {
    () => {
        #[allow(
            unsafe_code,
            reason = "functions of the C library, which are found here first"
        )]
        mod exits {
            #[unsafe(no_mangle)]
            extern "C" fn _exit(code: i32) -> ! {
                $crate::exit(code)
            }

            #[unsafe(no_mangle)]
            #[allow(non_snake_case, reason = "the C library's name")]
            extern "C" fn _Exit(code: i32) -> ! {
                $crate::exit(code)
            }
        }
    };
}

/// As `_exit` of the C library; a law that calls it is named, and has failed.
#[doc(hidden)]
pub fn exit(code: i32) -> ! {
    end_now(if tell("it called _exit()") { 1 } else { code })
}

/// Ends the process as a return from `main` would, but without what libraries have asked to be run then: none is ever
/// unloaded, and what a law does after its flight must not change what is known of it. Says first what its laws did
/// that no law should.
pub fn leave(code: u8) -> ExitCode {
    if !names_laws() {
        return ExitCode::from(code);
    }
    // There is no other place to say that nobody reads it.
    let _ = io::stdout().flush();
    for warning in crate::warnings() {
        let _ = writeln!(io::stderr(), "warning: {warning}");
    }
    end_children();
    // SAFETY: writes out what a library has printed; NULL means all streams.
    unsafe { libc::fflush(ptr::null_mut()) };
    end_now(i32::from(code))
}

/// Kills the child processes that are left: the process has waited for its own, so a law has forked these.
fn end_children() {
    let Ok(tasks) = fs::read_dir("/proc/self/task") else {
        return;
    };
    let lists = tasks.flatten().filter_map(|task| {
        // Absent where the kernel was built without it.
        fs::read_to_string(task.path().join("children")).ok()
    });
    let lists: Vec<String> = lists.collect();
    let words = lists.iter().flat_map(|list| list.split_whitespace());
    let children: Vec<i32> = words.filter_map(|pid| pid.parse().ok()).collect();
    let still_runs = |child: &&i32| {
        // SAFETY: takes what is left of a child that has ended; 0 says that it has not.
        unsafe { libc::waitpid(**child, ptr::null_mut(), libc::WNOHANG) == 0 }
    };
    let left = children.iter().filter(still_runs).inspect(|child| {
        // SAFETY: a child that nobody has waited for keeps its number.
        unsafe { libc::kill(**child, libc::SIGKILL) };
    });
    let count = left.count();
    if count > 0 {
        let _ = writeln!(
            io::stderr(),
            "warning: a law left {count} child process(es) behind; they were killed"
        );
    }
}

/// Libraries that are known; a process has one a role, and a trial one.
const KNOWN: usize = 16;

/// A piece of code, and the law that it belongs to.
type Code = (Range<usize>, &'static str);

/// In the order in which they were loaded. A handler may read them at any time.
static CODES: [OnceLock<Code>; KNOWN] = [const { OnceLock::new() }; KNOWN];

fn law_at(address: usize) -> Option<&'static str> {
    let codes = CODES.iter().map_while(OnceLock::get);
    codes
        .filter(|(code, _)| code.contains(&address))
        .map(|(_, law)| *law)
        .next()
}

/// The segment of code that an address lies in; empty where it is data, or nothing.
pub(crate) fn segment_of(address: usize) -> Range<usize> {
    let mut found = (address, 0..0);
    // SAFETY: the callback is called with the objects of this process while the call lasts, and `found` lives as long.
    unsafe { libc::dl_iterate_phdr(Some(look), (&raw mut found).cast()) };
    found.1
}

/// Remembers a law by the code that one of its functions lies in.
pub(crate) fn remember(function: usize, law: &'static str) {
    let code = segment_of(function);
    if code.is_empty() || law_at(function).is_some() {
        return;
    }
    let mut left = (code, law);
    for place in &CODES {
        match place.set(left) {
            Ok(()) => return,
            Err(still) => left = still,
        }
    }
    // There are too many: a crash of this one is not named.
}

/// Takes the segment with the function, where this object has it.
unsafe extern "C" fn look(object: *mut libc::dl_phdr_info, _: usize, found: *mut c_void) -> i32 {
    // SAFETY: the loader hands over an object with so many headers, and `remember` its own value.
    let (object, (function, code)) =
        unsafe { (&*object, &mut *found.cast::<(usize, Range<usize>)>()) };
    for i in 0..usize::from(object.dlpi_phnum) {
        // SAFETY: as above.
        let header = unsafe { &*object.dlpi_phdr.add(i) };
        let from = (object.dlpi_addr + header.p_vaddr) as usize;
        let segment = from..from + header.p_memsz as usize;
        let is_code = header.p_type == libc::PT_LOAD && header.p_flags & libc::PF_X != 0;
        if is_code && segment.contains(function) {
            *code = segment;
            return 1;
        }
    }
    0
}

/// Where a thread was as a signal came; 0 where that is not known.
#[cfg(target_arch = "x86_64")]
fn interrupted_at(context: *const c_void) -> usize {
    // SAFETY: the system hands such a context to a handler that has asked for it.
    let context = unsafe { &*context.cast::<libc::ucontext_t>() };
    context.uc_mcontext.gregs[libc::REG_RIP as usize] as usize
}

#[cfg(target_arch = "aarch64")]
fn interrupted_at(context: *const c_void) -> usize {
    // SAFETY: the system hands such a context to a handler that has asked for it.
    let context = unsafe { &*context.cast::<libc::ucontext_t>() };
    context.uc_mcontext.pc as usize
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
const fn interrupted_at(_: *const c_void) -> usize {
    0
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

    #[test]
    fn code_is_known_by_a_function_in_it() {
        let function = law_at as *const () as usize;
        assert_eq!(law_at(function), None);
        remember(function, "law");
        remember(function, "another");
        // Data is no code.
        assert!(segment_of((&raw const CODES).addr()).is_empty());
        assert_eq!((law_at(function), law_at(0)), (Some("law"), None));
    }
}
