//! The steps of the real-time set-up: requested, granted, or refused and why.
//!
//! Each step is tried on its own, and none is skipped silently. A refusal is reported with its error number. It ends
//! the process only under [`Mode::Require`].

use std::fs::{self, File, OpenOptions};
use std::hint::black_box;
use std::io::{self, Write as _};
use std::num::NonZero;
use std::time::Duration;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity, set_current_timer_slack};

use super::sys;
use super::thread::{allowed_cpus, loops_cpu, prefault_stack};
use model::realtime::{Grants, Mode, Settings, Step};
use model::role::Role;
use wire::error::Error;

/// What the user may do when a step is refused with an error number.
#[must_use]
pub fn remedy(step: Step, errno: i64) -> &'static str {
    let not_permitted = errno == i64::from(libc::EPERM);
    match step {
        Step::Scheduler if not_permitted && rustix::process::geteuid().is_root() => {
            "root is refused SCHED_FIFO where its cpu cgroup has no real-time budget: write one to \
                 cpu.rt_runtime_us of the cgroup, or start from the root cgroup"
        }
        Step::Scheduler => {
            "start as root, give the executable CAP_SYS_NICE (setcap cap_sys_nice,cap_ipc_lock+ep), or raise \
                 the rtprio limit in /etc/security/limits.d and log in again"
        }
        Step::Affinity => "name a processor that this process may use: --cpu N (taskset -p $$ lists them)",
        Step::MemoryLock => {
            "start as root, give the executable CAP_IPC_LOCK, or raise the memlock limit in \
                 /etc/security/limits.d and log in again"
        }
        Step::Malloc => "use a build for glibc",
        Step::Prefault => "free memory, or enlarge /dev/shm",
        Step::TimerSlack => "use a kernel that knows PR_SET_TIMERSLACK",
        Step::CpuLatency => "start as root, or let your group write /dev/cpu_dma_latency",
    }
}

/// The set-up as long as it is in force.
#[derive(Debug)]
pub struct Engaged {
    /// What was granted.
    pub grants: Grants,
    /// The kernel honours the wish for as long as the device is open.
    _cpu_latency: Option<File>,
}

/// Heap that is touched in advance [bytes]: far more than a loop's 48-byte loan ever needs.
const HEAP_BYTES: usize = 1 << 20;

impl Engaged {
    /// Requests everything that a role needs. Call it after the ports were made.
    ///
    /// # Errors
    /// [`Error::RealtimeRefused`] under [`Mode::Require`].
    pub fn engage(role: Role, settings: &Settings) -> Result<Self, Error> {
        let mut engaged = Self { grants: Grants::default(), _cpu_latency: None };
        if settings.mode != Mode::Off {
            engaged.ask(role, settings);
        }
        let (policy, priority) = sys::scheduler();
        engaged.grants.policy = u64::from(policy.unsigned_abs());
        engaged.grants.priority = u64::from(priority.unsigned_abs());
        if settings.mode == Mode::Require {
            engaged.insist(role)?;
        }
        Ok(engaged)
    }

    fn ask(&mut self, role: Role, settings: &Settings) {
        let grants = &mut self.grants;
        let slack = set_current_timer_slack(NonZero::new(1)).map_err(Into::into);
        grants.note(Step::TimerSlack, 1, slack);
        let (cpus, cpu) = cpus_for(role, settings.cpu);
        grants.note(Step::Affinity, cpu as u64, sched_setaffinity(None, &cpus).map_err(Into::into));
        if role == Role::Record {
            return;
        }
        grants.note(Step::Malloc, 0, sys::keep_freed_memory());
        let locked = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(Into::into);
        grants.note(Step::MemoryLock, 0, locked);
        prefault_stack();
        drop(black_box(vec![1_u8; HEAP_BYTES]));
        grants.note(Step::Prefault, 0, populate_mappings());
        match hold_cpu_latency() {
            Ok(file) => {
                grants.note(Step::CpuLatency, 0, Ok(()));
                self._cpu_latency = Some(file);
            }
            Err(error) => grants.note(Step::CpuLatency, 0, Err(error)),
        }
        let priority = settings.priority + role.priority_step();
        grants.note(Step::Scheduler, u64::from(priority.unsigned_abs()), sys::set_fifo(priority));
    }

    fn insist(&self, role: Role) -> Result<(), Error> {
        let refused: Vec<Step> = self.grants.refused().filter(|step| step.required()).collect();
        let Some(first) = refused.first() else { return Ok(()) };
        let word = |step: &Step| format!("{step:?} ({})", self.grants.of(*step).reason());
        Err(Error::RealtimeRefused {
            role,
            refused: refused.iter().map(word).collect::<Vec<_>>().join(", "),
            remedy: format!(
                "{}; or fly with what is granted: --rt prefer",
                remedy(*first, self.grants.of(*first).errno)
            ),
        })
    }
}

/// Touches everything mapped since the set-up: the last act before a loop is armed.
///
/// # Errors
/// [`Error::System`] when memory, or /dev/shm, has run out.
pub fn settle() -> Result<(), Error> {
    populate_mappings().map_err(|e| Error::system("cannot make the memory of the process present", e))
}

