//! The numbers that stand for a fault in messages.

use crate::kind::{FaultKind, LiveFault, PORTS, Place, Span, Target};
use messages::fault_kinds::{FaultSpec, FaultValue, Kind};
use messages::layout::layout;
use messages::role::{Channel, Role, STAGES};

layout! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct FaultCode {
        pub what: u64,
        /// Place of the input among [`PORTS`], or of the stage among [`STAGES`].
        pub place: u64,
        /// Place of the field among those that faults can change.
        pub field: u64,
        /// Place of the number in it, or of the stage's channel, and 1; 0 is all of them.
        pub axis: u64,
        /// The number of the fault, or the bits of it.
        pub first: u64,
        pub second: u64,
        pub ends: u64,
        pub from: u64,
        pub to: u64,
    }
}

impl FaultCode {
    pub fn of(fault: &LiveFault) -> Self {
        let (place, field, axis) = match fault.kind.target {
            Target::Message(_, port) => (port as u64, 0, None),
            Target::Number(_, port, Place { field, axis }) => (port as u64, field as u64, axis),
            Target::Stage(_, role, channel) => (role as u64, 0, channel.map(|it| it as usize)),
            Target::Processor(_) => (0, 0, None),
            Target::Channel(_, channel) => (0, 0, Some(channel as usize)),
        };
        let FaultValue([first, second]) = fault.kind.value;
        Self {
            what: fault.kind.spec().id as u64,
            place,
            field,
            axis: axis.map_or(0, |axis| axis as u64 + 1),
            first,
            second,
            ends: u64::from(fault.ends),
            from: fault.span.from,
            to: fault.span.to,
        }
    }

    /// The fault; nothing where the numbers are none that a fault may have.
    pub fn fault(&self) -> Option<LiveFault> {
        let spec = FaultSpec::of(self.what)?;
        let value = FaultValue([self.first, self.second]);
        let at = usize::try_from(self.place).ok()?;
        let port = || PORTS.get(at).copied();
        let channel = || Some(self.axis(Channel::ALL.len())?.map(|it| Channel::ALL[it]));
        let target = match spec.kind {
            Kind::Message(kind) => Target::Message(kind, port()?),
            Kind::Number(kind) => {
                let field = usize::try_from(self.field).ok()?;
                let axis = self.axis(port()?.fields().get(field)?.axes.len())?;
                Target::Number(kind, port()?, Place { field, axis })
            }
            Kind::Stage(kind) => {
                let (role, channel) = (*STAGES.get(at)?, channel()?);
                let is_possible = kind.acts_on(role) && (role != Role::Plant || channel.is_none());
                is_possible.then_some(Target::Stage(kind, role, channel))?
            }
            Kind::Processor(kind) => Target::Processor(kind),
            Kind::Channel(kind) => Target::Channel(kind, channel()??),
        };
        let ends = self.ends == 1;
        let is_fault = spec.value.has(value) && self.ends <= 1 && !(ends && spec.is_once());
        is_fault.then_some(LiveFault {
            kind: FaultKind { target, value },
            ends,
            span: Span::new(self.from, self.to),
        })
    }

    /// Which of so many is meant, or all.
    fn axis(&self, count: usize) -> Option<Option<usize>> {
        let Some(place) = self.axis.checked_sub(1) else {
            return Some(None);
        };
        let place = usize::try_from(place).ok()?;
        (place < count).then_some(Some(place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_no_fault_are_none() {
        let share = |share: f64| share.to_bits();
        let (third, long) = (3, 1 << 62);
        // What, place, field, axis, first, second, ends.
        let code = |[what, place, field, axis, first, second, ends]: [u64; 7]| FaultCode {
            what,
            place,
            field,
            axis,
            first,
            second,
            ends,
            ..FaultCode::default()
        };
        for sound in [
            [1, 0, 0, 0, share(0.1), 0, 0],
            [6, third, 1, 3, share(1.0), 0, 0],
            [9, 2, 0, 0, 40, 400, 0],
            [10, 2, 0, 0, 5, 0, 0],
        ] {
            let fault = code(sound).fault();
            assert_eq!(fault.as_ref().map(FaultCode::of), Some(code(sound)));
        }
        for broken in [
            [0, 0, 0, 0, share(0.1), 0, 0],
            [14, 0, 0, 0, 0, 0, 0],
            [1000, 0, 0, 0, share(0.1), 0, 0],
            [1, 5, 0, 0, share(0.1), 0, 0],
            [1, 0, 0, 0, share(1.5), 0, 0],
            [1, 0, 0, 0, share(f64::NAN), 0, 0],
            [1, 0, 0, 0, share(0.1), 0, 2],
            [2, 0, 0, 0, 3, 2, 0],
            [2, 0, 0, 0, 1, 1_000_001, 0],
            [3, 0, 0, 0, 61, 0, 0],
            [4, 0, 0, 0, 0, 0, 0],
            [6, third, 2, 3, share(1.0), 0, 0],
            [6, third, 1, 4, share(1.0), 0, 0],
            [6, third, 1, 3, share(f64::INFINITY), 0, 0],
            [6, third, 1, 3, share(-1.0), 0, 0],
            [7, third, 1, 3, share(0.0), 0, 0],
            [9, 4, 0, 0, 40, 400, 0],
            [9, 2, 0, 0, 401, 400, 0],
            [9, 2, 0, 0, 0, 400, 0],
            [9, 2, 0, 0, 40, long, 0],
            [10, 2, 0, 0, long, 0, 0],
            [10, 2, 0, 4, 5, 0, 0],
            [10, Role::Plant as u64, 0, 1, 5, 0, 0],
            [10, 2, 0, 0, 5, 0, 1],
            [11, 2, 0, 0, 5, 0, 1],
            [11, Role::Plant as u64, 0, 0, 5, 0, 0],
            [12, 2, 0, 0, 100, 0, 0],
            [12, 2, 0, 0, 0, 0, 0],
            [13, 2, 0, 0, share(1.5), 0, 0],
        ] {
            assert_eq!(code(broken).fault(), None, "{broken:?}");
        }
    }
}
