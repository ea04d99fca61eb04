//! Hang detection: a process hangs when the counter it publishes stops advancing.
//!
//! A loop counts ticks, even if its input is missing, so the counter does not depend on other loops. The recorder counts
//! how often it looks for messages, and has more time: it is not real-time. Some reasons for a counter to stop are no hang:
//!
//! | reason | how it is recognized |
//! |---|---|
//! | the supervisor did not get to look | a gap between two looks counts as two usual ones at most |
//! | the loop waits for the processor | it is ready, and has run in less than half of the time; or it has just counted |
//! | the process has been killed or has failed, and is not gone yet | the kernel reports that it is dying |
//! | the machine, or the loops' processor, stood still | no other loop's counter advanced either |
//! | the recorder waits for a disk | its state is D |
//!
//! A process that a signal has stopped hangs, whatever the other loops do.

use std::collections::BTreeMap;
use std::time::Duration;

use host::sampler::Look;
use messages::blackboards::{RolePhase, Status};
use messages::role::{Replica, Role};

/// How often the supervisor looks if it restarts roles.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(10);
/// A counter of another loop that does not advance for this time, or for [`TICKS`], is a hang: it is noticed within 100 ms.
pub(super) const HANG_TIMEOUT: Duration = Duration::from_millis(80);
const TICKS: u32 = 5;
/// The plant's time limit: the loops survive a shorter stop, and no other process can replace it.
const PLANT_TIMEOUT: Duration = Duration::from_secs(1);
/// The recorder's time limit: it writes its report each second, to a disk that may be slow.
const RECORDER_TIMEOUT: Duration = Duration::from_secs(10);

#[derive(Debug)]
pub(super) struct HangDetector {
    timeout: Duration,
    plant_timeout: Duration,
    counters: BTreeMap<Replica, Counter>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Counter {
    /// Epoch and count; `None` if the process does not fly.
    count: Option<(u64, u64)>,
    stopped_for: Duration,
    /// Run time of its thread when the counter was first seen to have stopped [ns].
    ran_ns: u64,
}

/// Epoch and count of a process; `None` if it does not fly.
fn count(role: Role, status: &Status) -> Option<(u64, u64)> {
    let count = match role {
        Role::Record => status.rounds,
        // Any process of the user can write the numbers.
        _ => status.ticks_run.wrapping_add(status.ticks_skipped),
    };
    let is_flying = status.phase() == RolePhase::Flying;
    is_flying.then_some((status.epoch, count))
}

impl HangDetector {
    /// `tick` is the wall time of a tick. In slow motion, a fault lasts `slowdown` times as long, so the limits do, too.
    pub(super) fn new(tick: Duration, slowdown: u32) -> Self {
        Self {
            timeout: HANG_TIMEOUT.saturating_mul(slowdown).max(tick * TICKS),
            plant_timeout: PLANT_TIMEOUT.saturating_mul(slowdown),
            counters: BTreeMap::new(),
        }
    }

    /// Updates the counters, `since` the last look; returns the processes that hang. It reads the statuses again after a
    /// look at one that seems to hang.
    pub(super) fn hanging(
        &mut self,
        read: impl Fn() -> BTreeMap<Replica, Status>,
        since: Duration,
        look: impl Fn(u64) -> Option<Look>,
    ) -> Vec<Replica> {
        let since = since.min(2 * LOOK_EVERY);
        let statuses = read();
        for (replica, status) in &statuses {
            let counter = self.counters.entry(*replica).or_default();
            let count = count(replica.role, status);
            if count != counter.count || count.is_none() {
                *counter = Counter {
                    count,
                    ..Counter::default()
                };
            } else {
                if counter.stopped_for.is_zero() {
                    counter.ran_ns = look(status.pid).map_or(0, |look| look.ran_ns);
                }
                counter.stopped_for += since;
            }
        }
        let hangs = |(replica, status): &(&Replica, &Status)| {
            let counter = &self.counters[*replica];
            counter.stopped_for >= self.timeout(replica.role)
                && look(status.pid).is_some_and(|look| self.is_hang(**replica, counter, look))
        };
        let mut hanging: Vec<Replica> = statuses.iter().filter(hangs).map(|it| *it.0).collect();
        if !hanging.is_empty() {
            let now = read();
            let count_now = |it: &Replica| count(it.role, now.get(it)?);
            hanging.retain(|it| count_now(it) == self.counters[it].count);
        }
        hanging
    }

    fn timeout(&self, role: Role) -> Duration {
        match role {
            Role::Record => RECORDER_TIMEOUT,
            Role::Plant => self.timeout.max(self.plant_timeout),
            _ => self.timeout,
        }
    }

