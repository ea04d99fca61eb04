//! The steps of the real-time set-up: requested, granted, or refused and why.
//!
//! Each step is tried on its own, and none is skipped silently. A refusal is reported with its error number. It ends
//! the process only under [`RealtimeMode::Require`].

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::hint::black_box;
use std::io::{self, Write as _};
use std::num::NonZero;
use std::sync::atomic::Ordering;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};
use rustix::thread::{CpuSet, sched_setaffinity, set_current_timer_slack};

use super::memory::{UNKNOWN, mappings, populate_mappings, settle};
use super::sys;
use super::thread::{Raised, allowed_cpus, loop_processors, loops_cpu, of_cpus, prefault_stack};
use crate::wakes::place;
use errors::{Failure, NO_REAL_TIME, errno_text};
use ipc::error::Error;
use messages::realtime::{Grants, RealtimeMode, RealtimeSettings, RealtimeStep};
use messages::role::{Channel, Replica, Role};

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
            "start as root, or let a group of yours write /dev/cpu_dma_latency (`ironbird docs measuring` has the udev rule)"
        }
    }
}

/// What works without privileges.
pub const WITHOUT_ROOT: &str = "without root the same laws fly in lockstep (--pace lockstep), in slow motion \
                            (flight.slowdown), and in `ironbird simulate`";

/// The set-up as long as it is in force: a loop leaves SCHED_FIFO when this is dropped.
///
/// To be dropped before ports and shared memory are given up. The kernel takes locks for that, and a SCHED_FIFO process
/// that spins on a kernel lock held by a lower one on its processor deadlocks.
#[derive(Debug)]
pub struct Engaged {
    pub grants: Grants,
    /// The thread that is under SCHED_FIFO by this set-up, and its priority; 0 where it is not.
    loop_thread: i32,
    priority: i32,
    /// The role's processor, and those where it joins a flight.
    place: Option<(usize, CpuSet)>,
    /// In force while the device is open.
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

/// The part of the set-up that a stage does before it has ports.
#[derive(Debug)]
pub struct Ahead {
    /// Above ordinary threads during the set-up.
    _raised: Raised,
    /// The process that gives memory and files back if this one is killed.
    releaser: Option<Pid>,
    grants: Grants,
    /// The role's processor, and those where it prepares.
    cpu: usize,
    others: CpuSet,
    /// The mappings that are locked, and so stay present.
    pub(crate) locked: BTreeSet<String>,
}

impl Ahead {
    /// Locks and touches the memory, and leaves the loops' processor: a process that joins a flight costs the loops
    /// nothing until then.
    ///
    /// Refusals are reported with the rest of the set-up. `None` if the mode is `off`.
    pub fn prepare(replica: Replica, settings: &RealtimeSettings) -> Option<Self> {
        if settings.mode == RealtimeMode::Off {
            return None;
        }
        let mut grants = Grants::default();
        let (_, cpu) = cpus_for(replica, settings);
        let (others, _) = cpus_for(Role::Record.into(), settings);
        // Fails on a machine with one processor.
        let _ = sched_setaffinity(None, &others);
        // Optional: without it the end of this process costs the loops more.
        let releaser = sys::start_releaser().ok().and_then(Pid::from_raw);
        hold_memory(&mut grants);
        let raised = Raised::now();
        let is_locked = grants.of(RealtimeStep::MemoryLock).granted();
        let locked = if is_locked {
            mappings()
        } else {
            BTreeSet::new()
        };
        Some(Self {
            _raised: raised,
            releaser,
            grants,
            cpu,
            others,
            locked,
        })
    }

