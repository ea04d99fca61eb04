//! A signal for a role of a flight, at the beginning of a tick.

use model::boards::Run;
use model::grid::Pace;
use model::role::Role;
use rustix::process::{Pid, Signal, kill_process};
use wire::clock::{now_ns, sleep_until};
use wire::instance::Instance;

use failure::Failure;

/// Waits until a tick of the run begins, then sends a signal to the process that plays the role by then; gives its
/// number. A tick that has begun is not waited for.
///
/// `run` is what the plant's board says of a flight in the air. The signal is sent some ten microseconds after the
/// tick has begun, and later where this thread is not given a processor.
///
/// # Errors
/// [`Failure`] where the run has no clock, or nobody plays the role.
pub fn send_at(instance: &Instance, run: &Run, tick: u64, role: Role, signal: Signal) -> Result<u32, Failure> {
    let Pace::Realtime(grid) = run.pace() else {
        return Err(Failure::usage(format!("tick {tick} has no place on the clock: the flight is in lockstep"))
            .help("fly on the clock: --pace realtime"));
    };
    let begin_ns = grid.begin_of(tick);
    while now_ns() < begin_ns {
        // A signal to this process may end the sleep.
        sleep_until(begin_ns);
    }
    let pid = instance.pid_of(role);
    let process = pid.and_then(|pid| i32::try_from(pid).ok()).and_then(Pid::from_raw);
    let sent = process.is_some_and(|process| kill_process(process, signal).is_ok());
    pid.filter(|_| sent).ok_or_else(|| Failure::failed(format!("tick {tick}: no process plays the role {role}")))
}
