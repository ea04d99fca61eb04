//! The system calls and allocator hooks that safe crates do not offer: the project's only `unsafe` code.
#![allow(unsafe_code, reason = "the one module where it is allowed; every use says why it is sound")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::io;
use std::ops::Deref;
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use rustix::fs::fstat;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use rustix::time::Timespec;
use signal_hook::SigId;

/// Puts the calling thread under SCHED_FIFO.
///
/// # Errors
/// EPERM without CAP_SYS_NICE or a sufficient RLIMIT_RTPRIO, or in a cpu cgroup without a real-time budget.
pub(super) fn set_fifo(priority: i32) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: the pointer is to a live, initialised sched_param; the call keeps none of it.
    check(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })
}

/// The scheduling policy and priority of the calling thread.
pub(super) fn scheduler() -> (i32, i32) {
    let mut parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: the pointer is to a live sched_param that the call fills; pid 0 is the caller.
    unsafe {
        let policy = libc::sched_getscheduler(0);
        libc::sched_getparam(0, &raw mut parameters);
        (policy, parameters.sched_priority)
    }
}

/// Keeps freed memory: malloc neither trims the heap nor maps large blocks one by one.
///
/// # Errors
/// Refused by a C library that does not know the options.
#[cfg(target_env = "gnu")]
pub(super) fn keep_freed_memory() -> io::Result<()> {
    // SAFETY: mallopt takes plain numbers; it is called before the process has a second thread that allocates.
    let granted = unsafe { libc::mallopt(libc::M_TRIM_THRESHOLD, -1) == 1 && libc::mallopt(libc::M_MMAP_MAX, 0) == 1 };
    if granted { Ok(()) } else { Err(io::Error::from(io::ErrorKind::Unsupported)) }
}

#[cfg(not(target_env = "gnu"))]
pub(super) fn keep_freed_memory() -> io::Result<()> {
    Err(io::Error::from(io::ErrorKind::Unsupported))
}

/// How the pages of an address range are to be made present.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Touch {
    /// As reading them would.
    Read,
    /// As writing them would, with the content unchanged.
    Write,
}

/// Makes every page of an address range present, without the SIGBUS of a full /dev/shm.
///
/// # Errors
/// ENOMEM or EFAULT when memory runs out; EINVAL before Linux 5.14 or for a mapping that cannot be populated.
pub(super) fn populate(start: usize, length: usize, touch: Touch) -> io::Result<()> {
    let advice = match touch {
        Touch::Read => libc::MADV_POPULATE_READ,
        Touch::Write => libc::MADV_POPULATE_WRITE,
    };
    let address = std::ptr::with_exposed_provenance_mut(start);
    // SAFETY: neither advice changes content; a range that is not mapped is an error, not a fault.
    check(unsafe { libc::madvise(address, length, advice) })
}

/// Page faults and context switches of the calling thread so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Usage {
    pub(super) minor_faults: u64,
    pub(super) major_faults: u64,
    pub(super) voluntary_switches: u64,
    pub(super) involuntary_switches: u64,
    pub(super) cpu_ns: u64,
}

/// Resource usage of the calling thread.
pub(super) fn thread_usage() -> Usage {
    let mut usage = std::mem::MaybeUninit::<libc::rusage>::zeroed();
    // SAFETY: the pointer is to memory for one rusage, for which all zeroes are a valid value.
    let usage = unsafe {
        libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr());
        usage.assume_init()
    };
    let ns = |time: libc::timeval| time.tv_sec.unsigned_abs() * 1_000_000_000 + time.tv_usec.unsigned_abs() * 1_000;
    Usage {
        minor_faults: usage.ru_minflt.unsigned_abs(),
        major_faults: usage.ru_majflt.unsigned_abs(),
        voluntary_switches: usage.ru_nvcsw.unsigned_abs(),
        involuntary_switches: usage.ru_nivcsw.unsigned_abs(),
        cpu_ns: ns(usage.ru_utime) + ns(usage.ru_stime),
    }
}

/// A futex with a number to hand over; alone on its cache line.
#[derive(Debug)]
#[repr(C, align(64))]
pub struct Bell {
    /// Grows with every ring: the word to wait on.
    pub rung: AtomicU32,
    /// What is handed over.
    pub token: AtomicU64,
}

/// Bells of a page.
pub const BELLS: usize = 64;

/// A page of bells that processes share.
#[derive(Debug)]
pub struct BellPage {
    page: NonNull<[Bell; BELLS]>,
}

impl BellPage {
    /// Bytes that its file must have.
    pub const BYTES: usize = size_of::<[Bell; BELLS]>();