    fn is_hang(&self, replica: Replica, counter: &Counter, look: Look) -> bool {
        let half = counter.stopped_for / 2;
        let ran = Duration::from_nanos(look.ran_ns.saturating_sub(counter.ran_ns));
        let is_starved = look.state == 'R' && ran < half;
        let waits_for_disk = look.state == 'D' && replica.role == Role::Record;
        let others_advanced = self.counters.iter().any(|(of, other)| {
            of.role != Role::Record && other.count.is_some() && other.stopped_for < half
        });
        !look.is_dying && (look.is_stopped() || (others_advanced && !is_starved && !waits_for_disk))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::role::STAGES;
    use std::cell::Cell;

    const INNER: usize = 2;
    const MS_10: Duration = Duration::from_millis(10);
    const ALL_BUT_INNER: [bool; 4] = [true, true, false, true];
    const ALL_BUT_PLANT: [bool; 4] = [false, true, true, true];

    fn of_stages(statuses: [Status; 4]) -> BTreeMap<Replica, Status> {
        STAGES
            .map(Replica::from)
            .into_iter()
            .zip(statuses)
            .collect()
    }

    fn flying(ticks_run: u64) -> Status {
        Status {
            phase: RolePhase::Flying as u64,
            ticks_run,
            ..Status::default()
        }
    }

    /// Looks at loops of which those in `advances` advance; returns the loops that hang at the last look.
    fn hanging(
        advances: [bool; 4],
        state: char,
        ran_share: f64,
        since: Duration,
        looks: u32,
    ) -> Vec<Replica> {
        let mut detector = HangDetector::new(Duration::from_millis(1), 1);
        let mut hanging = Vec::new();
        for look in 0..looks {
            let status = |advances| flying(if advances { u64::from(look) } else { 7 });
            let look = Look {
                state,
                ran_ns: (f64::from(look) * since.as_nanos() as f64 * ran_share) as u64,
                is_dying: false,
            };
            let statuses = || of_stages(advances.map(status));
            hanging = detector.hanging(statuses, since, |_| Some(look));
        }
        hanging
    }

    #[test]
    fn a_counter_that_stops_is_a_hang_after_80_ms_or_1_s_unless_the_loop_or_the_machine_waits() {
        let all = STAGES.map(Replica::from);
        let inner = [all[INNER]];
        let second = Duration::from_secs(1);
        for (advances, state, ran_share, since, looks, expected) in [
            (ALL_BUT_INNER, 'S', 0.0, MS_10, 9, &inner[..]),
            (ALL_BUT_INNER, 'S', 0.0, MS_10, 8, &[]),
            (ALL_BUT_INNER, 'D', 0.0, MS_10, 9, &inner),
            (ALL_BUT_INNER, 'D', 0.0, MS_10, 8, &[]),
            (ALL_BUT_INNER, 'T', 0.0, MS_10, 9, &inner),
            (ALL_BUT_INNER, 't', 0.0, MS_10, 9, &inner),
            // It computes without end.
            (ALL_BUT_INNER, 'R', 0.9, MS_10, 9, &inner),
            // It waits for the processor.
            (ALL_BUT_INNER, 'R', 0.1, MS_10, 20, &[]),
            ([true; 4], 'S', 0.0, MS_10, 20, &[]),
            ([false; 4], 'S', 0.0, MS_10, 20, &[]),
            ([false; 4], 'T', 0.0, MS_10, 20, &all[1..]),
            (ALL_BUT_PLANT, 'T', 0.0, MS_10, 100, &[]),
            (ALL_BUT_PLANT, 'T', 0.0, MS_10, 101, &all[..1]),
            // A supervisor that did not get to look for a second has seen nothing of it.
            (ALL_BUT_INNER, 'S', 0.0, second, 4, &[]),
        ] {
            let hanging = hanging(advances, state, ran_share, since, looks);
            assert_eq!(
                hanging, expected,
                "{advances:?} {state} {ran_share} {looks}"
            );
        }
    }

    #[test]
    fn a_recorder_hangs_after_10_s_unless_it_waits_for_the_processor_or_a_disk() {
        for (state, ran_share, expected) in [
            ('S', 0.0, Some(1000)),
            ('T', 0.0, Some(1000)),
            ('R', 0.9, Some(1000)),
            ('R', 0.1, None),
            ('D', 0.0, None),
        ] {
            let mut detector = HangDetector::new(Duration::from_millis(1), 1);
            let looks = (0..1100).find(|&ticks| {
                // Its newest tick advances, and its rounds do not.
                let mut statuses = of_stages([flying(ticks); 4]);
                statuses.insert(Role::Record.into(), flying(ticks));
                let look = Look {
                    state,
                    ran_ns: (ticks as f64 * 1e7 * ran_share) as u64,
                    is_dying: false,
                };
                let hanging = detector.hanging(|| statuses.clone(), MS_10, |_| Some(look));
                !hanging.is_empty()
            });
            assert_eq!(looks, expected, "{state} {ran_share}");
        }
    }

    #[test]
    fn numbers_that_another_process_wrote_do_not_end_the_supervisor() {
        let forged = Status {
            ticks_skipped: u64::MAX,
            ..flying(u64::MAX)
        };
        let mut detector = HangDetector::new(Duration::from_millis(1), 1);
        let hanging = detector.hanging(|| of_stages([forged; 4]), MS_10, |_| None);
        assert_eq!(hanging, []);
    }

    #[test]
    fn the_timeout_is_five_long_ticks_and_neither_a_dying_process_nor_one_that_counts_again_hangs()
    {
        for (tick_ms, slowdown, is_dying, counts, expected) in [
            (1, 1, false, false, Some(8)),
            (100, 1, false, false, Some(50)),
            // In slow motion a stop lasts longer, too.
            (8, 8, false, false, Some(64)),
            (1, 1, true, false, None),
            (1, 1, false, true, None),
        ] {
            let mut detector = HangDetector::new(Duration::from_millis(tick_ms), slowdown);
            let look = Look {
                state: 'D',
                ran_ns: 0,
                is_dying,
            };
            let looks = (0..100).find(|&ticks| {
                let (on, reads) = (flying(ticks), Cell::new(0));
                let loops = || {
                    let again = u64::from(counts) * reads.replace(1);
                    of_stages([on, on, flying(7 + again), on])
                };
                !detector.hanging(loops, MS_10, |_| Some(look)).is_empty()
            });
            assert_eq!(looks, expected, "{tick_ms} {is_dying}");
        }
    }
}
