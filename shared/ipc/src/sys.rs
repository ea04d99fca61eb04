//! The only `unsafe` code of this crate: event memory, timers, payloads, signal masks, locks beside forks.
#![allow(
    unsafe_code,
    reason = "the one module of the crate where it is allowed; every use says why it is sound"
)]

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::os::fd::{AsFd, AsRawFd as _, BorrowedFd};
use std::ptr::NonNull;
use std::sync::Once;
use std::sync::atomic::{AtomicI32, AtomicU32, AtomicU64, Ordering};

use iceoryx2::prelude::ZeroCopySend;
use messages::check_word::check_word;
use messages::inspection::Reason;
use messages::layout::{Layout, Plain, words};
use rustix::fs::{FlockOperation, flock, fstat};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use rustix::time::Timespec;
use signal_hook::SigId;

/// A value as it travels through shared memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(transparent)]
pub struct Payload<T>(pub T);

// SAFETY: what is `Plain` consists of numbers alone: no pointer, no handle, nothing to drop.
unsafe impl<T: Plain> ZeroCopySend for Payload<T> {}

/// Numbers as they travel through shared memory, with a check word over all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Sealed<T> {
    content: T,
    check: u64,
}

// SAFETY: what has a layout is `Plain`, and a number stands behind it.
unsafe impl<T: Layout> ZeroCopySend for Sealed<T> {}

impl<T: Layout> Sealed<T> {
    #[inline]
    pub fn new(content: T) -> Self {
        Self {
            check: check_word(words(&content)),
            content,
        }
    }

    /// The content, if its check word is right. Call it on a copy: shared memory may change after the check.
    #[inline]
    pub fn open(&self) -> Result<&T, Reason> {
        if check_word(words(&self.content)) == self.check {
            Ok(&self.content)
        } else {
            Err(Reason::Checksum)
        }
    }
}

/// A futex with a number to hand over; alone on its cache line.
#[derive(Debug)]
#[repr(C, align(64))]
pub struct WakeWord {
    /// Counts notifications: the word to wait on.
    pub count: AtomicU32,
    /// Counts notifications of a warm-up run.
    pub rehearsals: AtomicU32,
    pub token: AtomicU64,
    /// The tick after the newest one without a message of the role before; 0 is none.
    pub silent: AtomicU64,
    /// 1 while the owner reads `count` in a loop, so that a notification needs no system call.
    pub polled: AtomicU32,
}

pub const EVENTS: usize = 64;

#[derive(Debug)]
pub struct WakePage {
    page: NonNull<[WakeWord; EVENTS]>,
}

impl WakePage {
    pub const BYTES: usize = size_of::<[WakeWord; EVENTS]>();

    /// Maps a memory file of at least [`Self::BYTES`], which no process may shrink, and touches it.
    pub fn map(file: BorrowedFd<'_>) -> io::Result<Self> {
        if fstat(file)?.st_size.unsigned_abs() < Self::BYTES as u64 {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "not a memory file for a page of wake-up events",
            ));
        }
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping at an address of the kernel's choice touches no memory of ours.
        let page = unsafe {
            mmap(
                std::ptr::null_mut(),
                Self::BYTES,
                protection,
                MapFlags::SHARED | MapFlags::POPULATE,
                file,
                0,
            )
        }?;
        let page = NonNull::new(page.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { page })
    }
}

impl Deref for WakePage {
    type Target = [WakeWord; EVENTS];

    fn deref(&self) -> &Self::Target {
        // SAFETY: the mapping lives as long as `self`, its file does not shrink, a page's address is aligned for
        // `WakeWord`, and every content is a valid one of its atomics, which other processes may change at any time.
        unsafe { self.page.as_ref() }
    }
}

// SAFETY: a shared mapping of atomics, which any thread may use and any one may unmap.
unsafe impl Send for WakePage {}
// SAFETY: as above.
unsafe impl Sync for WakePage {}

impl Drop for WakePage {
    fn drop(&mut self) {
        // SAFETY: the range was mapped by `map`, and references to it ended with the borrow of `self`.
        let _ = unsafe { munmap(self.page.as_ptr().cast(), Self::BYTES) };
    }
}

/// A timer of the kernel that notifies the thread that created it.
///
/// It does so from a signal handler, so that a thread that waits on the event's word sees it change, or is interrupted.
#[derive(Debug)]
pub struct Alarm {
    timer: libc::timer_t,
    handler: SigId,
}

impl Alarm {
    /// The signal that it uses up: a process has one alarm.
    const SIGNAL: i32 = libc::SIGALRM;

    /// A timer that is not set, for an event of a page and the calling thread.
    pub fn new(page: WakePage, place: usize) -> io::Result<Self> {
        let notify = move || {
            page[place].count.fetch_add(1, Ordering::Release);
        };
        // A mask is inherited through exec: the parent process may have blocked the signal.
        mask_signals(libc::SIG_UNBLOCK, &[Self::SIGNAL])?;
        // SAFETY: adding to an atomic is all that the handler does; it neither allocates nor locks nor panics.
        let handler = unsafe { signal_hook::low_level::register(Self::SIGNAL, notify) }?;
        let mut timer = std::ptr::null_mut();
        // SAFETY: all zeroes are a valid sigevent; the pointers are to live values, of which the call keeps none.
        let made = check(unsafe {
            let mut event: libc::sigevent = std::mem::zeroed();
            event.sigev_notify = libc::SIGEV_THREAD_ID;
            event.sigev_signo = Self::SIGNAL;
            event.sigev_notify_thread_id = rustix::thread::gettid().as_raw_pid();
            libc::timer_create(libc::CLOCK_MONOTONIC, &raw mut event, &raw mut timer)
        });
        if let Err(e) = made {
            signal_hook::low_level::unregister(handler);
            return Err(e);
        }
        Ok(Self { timer, handler })
    }

