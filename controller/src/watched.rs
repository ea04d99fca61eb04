//! The inner loop with the theorem's monitor beside it.
//!
//! Both the process and the in-process flight run this pair. The law runs first and never sees the truth. The monitor
//! runs second; it sees the truth and writes only its own block.

use law::InnerLaw;
use model::messages::{Dated, Setpoint, State, Wrench};

use crate::inner::InnerLoop;
use crate::monitor::TheoremMonitor;
use crate::settings::LoopSettings;

/// An inner loop that is watched.
#[derive(Clone, Debug)]
pub struct WatchedLoop {
    law: InnerLoop,
    monitor: TheoremMonitor,
}

impl WatchedLoop {
    /// The loop and the monitor of settings that passed [`Settings::check`].
    #[must_use]
    pub fn new(settings: &LoopSettings) -> Self {
        Self { law: InnerLoop::new(settings), monitor: TheoremMonitor::new(settings) }
    }
}

impl InnerLaw for WatchedLoop {
    /// [`InnerLoop`]'s tick, with the monitor's block filled in.
    #[inline]
    fn tick(&mut self, tick: u64, state: &Dated<State>, setpoint: &Dated<Setpoint>) -> Wrench {
        let wrench = self.law.tick(tick, state, setpoint);
        Wrench { monitor: *self.monitor.watch(tick, state, &wrench, self.law.evidence()), ..wrench }
    }
}
