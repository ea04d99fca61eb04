//! The steps of the real-time set-up: requested, granted, or refused and why.
//!
//! Each step is tried on its own, and none is skipped silently. A refusal is reported with its error number. It ends
//! the process only under [`Mode::Require`].

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::hint::black_box;
use std::io::{self, Write as _};
use std::num::NonZero;
use std::sync::atomic::Ordering;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity, set_current_timer_slack};

use super::memory::{UNKNOWN, mappings, populate_mappings, settle};
use super::sys;
use super::thread::{Raised, allowed_cpus, loop_processors, loops_cpu, prefault_stack};
use crate::wakes::place;
use errors::errno_text;
use ipc::error::Error;
use messages::realtime::{Grants, RealtimeMode, RealtimeSettings, RealtimeStep};
use messages::role::Role;

/// What the user may do when a step is refused with an error number.
pub fn remedy(step: RealtimeStep, errno: i64) -> &'static str {
    let not_permitted = errno == i64::from(libc::EPERM);
    match step {
        RealtimeStep::Scheduler if not_permitted && rustix::process::geteuid().is_root() => {
            "root is refused SCHED_FIFO where its cpu cgroup has no real-time budget: write one to \
                 cpu.rt_runtime_us of the cgroup, or start from the root cgroup"
        }
        RealtimeStep::Scheduler => {
            "start as root, give the executable CAP_SYS_NICE (setcap cap_sys_nice,cap_ipc_lock+ep), or raise \
                 the rtprio limit in /etc/security/limits.d and log in again"
        }
        RealtimeStep::Affinity => {
            "name a processor that this process may use: --cpu N (taskset -p $$ lists them)"
        }
        RealtimeStep::MemoryLock => {
            "start as root, give the executable CAP_IPC_LOCK, or raise the memlock limit in \
                 /etc/security/limits.d and log in again"
        }
        RealtimeStep::Malloc => "use a build for glibc",
        RealtimeStep::Prefault if errno == i64::from(UNKNOWN) => {
            "use Linux 5.14 or newer, which knows MADV_POPULATE_WRITE"
        }
        RealtimeStep::Prefault => "free memory, or enlarge /dev/shm",
        RealtimeStep::TimerSlack => "use a kernel that knows PR_SET_TIMERSLACK",
        RealtimeStep::CpuLatency => {
            "start as root, or let a group of yours write /dev/cpu_dma_latency (docs/measuring.md has the udev rule)"
        }
    }
}

/// What needs no privilege, and tells all but latencies.
pub const WITHOUT_ROOT: &str = "without root the same laws fly in lockstep (--pace lockstep), in slow motion \
                            (flight.slowdown), and in `ironbird simulate`";

/// The set-up as long as it is in force: a loop leaves SCHED_FIFO when this is dropped.
///
/// To be dropped before ports and shared memory are given up. The kernel takes locks for that, and a SCHED_FIFO process
/// that spins on one which a process below it on the same processor holds never ends, nor lets that one run.
#[derive(Debug)]
pub struct Engaged {
    pub grants: Grants,
    /// The thread that is under SCHED_FIFO by this set-up; 0 where it is not.
    loop_thread: i32,
    /// The kernel honours the wish for as long as the device is open.
    _cpu_latency: Option<File>,
}

impl Drop for Engaged {
    fn drop(&mut self) {
        if self.loop_thread != 0 {
            // A process may always put its own threads under SCHED_OTHER.
            let _ = sys::set_other(self.loop_thread);
            let _ = sys::LOOP_THREAD.compare_exchange(
                self.loop_thread,
                0,
                Ordering::SeqCst,
                Ordering::SeqCst,
            );
        }
    }
}

/// The part of the set-up that a standby does before it has ports.
#[derive(Debug)]
pub struct Ahead {
    /// Once activated, it waits for real-time threads only.
    _raised: Raised,
    grants: Grants,
    /// The role's processor.
    cpu: usize,
    /// The mappings that are locked, and so stay present.
    pub(crate) locked: BTreeSet<String>,
}

impl Ahead {
    /// Locks and touches the memory, and leaves the loops' processor: a standby costs the loops nothing.
    ///
    /// Refusals are reported with the rest of the set-up. Nothing without a set-up.
    pub fn prepare(role: Role, settings: &RealtimeSettings) -> Option<Self> {
        if settings.mode == RealtimeMode::Off {
            return None;
        }
        let mut grants = Grants::default();
        let (_, cpu) = cpus_for(role, settings);
        let (others, _) = cpus_for(Role::Record, settings);
        // Who has one processor alone waits on that one.
        let _ = sched_setaffinity(None, &others);
        hold_memory(&mut grants);
        let raised = Raised::now();
        let is_locked = grants.of(RealtimeStep::MemoryLock).granted();
        let locked = if is_locked {
            mappings()
        } else {
            BTreeSet::new()
        };
        // What ports map from now on is touched once, when the role arms, and not by each mapping too.
        let _ = mlockall(MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT);
        Some(Self {
            _raised: raised,
            grants,
            cpu,
            locked,
        })
    }

