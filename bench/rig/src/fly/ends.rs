//! The ends of processes, which end a wait at once.

use std::os::fd::{AsFd as _, OwnedFd};
use std::process::Child;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use wire::clock::{now_ns, timespec};

/// Processes whose ends are waited for: a descriptor of each, which the kernel makes readable when it has ended.
#[derive(Default)]
pub(super) struct Ends(Vec<(u32, OwnedFd)>);

impl Ends {
    /// Has a wait end with this process. Where the system has no such descriptor (before Linux 5.3) or no more, its end
    /// is found at the next look.
    pub(super) fn watch(&mut self, child: &Child) {
        let end = number_of(child).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        self.0.extend(end.map(|end| (child.id(), end)));
    }

    /// Forgets a process that was reaped.
    pub(super) fn forget(&mut self, pid: u32) {
        self.0.retain(|(known, _)| *known != pid);
    }

    /// Waits until an instant, or until one of the processes has ended; whether one has. A signal may end it early.
    ///
    /// An end ends one wait: one that cannot be reaped, as under a debugger, is found at the looks that follow.
    pub(super) fn wait_until(&mut self, instant_ns: u64) -> bool {
        let mut ends: Vec<_> = self.0.iter().map(readable).collect();
        let time = timespec(instant_ns.saturating_sub(now_ns()));
        if !poll(&mut ends, Some(&time)).is_ok_and(|ended| ended > 0) {
            return false;
        }
        let mut has_ended = ends.iter().map(|end| !end.revents().is_empty()).collect::<Vec<_>>().into_iter();
        self.0.retain(|_| !has_ended.next().unwrap_or(false));
        true
    }
}

fn readable((_, end): &(u32, OwnedFd)) -> PollFd<'_> {
    PollFd::from_borrowed_fd(end.as_fd(), PollFlags::IN)
}

/// The number of a process, and of its group.
pub(super) fn number_of(child: &Child) -> Option<Pid> {
    i32::try_from(child.id()).ok().and_then(Pid::from_raw)
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn a_wait_ends_with_a_process_and_without_one_at_its_instant() {
        let mut child = Command::new("sleep").arg("600").spawn().unwrap();
        let mut ends = Ends::default();
        ends.watch(&child);
        let soon = now_ns() + 20_000_000;
        assert!(!ends.wait_until(soon) && now_ns() >= soon, "it lives");
        child.kill().unwrap();
        let late = now_ns() + 60_000_000_000;
        assert!(ends.wait_until(late) && now_ns() < late);
        assert!(!ends.wait_until(now_ns() + 1_000_000), "nobody has reaped it yet, and no wait spins on it");
        child.wait().unwrap();
    }
}
