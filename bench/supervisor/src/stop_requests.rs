//! Signals to the supervisor that request the end of the flight. It polls them; no thread waits for them.

use process::signals::{ends_at_once, stop_signals};
use signal_hook::consts::SIGCHLD;
use signal_hook::iterator::Signals;

use errors::Failure;

#[derive(Debug)]
pub struct StopRequests {
    signals: Signals,
    /// A signal has requested the end of the flight.
    pub is_requested: bool,
    /// A person has repeated the request: the flight ends at once.
    pub is_urgent: bool,
}

impl StopRequests {
    pub fn listen() -> Result<Self, Failure> {
        let mut handled = stop_signals();
        // If it were ignored, as the parent process may have chosen, no child could be waited for.
        handled.push(SIGCHLD);
        let signals = Signals::new(handled)
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
        Ok(Self {
            signals,
            is_requested: false,
            is_urgent: false,
        })
    }

    /// Takes the signals since the last call. Only a later call takes a repeated request as such.
    pub fn poll(&mut self) {
        let was_requested = self.is_requested;
        for signal in self.signals.pending().filter(|signal| *signal != SIGCHLD) {
            self.is_requested = true;
            self.is_urgent |= was_requested && ends_at_once(signal);
        }
    }
}

#[cfg(test)]
mod tests {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::low_level::raise;

    use super::*;

    #[test]
    fn only_a_repeated_request_of_a_person_is_urgent() {
        let mut requests = StopRequests::listen().unwrap();
        requests.poll();
        assert!(!requests.is_requested);
        raise(SIGCHLD).unwrap();
        requests.poll();
        assert!(!requests.is_requested, "the end of a child is no request");
        for signal in [SIGTERM, SIGHUP, SIGTERM, SIGHUP] {
            raise(signal).unwrap();
            requests.poll();
            assert!(
                requests.is_requested && !requests.is_urgent,
                "signal {signal}"
            );
        }
        raise(SIGINT).unwrap();
        requests.poll();
        assert!(requests.is_urgent);
    }
}
