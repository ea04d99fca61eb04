//! Faults of messages and stages, as the report lists them. Changes of parameters are in [`crate::swaps`].

use serde::{Deserialize, Serialize};

/// Until when a fault strikes that has no end.
const FOR_GOOD: &str = "for good";
const ONCE: &str = "once";
const CALLED_OFF: &str = "called off before";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InjectedFault {
    pub what: String,
    pub tick: u64,
    pub time_s: f64,
    /// First tick that it does not strike any more; none where it has no end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_tick: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub live: bool,
}

impl InjectedFault {
    /// A fault that strikes from a tick of `period_s` [s] on, and up to another where it has an end.
    pub fn new(what: String, tick: u64, to_tick: Option<u64>, period_s: f64) -> Self {
        let time_s = |tick: u64| tick as f64 * period_s;
        Self {
            what,
            tick,
            time_s: time_s(tick),
            to_tick,
            to_s: to_tick.map(time_s),
            live: false,
        }
    }

    pub fn in_flight(self) -> Self {
        Self { live: true, ..self }
    }

    /// `setpoint.drop=0.1 from tick 8000 (8.000 s) to tick 9000 (9.000 s)`.
    pub fn words(&self) -> String {
        let (what, tick, time_s) = (&self.what, self.tick, self.time_s);
        let how = if self.live {
            ", injected in flight"
        } else {
            ""
        };
        let from = format!("tick {tick} ({time_s:.3} s)");
        match self.to_tick.zip(self.to_s) {
            _ if self.is_called_off() => format!("{what} from {from}, called off before{how}"),
            Some((tick, time_s)) => {
                format!("{what} from {from} to tick {tick} ({time_s:.3} s){how}")
            }
            None if self.happens_once() => format!("{what} at {from}{how}"),
            None => format!("{what} from {from}{how}"),
        }
    }

    pub fn brief(&self) -> String {
        let Self { what, time_s, .. } = self;
        match self.until() {
            until if until == ONCE => format!("{what} at {time_s:.3} s"),
            until if until == FOR_GOOD => format!("{what} from {time_s:.3} s on"),
            until if until == CALLED_OFF => format!("{what} called off before {time_s:.3} s"),
            until => format!("{what} {time_s:.3} to {until}"),
        }
    }

    /// Whether it struck in some ticks, or just before them: what happens once is seen in the next tick, too.
    pub fn strikes(&self, first: u64, last: u64) -> bool {
        let to = match self.happens_once() {
            true => self.tick.saturating_add(2),
            false => self.to_tick.unwrap_or(u64::MAX),
        };
        self.tick <= last && to > first && !self.is_called_off()
    }

    /// Ended by another fault's tick, where it would be on then.
    pub fn end(&mut self, tick: u64, period_s: f64) {
        if !self.happens_once() && self.to_tick.is_none_or(|to| to > tick) {
            (self.to_tick, self.to_s) = (Some(tick), Some(tick as f64 * period_s));
        }
    }

    fn happens_once(&self) -> bool {
        let happens_once = |one: &str| {
            let name = one.split('=').next().unwrap_or_default();
            let kinds = [".stop", ".kill", ".late"];
            one.ends_with("=off") || kinds.iter().any(|kind| name.ends_with(kind))
        };
        self.to_tick.is_none() && self.what.split(',').all(happens_once)
    }

    fn is_called_off(&self) -> bool {
        self.to_tick.is_some_and(|to| to <= self.tick)
    }

    /// Until when it strikes: an instant, for good, or once.
    pub fn until(&self) -> String {
        match self.to_s {
            _ if self.is_called_off() => CALLED_OFF.into(),
            Some(to_s) => format!("{to_s:.3} s"),
            None if self.happens_once() => ONCE.into(),
            None => FOR_GOOD.into(),
        }
    }

    /// Its begin and its end as marks over time [s].
    pub(crate) fn marks(&self) -> impl Iterator<Item = (f64, String)> {
        let Self { what, time_s, .. } = self;
        let begin = (*time_s, format!("fault from {time_s:.3} s: {what}"));
        let end = |to_s| (to_s, format!("fault until {to_s:.3} s: {what}"));
        let end = self.to_s.map(end);
        std::iter::once(begin).chain(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(what: &str, tick: u64, to_tick: Option<u64>, period_s: f64) -> InjectedFault {
        InjectedFault::new(what.into(), tick, to_tick, period_s)
    }

    #[test]
    fn a_fault_is_told_with_its_instants() {
        let with_end = fault("state.drop=0.1", 8000, Some(9000), 0.001);
        let for_good = fault("state.freeze", 500, None, 0.002);
        let once = fault("inner.stop=20ms", 8000, None, 0.001);
        let mut ended = for_good.clone();
        ended.end(700, 0.002);
        ended.end(900, 0.002);
        let mut called_off = ended.clone();
        called_off.end(400, 0.002);
        for (fault, words, brief, until) in [
            (
                &with_end,
                "state.drop=0.1 from tick 8000 (8.000 s) to tick 9000 (9.000 s)",
                "state.drop=0.1 8.000 to 9.000 s",
                "9.000 s",
            ),
            (
                &for_good,
                "state.freeze from tick 500 (1.000 s)",
                "state.freeze from 1.000 s on",
                "for good",
            ),
            (
                &once,
                "inner.stop=20ms at tick 8000 (8.000 s)",
                "inner.stop=20ms at 8.000 s",
                "once",
            ),
            (
                &ended,
                "state.freeze from tick 500 (1.000 s) to tick 700 (1.400 s)",
                "state.freeze 1.000 to 1.400 s",
                "1.400 s",
            ),
            (
                &called_off,
                "state.freeze from tick 500 (1.000 s), called off before",
                "state.freeze called off before 1.000 s",
                "called off before",
            ),
        ] {
            assert_eq!((&*fault.words(), &*fault.brief()), (words, brief));
            assert_eq!(fault.until(), until);
        }
        let live = "state.freeze from tick 500 (1.000 s), injected in flight";
        assert_eq!(for_good.clone().in_flight().words(), live);
        assert!(with_end.marks().map(|(time_s, _)| time_s).eq([8.0, 9.0]));
        assert_eq!(for_good.marks().count(), 1);
        assert!(with_end.strikes(7000, 8000) && with_end.strikes(8999, 9999));
        assert!(!with_end.strikes(7000, 7999) && !with_end.strikes(9000, 9999));
        assert!(for_good.strikes(9000, 9000) && !for_good.strikes(0, 499));
        assert!(once.strikes(8001, 8020) && !once.strikes(8002, 8020));
        assert!(!called_off.strikes(0, 9000));
    }

    #[test]
    fn faults_that_happen_once_have_no_end() {
        for (what, until) in [
            ("inner.kill", "once"),
            ("inner.late=1ms,mixer.kill", "once"),
            ("state.drop=off", "once"),
            ("inner.kill,cpu.hog=90", "for good"),
        ] {
            assert_eq!(fault(what, 8000, None, 0.001).until(), until, "{what}");
        }
    }
}