    /// Touches what ports have mapped since, away from the loops' processor.
    pub fn touch(&mut self) -> Result<(), Error> {
        settle(Some(&self.locked))?;
        if !self.locked.is_empty() {
            self.locked = mappings();
        }
        Ok(())
    }
}

/// Heap that is touched in advance [bytes]: far more than a loop's 48-byte loan ever needs.
const HEAP_BYTES: usize = 1 << 20;

impl Engaged {
    /// Requests everything that a role needs, but for what was done `ahead`. Call it after the ports were made.
    pub fn engage(
        role: Role,
        settings: &RealtimeSettings,
        ahead: Option<&Ahead>,
    ) -> Result<Self, Error> {
        let mut engaged = Self {
            grants: Grants::default(),
            loop_thread: 0,
            _cpu_latency: None,
        };
        if settings.mode != RealtimeMode::Off {
            engaged.ask(role, settings, ahead);
        }
        let (policy, priority) =
            sys::scheduler().map_err(|e| Error::system("cannot read the own scheduling", e))?;
        engaged.grants.policy = u64::from(policy.unsigned_abs());
        engaged.grants.priority = u64::from(priority.unsigned_abs());
        if settings.mode == RealtimeMode::Require {
            engaged.insist(role)?;
        }
        Ok(engaged)
    }

    fn ask(&mut self, role: Role, settings: &RealtimeSettings, ahead: Option<&Ahead>) {
        if let Some(ahead) = ahead {
            self.grants = ahead.grants;
        }
        let grants = &mut self.grants;
        let slack = set_current_timer_slack(NonZero::new(1)).map_err(Into::into);
        grants.note(RealtimeStep::TimerSlack, 1, errno(slack));
        let priority = settings.priority + role.priority_step();
        if ahead.is_some() {
            // So that it does not wait when it moves to the loops' processor. The result is noted below.
            let _ = sys::set_fifo(priority);
        }
        let (cpus, cpu) = match ahead {
            Some(ahead) => (only(ahead.cpu), ahead.cpu),
            None => cpus_for(role, settings),
        };
        let affinity = sched_setaffinity(None, &cpus).map_err(Into::into);
        grants.note(RealtimeStep::Affinity, cpu as u64, errno(affinity));
        if role == Role::Record {
            return;
        }
        if ahead.is_none() {
            hold_memory(grants);
        }
        let held = hold_cpu_latency().map(|file| self._cpu_latency = Some(file));
        grants.note(RealtimeStep::CpuLatency, 0, errno(held));
        let fifo = sys::set_fifo(priority);
        if fifo.is_ok() {
            self.loop_thread = sys::thread_number();
            sys::LOOP_THREAD.store(self.loop_thread, Ordering::SeqCst);
        }
        self.grants.note(
            RealtimeStep::Scheduler,
            u64::from(priority.unsigned_abs()),
            errno(fifo),
        );
    }

    fn insist(&self, role: Role) -> Result<(), Error> {
        let refused: Vec<RealtimeStep> = self
            .grants
            .refused()
            .filter(|step| step.required())
            .collect();
        if refused.is_empty() {
            return Ok(());
        }
        let mut remedies: Vec<_> = refused
            .iter()
            .map(|step| remedy(*step, self.grants.of(*step).errno))
            .collect();
        remedies.dedup();
        let word =
            |step: &RealtimeStep| format!("{step:?} ({})", errno_text(self.grants.of(*step).errno));
        Err(Error::RealtimeRefused {
            role,
            refused: refused.iter().map(word).collect::<Vec<_>>().join(", "),
            remedy: format!(
                "{}; or fly with what is granted: --rt prefer; {WITHOUT_ROOT}",
                remedies.join("; ")
            ),
        })
    }
}

fn hold_memory(grants: &mut Grants) {
    grants.note(RealtimeStep::Malloc, 0, errno(sys::keep_freed_memory()));
    let locked = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(Into::into);
    grants.note(RealtimeStep::MemoryLock, 0, errno(locked));
    prefault_stack();
    drop(black_box(vec![1_u8; HEAP_BYTES]));
    grants.note(
        RealtimeStep::Prefault,
        0,
        errno(populate_mappings(None, sys::populate)),
    );
}

