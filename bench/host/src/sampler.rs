//! Kernel counters of the loops, read from /proc each time the recorder looks.

use std::io::ErrorKind;

use ipc::clock::now_ns;
use messages::blackboards::{RolePhase, Status};
use messages::realtime::RealtimeStep;
use messages::role::{Channel, STAGES};

use crate::Machine;
use crate::cpu_times::CpuTimes;
use analysis::observations::{CounterSample, Counters, Life};

#[derive(Clone, Debug)]
pub struct Watch {
    /// The processor that all loops were granted; none where they were not, or not the same.
    pub processor: Option<u64>,
    /// A hypervisor may run below, and take time from them.
    pub is_virtual: bool,
    /// Files that count how often processor quotas of the plant, which stands for all loops, were used up.
    pub quota_counters: Vec<String>,
}

impl Watch {
    pub fn new(loops: &[Status; STAGES.len()], is_virtual: bool) -> Self {
        let mut cpus = loops.iter().map(|status| {
            let grant = status.grants.of(RealtimeStep::Affinity);
            grant.granted().then_some(grant.value)
        });
        let first = cpus.next().flatten();
        Self {
            processor: first.filter(|first| cpus.all(|cpu| cpu == Some(*first))),
            is_virtual,
            quota_counters: Machine::files().group_counters(&loops[0].pid.to_string(), "cpu"),
        }
    }

    /// Samples the counters of the plant and of a channel.
    pub fn sample(&self, channel: Channel, loops: &[Status; STAGES.len()]) -> CounterSample {
        let from_ns = now_ns();
        let stolen = match self.is_virtual {
            true => CpuTimes::read(self.processor).stolen,
            false => 0,
        };
        let [_, throttled_us] = Machine::files().throttled(&self.quota_counters);
        let stages = loops.map(|status| Counters {
            // Quotas are for SCHED_OTHER.
            throttled_us: throttled_us * u64::from(status.grants.policy == 0),
            ..counters(status.pid)
        });
        CounterSample {
            from_ns,
            channel: channel as u64,
            stages,
            stolen,
            at_ns: now_ns(),
        }
    }
}

/// What a process's main thread is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// The kernel's letter: `R` ready or running, `S` and `D` waiting, `T` and `t` stopped, `Z` ended.
    pub state: char,
    pub ran_ns: u64,
    /// Whether the kernel is putting the process away, for a signal or an exit code that is none of 0: what it had open
    /// may take a busy disk a second.
    pub is_dying: bool,
}

impl Look {
    pub fn at(pid: u64) -> Option<Self> {
        const PF_EXITING: u64 = 4;
        let line = read(pid, "stat").ok()?;
        let stat = Stat::of(&line);
        Some(Self {
            state: stat.state()?,
            ran_ns: scheduled(pid)[0],
            // A main thread that has ended by itself, and left others behind, has the exit code 0.
            is_dying: stat.number(9) & PF_EXITING != 0 && stat.number(52) != 0,
        })
    }

    pub const fn is_stopped(self) -> bool {
        matches!(self.state, 'T' | 't')
    }
}

/// Which of these loops ended without landing.
pub fn fallen(loops: &[Status; STAGES.len()]) -> [bool; STAGES.len()] {
    loops.map(|status| {
        status.phase() != RolePhase::Landed && counters(status.pid).life == Life::Dead
    })
}

/// What is counted for the main thread of a process, which is the loop's; 0 is no process.
fn counters(pid: u64) -> Counters {
    let mut counters = Counters {
        pid,
        ..Counters::default()
    };
    if pid == 0 {
        return counters;
    }
    match read(pid, "stat") {
        Ok(stat) => (counters.life, counters.faults) = life_and_faults(&Stat::of(&stat)),
        Err(e) if e.kind() == ErrorKind::NotFound => counters.life = Life::Dead,
        // What may not be read says nothing.
        Err(_) => {}
    }
    // The kernel removes these files together with the process, so only its end makes reading them fail.
    [counters.ran_ns, counters.waited_ns] = scheduled(pid);
    counters
}

/// How long the main thread of a process has run and waited to run [ns].
fn scheduled(pid: u64) -> [u64; 2] {
    let text = read(pid, "schedstat").unwrap_or_default();
    let mut numbers = text.split_whitespace().map(|ns| ns.parse().unwrap_or(0));
    [(); 2].map(|()| numbers.next().unwrap_or(0))
}

