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
use std::fmt::{self, Write as _};
use std::fs;
use std::io;
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

pub(crate) fn name_laws() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        PROCESS.store(process::id(), Ordering::Relaxed);
        for signal in DEADLY {
            let mut action = MaybeUninit::<libc::sigaction>::zeroed();
            let handler: extern "C" fn(i32, *const libc::siginfo_t, *const c_void) = name_and_die;
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
            // Each thread that calls exit() takes one of them.
            for _ in 0..EXITS {
                libc::atexit(name_exit);
            }
            at_quick_exit(name_quick_exit);
        }
    });
}

/// Threads in which a law may call exit() at once.
const EXITS: usize = 32;

extern "C" fn name_and_die(signal: i32, info: *const libc::siginfo_t, context: *const c_void) {
    // SAFETY: the system hands over a siginfo that lives as long as the handler runs.
    let code = unsafe { (*info).si_code };
    // A thread that the law has started is in no call.
    let outside =
        || law_at(interrupted_at(context)).map(|law| Call::new(law, "outside of its calls"));
    if !name_law(call().or_else(outside), meaning(signal, code)) && signal == libc::SIGXCPU {
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
extern "C" fn name_exit() {
    if name_law(call(), "it called exit()") {
        end_now(1);
    }
}

extern "C" fn name_quick_exit() {
    if name_law(call(), "it called quick_exit()") {
        end_now(1);
    }
}

/// Writes the law of a call and why the process ends; false without a call, and in a child process of a law.
fn name_law(call: Option<Call>, meaning: &str) -> bool {
    let Some(call) = call.filter(|_| PROCESS.load(Ordering::Relaxed) == process::id()) else {
        return false;
    };
    // Formatting into a stream without a buffer neither allocates nor locks.
    let (law, doing) = (call.law, call.doing);
    let _ = match call.tick {
        Some(tick) => writeln!(Stderr, "error: {law} failed {doing}{tick}: {meaning}"),
        None => writeln!(Stderr, "error: {law} failed {doing}: {meaning}"),
    };
    true
}

/// Standard error without a lock, for a signal handler.
struct Stderr;

impl fmt::Write for Stderr {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        // SAFETY: the bytes live. If standard error takes no more, the process ends all the same.
        unsafe { libc::write(libc::STDERR_FILENO, text.as_ptr().cast(), text.len()) };
        Ok(())
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
    let is_law = name_law(call(), "it called _exit()");
    end_now(if is_law { 1 } else { code })
}

/// Prints the warnings and ends the process; returns if the process has loaded no law.
pub(crate) fn leave(code: u8, warnings: Vec<String>) -> ExitCode {
    if PROCESS.load(Ordering::Relaxed) == 0 {
        return ExitCode::from(code);
    }
    // If standard output is closed, there is no other place to report it.
    let _ = io::Write::flush(&mut io::stdout());
    for warning in warnings {
        let _ = writeln!(Stderr, "warning: {warning}");
    }
    end_children();
    // SAFETY: writes out what a library has printed; NULL means all streams.
    unsafe { libc::fflush(ptr::null_mut()) };
    end_now(i32::from(code))
}

/// Kills the child processes that are left: the process has waited for its own, so a law has forked these.
fn end_children() {
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten();
    // The file is missing if the kernel was built without it.
    let lists = tasks
        .flatten()
        .filter_map(|task| fs::read_to_string(task.path().join("children")).ok());
    let lists: Vec<String> = lists.collect();
    let mut count = 0;
    for child in lists.join(" ").split(' ').filter_map(|it| it.parse().ok()) {
        // SAFETY: reaps a child that has ended; 0 means that it has not, and then its number is still its own.
        unsafe {
            if libc::waitpid(child, ptr::null_mut(), libc::WNOHANG) == 0 {
                libc::kill(child, libc::SIGKILL);
                count += 1;
            }
        }
    }
    if count > 0 {
        let _ = writeln!(
            Stderr,
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
    let mut codes = CODES.iter().map_while(OnceLock::get);
    codes.find_map(|(code, law)| code.contains(&address).then_some(*law))
}

/// The segment of code that an address lies in; empty where it is data, or nothing.
pub(crate) fn segment_of(address: usize) -> Range<usize> {
    let mut found = (address, 0..0);
    // SAFETY: the callback is called with the objects of this process while the call lasts, and `found` lives as long.
    unsafe { libc::dl_iterate_phdr(Some(look), (&raw mut found).cast()) };
    found.1
}

/// Remembers a law by the code that one of its functions lies in. With too many laws, a crash of this one is not named.
pub(crate) fn remember(function: usize, law: &'static str) {
    let code = segment_of(function);
    if !code.is_empty() && law_at(function).is_none() {
        // Another thread may take a free place first.
        let _ = CODES
            .iter()
            .any(|place| place.set((code.clone(), law)).is_ok());
    }
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
    // SAFETY: the system hands such a context to a handler with SA_SIGINFO.
    let context = unsafe { &*context.cast::<libc::ucontext_t>() };
    context.uc_mcontext.gregs[libc::REG_RIP as usize] as usize
}

#[cfg(target_arch = "aarch64")]
fn interrupted_at(context: *const c_void) -> usize {
    // SAFETY: the system hands such a context to a handler with SA_SIGINFO.
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
    fn code_is_known_by_a_function_in_it() {
        let function = law_at as *const () as usize;
        assert_eq!(law_at(function), None);
        remember(function, "law");
        remember(function, "another");
        // Data is no code.
        assert!(segment_of((&raw const CODES).addr()).is_empty());
        assert_eq!((law_at(function), law_at(0)), (Some("law"), None));
    }

    #[test]
    fn a_signal_that_was_sent_is_told_from_a_mistake() {
        for (signal, name) in [
            (libc::SIGSEGV, "SIGSEGV"),
            (libc::SIGBUS, "SIGBUS"),
            (libc::SIGFPE, "SIGFPE"),
            (libc::SIGILL, "SIGILL"),
        ] {
            let sent = format!("{name}: the signal was sent to it");
            let [zero, one, two] = [0, 1, 2].map(|code| meaning(signal, code));
            assert_eq!(zero, sent);
            assert!(one.starts_with(name) && one != sent && two.starts_with(name) && two != sent);
            assert_eq!(one != two, signal == libc::SIGFPE);
        }
        let own = [libc::SIGABRT, libc::SIGXCPU, libc::SIGHUP].map(|signal| meaning(signal, 0));
        assert_eq!(
            own.map(|it| it.split(' ').next()),
            [Some("SIGABRT:"), Some("SIGXCPU:"), Some("a")]
        );
    }
}