/// The processors for a role: the loops share one, everything else takes the others, if there are any.
fn cpus_for(role: Role, wanted: Option<usize>) -> (CpuSet, usize) {
    let allowed = allowed_cpus();
    let cpu = wanted.unwrap_or_else(loops_cpu);
    if role == Role::Record {
        let mut others = allowed;
        if allowed.count() > 1 && cpu < CpuSet::MAX_CPU {
            others.unset(cpu);
        }
        return (others, cpu);
    }
    let mut own = CpuSet::new();
    if cpu < CpuSet::MAX_CPU {
        own.set(cpu);
    }
    (own, cpu)
}

/// Makes every page present that the process can write or read: its own, those that its ports share, and those that
/// other processes write and it only reads.
fn populate_mappings() -> io::Result<()> {
    for line in fs::read_to_string(MAPPINGS)?.lines() {
        let Some((range, rest)) = line.split_once(' ') else { continue };
        let Some((start, end)) = range.split_once('-') else { continue };
        let (Ok(start), Ok(end)) = (usize::from_str_radix(start, 16), usize::from_str_radix(end, 16)) else { continue };
        let Some(touch) = touch(rest) else { continue };
        // Another thread may give the range back, and take it again, while it is being touched.
        let mut tries = 0;
        while let Err(refused) = sys::populate(start, end - start, touch) {
            if !fs::read_to_string(MAPPINGS)?.lines().any(|now| now == line) {
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

/// How often to try touching a range that exists; if memory has run out, further tries do not help.
const POPULATE_TRIES: u32 = 100;
/// The list of the process' mappings.
const MAPPINGS: &str = "/proc/self/maps";

/// How to touch a mapping, by its line in /proc/self/maps from the permissions on.
fn touch(mapping: &str) -> Option<sys::Touch> {
    let kernels = mapping.split_whitespace().nth(4).is_some_and(|name| name.starts_with('['));
    // The main thread's stack grows by itself down to its limit; what it needs was touched by `prefault_stack`.
    if mapping.starts_with("rw") {
        (!mapping.ends_with("[stack]")).then_some(sys::Touch::Write)
    } else {
        // The pages of the kernel, as of [vvar], are always there and cannot be asked for.
        (mapping.starts_with('r') && !kernels).then_some(sys::Touch::Read)
    }
}

/// Keeps the processors out of deep sleep for as long as the file is open.
///
/// # Errors
/// Where /dev/cpu_dma_latency is not there or may not be written.
pub fn hold_cpu_latency() -> io::Result<File> {
    let mut file = OpenOptions::new().write(true).open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::realtime::STEPS;

    #[test]
    fn a_processor_that_does_not_exist_is_refused_and_named_under_require() {
        let settings = Settings { mode: Mode::Require, priority: 80, cpu: Some(100_000) };
        // On a thread of its own: a test must not leave its settings to others.
        let error = std::thread::spawn(move || Engaged::engage(Role::Record, &settings).map(|_| ()));
        // The recorder keeps off the loops' processor, so a missing one does not concern it.
        assert!(error.join().unwrap().is_ok());
        let error = std::thread::spawn(move || cpus_for(Role::Plant, settings.cpu).0.count()).join().unwrap();
        assert_eq!(error, 0, "the empty set, which the kernel refuses");
    }

    #[test]
    fn off_asks_for_nothing() {
        let settings = Settings { mode: Mode::Off, priority: 80, cpu: None };
        let engaged = Engaged::engage(Role::Plant, &settings).unwrap();
        assert!(STEPS.iter().all(|step| engaged.grants.of(*step).asked == 0));
    }

    #[test]
    fn every_refusal_has_a_remedy() {
        for step in STEPS {
            assert!(!remedy(step, i64::from(libc::EPERM)).is_empty());
            assert!(!remedy(step, i64::from(libc::EINVAL)).is_empty());
        }
    }

    #[test]
    fn memory_is_touched_as_it_may_be() {
        let cases = [
            ("rw-p 00000000 00:00 0                          [heap]", Some(sys::Touch::Write)),
            ("rw-s 00000000 00:19 12                         /dev/shm/x.data", Some(sys::Touch::Write)),
            ("r--s 00000000 00:19 12                         /dev/shm/x.data", Some(sys::Touch::Read)),
            ("r-xp 00001000 08:01 12                         /usr/bin/x", Some(sys::Touch::Read)),
            ("rw-p 00000000 00:00 0                          [stack]", None),
            ("r--p 00000000 00:00 0                          [vvar]", None),
            ("---p 00000000 00:00 0", None),
            ("rw-p 00000000 00:00 0", Some(sys::Touch::Write)),
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
                    std::thread::spawn(|| drop(vec![1_u8; 4 << 20])).join().unwrap();
                }
            });
            let settled = (0..50).try_for_each(|_| settle());
            done.store(true, std::sync::atomic::Ordering::Relaxed);
            settled.unwrap();
        });
    }
}
