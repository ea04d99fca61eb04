//! System calls that no safe crate offers.
#![allow(unsafe_code, reason = "system calls; every use says why it is sound")]

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use ipc::sys::check;
use messages::grid::NS_PER_S;
use messages::realtime::Usage;
use signal_hook::SigId;

pub(super) fn set_fifo(priority: i32) -> io::Result<()> {
    set_scheduler(0, libc::SCHED_FIFO, priority)
}

/// Puts the calling thread under SCHED_FIFO at its lowest priority; what it starts is under SCHED_OTHER, now and later.
pub(super) fn set_lowest_fifo() -> io::Result<()> {
    set_scheduler(0, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, 1)
}

/// Puts a thread of this process, or with 0 the calling one, back under SCHED_OTHER, which is always permitted.
pub(super) fn set_other(thread: i32) -> io::Result<()> {
    set_scheduler(thread, libc::SCHED_OTHER, 0)
}

fn set_scheduler(thread: i32, policy: i32, priority: i32) -> io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    // SAFETY: the call takes a number alone.
    let now = unsafe { libc::sched_getscheduler(thread) };
    // Without CAP_SYS_NICE a process may not clear this flag: a call that leaves it out would be refused.
    let kept = if now < 0 {
        0
    } else {
        now & libc::SCHED_RESET_ON_FORK
    };
    let policy = policy | kept;
    // SAFETY: the pointer is to a live, initialised sched_param; the call keeps none of it.
    check(unsafe { libc::sched_setscheduler(thread, policy, &raw const parameters) })
}

pub(super) fn scheduler() -> io::Result<(i32, i32)> {
    let mut parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: the pointer is to a live sched_param that the call fills; pid 0 is the caller.
    let (policy, read) = unsafe {
        (
            libc::sched_getscheduler(0),
            libc::sched_getparam(0, &raw mut parameters),
        )
    };
    if policy < 0 {
        return Err(io::Error::last_os_error());
    }
    check(read)?;
    Ok((
        policy & !libc::SCHED_RESET_ON_FORK,
        parameters.sched_priority,
    ))
}

pub(super) fn thread_number() -> i32 {
    // SAFETY: the call takes nothing, and cannot fail.
    unsafe { libc::gettid() }
}

/// The thread of this process whose loop is under SCHED_FIFO; 0 while there is none.
pub(super) static LOOP_THREAD: AtomicI32 = AtomicI32::new(0);

/// Ends the process at once, with `code`, when `signal` comes and `flag` is set. The destructors that would give real
/// time back do not run then, so the handler does that itself.
pub(crate) fn exit_when_signalled(
    signal: i32,
    code: i32,
    flag: &Arc<AtomicBool>,
) -> io::Result<SigId> {
    let flag = Arc::clone(flag);
    let exit = move || {
        if flag.load(Ordering::SeqCst) {
            let thread = LOOP_THREAD.load(Ordering::SeqCst);
            if thread != 0 {
                let _ = set_other(thread);
            }
            signal_hook::low_level::exit(code);
        }
    };
    // SAFETY: the handler reads two atomics and makes two system calls; it neither allocates nor locks nor panics.
    unsafe { signal_hook::low_level::register(signal, exit) }
}

/// Gives a signal that is ignored its default action back; one that has a handler keeps it.
pub(crate) fn no_longer_ignore(signal: i32) -> io::Result<()> {
    let mut action = std::mem::MaybeUninit::<libc::sigaction>::zeroed();
    // SAFETY: the pointers are to memory for one sigaction, for which all zeroes are a valid value; the default action
    // runs no code of ours.
    unsafe {
        check(libc::sigaction(
            signal,
            std::ptr::null(),
            action.as_mut_ptr(),
        ))?;
        let mut action = action.assume_init();
        if action.sa_sigaction != libc::SIG_IGN {
            return Ok(());
        }
        action.sa_sigaction = libc::SIG_DFL;
        check(libc::sigaction(
            signal,
            &raw const action,
            std::ptr::null_mut(),
        ))
    }
}

/// Keeps freed memory: malloc neither trims the heap nor maps large blocks one by one.
#[cfg(target_env = "gnu")]
pub(super) fn keep_freed_memory() -> io::Result<()> {
    // SAFETY: mallopt takes plain numbers, and takes the allocator's own lock against other threads.
    let granted = unsafe {
        libc::mallopt(libc::M_TRIM_THRESHOLD, -1) == 1 && libc::mallopt(libc::M_MMAP_MAX, 0) == 1
    };
    if granted {
        Ok(())
    } else {
        Err(io::Error::from(io::ErrorKind::Unsupported))
    }
}

#[cfg(not(target_env = "gnu"))]
pub(super) fn keep_freed_memory() -> io::Result<()> {
    Err(io::Error::from(io::ErrorKind::Unsupported))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Touch {
    Read,
    /// As writing them would, with the content unchanged.
    Write,
}

/// Makes every page of an address range present, without the SIGBUS of a full /dev/shm.
pub(super) fn populate(start: usize, length: usize, touch: Touch) -> io::Result<()> {
    let advice = match touch {
        Touch::Read => libc::MADV_POPULATE_READ,
        Touch::Write => libc::MADV_POPULATE_WRITE,
    };
    let address = std::ptr::with_exposed_provenance_mut(start);
    // SAFETY: neither advice changes content; a range that is not mapped is an error, not a fault.
    check(unsafe { libc::madvise(address, length, advice) })
}

/// What the calling thread has used so far, without its allocations.
pub(super) fn thread_usage() -> Usage {
    let mut usage = std::mem::MaybeUninit::<libc::rusage>::zeroed();
    // SAFETY: the pointer is to memory for one rusage, for which all zeroes are a valid value.
    let usage = unsafe {
        libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr());
        usage.assume_init()
    };
    let ns = |time: libc::timeval| {
        time.tv_sec.unsigned_abs() * NS_PER_S + time.tv_usec.unsigned_abs() * 1_000
    };
    Usage {
        minor_faults: usage.ru_minflt.unsigned_abs(),
        major_faults: usage.ru_majflt.unsigned_abs(),
        voluntary_switches: usage.ru_nvcsw.unsigned_abs(),
        involuntary_switches: usage.ru_nivcsw.unsigned_abs(),
        allocations: 0,
        cpu_ns: ns(usage.ru_utime) + ns(usage.ru_stime),
    }
}