    /// Sets it to an instant on CLOCK_MONOTONIC, replacing the previous one. A past instant notifies at once.
    pub fn set(&self, instant: Timespec) -> io::Result<()> {
        let time = |tv_sec, tv_nsec| libc::timespec { tv_sec, tv_nsec };
        // An instant of zero would switch it off.
        let tv_nsec = instant.tv_nsec.max(libc::c_long::from(instant.tv_sec == 0));
        let once = libc::itimerspec {
            it_interval: time(0, 0),
            it_value: time(instant.tv_sec, tv_nsec),
        };
        // SAFETY: the timer lives as long as `self`; the pointer is to a live value, of which the call keeps nothing.
        check(unsafe {
            libc::timer_settime(
                self.timer,
                libc::TIMER_ABSTIME,
                &raw const once,
                std::ptr::null_mut(),
            )
        })
    }
}

impl Drop for Alarm {
    fn drop(&mut self) {
        // SAFETY: the timer was made by `new`, and is not used after this.
        unsafe { libc::timer_delete(self.timer) };
        signal_hook::low_level::unregister(self.handler);
    }
}

/// Changes the calling thread's signal mask: `how` is SIG_BLOCK, SIG_UNBLOCK or SIG_SETMASK.
pub fn mask_signals(how: i32, signals: &[i32]) -> io::Result<()> {
    let mut set = std::mem::MaybeUninit::<libc::sigset_t>::zeroed();
    // SAFETY: the pointers are to memory for one signal set, which the first call fills; a mask is set, none is read.
    let failed = unsafe {
        libc::sigemptyset(set.as_mut_ptr());
        for signal in signals {
            libc::sigaddset(set.as_mut_ptr(), *signal);
        }
        libc::pthread_sigmask(how, set.as_ptr(), std::ptr::null_mut())
    };
    if failed == 0 {
        Ok(())
    } else {
        Err(io::Error::from_raw_os_error(failed))
    }
}

/// The outcome of a system call that returns 0, or -1 and an error number.
pub fn check(result: i32) -> io::Result<()> {
    if result == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

const LOCKED: usize = 1024;

/// Descriptors that hold locks; -1 marks a free place.
static LOCKS: [AtomicI32; LOCKED] = [const { AtomicI32::new(-1) }; LOCKED];

/// A locked file whose lock ends with this process, even if the process forks: a child shares the open file, and
/// would otherwise keep it locked.
#[derive(Debug)]
pub struct Locked {
    file: File,
    place: usize,
}

impl Locked {
    /// Keeps a file that has been locked. Fails if the process holds too many locks.
    pub fn new(file: File) -> io::Result<Self> {
        static CLOSES: Once = Once::new();
        // SAFETY: the function lives as long as the process, and makes system calls alone.
        CLOSES.call_once(|| unsafe {
            libc::pthread_atfork(None, None, Some(close_locks));
        });
        let descriptor = file.as_raw_fd();
        let take = |place: &AtomicI32| {
            place
                .compare_exchange(-1, descriptor, Ordering::AcqRel, Ordering::Relaxed)
                .is_ok()
        };
        let full = || io::Error::other(format!("this process already holds {LOCKED} locks"));
        let place = LOCKS.iter().position(take).ok_or_else(full)?;
        Ok(Self { file, place })
    }
}

impl AsFd for Locked {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl Drop for Locked {
    fn drop(&mut self) {
        // A child that another thread forks before the file is closed inherits an unlocked file. If unlocking fails,
        // closing the file still unlocks it.
        let _ = flock(&self.file, FlockOperation::Unlock);
        // Before the file is closed, because its number may then be another file's.
        LOCKS[self.place].store(-1, Ordering::Release);
    }
}

/// In a child that was forked: the parent's descriptor goes on holding the lock.
extern "C" fn close_locks() {
    for lock in &LOCKS {
        let file = lock.swap(-1, Ordering::AcqRel);
        if file >= 0 {
            // SAFETY: the child has a copy of the descriptor, of which nothing in it makes use: it holds a lock.
            unsafe { libc::close(file) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_lock_is_free_even_if_a_child_has_inherited_its_file() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("lock");
        let file = File::create(&path).unwrap();
        flock(&file, FlockOperation::NonBlockingLockExclusive).unwrap();
        let locked = Locked::new(file).unwrap();
        let other = File::open(&path).unwrap();
        let is_free = || flock(&other, FlockOperation::NonBlockingLockExclusive).is_ok();
        // Like a fork, a duplicate shares the open file.
        let inherited = locked.as_fd().try_clone_to_owned().unwrap();
        assert!(!is_free());
        drop(locked);
        assert!(is_free());
        drop(inherited);
    }
}
