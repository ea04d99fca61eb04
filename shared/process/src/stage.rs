//! The loop of a stage that its input wakes: outer, inner, mixer.
//!
//! Deadline first, event second: a stage waits for its input until its own deadline inside the tick. It then works with
//! the newest data it has, and its message says so. If a tick is over before the stage got to it, the tick is skipped
//! and counted. Skipped ticks are never made up for in a burst.

mod pacer;

use self::pacer::{Pacer, WakeReason};
use crate::rt::UsageMeter;
use crate::session::say_landed;
use crate::session::{Armed, RoleSession};
use ipc::clock::Horizon;
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::{WakeEvent, Wire};
use messages::blackboards::{EndReason, Run, RunPhase, Status};
use messages::grid::{NS_PER_S, Pace};
use messages::inspection::{Expected, Rejections};
use messages::role::Role;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickContext {
    pub tick: u64,
    /// When the stage woke for it [ns].
    pub receive_ns: u64,
    /// How long the previous tick kept the stage busy [ns].
    pub previous_busy_ns: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickOutcome {
    /// Some input was not of the tick.
    pub stale: bool,
}

pub trait Stage {
    const ROLE: Role;

    fn arm(&mut self, wire: &Wire, expected: Expected, epoch: u64) -> Result<(), Error>;

    /// Takes what has arrived, and returns the tick of the input that wakes the stage ([`NO_TICK`]: none yet).
    ///
    /// `horizon` tells its ports which ticks can have begun.
    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error>;

    /// Works a tick with what was taken: step, limit, publish. `end` asks for the run's end, before anything is published:
    /// whoever has the output can know.
    fn tick(
        &mut self,
        turn: &TickContext,
        end: &mut dyn FnMut(EndReason),
    ) -> Result<TickOutcome, Error>;

    /// Does what [`Stage::tick`] would, with what was taken last as if it were of this tick, and changes nothing: the
    /// law works on a clone, and no message is sent. The next stage is rung for its rehearsal. False where the law
    /// cannot be copied: nothing is rehearsed then, here and behind it.
    fn rehearse(&mut self, tick: u64) -> Result<bool, Error>;

    /// Called last, when the run is over: sends the final message to the next stage.
    fn finish(&mut self, tick: u64) -> Result<(), Error> {
        let _ = tick;
        Ok(())
    }

    fn rejections(&self) -> Rejections;

    /// What its law has learnt so far; nothing where it does not learn.
    fn estimates(&self) -> Option<[f64; 3]> {
        None
    }

    /// Begins with these estimates; false, and nothing is changed, where the law may not have them.
    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        let _ = estimates;
        false
    }
}

/// After this long without a sign of life from the plant, a stage checks whether the plant's process lives [ns].
const PLANT_SILENT_NS: u64 = NS_PER_S;
/// And then how often [ns]: a look opens a file, which is not for every tick.
const PLANT_LOOK_NS: u64 = NS_PER_S / 10;

pub fn run<S: Stage>(stage: S, doorbell: WakeEvent, station: RoleSession) -> Result<(), Error> {
    // They are given up in the reverse order: real time, which `armed` holds, the ports, the doorbell, whose alarm may
    // ring until then, and the place last.
    let mut station = station;
    let doorbell = doorbell;
    let mut stage = stage;
    let armed = station.join(|wire, expected, epoch| stage.arm(wire, expected, epoch))?;
    resume(&mut stage, &station, &armed);
    let mut pacer = Pacer::new(armed.pace, S::ROLE, armed.first_tick);
    let meter = UsageMeter::start();
    let flown = fly(&mut stage, &doorbell, &mut station, &armed, &mut pacer);
    let finished = stage.finish(pacer.next_tick);
    if flown.is_err() {
        station.status.wants_end = EndReason::Failed as u64;
    }
    station.land(&meter);
    if flown.is_ok() {
        say_landed(S::ROLE, &armed.run.get());
    }
    flown.and(finished)
}