    /// Number of the process that outlives this one where it is killed; 0 is none.
    pub fn releaser(&self) -> u64 {
        self.releaser.map_or(0, |pid| {
            u64::from(pid.as_raw_nonzero().get().unsigned_abs())
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

impl Drop for Ahead {
    fn drop(&mut self) {
        if let Some(pid) = self.releaser {
            let _ = kill_process(pid, Signal::KILL);
            let _ = waitpid(Some(pid), WaitOptions::empty());
        }
    }
}

/// Heap that is touched in advance [bytes]: far more than a loop's 48-byte loan ever needs.
const HEAP_BYTES: usize = 1 << 20;

impl Engaged {
    /// Requests everything that a role needs, but for what was done `ahead`. Call it after the ports were made.
    pub fn engage(
        replica: impl Into<Replica>,
        settings: &RealtimeSettings,
        ahead: Option<&Ahead>,
    ) -> Result<Self, Error> {
        let replica = replica.into();
        let mut engaged = Self {
            grants: Grants::default(),
            loop_thread: 0,
            priority: 0,
            place: None,
            _cpu_latency: None,
        };
        if settings.mode != RealtimeMode::Off {
            engaged.ask(replica, settings, ahead);
        }
        let (policy, priority) =
            sys::scheduler().map_err(|e| Error::system("cannot read the scheduling policy", e))?;
        engaged.grants.policy = u64::from(policy.unsigned_abs());
        engaged.grants.priority = u64::from(priority.unsigned_abs());
        if settings.mode == RealtimeMode::Require {
            engaged.insist(replica.role)?;
        }
        engaged.leave_loop();
        Ok(engaged)
    }

    /// Leaves the loops' processor and SCHED_FIFO: what it takes to join a flight costs the loops nothing.
    fn leave_loop(&self) {
        if let Some((_, others)) = &self.place {
            // First: a busy loop on that processor would delay the move.
            let _ = sched_setaffinity(None, others);
            if self.loop_thread != 0 {
                let _ = sys::set_other(self.loop_thread);
            }
        }
    }

    /// Takes the place in the loop that was granted.
    pub fn enter_loop(&self) {
        if let Some((cpu, _)) = &self.place {
            if self.loop_thread != 0 {
                // First: a busy loop on that processor would delay the move.
                let _ = sys::set_fifo(self.priority);
            }
            let _ = sched_setaffinity(None, &of_cpus(&[*cpu]));
        }
    }

    fn ask(&mut self, replica: Replica, settings: &RealtimeSettings, ahead: Option<&Ahead>) {
        if let Some(ahead) = ahead {
            self.grants = ahead.grants;
        }
        let grants = &mut self.grants;
        if replica.role != Role::Record {
            // First: it wakes all processors that sleep.
            let held = hold_cpu_latency().map(|file| self._cpu_latency = Some(file));
            grants.note(RealtimeStep::CpuLatency, 0, errno(held));
        }
        let slack = set_current_timer_slack(NonZero::new(1)).map_err(Into::into);
        grants.note(RealtimeStep::TimerSlack, 1, errno(slack));
        let priority = settings.priority + replica.priority_step(settings.channel_cpus);
        if ahead.is_some() {
            // A busy loop on that processor would delay the move. The result is noted below.
            let _ = sys::set_fifo(priority);
        }
        let (cpus, cpu) = match ahead {
            Some(ahead) => (of_cpus(&[ahead.cpu]), ahead.cpu),
            None => cpus_for(replica, settings),
        };
        let affinity = sched_setaffinity(None, &cpus).map_err(Into::into);
        grants.note(RealtimeStep::Affinity, cpu as u64, errno(affinity));
        if replica.role == Role::Record {
            return;
        }
        if ahead.is_none() {
            hold_memory(grants);
        }
        let fifo = sys::set_fifo(priority);
        self.place = ahead.map(|ahead| (ahead.cpu, ahead.others));
        if fifo.is_ok() {
            (self.loop_thread, self.priority) = (sys::thread_number(), priority);
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
        let refused = refused.iter().map(word).collect::<Vec<_>>().join(", ");
        let what =
            format!("real time was required and not granted to the {role} process: {refused}");
        Err(Failure::new(NO_REAL_TIME, what)
            .help(format!(
                "{}; or fly with what is granted: --rt prefer; {WITHOUT_ROOT}",
                remedies.join("; ")
            ))
            .into())
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
    // Later mappings are touched when the role arms, not one by one: of a restarted process that would be some megabytes
    // in flight.
    if grants.of(RealtimeStep::MemoryLock).granted() {
        let _ = mlockall(MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT);
    }
}

/// The error number of a step; a reason without one counts as "not implemented".
fn errno(outcome: io::Result<()>) -> i64 {
    outcome.err().map_or(0, |reason| {
        i64::from(reason.raw_os_error().unwrap_or(libc::ENOSYS))
    })
}

/// The processors for a role, and the first of them that is the loops': all others use the remaining
/// ones, or at least not the plant's, if there is another one.
fn cpus_for(replica: Replica, settings: &RealtimeSettings) -> (CpuSet, usize) {
    let allowed = allowed_cpus();
    let first = settings.cpu.unwrap_or_else(loops_cpu);
    let loops = loop_processors(first, settings.loop_cpus.max(settings.channel_cpus));
    if replica.role != Role::Record {
        let place = match replica.channel {
            Channel::A => place(replica.role, settings.loop_cpus.min(loops.len())),
            Channel::B | Channel::C => (settings.channel_cpus - 1).min(loops.len() - 1),
        };
        return (of_cpus(&loops[place..=place]), loops[place]);
    }
    // Where channels b and c have a processor of their own, it is shared with everything else.
    let loops = &loops[..settings.loop_cpus.min(loops.len())];
    let mut others = allowed;
    for cpu in loops.iter().filter(|cpu| **cpu < CpuSet::MAX_CPU) {
        others.unset(*cpu);
    }
    if others.count() == 0 {
        others = allowed;
        if allowed.count() > 1 && first < CpuSet::MAX_CPU {
            others.unset(first);
        }
    }
    (others, first)
}

/// The calling thread on other processors than the loops', until this is dropped. What it starts is there too.
#[derive(Debug)]
pub struct OffLoops {
    before: CpuSet,
}

impl OffLoops {
    pub fn now(settings: &RealtimeSettings) -> Self {
        let before = allowed_cpus();
        let mut others = cpus_for(Role::Record.into(), settings).0;
        if settings.channel_cpus > 1 {
            others.unset(cpus_for(Replica::new(Role::Outer, Channel::B), settings).1);
        }
        // If none is left, it stays where it is: a stage there may compute without end.
        if others.count() > 0 {
            let _ = sched_setaffinity(None, &others);
        }
        Self { before }
    }

    /// The processors that were allowed before.
    pub fn allowed(&self) -> Vec<usize> {
        (0..CpuSet::MAX_CPU)
            .filter(|cpu| self.before.is_set(*cpu))
            .collect()
    }
}

impl Drop for OffLoops {
    fn drop(&mut self) {
        let _ = sched_setaffinity(None, &self.before);
    }
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
            lead: LeadSetting::Fixed(0),
            rehearse: false,
            ..RealtimeSettings::OFF
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
