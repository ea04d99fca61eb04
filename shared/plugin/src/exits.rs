//! The end of a process that has loaded libraries: a law's code decides neither its exit code nor what runs at exit.
#![allow(
    unsafe_code,
    reason = "system calls that end the process; each use says why it is sound"
)]

use std::fs;
use std::io::{self, Write as _};
use std::process::ExitCode;
use std::ptr;

use crate::crash;
use crate::process_exit::end_now;

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
    end_now(if crash::tell("it called _exit()") {
        1
    } else {
        code
    })
}

/// Ends the process as a return from `main` would, but without what libraries have asked to be run then: none is ever
/// unloaded, and what a law does after its flight must not change what is known of it. Says first what its laws did
/// that no law should.
pub fn leave(code: u8) -> ExitCode {
    if !crash::names_laws() {
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
    let children: Vec<i32> = lists
        .flat_map(|list| {
            list.split_whitespace()
                .filter_map(|pid| pid.parse().ok())
                .collect::<Vec<i32>>()
        })
        .collect();
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
