//! Ends of a process that holds libraries: what a law's code may not decide, and what it does not get to do.
#![allow(unsafe_code, reason = "system calls that end the process; each use says why it is sound")]

use std::io::{self, Write as _};
use std::process::ExitCode;
use std::ptr;

use crate::crash;

/// Takes over the C library's ways to end a process at once, so that a law that calls one is named, and its code is not
/// taken for a success. To be written once, in the executable: its functions are found before those of the C library.
#[macro_export]
macro_rules! name_exits {
    () => {
        #[allow(unsafe_code, reason = "functions of the C library, which are found here first")]
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
    end_now(if crash::tell("it called _exit()") { 1 } else { code })
}

/// Ends the process as a return from `main` would, but without what libraries have asked to be run then: none is ever
/// unloaded, and what a law does after its flight must not change what is known of it. Says first what its laws did
/// that no law should.
#[must_use]
pub fn leave(code: u8) -> ExitCode {
    if !crash::names_laws() {
        return ExitCode::from(code);
    }
    // There is no other place to say that nobody reads it.
    let _ = io::stdout().flush();
    for warning in crate::warnings() {
        let _ = writeln!(io::stderr(), "warning: {warning}");
    }
    // SAFETY: writes out what a library has printed; NULL means all streams.
    unsafe { libc::fflush(ptr::null_mut()) };
    end_now(i32::from(code))
}

/// Ends the process, and runs nothing more in it.
pub(crate) fn end_now(code: i32) -> ! {
    loop {
        // SAFETY: takes a number, and does not return.
        unsafe { libc::syscall(libc::SYS_exit_group, code) };
    }
}
