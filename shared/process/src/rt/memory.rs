//! Makes the memory of the process present before its loop needs it.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::time::Duration;

use rustix::mm::Advice;

use super::sys;
use ipc::error::Error;
use ipc::instance::SHARED_MEMORY;

/// Touches everything mapped since the set-up: the last act before a loop is armed.
///
/// It does so without real time too: shared memory that has run out is an error here but a SIGBUS in flight. A kernel
/// without this call (before Linux 5.14) is no error: the pages come when they are touched, and the set-up has
/// reported `RealtimeStep::Prefault` as refused. What is `locked` is there.
pub fn settle(locked: Option<&BTreeSet<String>>) -> Result<(), Error> {
    settle_by(locked, sys::populate)
}

fn settle_by(
    locked: Option<&BTreeSet<String>>,
    populate: impl FnMut(usize, usize, Advice) -> io::Result<()>,
) -> Result<(), Error> {
    match populate_mappings(locked, populate) {
        Err(e) if e.raw_os_error() != Some(UNKNOWN) => Err(Error::system(
            "cannot make the memory of the process present (memory, or shared memory in /dev/shm, has run out)",
            e,
        )),
        _ => Ok(()),
    }
}

/// What is said of a kernel that does not know how to populate memory.
pub(super) const UNKNOWN: i32 = libc::ENOSYS;

/// Asks for a page of which it is certain that there is memory behind it: only a kernel that does not know the question
/// says then that it is wrong. Of any other range, the same answer speaks of the range.
fn ask_whether_known(
    populate: &mut impl FnMut(usize, usize, Advice) -> io::Result<()>,
) -> io::Result<()> {
    let page_bytes = rustix::param::page_size();
    let on_the_stack = 0_u8;
    let page = (&raw const on_the_stack).expose_provenance() & !(page_bytes - 1);
    match populate(page, page_bytes, sys::WRITE) {
        Err(e) if e.raw_os_error() == Some(libc::EINVAL) => {
            Err(io::Error::from_raw_os_error(UNKNOWN))
        }
        _ => Ok(()),
    }
}

/// Makes every page present that the process can write or read: its own ones, the shared ones of its ports, and
/// those that other processes write and it only reads. Those are left out that are `locked` already.
pub(super) fn populate_mappings(
    locked: Option<&BTreeSet<String>>,
    mut populate: impl FnMut(usize, usize, Advice) -> io::Result<()>,
) -> io::Result<()> {
    ask_whether_known(&mut populate)?;
    let is_new = |line: &&str| locked.is_none_or(|locked| !locked.contains(*line));
    for line in maps()?.lines().filter(is_new) {
        let Some((start, end, touch)) = mapping(line) else {
            continue;
        };
        // Another thread may give the range back, and take it again, while it is being touched.
        let mut tries = 0;
        while let Err(refused) = populate(start, end - start, touch) {
            if !maps()?.lines().any(|now| now == line) {
                break;
            }
            tries += 1;
            if tries == POPULATE_TRIES {
                return Err(refused);
            }
            std::thread::sleep(Duration::from_micros(100));
        }
    }
    Ok(())
}

/// What is touched of a segment that another process writes [bytes]: its sender uses the first places again and again, and
/// has touched all of it. A loop gives such a segment back in flight when its sender has died: each page costs time.
const READ_BYTES: usize = 512 << 10;

/// How often a range that is there is tried to be touched: memory that has run out stays so.
const POPULATE_TRIES: u32 = 100;

/// The mappings of this process, one a line; a path in them may be no UTF-8.
fn maps() -> io::Result<String> {
    fs::read("/proc/self/maps").map(|maps| String::from_utf8_lossy(&maps).into_owned())
}

pub(super) fn mappings() -> BTreeSet<String> {
    let maps = maps().unwrap_or_default();
    maps.lines().map(str::to_owned).collect()
}

