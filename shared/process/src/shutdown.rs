//! What a role says when its flight is over.
//!
//! It is the one line between two flights of a process started by hand.

use messages::blackboards::Run;
use messages::content::NO_TICK;
use messages::role::Role;

/// Says how the flight ended; the loop is over, and nobody waits for its process any more.
pub fn say_landed(role: Role, run: &Run) {
    let flown_s = if run.tick == NO_TICK {
        0.0
    } else {
        run.flight_time_s(run.tick)
    };
    tracing::info!(
        "{role}: flight {} after {flown_s:.1} s",
        run.ending().name()
    );
}
