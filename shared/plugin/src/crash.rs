//! The end of a process that has loaded laws.
//!
//! A law of a library can do what code in C can do: read where nothing is, divide by zero, abort, exit. The system then
//! ends the process without naming the law. Here a handler writes one line first, and the process dies as it would
//! have. A law decides neither the exit code of the process nor what runs at its exit.
#![allow(
    unsafe_code,
    reason = "signal handlers and system calls; each use says why it is sound"
)]

use std::fmt::{self, Write as _};
use std::fs;
use std::io;
use std::mem::MaybeUninit;
use std::process::{self, ExitCode};
use std::ptr;
use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::call::call;
use crate::process_exit::end_now;

/// Signals that kill a process from within.
const DEADLY: [(i32, &str); 6] = [
    (libc::SIGSEGV, "SIGSEGV: invalid memory access"),
    (
        libc::SIGBUS,
        "SIGBUS: access beyond the end of a mapped file",
    ),
    (libc::SIGFPE, "SIGFPE: arithmetic exception"),
    (libc::SIGILL, "SIGILL: illegal instruction"),
    (libc::SIGABRT, "SIGABRT: it aborted"),
    (
        libc::SIGXCPU,
        "SIGXCPU: it computed for half a second without an end",
    ),
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
        for (signal, _) in DEADLY {
            let mut action = MaybeUninit::<libc::sigaction>::zeroed();
            let handler: extern "C" fn(i32, *const libc::siginfo_t) = name_and_die;
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

extern "C" fn name_and_die(signal: i32, info: *const libc::siginfo_t) {
    let meaning = DEADLY.iter().find(|(number, _)| *number == signal);
    let meaning = meaning.map_or("", |(_, meaning)| *meaning);
    // SAFETY: the system hands over a siginfo that lives as long as the handler runs.
    let is_sent = unsafe { (*info).si_code } <= 0 && signal != libc::SIGABRT;
    let meaning = match meaning.split_once(':') {
        Some((name, _)) if is_sent => name,
        _ => meaning,
    };
    if !name_law(meaning) && signal == libc::SIGXCPU {
        return;
    }
    // SAFETY: both calls are allowed here; the signal is delivered, with its default action, as this handler returns.
    unsafe {
        libc::signal(signal, libc::SIG_DFL);
        libc::raise(signal);
    }
}

/// A law that ends the process has not landed.
extern "C" fn name_exit() {
    if name_law("it called exit()") {
        end_now(1);
    }
}

extern "C" fn name_quick_exit() {
    if name_law("it called quick_exit()") {
        end_now(1);
    }
}

/// Writes the law of the present call and why the process ends; false without a call, and in a child process of a law.
fn name_law(meaning: &str) -> bool {
    let Some(call) = call().filter(|_| PROCESS.load(Ordering::Relaxed) == process::id()) else {
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
