//! Faults, parameter changes and failed processes of a flight, as the report lists them.

use faults::grammar::duration;
use faults::{FAULTS, Lasts};
use messages::content::{Change, SwapRecord};
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InjectedFault {
    pub what: String,
    pub tick: u64,
    pub time_s: f64,
    /// First tick at which it is no longer active; none where it has no end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_tick: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub live: bool,
    /// Ticks by which the supervisor began it late.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delayed_ticks: Option<u64>,
}

impl InjectedFault {
    /// A fault that is active from a tick of `period_s` [s] on, and up to another where it has an end.
    pub fn new(what: String, tick: u64, to_tick: Option<u64>, period_s: f64) -> Self {
        let time_s = |tick: u64| tick as f64 * period_s;
        Self {
            what,
            tick,
            time_s: time_s(tick),
            to_tick,
            to_s: to_tick.map(time_s),
            live: false,
            delayed_ticks: None,
        }
    }

    /// Records how late the supervisor began a fault, if that is a part of this one.
    pub fn note(&mut self, delayed: &Self) {
        let is_part = self.what.split(',').any(|what| what == delayed.what);
        if is_part && self.tick == delayed.tick {
            self.delayed_ticks = delayed.delayed_ticks;
        }
    }

    fn begun(&self) -> u64 {
        self.tick.saturating_add(self.delayed_ticks.unwrap_or(0))
    }

    pub fn in_flight(self) -> Self {
        Self { live: true, ..self }
    }

    /// First tick in which it can no longer act; none if it has no end. An event acts also in the tick after it; a stop,
    /// until it has ended or its process was replaced.
    pub fn end_tick(&self, period_s: f64, failures: &[ProcessFailure]) -> Option<u64> {
        match self.happens_once() {
            true => Some(
                self.begun()
                    .saturating_add(2 + self.stop_ticks(period_s, failures)),
            ),
            false => self.to_tick,
        }
    }

    /// True if the fault may have a part in an outage of these ticks.
    pub fn is_active(
        &self,
        first: u64,
        last: u64,
        period_s: f64,
        failures: &[ProcessFailure],
    ) -> bool {
        let to = self.end_tick(period_s, failures).unwrap_or(u64::MAX);
        self.begun() <= last && to > first && !self.is_cancelled()
    }

    /// Ticks of the longest stop among its changes, or up to the successor of a process that did not outlive its stop.
    fn stop_ticks(&self, period_s: f64, failures: &[ProcessFailure]) -> u64 {
        let stop = |change: &str| {
            let (stage, time) = change.split_once(".stop=")?;
            let planned = (duration(time).ok()?.as_secs_f64() / period_s).round() as u64;
            let back = |it: &ProcessFailure| (it.tick + it.ticks_lost?).checked_sub(self.begun());
            let replaced = failures
                .iter()
                .filter(|it| it.role == stage)
                .filter_map(back);
            Some(replaced.fold(planned, u64::min))
        };
        self.what.split(',').filter_map(stop).max().unwrap_or(0)
    }

    /// Ends the fault at a tick if it would act longer. If that is before it begins, it never acts.
    pub fn end(&mut self, tick: u64, period_s: f64) {
        let tick = tick.max(self.tick);
        let has_begun = tick > self.tick;
        if !(has_begun && self.happens_once()) && self.to_tick.is_none_or(|to| to > tick) {
            (self.to_tick, self.to_s) = (Some(tick), Some(tick as f64 * period_s));
        }
    }

    pub fn happens_once(&self) -> bool {
        let happens_once = |one: &str| {
            let name = one.split('=').next().unwrap_or_default();
            let mut once = FAULTS.iter().filter(|spec| spec.lasts != Lasts::ForGood);
            one.ends_with("=off") || once.any(|it| name.split('.').next_back() == Some(it.name))
        };
        self.to_tick.is_none() && self.what.split(',').all(happens_once)
    }

    /// True for a fault that began and does more than end others.
    pub fn acted(&self) -> bool {
        !self.is_cancelled() && self.what.split(',').any(|it| !it.ends_with("=off"))
    }

