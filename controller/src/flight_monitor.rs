//! Feeds the theorem's monitor from a flight's messages, through restarts of the inner loop and handovers.

use crate::TheoremMonitor;
use crate::innovation::Innovation;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;

/// One monitor as long as each wrench continues from the law's state after the wrench before, whichever process sent it.
///
/// Every wrench names the state that it continued from. A law that began with its initial state has a new monitor. Where
/// a wrench continues from a state that was not watched, because a message was lost or because another channel's state
/// differed, another monitor follows the law, and has no result until the law has forgotten what was not watched.
#[derive(Clone, Debug)]
pub struct FlightMonitor {
    /// A fresh monitor; none if the law has no theorem.
    begin: Option<TheoremMonitor>,
    /// Number of the present monitor, and of its next result.
    number: u64,
    next_result: u64,
    /// Tick and history of the law's state after the newest wrench.
    watched: Option<(u64, u64)>,
    monitor: Option<TheoremMonitor>,
    /// Whether the law still has samples that were not watched, so that there are no results.
    catches_up: bool,
    /// The newest V_th at a start that there is a result of [rad^2/s^2].
    v_th_start: f64,
}

/// Value of `watched` after a wrench whose inputs are not known: no wrench continues from it.
const NOT_WATCHED: Option<(u64, u64)> = Some((NO_TICK, 0));

impl FlightMonitor {
    pub fn new(begin: Option<TheoremMonitor>) -> Self {
        Self {
            monitor: begin.clone(),
            begin,
            number: 0,
            next_result: 0,
            watched: None,
            catches_up: false,
            v_th_start: 0.0,
        }
    }

    pub const fn applies(&self) -> bool {
        self.begin.is_some()
    }

    /// Number of the present monitor.
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// The innovation of the present law's steps, which needs no ground truth.
    pub fn innovation(&self) -> Innovation {
        let monitor = self.monitor.as_ref();
        monitor.map_or(Innovation::default(), |monitor| *monitor.innovation())
    }

    /// [`TheoremMonitor::error_allowed`] of the present law.
    pub fn error_allowed(&self) -> [f64; 3] {
        let monitor = self.monitor.as_ref();
        monitor.map_or([0.0; 3], TheoremMonitor::error_allowed)
    }

    /// Rate error of the newest wrench [rad/s]; none if it was not watched.
    pub fn rate_error_rad_s(&self) -> Option<f64> {
        self.monitor.as_ref().map(TheoremMonitor::rate_error_rad_s)
    }

    /// Its root mean square over the last second or so [rad/s]; none without a theorem.
    pub fn rate_error_rms_rad_s(&self) -> Option<f64> {
        let monitor = self.monitor.as_ref();
        monitor.map(TheoremMonitor::rate_error_rms_rad_s)
    }

    /// The monitor message for a wrench and the state and setpoint it was computed from; none if the law's state was not
    /// watched.
    ///
    /// Its header is that of the wrench, with the monitor's number as epoch and that of the result as sequence number.
    pub fn watch(
        &mut self,
        wrench: &Message<Wrench>,
        state: Option<&Stamped<State>>,
        setpoint: Option<&Stamped<Setpoint>>,
    ) -> Option<Message<Monitor>> {
        let mut envelope = wrench.envelope;
        let (tick, law_state) = (envelope.tick, &envelope.law_state);
        if law_state.from_tick == NO_TICK {
            self.begin();
        } else if self.watched != Some((law_state.from_tick, law_state.before)) {
            self.lose(tick);
        }
        self.watched = NOT_WATCHED;
        let (state, setpoint) = state.zip(setpoint)?;
        self.watched = Some((tick, law_state.after));
        if self.catches_up
            && self
                .monitor
                .as_ref()
                .is_some_and(TheoremMonitor::has_caught_up)
        {
            self.resume();
        }
        let content = *self.watch_next(tick, state, setpoint, &wrench.content)?;
        if self.catches_up {
            return None;
        }
        self.v_th_start = content.v_th_start;
        (envelope.epoch, envelope.seq) = (self.number, self.next_result);
        self.next_result += 1;
        Some(Message { envelope, content })
    }

    /// Takes the rotor command of a tick, before the wrench of the next tick.
    pub fn command(&mut self, tick: u64, command: &RotorSpeeds) {
        if let Some(monitor) = &mut self.monitor {
            monitor.command(tick, command);
        }
    }

    /// Begins with a new monitor: the law has its initial state.
    pub fn begin(&mut self) {
        if self.watched.is_some() {
            (self.number, self.next_result) = (self.number + 1, 0);
        }
        self.renew();
        self.catches_up = false;
    }

    fn renew(&mut self) {
        let before = std::mem::replace(&mut self.monitor, self.begin.clone());
        if let (Some(monitor), Some(before)) = (&mut self.monitor, &before) {
            monitor.take_over(before);
        }
    }

    /// Follows a law whose state is not known before the wrench of a tick.
    fn lose(&mut self, tick: u64) {
        self.renew();
        if let Some(monitor) = &mut self.monitor {
            monitor.join(tick);
            self.catches_up = true;
        }
    }