/// Has a law begin with what its predecessor had learnt in this run, where it may, and says whether it does.
fn resume<S: Stage>(stage: &mut S, station: &RoleSession, armed: &Armed) {
    let Status {
        estimates_run,
        estimates,
        ..
    } = station.status;
    if !station.resumes_estimates() || estimates_run != armed.expected.run_id {
        return;
    }
    let role = S::ROLE.name();
    if stage.resume(estimates) {
        tracing::info!(role, "begins with the last estimates {estimates:?}");
    } else {
        tracing::warn!(
            role,
            "begins with its priors: the last estimates {estimates:?} are none that its law may have"
        );
    }
}

fn fly<S: Stage>(
    stage: &mut S,
    doorbell: &WakeEvent,
    station: &mut RoleSession,
    armed: &Armed,
    pacer: &mut Pacer,
) -> Result<(), Error> {
    let mut previous_busy_ns = 0;
    let resumes = station.resumes_estimates();
    let mut signs_of_life = SignsOfLife::new(now_ns());
    loop {
        let (tick, receive_ns) = match pacer.wait(doorbell, |pace| stage.take(pace))? {
            WakeReason::Work { tick, receive_ns } => (tick, receive_ns),
            WakeReason::Rehearsal { tick } => {
                let is_rehearsed = stage.rehearse(tick)?;
                station.status.rehearsals += u64::from(is_rehearsed && tick > 0);
                continue;
            }
            WakeReason::Silence { tick, receive_ns } => {
                if let Some(next) = armed.run.successor() {
                    return Err(replaced(S::ROLE, &next));
                }
                if armed.run.get().phase() == RunPhase::Closed {
                    return Ok(());
                }
                if signs_of_life.look_is_due(receive_ns) && !station.plant_lives() {
                    return Err(Error::Absent {
                        what: "the plant died in flight".into(),
                    });
                }
                if armed.pace == Pace::Lockstep {
                    // The plant notices a stage that has died, and closes the run.
                    station.pass_on_stop();
                    continue;
                }
                if tick > armed.last_tick {
                    continue;
                }
                (tick, receive_ns)
            }
        };
        let worked = stage.tick(
            &TickContext {
                tick,
                receive_ns,
                previous_busy_ns,
            },
            &mut |end| station.ask_for_the_end(end),
        )?;
        if !worked.stale {
            signs_of_life.heard(receive_ns);
        }
        let status = &mut station.status;
        status.ticks_run += 1;
        status.ticks_stale += u64::from(worked.stale);
        status.ticks_skipped = pacer.skipped;
        status.rejections = stage.rejections();
        if let Some(estimates) = stage.estimates().filter(|_| resumes) {
            (status.estimates_run, status.estimates) = (armed.expected.run_id, estimates);
        }
        station.pass_on_stop();
        previous_busy_ns = now_ns() - receive_ns;
    }
}

fn replaced(role: Role, next: &Run) -> Error {
    Error::TooLate {
        what: format!(
            "another run has begun: a new plant (process {}) has the place of the one that this {role} process flew \
             with; start `ironbird {role}` again",
            next.plant_pid
        ),
    }
}

#[derive(Clone, Copy, Debug)]
struct SignsOfLife {
    heard_ns: u64,
    looked_ns: u64,
}

impl SignsOfLife {
    const fn new(now: u64) -> Self {
        Self {
            heard_ns: now,
            looked_ns: 0,
        }
    }

    const fn heard(&mut self, now: u64) {
        self.heard_ns = now;
    }

    const fn look_is_due(&mut self, now: u64) -> bool {
        let is_due = now > self.heard_ns + PLANT_SILENT_NS && now >= self.looked_ns + PLANT_LOOK_NS;
        if is_due {
            self.looked_ns = now;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plant_that_is_silent_is_looked_after_ten_times_a_second() {
        let mut signs = SignsOfLife::new(0);
        let looks = |signs: &mut SignsOfLife, from_ms: u64, to_ms: u64| {
            (from_ms..to_ms)
                .filter(|ms| signs.look_is_due(ms * 1_000_000))
                .count()
        };
        // Within a second it may be late.
        assert_eq!(looks(&mut signs, 0, 1001), 0);
        assert_eq!(looks(&mut signs, 1001, 3001), 20);
        signs.heard(3_001_000_000);
        assert_eq!(looks(&mut signs, 3001, 4002), 0);
    }
}