    /// Maps a memory file of at least [`Self::BYTES`], which nobody may shrink, and touches it.
    ///
    /// # Errors
    /// `InvalidInput` for a shorter file; what the system says.
    pub fn map(file: BorrowedFd<'_>) -> io::Result<Self> {
        if fstat(file)?.st_size.unsigned_abs() < Self::BYTES as u64 {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a memory file for a page of bells"));
        }
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping at an address of the kernel's choice touches no memory of ours.
        let page = unsafe {
            mmap(std::ptr::null_mut(), Self::BYTES, protection, MapFlags::SHARED | MapFlags::POPULATE, file, 0)
        }?;
        let page = NonNull::new(page.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { page })
    }
}

impl Deref for BellPage {
    type Target = [Bell; BELLS];

    fn deref(&self) -> &Self::Target {
        // SAFETY: the mapping lives as long as `self`, its file does not shrink, a page's address is aligned for `Bell`,
        // and every content is a valid one of its atomics, which other processes may change at any time.
        unsafe { self.page.as_ref() }
    }
}

// SAFETY: a shared mapping of atomics, which any thread may use and any one may unmap.
unsafe impl Send for BellPage {}
// SAFETY: as above.
unsafe impl Sync for BellPage {}

impl Drop for BellPage {
    fn drop(&mut self) {
        // SAFETY: the range was mapped by `map`, and references to it ended with the borrow of `self`.
        let _ = unsafe { munmap(self.page.as_ptr().cast(), Self::BYTES) };
    }
}

/// A timer of the kernel that rings a bell for the thread that made it.
///
/// It does so from a signal handler, so that whoever waits on the bell's word sees it change, or is interrupted.
#[derive(Debug)]
pub struct Alarm {
    timer: libc::timer_t,
    handler: SigId,
}

impl Alarm {
    /// The signal that it uses up: a process has one alarm.
    const SIGNAL: i32 = libc::SIGALRM;

    /// A timer that is not set, for a bell of a page and the calling thread.
    ///
    /// # Errors
    /// EAGAIN where the user has too many timers or signals queued.
    pub fn new(page: BellPage, place: usize) -> io::Result<Self> {
        let ring = move || {
            page[place].rung.fetch_add(1, Ordering::Release);
        };
        // SAFETY: adding to an atomic is all that the handler does; it neither allocates nor locks nor panics.
        let handler = unsafe { signal_hook::low_level::register(Self::SIGNAL, ring) }?;
        let mut timer = std::ptr::null_mut();
        // SAFETY: all zeroes are a valid sigevent; the pointers are to live values, of which the call keeps none.
        let made = check(unsafe {
            let mut event: libc::sigevent = std::mem::zeroed();
            event.sigev_notify = libc::SIGEV_THREAD_ID;
            event.sigev_signo = Self::SIGNAL;
            event.sigev_notify_thread_id = libc::gettid();
            libc::timer_create(libc::CLOCK_MONOTONIC, &raw mut event, &raw mut timer)
        });
        if let Err(e) = made {
            signal_hook::low_level::unregister(handler);
            return Err(e);
        }
        Ok(Self { timer, handler })
    }

    /// Sets it to an instant on CLOCK_MONOTONIC, and no longer to the one before; one that is past rings at once.
    ///
    /// # Errors
    /// What the system says.
    pub fn set(&self, instant: Timespec) -> io::Result<()> {
        // An instant of zero would switch it off.
        let tv_nsec = instant.tv_nsec.max(libc::c_long::from(instant.tv_sec == 0));
        let it_value = libc::timespec { tv_sec: instant.tv_sec, tv_nsec };
        let once = libc::itimerspec { it_interval: libc::timespec { tv_sec: 0, tv_nsec: 0 }, it_value };
        // SAFETY: the timer lives as long as `self`; the pointer is to a live value, of which the call keeps nothing.
        check(unsafe { libc::timer_settime(self.timer, libc::TIMER_ABSTIME, &raw const once, std::ptr::null_mut()) })
    }
}

impl Drop for Alarm {
    fn drop(&mut self) {
        // SAFETY: the timer was made by `new`, and is not used after this.
        unsafe { libc::timer_delete(self.timer) };
        signal_hook::low_level::unregister(self.handler);
    }
}

fn check(result: i32) -> io::Result<()> {
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// The system's allocator, counting the calls of each thread: the proof that a tick does not allocate.
#[derive(Debug)]
pub struct CountingAllocator;

thread_local! {
    // Const-initialised and without a destructor: counting never allocates itself.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// Allocations (and re-allocations) of the calling thread so far; 0 where the counter is not installed.
#[must_use]
pub fn thread_allocations() -> u64 {
    ALLOCATIONS.get()
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: promised by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: promised by the caller.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: promised by the caller.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: promised by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}