fn read(pid: u64, file: &str) -> std::io::Result<String> {
    std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/{file}"))
}

/// A line of /proc/PID/stat behind the name in brackets, which may hold anything: fields from the third on.
pub(crate) struct Stat<'a>(Vec<&'a str>);

impl<'a> Stat<'a> {
    pub(crate) fn of(line: &'a str) -> Self {
        let (_, fields) = line.rsplit_once(')').unwrap_or_default();
        Self(fields.split_whitespace().collect())
    }

    pub(crate) fn state(&self) -> Option<char> {
        self.0.first()?.chars().next()
    }

    /// The field with this number in proc(5); 0 where there is none.
    pub(crate) fn number(&self, field: usize) -> u64 {
        let number = self.0.get(field - 3);
        number.and_then(|it| it.parse().ok()).unwrap_or(0)
    }
}

fn life_and_faults(stat: &Stat) -> (Life, u64) {
    let life = match stat.state() {
        Some('T' | 't') => Life::Stopped,
        Some('Z' | 'X') => Life::Dead,
        _ => Life::Lives,
    };
    let (minflt, majflt) = (stat.number(10), stat.number(12));
    (life, minflt + majflt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stat_line_is_read_whatever_the_process_is_called() {
        let of = |line: &str| life_and_faults(&Stat::of(line));
        let line = "7 (a) T 1 (b) T 1 7 7 0 -1 4194304 12 0 3 0 1 2";
        assert_eq!(of(line), (Life::Stopped, 15));
        assert_eq!(of("7 (x) Z 1 7 7 0 -1 4194304 0 0 0 0").0, Life::Dead);
        assert_eq!(of("7 (x) R 1 7 7 0 -1 4194304 0 0 0 0").0, Life::Lives);
    }

    #[test]
    fn this_process_runs_and_one_that_never_was_is_dead() {
        let tid = u64::from(std::process::id());
        let here = counters(tid);
        assert_eq!((here.pid, here.life), (tid, Life::Lives));
        assert!(here.faults > 0);
        assert_eq!(counters(u64::from(u32::MAX)).life, Life::Dead);
        assert_eq!(counters(0).life, Life::Lives);
        let look = Look::at(tid).unwrap();
        assert!(
            "RSD".contains(look.state) && look.ran_ns > 0 && !look.is_stopped() && !look.is_dying,
            "{look:?}"
        );
        assert_eq!(Look::at(u64::from(u32::MAX)), None);
    }

    #[test]
    fn a_process_that_was_killed_or_failed_is_dying_until_its_parent_has_heard_of_it() {
        // A main thread that leaves others behind looks as one that succeeded.
        for (command, expected) in [("kill -KILL $$", true), ("exit 3", true), ("exit 0", false)] {
            let mut child = std::process::Command::new("sh")
                .args(["-c", command])
                .spawn()
                .unwrap();
            let look = || Look::at(u64::from(child.id())).unwrap();
            while look().state != 'Z' {
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            assert_eq!(look().is_dying, expected, "{command}");
            child.wait().unwrap();
        }
    }

    #[test]
    fn only_loops_that_ended_without_landing_have_fallen() {
        let (here, gone) = (u64::from(std::process::id()), u64::from(u32::MAX));
        let loops = [
            (here, RolePhase::Flying),
            (gone, RolePhase::Landed),
            (gone, RolePhase::Flying),
            (0, RolePhase::Starting),
        ]
        .map(|(pid, phase)| Status {
            pid,
            phase: phase as u64,
            ..Status::default()
        });
        assert_eq!(fallen(&loops), [false, false, true, false]);
    }

    #[test]
    fn a_quota_throttles_only_loops_that_are_not_real_time() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, "throttled_usec 7\n").unwrap();
        let mut loops = [Status::default(); STAGES.len()];
        let mut watch = Watch::new(&loops, true);
        watch.quota_counters = vec![file.path().display().to_string()];
        loops[1].grants.policy = 1;
        let sampled = watch
            .sample(Channel::A, &loops)
            .stages
            .map(|it| it.throttled_us);
        assert_eq!(sampled, [7, 0, 7, 7]);
    }
}
