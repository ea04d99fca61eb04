//! What is done to processes: stages that are late, stopped or killed, and processes that keep their processor busy.
//!
//! One table of rules for what is planned and what is injected: what a flight in the air took, its replay can plan.

use crate::fault::live::{FaultKind, LiveFault, MOST_LIVE};
use crate::fault::{NotTaken, Span};
use crate::role::Role;

/// How long a stage that was killed takes until it works again [ns]: a launcher that lets nothing start anew within
/// 50 ms, and a process that is ready well within as much again.
pub const RESTART_NS: u64 = 100_000_000;

/// What is done to processes in a flight, in the order in which it was planned or injected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acts {
    sample_time_ns: u64,
    acts: [Option<LiveFault>; MOST_LIVE],
}

impl Acts {
    /// Nothing, in a flight with ticks of so much flight time [ns].
    #[must_use]
    pub const fn none(sample_time_ns: u64) -> Self {
        Self {
            sample_time_ns,
            acts: [None; MOST_LIVE],
        }
    }

    /// Takes one more, or the end of one. Faults of messages are taken and do nothing here.
    ///
    /// # Errors
    /// [`NotTaken`] where two faults of a stage would meet, or two hogs or loads; where a stop is shorter than a tick;
    /// where there is nothing to end, or where there are [`MOST_LIVE`]. Nothing is changed then.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), NotTaken> {
        let LiveFault {
            trouble,
            ends,
            span,
        } = *fault;
        if matches!(trouble, FaultKind::Messages { .. }) {
            return Ok(());
        }
        if matches!(trouble, FaultKind::Stop { for_ns, .. } if for_ns < self.sample_time_ns) {
            return Err(NotTaken::UnderATick);
        }
        let of_processor =
            |other: &LiveFault| self.outage(other).is_none() && other.trouble.is_like(&trouble);
        if !ends
            && self
                .begun()
                .any(|other| of_processor(other) && other.span.meets(span))
        {
            return Err(NotTaken::Contradiction);
        }
        if let Some((role, own)) = self.outage(fault).filter(|_| !ends) {
            let meets = |other: &LiveFault| {
                self.outage(other)
                    .is_some_and(|(other, span)| other == role && span.meets(own))
            };
            if self.begun().any(meets) {
                return Err(NotTaken::Contradiction);
            }
        }
        let is_meant = |other: &LiveFault| {
            let Span { from, to } = other.span;
            other.trouble.is_like(&trouble) && to > span.from && from < to
        };
        if ends && !self.begun().any(is_meant) {
            return Err(NotTaken::NothingToEnd);
        }
        let place = self
            .acts
            .iter()
            .position(Option::is_none)
            .ok_or(NotTaken::NoRoom)?;
        if ends {
            let meant = self
                .acts
                .iter_mut()
                .flatten()
                .filter(|other| !other.ends && is_meant(other));
            meant.for_each(|other| other.span = other.span.cut(span.from));
        }
        self.acts[place] = Some(*fault);
        Ok(())
    }

    /// What is begun, up to its end; ends are not among it.
    pub fn begun(&self) -> impl Iterator<Item = &LiveFault> {
        self.acts.iter().flatten().filter(|fault| !fault.ends)
    }

    /// The ticks in which a fault has its stage not do what it does otherwise; none where it has no stage.
    fn outage(&self, fault: &LiveFault) -> Option<(Role, Span)> {
        let Span { from, .. } = fault.span;
        let ticks = |ns: u64| (ns / self.sample_time_ns.max(1)).max(1);
        let out = |ns| Span {
            from,
            to: from.saturating_add(ticks(ns)),
        };
        match fault.trouble {
            FaultKind::Late { role, .. } => Some((role, fault.span)),
            FaultKind::Stop { role, for_ns } => Some((role, out(for_ns))),
            FaultKind::Kill { role } => Some((role, out(RESTART_NS))),
            FaultKind::Messages { .. } | FaultKind::Hog { .. } | FaultKind::Load { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOG: FaultKind = FaultKind::Hog { priority: 90 };

    fn fault(trouble: FaultKind, from: u64, to: u64) -> LiveFault {
        LiveFault {
            trouble,
            ends: false,
            span: Span { from, to },
        }
    }

    fn off(trouble: FaultKind, from: u64) -> LiveFault {
        LiveFault {
            ends: true,
            ..fault(trouble, from, from + 1)
        }
    }

    fn stop(from: u64, ticks: u64) -> LiveFault {
        fault(
            FaultKind::Stop {
                role: Role::Inner,
                for_ns: ticks * 1_000_000,
            },
            from,
            from + 1,
        )
    }

    #[test]
    fn a_stage_has_one_fault_at_a_time() {
        let mut acts = Acts::none(1_000_000);
        acts.take(&stop(100, 20)).unwrap();
        assert_eq!(
            acts.take(&stop(119, 500)),
            Err(NotTaken::Contradiction),
            "its end would cut the other short"
        );
        acts.take(&stop(120, 5)).unwrap();
        let late = |from, to| {
            fault(
                FaultKind::Late {
                    role: Role::Inner,
                    least_ns: 1,
                    most_ns: 2,
                },
                from,
                to,
            )
        };
        assert_eq!(acts.take(&late(90, 101)), Err(NotTaken::Contradiction));
        let kill = |role| fault(FaultKind::Kill { role }, 110, 111);
        assert_eq!(acts.take(&kill(Role::Inner)), Err(NotTaken::Contradiction));
        acts.take(&kill(Role::Mixer)).unwrap();
        assert_eq!(
            acts.take(&fault(
                FaultKind::Stop {
                    role: Role::Mixer,
                    for_ns: 1_000_000
                },
                209,
                210
            )),
            Err(NotTaken::Contradiction)
        );
        acts.take(&fault(
            FaultKind::Stop {
                role: Role::Mixer,
                for_ns: 1_000_000,
            },
            210,
            211,
        ))
        .unwrap();
        acts.take(&late(200, Span::FOR_GOOD)).unwrap();
        acts.take(&off(late(0, 1).trouble, 300)).unwrap();
        acts.take(&stop(300, 1)).unwrap();
    }

    #[test]
    fn what_is_not_on_is_not_ended_and_what_is_ended_is_not_on() {
        let mut acts = Acts::none(1_000_000);
        assert_eq!(acts.take(&off(HOG, 100)), Err(NotTaken::NothingToEnd));
        acts.take(&fault(HOG, 50, 90)).unwrap();
        assert_eq!(
            acts.take(&off(HOG, 90)),
            Err(NotTaken::NothingToEnd),
            "its time is over by then"
        );
        acts.take(&fault(HOG, 200, Span::FOR_GOOD)).unwrap();
        assert_eq!(
            acts.take(&off(FaultKind::Load { share: 0.5 }, 100)),
            Err(NotTaken::NothingToEnd)
        );
        acts.take(&off(FaultKind::Hog { priority: 1 }, 100))
            .unwrap();
        assert_eq!(acts.take(&off(HOG, 101)), Err(NotTaken::NothingToEnd));
        let left: Vec<Span> = acts.begun().map(|fault| fault.span).collect();
        assert_eq!(
            left,
            [Span { from: 50, to: 90 }, Span { from: 200, to: 200 }]
        );
    }

    #[test]
    fn a_stop_takes_a_tick_at_least() {
        let stop = |for_ns| {
            fault(
                FaultKind::Stop {
                    role: Role::Inner,
                    for_ns,
                },
                100,
                101,
            )
        };
        assert_eq!(
            Acts::none(1_000_000).take(&stop(999_999)),
            Err(NotTaken::UnderATick)
        );
        assert_eq!(Acts::none(1_000_000).take(&stop(1_000_000)), Ok(()));
        assert_eq!(
            Acts::none(2_000_000).take(&stop(1_000_000)),
            Err(NotTaken::UnderATick)
        );
    }

    #[test]
    fn the_processor_has_one_hog_and_one_load_at_a_time() {
        let mut acts = Acts::none(1_000_000);
        acts.take(&fault(HOG, 100, Span::FOR_GOOD)).unwrap();
        let other = FaultKind::Hog { priority: 1 };
        assert_eq!(
            acts.take(&fault(other, 200, 300)),
            Err(NotTaken::Contradiction)
        );
        acts.take(&fault(FaultKind::Load { share: 0.5 }, 200, 300))
            .unwrap();
        assert_eq!(
            acts.take(&fault(FaultKind::Load { share: 0.1 }, 299, 400)),
            Err(NotTaken::Contradiction)
        );
        acts.take(&fault(other, 50, 100)).unwrap();
        acts.take(&off(HOG, 250)).unwrap();
        acts.take(&fault(other, 250, 300)).unwrap();
    }

    #[test]
    fn a_flight_has_room_for_so_many() {
        let mut acts = Acts::none(1_000_000);
        (0..MOST_LIVE as u64).for_each(|n| acts.take(&stop(n, 1)).unwrap());
        assert_eq!(acts.take(&stop(500, 1)), Err(NotTaken::NoRoom));
        assert_eq!(acts.begun().count(), MOST_LIVE);
    }
}