/// Start, end and touch of a mapping in a line of /proc/self/maps.
fn mapping(line: &str) -> Option<(usize, usize, Advice)> {
    let (range, rest) = line.split_once(' ')?;
    let (start, end) = range.split_once('-')?;
    let address = |hex| usize::from_str_radix(hex, 16).ok();
    let (start, end, touch) = (address(start)?, address(end)?, touch(rest)?);
    let is_of_others = touch == sys::READ && rest.contains(SHARED_MEMORY);
    let end = if is_of_others {
        end.min(start + READ_BYTES)
    } else {
        end
    };
    Some((start, end, touch))
}

/// How to touch a mapping, by its line in /proc/self/maps from the permissions on.
fn touch(mapping: &str) -> Option<Advice> {
    let kernels = mapping
        .split_whitespace()
        .nth(4)
        .is_some_and(|name| name.starts_with('['));
    // The main thread's stack grows by itself down to its limit; what it needs was touched by `prefault_stack`.
    if mapping.starts_with("rw") {
        (!mapping.ends_with("[stack]")).then_some(sys::WRITE)
    } else {
        // The pages of the kernel, as of [vvar], are always there and cannot be populated.
        (mapping.starts_with('r') && !kernels).then_some(sys::READ)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::realtime::RealtimeStep;

    #[test]
    fn a_kernel_that_cannot_populate_memory_is_tolerated_and_a_refused_range_is_not() {
        let refusal = |errno| Err(io::Error::from_raw_os_error(errno));
        let mut calls = 0;
        let refused = populate_mappings(None, |_, _, _| {
            calls += 1;
            refusal(libc::EINVAL)
        });
        assert_eq!(refused.unwrap_err().raw_os_error(), Some(UNKNOWN));
        assert_eq!(calls, 1);
        settle_by(None, |_, _, _| refusal(libc::EINVAL)).unwrap();
        let remedy = crate::rt::remedy(RealtimeStep::Prefault, i64::from(UNKNOWN));
        assert!(remedy.contains("Linux 5.14"));
        let full = settle_by(None, |_, _, _| refusal(libc::ENOMEM)).unwrap_err();
        assert!(full.to_string().contains("/dev/shm"), "{full}");
        // A range that was refused once, because it changed meanwhile, is tried again; one that stays so is an error.
        for refusals in [1, usize::MAX] {
            let mut starts = Vec::new();
            let settled = settle_by(None, |start, length, touch| {
                starts.push(start);
                let is_second = starts.len() > 2 && start == starts[1];
                match starts.len() == 2 || is_second && refusals > 1 {
                    true => refusal(libc::EINVAL),
                    false => sys::populate(start, length, touch),
                }
            });
            assert_eq!(settled.is_ok(), refusals == 1);
            assert_eq!(starts[1], starts[2]);
        }
    }

    #[test]
    fn memory_is_touched_as_it_may_be() {
        let cases = [
            ("rw-p 0 00:00 0 [heap]", Some(sys::WRITE)),
            ("rw-s 0 00:19 12 /dev/shm/x.data", Some(sys::WRITE)),
            ("r--s 0 00:19 12 /dev/shm/x.data", Some(sys::READ)),
            ("r-xp 1000 08:01 12 /usr/bin/x", Some(sys::READ)),
            ("rw-p 0 00:00 0 [stack]", None),
            ("r--p 0 00:00 0 [vvar]", None),
            ("---p 0 00:00 0", None),
            ("rw-p 0 00:00 0", Some(sys::WRITE)),
        ];
        for (mapping, expected) in cases {
            assert_eq!(touch(mapping), expected, "{mapping}");
        }
    }

    #[test]
    fn all_memory_of_the_process_can_be_made_present_whatever_its_threads_give_back() {
        let done = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    std::thread::spawn(|| drop(vec![1_u8; 4 << 20]))
                        .join()
                        .unwrap();
                }
            });
            let settled = (0..50).try_for_each(|_| settle(None));
            done.store(true, std::sync::atomic::Ordering::Relaxed);
            settled.unwrap();
        });
    }
}
