//! Whether a loop hangs: its heartbeat, the ticks on its status board, stands still.
//!
//! A loop counts a tick on its board even where its input is missing, so the heartbeat is its own. It may stand still
//! for four reasons that are no hang, and these are told apart:
//!
//! | what | how it is known |
//! |---|---|
//! | this process did not get to look | a gap between two looks counts as two usual ones at the most |
//! | the loop waits for the processor | it is ready, and has not run in half of the time |
//! | it has been killed, or has failed, and is not gone yet | the kernel says that it is dying, and of what |
//! | the machine, or the loops' processor, stood still | no other loop's heartbeat went on either |
//!
//! A process that a signal has stopped hangs, whatever the others do.

use std::time::Duration;

use machine::sampler::Look;
use model::boards::{RolePhase, Status};
use model::guards::{Guard, is_on};
use model::role::{Role, STAGES};

/// How often the launcher looks where it starts roles again.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(10);
/// A heartbeat that stands still for so long, or for [`TICKS`], is a hang: noticed within 100 ms, with the looks.
pub(super) const STILL: Duration = Duration::from_millis(80);
const TICKS: u32 = 5;

/// The heartbeats of the loops, in the order of [`STAGES`].
#[derive(Debug)]
pub(super) struct Pulses {
    still: Duration,
    of: [Pulse; STAGES.len()],
}

#[derive(Clone, Copy, Debug, Default)]
struct Pulse {
    /// Epoch and ticks; none of a loop that does not fly.
    beat: Option<(u64, u64)>,
    still: Duration,
    /// What its thread had run when the standstill was first seen [ns].
    ran_ns: u64,
}

impl Pulses {
    /// Of loops whose ticks take so long.
    pub(super) fn new(tick: Duration) -> Self {
        Self { still: STILL.max(tick * TICKS), of: [Pulse::default(); STAGES.len()] }
    }

    /// Takes a look at all loops, `since` the one before; gives those that hang.
    pub(super) fn hanging(
        &mut self,
        loops: &[Status; STAGES.len()],
        since: Duration,
        look: impl Fn(u64) -> Option<Look>,
    ) -> Vec<Role> {
        let since = since.min(2 * LOOK_EVERY);
        for (pulse, status) in self.of.iter_mut().zip(loops) {
            let flies = status.phase() == RolePhase::Flying;
            let beat = flies.then_some((status.epoch, status.ticks_run + status.ticks_skipped));
            if beat != pulse.beat || beat.is_none() {
                *pulse = Pulse { beat, ..Pulse::default() };
            } else {
                if pulse.still.is_zero() {
                    pulse.ran_ns = look(status.pid).map_or(0, |look| look.ran_ns);
                }
                pulse.still += since;
            }
        }
        let hangs = |i: &usize| {
            let pulse = &self.of[*i];
            pulse.still >= self.still
                && is_on(Guard::Heartbeat)
                && look(loops[*i].pid).is_some_and(|look| self.is_hang(pulse, look))
        };
        (0..STAGES.len()).filter(hangs).map(|i| STAGES[i]).collect()
    }

    fn is_hang(&self, pulse: &Pulse, look: Look) -> bool {
        let half = pulse.still / 2;
        let ran = Duration::from_nanos(look.ran_ns.saturating_sub(pulse.ran_ns));
        let is_starved = look.state == 'R' && ran < half;
        let others_went_on = self.of.iter().any(|other| other.beat.is_some() && other.still < half);
        !look.is_dying && (look.is_stopped() || (others_went_on && !is_starved))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INNER: usize = 2;

    /// Looks at loops for 200 ms, in which those that `beats` names go on; who hangs in the end.
    fn hanging(beats: [bool; 4], state: char, ran_share: f64, since: Duration, looks: u32) -> Vec<Role> {
        let mut pulses = Pulses::new(Duration::from_millis(1));
        let mut hanging = Vec::new();
        for look in 0..looks {
            let status = |beats: bool| Status {
                phase: RolePhase::Flying as u64,
                ticks_run: if beats { u64::from(look) } else { 7 },
                ..Status::default()
            };
            let ran_ns = (f64::from(look) * since.as_nanos() as f64 * ran_share) as u64;
            hanging = pulses.hanging(&beats.map(status), since, |_| Some(Look { state, ran_ns, is_dying: false }));
        }
        hanging
    }

    const MS_10: Duration = Duration::from_millis(10);
    const WITHOUT_INNER: [bool; 4] = [true, true, false, true];

    #[test]
    fn a_heartbeat_that_stands_still_is_a_hang_after_80_ms() {
        for state in ['S', 'D', 'T', 't'] {
            assert_eq!(hanging(WITHOUT_INNER, state, 0.0, MS_10, 9), [STAGES[INNER]], "{state}");
            assert_eq!(hanging(WITHOUT_INNER, state, 0.0, MS_10, 8), [], "{state}");
        }
        assert_eq!(hanging(WITHOUT_INNER, 'R', 0.9, MS_10, 9), [STAGES[INNER]], "it computes, and does not end");
        assert_eq!(hanging([true; 4], 'S', 0.0, MS_10, 20), []);
    }

    #[test]
    fn who_waits_for_the_processor_does_not_hang() {
        assert_eq!(hanging(WITHOUT_INNER, 'R', 0.1, MS_10, 20), []);
    }

    #[test]
    fn a_machine_that_stands_still_is_nobodys_hang_but_a_stopped_process_is() {
        assert_eq!(hanging([false; 4], 'S', 0.0, MS_10, 20), []);
        assert_eq!(hanging([false; 4], 'T', 0.0, MS_10, 20), STAGES);
        // A launcher that did not get to look for a second has seen nothing of it.
        assert_eq!(hanging(WITHOUT_INNER, 'S', 0.0, Duration::from_secs(1), 4), []);
    }

    /// Looks at loops of which the inner one's heartbeat stands still, until it hangs; after how many looks.
    fn looks_until_a_hang(tick: Duration, is_dying: bool) -> Option<u64> {
        let mut pulses = Pulses::new(tick);
        let look = Look { state: 'D', ran_ns: 0, is_dying };
        (0..100).find(|&ticks| {
            let status = |ticks_run| Status { phase: RolePhase::Flying as u64, ticks_run, ..Status::default() };
            let (on, still) = (status(ticks), status(7));
            !pulses.hanging(&[on, on, still, on], MS_10, |_| Some(look)).is_empty()
        })
    }

    #[test]
    fn long_ticks_are_waited_for() {
        assert_eq!(looks_until_a_hang(Duration::from_millis(1), false), Some(8));
        assert_eq!(looks_until_a_hang(Duration::from_millis(100), false), Some(50), "five ticks of 100 ms");
    }

    #[test]
    fn who_is_dying_does_not_hang() {
        assert_eq!(looks_until_a_hang(Duration::from_millis(1), true), None);
    }
}
