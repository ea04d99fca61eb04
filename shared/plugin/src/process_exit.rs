//! Ends the process at once, past every exit handler.
#![allow(unsafe_code, reason = "a system call that ends the process")]

pub(crate) fn end_now(code: i32) -> ! {
    loop {
        // SAFETY: takes a number, and does not return.
        unsafe { libc::syscall(libc::SYS_exit_group, code) };
    }
}
