//! Child processes that ask laws: the code of a law can end the process that it runs in.
#![allow(unsafe_code, reason = "a fork, which says why it is sound")]

use std::fs::File;
use std::io::{self, Seek as _, Write as _};
use std::mem::zeroed;
use std::os::fd::IntoRawFd as _;
use std::os::unix::process::ExitStatusExt as _;
use std::process::ExitStatus;
use std::ptr;
use std::sync::atomic::{AtomicI32, AtomicU8, Ordering};

use errors::output::say;
use errors::{FAILED, Failure, INTERRUPTED};
use rustix::fs::{MemfdFlags, memfd_create};
use rustix::io::retry_on_intr;
use rustix::process::{Pid, Signal, WaitOptions, set_parent_process_death_signal, waitpid};

use crate::crash;
use crate::process_exit::end_now;

/// Where the code of laws runs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum LawsRun {
    Here,
    /// Each question is asked in a child process, and the code runs in this one only when a law is made.
    AskedInChildren,
    /// This process goes on in a child process before it loads a law.
    InOneChild,
}

static LAWS_RUN: AtomicU8 = AtomicU8::new(LawsRun::Here as u8);

/// File in which the child that goes on notes its exit code; below 0, there is none.
static EXIT_CODE: AtomicI32 = AtomicI32::new(-1);

pub fn set_laws_run(place: LawsRun) {
    LAWS_RUN.store(place as u8, Ordering::Relaxed);
}

pub(crate) fn asks_children() -> bool {
    LAWS_RUN.load(Ordering::Relaxed) == LawsRun::AskedInChildren as u8
}

/// Signals that end the commands that go on in a child.
const ENDING: [i32; 4] = [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGQUIT];

/// Goes on in a child process where that is wanted, at the first call. The process that called waits for the child, and
/// ends with the exit code that the child has noted: an exit code alone may be a law's.
pub(crate) fn go_on_in_child() -> Result<(), Failure> {
    let wanted = LawsRun::InOneChild as u8;
    let here = LawsRun::Here as u8;
    if LAWS_RUN.compare_exchange(wanted, here, Ordering::Relaxed, Ordering::Relaxed) != Ok(wanted) {
        return Ok(());
    }
    let failed =
        |e: io::Error| Failure::failed(format!("cannot start a process for the laws: {e}"));
    let file = memfd_create("exit code", MemfdFlags::CLOEXEC).map_err(|e| failed(e.into()))?;
    let _ = io::stdout().flush();
    // SAFETY: a set is written before it is read; the one other thread, which may wait for the launcher's end, holds no lock.
    let (child, awaited) = unsafe {
        let (mut awaited, mut before): (libc::sigset_t, libc::sigset_t) = (zeroed(), zeroed());
        libc::sigemptyset(&raw mut awaited);
        for signal in ENDING.into_iter().chain([libc::SIGCHLD]) {
            libc::sigaddset(&raw mut awaited, signal);
        }
        libc::sigprocmask(libc::SIG_BLOCK, &raw const awaited, &raw mut before);
        let child = libc::fork();
        if child <= 0 {
            libc::sigprocmask(libc::SIG_SETMASK, &raw const before, ptr::null_mut());
        }
        (child, awaited)
    };
    if child == 0 {
        let _ = set_parent_process_death_signal(Some(Signal::TERM));
        EXIT_CODE.store(file.into_raw_fd(), Ordering::Relaxed);
        return Ok(());
    }
    let pid = Pid::from_raw(child.max(0)).ok_or_else(|| failed(io::Error::last_os_error()))?;
    let (status, was_interrupted) = await_end(pid, &awaited).map_err(failed)?;
    let mut noted = [0];
    let code = match rustix::io::pread(&file, &mut noted, 0) {
        Ok(1) => i32::from(noted[0]),
        _ if was_interrupted => i32::from(INTERRUPTED),
        _ => {
            let what = "the process that flew the laws ended before its work was done";
            let failure = Failure::failed(format!("{what}: {status}"));
            say(&failure
                .help("`ironbird laws FILE` tries a law by itself")
                .text());
            i32::from(FAILED)
        }
    };
    end_now(code)
}

/// Waits for a child, and passes on signals that other processes send to this one: those of a terminal reach both.
fn await_end(child: Pid, awaited: &libc::sigset_t) -> io::Result<(ExitStatus, bool)> {
    let mut was_interrupted = false;
    loop {
        if let Some((_, status)) = waitpid(Some(child), WaitOptions::NOHANG)? {
            return Ok((ExitStatus::from_raw(status.as_raw()), was_interrupted));
        }
        // SAFETY: the system writes the information before it is read.
        let (signal, info) = unsafe {
            let mut info: libc::siginfo_t = zeroed();
            (libc::sigwaitinfo(awaited, &raw mut info), info)
        };
        if ENDING.contains(&signal) {
            was_interrupted = true;
            if info.si_code <= 0 {
                // SAFETY: a call with two numbers; the child was not waited for.
                unsafe { libc::kill(child.as_raw_nonzero().get(), signal) };
            }
        }
    }
}

/// Notes the exit code, if this is the child that went on.
pub(crate) fn note_exit_code(code: u8) {
    let file = EXIT_CODE.load(Ordering::Relaxed);
    if file >= 0 {
        // SAFETY: the file stays open until the process ends, and one byte is read.
        unsafe { libc::pwrite(file, [code].as_ptr().cast(), 1, 0) };
    }
}

/// Asks a law, in a child process where that is wanted.
pub fn ask(
    law: &str,
    question: impl FnOnce() -> Result<String, Failure>,
) -> Result<String, Failure> {
    if !asks_children() {
        return question();
    }
    let failed =
        |e: io::Error| Failure::failed(format!("{law}: cannot start a process for it: {e}"));
    // It has no name. An exit code would not do: it may be the law's.
    let file = memfd_create("answer", MemfdFlags::CLOEXEC).map_err(|e| failed(e.into()))?;
    let mut file = File::from(file);
    // SAFETY: settings are read before this process starts threads; those of an observer hold no lock that the child needs.
    let child = unsafe { libc::fork() };
    if child == 0 {
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
        let answer = serde_json::to_vec(&question()).unwrap_or_default();
        // Without an answer, the parent names the law.
        let _ = file.write_all(&answer);
        crash::leave(0, Vec::new());
        end_now(0);
    }
    let pid = Pid::from_raw(child.max(0)).ok_or_else(|| failed(io::Error::last_os_error()))?;
    let ended = retry_on_intr(|| waitpid(Some(pid), WaitOptions::empty()));
    let ended = ended.map_err(|e| failed(e.into()))?;
    let status = ExitStatus::from_raw(ended.map_or(0, |(_, status)| status.as_raw()));
    let answer = file.rewind().and_then(|()| io::read_to_string(file));
    serde_json::from_str(&answer.map_err(failed)?).unwrap_or_else(|_| {
        let what = "the process that asked it ended without an answer";
        Err(Failure::failed(format!("{law}: {what}: {status}")))
    })
}
