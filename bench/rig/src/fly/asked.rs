//! Signals to the launcher. It polls them; no thread waits for them.

use role::stop::{ends_at_once, stop_signals};
use signal_hook::consts::SIGCHLD;
use signal_hook::iterator::Signals;

use failure::Failure;

/// What has been asked so far.
#[derive(Debug)]
pub(super) struct Asked {
    signals: Signals,
    /// To end the flight in order.
    pub(super) end: bool,
    /// A person did so again: to end it at once.
    pub(super) at_once: bool,
}

impl Asked {
    /// From now on.
    ///
    /// # Errors
    /// [`Failure`] where the system refuses.
    pub(super) fn listen() -> Result<Self, Failure> {
        let mut handled = stop_signals();
        // Who starts this process may have it ignored, and then no child could be waited for.
        handled.push(SIGCHLD);
        let signals = Signals::new(handled).map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
        Ok(Self { signals, end: false, at_once: false })
    }

    /// Takes in what has come since the last look; a person's second wish comes in a later look than the first.
    pub(super) fn look(&mut self) {
        let asked_before = self.end;
        for signal in self.signals.pending().filter(|signal| *signal != SIGCHLD) {
            self.end = true;
            self.at_once |= asked_before && ends_at_once(signal);
        }
    }
}

#[cfg(test)]
mod tests {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::low_level::raise;

    use super::*;

    #[test]
    fn only_a_person_is_impatient() {
        let mut asked = Asked::listen().unwrap();
        asked.look();
        assert!(!asked.end);
        raise(SIGCHLD).unwrap();
        asked.look();
        assert!(!asked.end, "a child's end is no wish");
        for signal in [SIGTERM, SIGHUP, SIGTERM, SIGHUP] {
            raise(signal).unwrap();
            asked.look();
            assert!(asked.end && !asked.at_once, "signal {signal}");
        }
        raise(SIGINT).unwrap();
        asked.look();
        assert!(asked.at_once);
    }
}
