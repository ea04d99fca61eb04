//! A hot standby: a process that waits beside a stage, with everything prepared that needs no role in the flight.
//!
//! It has its settings, its law, a node of the middleware, and its memory locked and touched. It holds no lock of a role,
//! no port that sends or receives, and writes on no blackboard. It does not run on the loops' processor, and waits in a system
//! call. A byte on standard input from its launcher lets it replace a stage that has died. The end of standard input,
//! which is also the launcher's, ends it.

use std::ffi::CStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::{Errno, read};
use rustix::stdio::stdin;
use rustix::thread::set_name;
use signal_hook::consts::{SIGHUP, SIGTERM};

use crate::rt::Ahead;
use crate::session::{Blackboards, Ready, StartConfig, status_board};
use crate::signals::end_with_launcher;
use faults::live::{LIVE, LiveBlackboard};
use ipc::Wire;
use ipc::clock::now_ns;
use ipc::error::Error;
use messages::blackboards::{RUN, SETTINGS, Status};
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::role::Role;

/// Name of a standby's process, as `ps -o comm` and `top` show it.
pub const NAME: &CStr = c"ironbird spare";
const NAME_OF_A_STAGE: &CStr = c"ironbird";

impl Ready {
    /// Opens everything that can be opened before the role is free. Services take longer to open than ports.
    fn open(role: Role, config: &StartConfig, stop: Arc<AtomicBool>) -> Result<Self, Error> {
        let mut wire = Wire::open(&config.instance)?;
        if matches!(role, Role::Outer | Role::Inner) {
            wire.hold_topic::<State>()?;
            wire.hold_topic::<Setpoint>()?;
        }
        if matches!(role, Role::Inner | Role::Mixer) {
            wire.hold_topic::<Wrench>()?;
        }
        if role == Role::Mixer {
            wire.hold_topic::<RotorSpeeds>()?;
        }
        wire.hold_board::<LiveBlackboard>(LIVE)?;
        wire.hold_board::<Status>(&status_board(role))?;
        let boards = Blackboards {
            run: wire.blackboard_reader(RUN)?,
            settings: wire.blackboard_reader(SETTINGS)?,
            status: wire.blackboard_reader(&status_board(role))?,
        };
        // Last: what was opened is locked with the rest.
        let ahead = Ahead::prepare(role, &config.rt);
        Ok(Self {
            ahead,
            boards,
            wire,
            stop,
        })
    }
}

/// Prepares everything and waits; returns the configuration to start with, or nothing if the standby is not needed or a
/// signal has ended it.
pub fn stand_by(role: Role, mut config: StartConfig) -> Result<Option<StartConfig>, Error> {
    // The launcher's death comes as a signal too, which must not end it before it has given up what it holds.
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Error::system("cannot handle signals", e))?;
    }
    end_with_launcher(config.launcher)?;
    config.ready = Some(Ready::open(role, &config, Arc::clone(&stop))?);
    let named = |name| set_name(name).map_err(|e| Error::system("cannot name the process", e));
    named(NAME)?;
    let is_activated =
        is_activated(&stop).map_err(|e| Error::system("cannot read standard input", e))?;
    config.begun_ns = now_ns();
    named(NAME_OF_A_STAGE)?;
    // A signal that comes meanwhile is handled when the role starts.
    Ok(Some(config).filter(|_| is_activated))
}

/// Waits for a byte, for the end of what can come, or for a signal.
fn is_activated(stop: &AtomicBool) -> Result<bool, Errno> {
    let mut byte = [0_u8];
    while !stop.load(Ordering::Relaxed) {
        match poll(&mut [PollFd::new(&stdin(), PollFlags::IN)], None) {
            Ok(_) => return Ok(read(stdin(), &mut byte)? > 0),
            Err(Errno::INTR) => {}
            Err(e) => return Err(e),
        }
    }
    Ok(false)
}
