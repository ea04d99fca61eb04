//! Faults of messages and stages, as the report lists them. Changes of parameters are in [`crate::swaps`].

use serde::{Deserialize, Serialize};

/// Until when a fault strikes that has no end.
const FOR_GOOD: &str = "for good";
/// Of one that has no duration.
const ONCE: &str = "once";
/// Of one that was ended before it began.
const CALLED_OFF: &str = "called off before";

/// A fault that was planned, or injected in flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InjectedFault {
    /// What, as it is typed: `inner.setpoint.delay=5`.
    pub what: String,
    pub tick: u64,
    /// The same as time of the flight [s].
    pub time_s: f64,
    /// First tick that it does not strike any more; none where it has no end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_tick: Option<u64>,
    /// The same as time of the flight [s].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    /// Whether it was injected in flight.
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
        let Self {
            what, tick, time_s, ..
        } = self;
        let to = self
            .to_tick
            .zip(self.to_s)
            .map(|(tick, time_s)| format!(" to tick {tick} ({time_s:.3} s)"));
        let how = if self.live {
            ", injected in flight"
        } else {
            ""
        };
        let begin = if self.happens_once() { "at" } else { "from" };
        match self.is_called_off() {
            true => format!("{what} from tick {tick} ({time_s:.3} s), called off before{how}"),
            false => format!(
                "{what} {begin} tick {tick} ({time_s:.3} s){}{how}",
                to.unwrap_or_default()
            ),
        }
    }

    /// The same in short, by the time of the flight.
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
        let to = if self.happens_once() {
            self.tick.saturating_add(2)
        } else {
            self.to_tick.unwrap_or(u64::MAX)
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
            one.ends_with("=off")
                || [".stop", ".kill", ".late"]
                    .iter()
                    .any(|once| name.ends_with(once))
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
        let end = self
            .to_s
            .map(|to_s| (to_s, format!("fault until {to_s:.3} s: {what}")));
        std::iter::once(begin).chain(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_told_with_its_instants() {
        let with_end = InjectedFault::new("state.drop=0.1".into(), 8000, Some(9000), 0.001);
        assert_eq!(
            with_end.words(),
            "state.drop=0.1 from tick 8000 (8.000 s) to tick 9000 (9.000 s)"
        );
        let marks: Vec<f64> = with_end.marks().map(|(time_s, _)| time_s).collect();
        assert_eq!(marks, [8.0, 9.0]);
        let for_good = InjectedFault::new("state.freeze".into(), 500, None, 0.002);
        assert_eq!(for_good.words(), "state.freeze from tick 500 (1.000 s)");
        assert_eq!(for_good.marks().count(), 1);
        assert_eq!(
            [with_end.until(), for_good.until()],
            ["9.000 s", "for good"]
        );
        for once in [
            "inner.stop=20ms",
            "inner.kill",
            "inner.late=1ms,mixer.kill",
            "state.drop=off",
        ] {
            assert_eq!(
                InjectedFault::new(once.into(), 8000, None, 0.001).until(),
                "once",
                "{once}"
            );
        }
        assert_eq!(
            InjectedFault::new("inner.kill,cpu.hog=90".into(), 8000, None, 0.001).until(),
            "for good"
        );
        let once = InjectedFault::new("inner.stop=20ms".into(), 8000, None, 0.001);
        assert_eq!(once.words(), "inner.stop=20ms at tick 8000 (8.000 s)");
        assert_eq!(
            [&with_end, &for_good, &once].map(InjectedFault::brief),
            [
                "state.drop=0.1 8.000 to 9.000 s",
                "state.freeze from 1.000 s on",
                "inner.stop=20ms at 8.000 s"
            ]
        );
        assert!(with_end.strikes(7000, 8000) && with_end.strikes(8999, 9999));
        assert!(!with_end.strikes(7000, 7999) && !with_end.strikes(9000, 9999));
        assert!(for_good.strikes(9000, 9000) && !for_good.strikes(0, 499));
        assert!(once.strikes(8001, 8020) && !once.strikes(8002, 8020));
        let mut ended = for_good.clone();
        ended.end(700, 0.002);
        assert_eq!(
            ended.words(),
            "state.freeze from tick 500 (1.000 s) to tick 700 (1.400 s)"
        );
        ended.end(900, 0.002);
        assert_eq!(ended.to_tick, Some(700), "it was over by then");
        ended.end(400, 0.002);
        assert_eq!(
            [ended.brief(), ended.until()],
            [
                "state.freeze called off before 1.000 s",
                "called off before"
            ]
        );
        assert!(!ended.strikes(0, 9000));
        assert_eq!(
            for_good.in_flight().words(),
            "state.freeze from tick 500 (1.000 s), injected in flight"
        );
    }
}