/// The error number of a step; a reason without one counts as "not implemented".
fn errno(outcome: io::Result<()>) -> i64 {
    outcome.err().map_or(0, |reason| {
        i64::from(reason.raw_os_error().unwrap_or(libc::ENOSYS))
    })
}

/// The processors for a role, and the first of them that is the loops': everything else takes those that the loops leave,
/// or at least not the plant's, if there is another one.
fn cpus_for(role: Role, settings: &RealtimeSettings) -> (CpuSet, usize) {
    let allowed = allowed_cpus();
    let first = settings.cpu.unwrap_or_else(loops_cpu);
    let loops = loop_processors(first, settings.loop_cpus);
    if role != Role::Record {
        let cpu = loops[place(role, loops.len())];
        return (only(cpu), cpu);
    }
    let mut others = allowed;
    for cpu in loops.into_iter().filter(|cpu| *cpu < CpuSet::MAX_CPU) {
        others.unset(cpu);
    }
    if others.count() == 0 {
        others = allowed;
        if allowed.count() > 1 && first < CpuSet::MAX_CPU {
            others.unset(first);
        }
    }
    (others, first)
}

fn only(cpu: usize) -> CpuSet {
    let mut set = CpuSet::new();
    if cpu < CpuSet::MAX_CPU {
        set.set(cpu);
    }
    set
}

/// Keeps the processors out of deep sleep for as long as the file is open.
pub fn hold_cpu_latency() -> io::Result<File> {
    let mut file = OpenOptions::new()
        .write(true)
        .open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::realtime::LeadSetting;

    const fn settings(mode: RealtimeMode, priority: i32) -> RealtimeSettings {
        RealtimeSettings {
            mode,
            priority,
            cpu: None,
            loop_cpus: 1,
            lead: LeadSetting::Fixed(0),
            rehearse: false,
        }
    }

    /// Settings for a processor that no machine has.
    const NOWHERE: RealtimeSettings = RealtimeSettings {
        cpu: Some(100_000),
        ..settings(RealtimeMode::Require, 80)
    };

    /// On a thread of its own: a test must not leave its settings to others.
    fn aside<T: Send>(act: impl FnOnce() -> T + Send) -> T {
        std::thread::scope(|scope| scope.spawn(act).join().unwrap())
    }

    #[test]
    fn a_processor_that_does_not_exist_is_refused_and_named_under_require() {
        // It comes first of what is refused, whatever else is.
        let error = aside(|| Engaged::engage(Role::Plant, &NOWHERE, None).map(drop)).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        let expected = "plant process: Affinity (Invalid argument";
        assert!(error.to_string().contains(expected), "{error}");
        assert!(error.remedy().unwrap().contains("--cpu N"), "{error:?}");
        let mut settings = NOWHERE;
        settings.mode = RealtimeMode::Prefer;
        let engaged = aside(|| Engaged::engage(Role::Plant, &settings, None)).unwrap();
        let affinity = engaged.grants.of(RealtimeStep::Affinity);
        let errno = i64::from(libc::EINVAL);
        assert_eq!((affinity.value, affinity.errno), (100_000, errno));
        // The recorder keeps off the loops' processor, so a missing one does not concern it.
        aside(|| Engaged::engage(Role::Record, &NOWHERE, None).map(drop)).unwrap();
    }

    #[test]
    fn off_requests_nothing_and_each_refusal_has_a_remedy_of_its_own() {
        let settings = settings(RealtimeMode::Off, 80);
        let mut engaged = Engaged::engage(Role::Plant, &settings, None).unwrap();
        let requested = |step: &RealtimeStep| engaged.grants.of(*step).asked != 0;
        assert!(!RealtimeStep::ALL.iter().any(requested));
        let remedies: BTreeSet<_> = RealtimeStep::ALL
            .iter()
            .map(|step| remedy(*step, i64::from(libc::EPERM)))
            .collect();
        assert_eq!(remedies.len(), RealtimeStep::ALL.len(), "{remedies:?}");
        let grants = &mut engaged.grants;
        grants.note(RealtimeStep::MemoryLock, 0, i64::from(libc::EPERM));
        grants.note(RealtimeStep::CpuLatency, 0, i64::from(libc::EACCES));
        let error = engaged.insist(Role::Mixer).unwrap_err();
        let expected = "mixer process: MemoryLock (Operation not permitted (os error 1))";
        assert!(error.to_string().ends_with(expected), "{error}");
        assert!(error.remedy().unwrap().contains("CAP_IPC_LOCK"));
    }
}
