//! System calls that no safe crate offers.
#![allow(unsafe_code, reason = "system calls; every use says why it is sound")]

use std::io;
use std::os::unix::process::CommandExt as _;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use ipc::sys::check;
use messages::grid::NS_PER_S;
use messages::realtime::Usage;
use rustix::mm::{Advice, madvise};
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

/// Starts a process that has this one's memory and open files, and lives until the calling thread has ended; returns its
/// number.
///
/// The kernel gives back memory and files in the last process that has them, on its processor and at its priority. Of a
/// SCHED_FIFO process that is killed, this would hold up the loops on its processor for some milliseconds. So the other one,
/// which is under SCHED_OTHER and on the processors that the caller has now, is the last.
pub(super) fn start_releaser() -> io::Result<i32> {
    const STACK_BYTES: usize = 16 << 10;
    // The process has its stack as long as it has this memory.
    let stack: &'static mut [u128] = Box::leak(vec![0; STACK_BYTES / size_of::<u128>()].into());
    let flags = libc::CLONE_VM | libc::CLONE_FILES | libc::CLONE_FS | libc::SIGCHLD;
    // SAFETY: the function below uses a stack of its own, which grows down from its end, and nothing else of this process's
    // memory; it makes system calls alone, which touch the shared error number only if they fail.
    let started = unsafe {
        let top = stack.as_mut_ptr_range().end.cast();
        let parent = std::ptr::without_provenance_mut(libc::getpid().unsigned_abs() as usize);
        libc::clone(release_last, top, flags, parent)
    };
    match started {
        -1 => Err(io::Error::last_os_error()),
        number => Ok(number),
    }
}

/// Waits for the death of its parent; `parent` is its process number.
extern "C" fn release_last(parent: *mut libc::c_void) -> libc::c_int {
    // SAFETY: every call takes numbers, or a pointer to a live value on this stack.
    unsafe {
        let mut all = std::mem::MaybeUninit::<libc::sigset_t>::zeroed().assume_init();
        libc::sigfillset(&raw mut all);
        libc::sigprocmask(libc::SIG_BLOCK, &raw const all, std::ptr::null_mut());
        libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL);
        libc::prctl(libc::PR_SET_NAME, c"ironbird release".as_ptr());
        while libc::getppid().unsigned_abs() as usize == parent.addr() {
            libc::pause();
        }
    }
    0
}

pub(super) fn thread_number() -> i32 {
    rustix::thread::gettid().as_raw_pid()
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

/// Has a program that is not ours be killed with the thread that starts it, also while it is stopped; wake up within 1 ns of
/// its timers; and run under SCHED_FIFO with a priority above 0, where the kernel permits it.
pub fn prepare_child(command: &mut Command, priority: i32) -> &mut Command {
    let set_up = move || {
        // SAFETY: the calls take numbers alone.
        unsafe {
            check(libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL))?;
            check(libc::prctl(libc::PR_SET_TIMERSLACK, 1))?;
        }
        if priority > 0 {
            let _ = set_scheduler(0, libc::SCHED_FIFO, priority);
        }
        Ok(())
    };
    // SAFETY: between fork and exec this makes system calls alone, and allocates nothing.
    unsafe { command.pre_exec(set_up) }
}

/// Whether this process ignores a signal, as its parent may have wanted it to.
pub(crate) fn is_ignored(signal: i32) -> bool {
    let mut action = std::mem::MaybeUninit::<libc::sigaction>::zeroed();
    // SAFETY: the pointer is to memory for one sigaction, for which all zeroes are a valid value.
    let action = unsafe {
        libc::sigaction(signal, std::ptr::null(), action.as_mut_ptr());
        action.assume_init()
    };
    action.sa_sigaction == libc::SIG_IGN
}

/// Gives a signal that is ignored its default action back; one that has a handler keeps it.
pub(crate) fn no_longer_ignore(signal: i32) -> io::Result<()> {
    // SAFETY: the default action runs no code of ours.
    if is_ignored(signal) && unsafe { libc::signal(signal, libc::SIG_DFL) } == libc::SIG_ERR {
        return Err(io::Error::last_os_error());
    }
    Ok(())
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

/// How pages are made present: read, or as writing them would, with the content unchanged.
pub(super) const READ: Advice = Advice::LinuxPopulateRead;
pub(super) const WRITE: Advice = Advice::LinuxPopulateWrite;

/// Makes every page of an address range present, without the SIGBUS of a full /dev/shm.
pub(super) fn populate(start: usize, length: usize, touch: Advice) -> io::Result<()> {
    let address = std::ptr::with_exposed_provenance_mut(start);
    // SAFETY: neither advice changes content; a range that is not mapped is an error, not a fault.
    Ok(unsafe { madvise(address, length, touch) }?)
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
