//! Faults of messages and stages as the report has them, and their words. Those of parameters are swaps.

use serde::{Deserialize, Serialize};

/// A fault that was planned, or injected in flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InjectedFault {
    /// What, as it is typed: `inner.setpoint.delay=5`.
    pub what: String,
    /// First tick that it strikes.
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
    #[must_use]
    pub fn new(what: String, tick: u64, to_tick: Option<u64>, period_s: f64) -> Self {
        let time_s = |tick: u64| tick as f64 * period_s;
        Self { what, tick, time_s: time_s(tick), to_tick, to_s: to_tick.map(time_s), live: false }
    }

    /// The same, injected in flight.
    #[must_use]
    pub fn in_flight(self) -> Self {
        Self { live: true, ..self }
    }

    /// `setpoint.drop=0.1 from tick 8000 (8.000 s) to tick 9000 (9.000 s)`.
    #[must_use]
    pub fn words(&self) -> String {
        let Self { what, tick, time_s, .. } = self;
        let to = self.to_tick.zip(self.to_s).map(|(tick, time_s)| format!(" to tick {tick} ({time_s:.3} s)"));
        let how = if self.live { ", injected in flight" } else { "" };
        format!("{what} from tick {tick} ({time_s:.3} s){}{how}", to.unwrap_or_default())
    }

    /// Until when it strikes: an instant, for good, or once.
    #[must_use]
    pub fn until(&self) -> String {
        let happens_once = |one: &str| {
            let name = one.split('=').next().unwrap_or_default();
            one.ends_with("=off") || [".stop", ".kill", ".late"].iter().any(|once| name.ends_with(once))
        };
        match self.to_s {
            Some(to_s) => format!("{to_s:.3} s"),
            None if self.what.split(',').all(happens_once) => "once".into(),
            None => "for good".into(),
        }
    }

    /// Its begin and its end as marks over time [s].
    pub(crate) fn marks(&self) -> impl Iterator<Item = (f64, String)> {
        let Self { what, time_s, .. } = self;
        let begin = (*time_s, format!("fault from {time_s:.3} s: {what}"));
        let end = self.to_s.map(|to_s| (to_s, format!("fault until {to_s:.3} s: {what}")));
        std::iter::once(begin).chain(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_told_with_its_instants() {
        let with_end = InjectedFault::new("state.drop=0.1".into(), 8000, Some(9000), 0.001);
        assert_eq!(with_end.words(), "state.drop=0.1 from tick 8000 (8.000 s) to tick 9000 (9.000 s)");
        let marks: Vec<f64> = with_end.marks().map(|(time_s, _)| time_s).collect();
        assert_eq!(marks, [8.0, 9.0]);
        let for_good = InjectedFault::new("state.freeze".into(), 500, None, 0.002);
        assert_eq!(for_good.words(), "state.freeze from tick 500 (1.000 s)");
        assert_eq!(for_good.marks().count(), 1);
        assert_eq!([with_end.until(), for_good.until()], ["9.000 s", "for good"]);
        for once in ["inner.stop=20ms", "inner.kill", "inner.late=1ms,mixer.kill", "state.drop=off"] {
            assert_eq!(InjectedFault::new(once.into(), 8000, None, 0.001).until(), "once", "{once}");
        }
        assert_eq!(InjectedFault::new("inner.kill,cpu.hog=90".into(), 8000, None, 0.001).until(), "for good");
        assert_eq!(for_good.in_flight().words(), "state.freeze from tick 500 (1.000 s), injected in flight");
    }
}