    /// Begins with results again: the law has forgotten what was not watched.
    fn resume(&mut self) {
        (self.number, self.next_result) = (self.number + 1, 0);
        self.catches_up = false;
        if let Some(monitor) = &mut self.monitor {
            monitor.resume(self.v_th_start);
        }
    }

    /// The result for the newest wrench; none before the first one, or where the law's state was not watched.
    pub fn newest(&self) -> Option<&Monitor> {
        let is_watched = self.watched.is_some() && !self.catches_up;
        let watched = self.monitor.as_ref().filter(|_| is_watched);
        watched.map(TheoremMonitor::shown)
    }

    /// As [`Self::watch`], where no message is lost.
    pub fn watch_next(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        wrench: &Wrench,
    ) -> Option<&Monitor> {
        self.watched.get_or_insert((tick, 0));
        self.monitor
            .as_mut()
            .map(|monitor| monitor.watch(tick, state, setpoint, wrench))
    }
}

#[cfg(test)]
mod tests {
    use crate::Gains;
    use control_api::Rig;
    use messages::content::Mode;
    use messages::history::LawState;
    use messages::role::Channel;

    use super::*;

    /// The results for wrenches of these ticks, each with the state that it continued from and the history after it, and
    /// the tick of its own state, if that has arrived: number of the monitor, and ticks that it has seen.
    fn results(
        wrenches: impl IntoIterator<Item = (u64, LawState, Option<u64>)>,
    ) -> Vec<Option<(u64, u64)>> {
        let begin = TheoremMonitor::new(&Rig::default(), &Gains::default());
        let mut monitor = FlightMonitor::new(Some(begin));
        let mut result = |(tick, law_state, state): (u64, LawState, Option<u64>)| {
            // Held, so that every tick counts as stale.
            let mode = Mode::Held as u64;
            let mut wrench = Message::of_tick(
                tick,
                Wrench {
                    mode,
                    ..Wrench::default()
                },
            );
            wrench.envelope.law_state = law_state;
            let state = state.map(|tick| Stamped::new(tick, State::default()));
            let setpoint = Stamped::new(tick, Setpoint::default());
            let result = monitor.watch(&wrench, state.as_ref(), Some(&setpoint))?;
            assert_eq!(result.envelope.tick, tick);
            assert_eq!(result.envelope.seq + 1, result.content.ticks_stale);
            Some((result.envelope.epoch, result.content.ticks_stale))
        };
        wrenches.into_iter().map(&mut result).collect()
    }

    fn from(tick: u64, before: u64, after: u64) -> LawState {
        LawState {
            after,
            ..LawState::after(tick, Channel::A, before)
        }
    }

    #[test]
    fn a_monitor_goes_on_with_the_state_that_it_has_watched_whoever_continues_from_it() {
        let of_b = LawState {
            channel: 1,
            ..from(1, 0, 0)
        };
        let wrenches = [
            (0, LawState::INITIAL),
            (1, from(0, 0, 0)),
            (2, of_b),
            // Restarted after a pause.
            (9, from(2, 0, 7)),
            (10, from(9, 7, 8)),
            (11, LawState::INITIAL),
        ];
        let wrenches = wrenches.map(|(tick, law_state)| (tick, law_state, Some(tick)));
        let expected = [(0, 1), (0, 2), (0, 3), (0, 4), (0, 5), (1, 1)].map(Some);
        assert_eq!(results(wrenches), expected);
    }

    /// Without samples, nothing is forgotten: in two of three ticks with their state, one is measured whole.
    #[test]
    fn a_step_from_a_state_that_was_not_watched_has_no_result_until_the_law_has_forgotten_it_or_begins_anew()
     {
        let all: fn(u64) -> bool = |_| true;
        let two_of_three: fn(u64) -> bool = |tick| tick % 3 != 0;
        let after_loss = [(all, 830..=832), (two_of_three, 2486..=2492)];
        for (has_state, expected) in after_loss {
            for unknown in [
                // A state, or a wrench, was lost.
                (1, from(0, 0, 0), None),
                (2, from(1, 0, 0), Some(2)),
                // Another channel's state, which differed.
                (1, from(0, 5, 6), Some(1)),
            ] {
                let (lost, mut after) = (unknown.0, unknown.1.after);
                let later = (lost + 1..lost + 3000).map(|tick| {
                    let law_state = from(tick - 1, std::mem::take(&mut after), 0);
                    let state = if has_state(tick) { tick } else { tick - 1 };
                    (tick, law_state, Some(state))
                });
                let first = [(0, LawState::INITIAL, Some(0)), unknown];
                let last = (20_000, LawState::INITIAL, Some(20_000));
                let results = results(first.into_iter().chain(later).chain([last]));
                let without = results[1..].iter().take_while(|it| it.is_none()).count();
                assert_eq!(results[0], Some((0, 1)));
                assert!(expected.contains(&without), "{unknown:?}: {without}");
                let resumed = [results[1 + without], results[2 + without]];
                assert_eq!(resumed, [Some((1, 1)), Some((1, 2))], "{unknown:?}");
                assert_eq!(results.last(), Some(&Some((2, 1))), "{unknown:?}");
            }
        }
        assert_eq!(results([(7, from(6, 0, 0), Some(7))]), [None]);
    }
}