    /// Whether another fault ended it before it began.
    pub fn is_cancelled(&self) -> bool {
        self.to_tick.is_some_and(|to| to <= self.tick)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AppliedSwap {
    pub tick: u64,
    pub time_s: f64,
    pub parameter_epoch: u64,
    pub changes: Vec<ParameterChange>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterChange {
    pub name: String,
    pub old: f64,
    /// From then on, or from the end of the ramp on.
    pub new: f64,
    /// How long the ramp to it takes [s]; 0 where it holds at once.
    pub over_s: f64,
}

impl AppliedSwap {
    /// A swap that holds from a tick of `period_s` [s] on.
    pub fn new(tick: u64, period_s: f64, record: &SwapRecord) -> Self {
        let change = |it: Change| ParameterChange {
            name: it.parameter.name().into(),
            old: it.old,
            new: it.new,
            over_s: if it.steps > 1 {
                it.steps as f64 * period_s
            } else {
                0.0
            },
        };
        Self {
            tick,
            time_s: tick as f64 * period_s,
            parameter_epoch: record.parameter_epoch,
            changes: record.changes().map(change).collect(),
        }
    }
}

/// The end of a process that the flight still needed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcessFailure {
    pub role: String,
    /// Tick of its last message; of a process that sent none, the tick in which its end was noticed.
    pub tick: u64,
    pub time_s: f64,
    /// When the process started, on `CLOCK_MONOTONIC` [ns]: the epoch of its messages. 0 where it sent none.
    pub epoch: u64,
    /// How it ended, as `signal: 9 (SIGKILL)`; empty if no process waited for it.
    pub how: String,
    /// From the beginning of its last tick until the supervisor was notified [ms].
    pub noticed_after_ms: Option<f64>,
    /// From its last message to the first one of its successor [ms]; none where there was none.
    pub back_after_ms: Option<f64>,
    /// Ticks of which the role sent no message, up to its successor's first or to the end of the flight.
    pub ticks_lost: Option<u64>,
    /// Of a successor that sent no message: tick of the failure that it was started for, which also counts its ticks.
    pub within: Option<u64>,
    /// Parts of that time, where a supervisor saw it.
    pub back_parts: Option<RecoveryPhases>,
    /// Largest position error after its last message, within [`COST_S`](crate::process_failures::COST_S) [m].
    pub position_error_max_m: Option<f64>,
}

/// Parts of the recovery time of a stage, in order [ms].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RecoveryPhases {
    pub noticed_ms: f64,
    /// The supervisor removed the dead process's shared memory.
    pub cleaned_ms: f64,
    /// The supervisor waited until the restart was due, and the new process ran.
    pub begun_ms: f64,
    /// It had its settings and its law.
    pub made_ms: f64,
    /// It had its place: the role's lock, a node of the middleware, its status board.
    pub placed_ms: f64,
    pub ported_ms: f64,
    pub engaged_ms: f64,
    /// It had found the run, and connected its ports.
    pub armed_ms: f64,
    /// The tick of its first message began.
    pub first_tick_ms: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(what: &str, tick: u64, to_tick: Option<u64>, period_s: f64) -> InjectedFault {
        InjectedFault::new(what.into(), tick, to_tick, period_s)
    }

    #[test]
    fn a_fault_acts_from_its_tick_to_its_end() {
        let with_end = fault("state.drop=0.1", 8000, Some(9000), 0.001);
        let for_good = fault("state.freeze", 500, None, 0.002);
        let once = fault("inner.stop=20ms", 8000, None, 0.001);
        let mut ended = for_good.clone();
        ended.end(700, 0.002);
        ended.end(900, 0.002);
        assert_eq!(
            (ended.to_tick, ended.to_s),
            (Some(700), Some(700.0 * 0.002))
        );
        let mut cancelled = ended;
        cancelled.end(400, 0.002);
        assert!(
            with_end.is_active(7000, 8000, 0.001, &[])
                && with_end.is_active(8999, 9999, 0.001, &[])
        );
        assert!(
            !with_end.is_active(7000, 7999, 0.001, &[])
                && !with_end.is_active(9000, 9999, 0.001, &[])
        );
        assert!(
            for_good.is_active(9000, 9000, 0.001, &[]) && !for_good.is_active(0, 499, 0.001, &[])
        );
        assert!(once.is_active(8021, 8030, 0.001, &[]) && !once.is_active(8022, 8030, 0.001, &[]));
        let mut late = once.clone();
        late.delayed_ticks = Some(500);
        assert!(!late.is_active(8021, 8030, 0.001, &[]) && late.is_active(8521, 8530, 0.001, &[]));
        let event = fault("inner.kill", 8000, None, 0.001);
        let replaced = ProcessFailure {
            role: "inner".into(),
            tick: 7999,
            ticks_lost: Some(11),
            ..ProcessFailure::default()
        };
        assert!(once.is_active(8011, 8030, 0.001, std::slice::from_ref(&replaced)));
        assert!(!once.is_active(8012, 8030, 0.001, &[replaced]));
        assert!(
            event.is_active(8001, 8020, 0.001, &[]) && !event.is_active(8002, 8020, 0.001, &[])
        );
        assert!(cancelled.is_cancelled() && !cancelled.is_active(0, 9000, 0.001, &[]));
    }

    #[test]
    fn faults_that_happen_once_have_no_end() {
        for (what, once) in [
            ("inner.kill", true),
            ("b.switch", true),
            ("inner.late=1ms,mixer.kill", true),
            ("state.drop=off", true),
            ("inner.kill,cpu.hog=90", false),
        ] {
            assert_eq!(
                fault(what, 8000, None, 0.001).happens_once(),
                once,
                "{what}"
            );
        }
    }
}
