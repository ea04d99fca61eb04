//! A role's place in the rig: from the start of its process to the armed loop.
//!
//! ```text
//! Starting --ports made, real time on--> Ready --plant announces t_0--> Armed --plant keeps it--> Flying --> Landed
//! ```
//!
//! The plant opens a run when every role is ready with the same settings. It announces t_0 early enough for all to arm
//! before it. If a role has not armed in time, the plant announces a later t_0. A role that starts while the plant is
//! flying joins the run at the present tick.

mod join;
mod open;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

pub use join::{Armed, JoinedRun};
pub use open::Opened;

use crate::rt::{self, Ahead, Engaged, UsageMeter};
use crate::signals::{ends_at_once, stop_signals};
use crate::throttled_log::ThrottledLog;
use errors::{FAILED, INTERRUPTED};
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::instance::{Instance, Lock};
use ipc::{Blackboard, Wire};
use messages::blackboards::{Arrival, EndReason, RUN, RolePhase, Run, RunPhase, Status};
use messages::content::NO_TICK;
use messages::realtime;
use messages::role::{Channel, Replica, Role};
use messages::settings_text::fingerprint;

pub struct StartConfig {
    pub instance: Instance,
    pub rt: realtime::RealtimeSettings,
    /// The settings that all roles of a run must share: one `key = value` a line.
    pub settings: String,
    /// The options that every role of the run needs for its laws, as `--inner geometric`; empty for the usual ones.
    pub law_options: String,
    pub channel: Channel,
    /// Messages that the recorder's receivers keep of a topic.
    pub depth: usize,
    /// Process number of the launcher, whose death ends the role; `None` when started by hand.
    pub launcher: Option<u32>,
    /// When the process was started [ns].
    pub begun_ns: u64,
}

const LOOK_EVERY: Duration = Duration::from_millis(2);

pub fn status_board(replica: impl Into<Replica>) -> String {
    format!("status/{}", replica.into())
}

pub(crate) fn state_board(replica: Replica) -> String {
    format!("state/{replica}")
}

pub struct RoleSession {
    /// What of the real-time set-up was done ahead. First: it is given back before anything else.
    ahead: Option<Ahead>,
    pub(crate) replica: Replica,
    config: StartConfig,
    wire: Wire,
    board: Blackboard<Status>,
    stop: Arc<AtomicBool>,
    /// Process number of the plant that the role follows; 0 while it follows none.
    plant_pid: u64,
    /// The role's status; published by [`RoleSession::publish_status`].
    pub status: Status,
    // Last: everything else is released before another process may take the role.
    lock: Lock,
}

impl RoleSession {
    pub fn take(role: Role, config: StartConfig) -> Result<Self, Error> {
        let stop = Arc::default();
        for signal in stop_signals() {
            let failed = |e| Error::system("cannot handle signals", e);
            if ends_at_once(signal) {
                // In this order the second signal finds the flag set by the first, and ends the process at once.
                rt::exit_when_signalled(signal, i32::from(INTERRUPTED), &stop).map_err(failed)?;
            }
            signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(failed)?;
        }
        // If a signal has interrupted a system call, that is the reason, and not the call.
        Self::start(role, config, Arc::clone(&stop)).map_err(|error| {
            match stop.load(Ordering::Relaxed) && error.exit_code() == FAILED {
                true => Error::Interrupted,
                false => error,
            }
        })
    }

    fn start(role: Role, config: StartConfig, stop: Arc<AtomicBool>) -> Result<Self, Error> {
        let made_ns = now_ns();
        let (replica, channels) = (Replica::new(role, config.channel), config.rt.channels);
        let depth = config.depth;
        // If another process has the role, that is the error.
        if !config.instance.is_occupied(replica) {
            config
                .instance
                .check_shared_memory(Wire::needed_bytes(channels, depth))?;
        }
        let lock = config.instance.lock(replica)?;
        let wire = Wire::open(&config.instance)?.in_flight(replica.channel, channels, depth);
        let board = wire.blackboard(&status_board(replica))?;
        let epoch = now_ns();
        let ahead = match role {
            Role::Plant | Role::Record => None,
            Role::Outer | Role::Inner | Role::Mixer => Ahead::prepare(replica, &config.rt),
        };
        let status = Status {
            pid: u64::from(std::process::id()),
            releaser: ahead.as_ref().map_or(0, Ahead::releaser),
            epoch,
            arrival: Arrival {
                begun_ns: config.begun_ns,
                made_ns,
                placed_ns: epoch,
                ..Arrival::default()
            },
            settings: fingerprint(&config.settings),
            ..Status::default()
        };
        board.put(status);
        Ok(Self {
            replica,
            config,
            wire,
            ahead,
            board,
            stop,
            plant_pid: 0,
            status,
            lock,
        })
    }

    pub const fn wire(&self) -> &Wire {
        &self.wire
    }

    pub fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    pub fn stop_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    pub const fn rt(&self) -> &realtime::RealtimeSettings {
        &self.config.rt
    }

    pub fn publish_status(&self) {
        self.board.put(self.status);
    }

    /// Publishes the status; requests the end of the run after a signal.
    pub fn pass_on_stop(&mut self) {
        if self.stop_requested() && self.status.wants_end == EndReason::None as u64 {
            self.status.wants_end = EndReason::Interrupted as u64;
        }
        self.publish_status();
    }

    pub fn request_end(&mut self, end: EndReason) {
        self.status.wants_end = end as u64;
        self.publish_status();
    }

    fn enter(&mut self, phase: RolePhase) {
        self.status.phase = phase as u64;
        self.publish_status();
    }

    /// Waits until the recorder has made its ports, or a run flies. A message reaches receivers in the order in which they
    /// were made: what a process sent as it was killed is in the log if it has reached a loop.
    pub fn await_recorder(&self) -> Result<(), Error> {
        let mut log = ThrottledLog::new(self.replica.role);
        let board = status_board(Replica::new(Role::Record, Channel::A));
        let is_there = |role: Role| self.config.instance.is_occupied(role);
        loop {
            let recorder = self.wire.blackboard_reader::<Status>(&board)?;
            let has_ports = recorder.is_some_and(|it| it.get().arrival.ported_ns > 0);
            let run = self.wire.blackboard_reader::<Run>(RUN)?;
            let flies = run.is_some_and(|it| it.get().phase() == RunPhase::Flying);
            if has_ports && is_there(Role::Record) || flies && is_there(Role::Plant) {
                return Ok(());
            }
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            log.waiting_for(|| match is_there(Role::Plant) {
                true => "the recorder (`ironbird record`)".into(),
                false => "the plant (`ironbird plant`)".into(),
            });
            sleep(5 * LOOK_EVERY);
        }
    }

    /// Says that the ports are made, after real time is engaged.
    ///
    /// Real time is given back when what this returns is dropped: before the ports and the place.
    fn report_ready(&mut self) -> Result<Engaged, Error> {
        self.ahead.as_mut().map_or(Ok(()), Ahead::touch)?;
        self.status.arrival.ported_ns = now_ns();
        let engaged = Engaged::engage(self.replica, &self.config.rt, self.ahead.as_ref())?;
        self.status.arrival.engaged_ns = now_ns();
        self.status.grants = engaged.grants;
        self.enter(RolePhase::Ready);
        Ok(engaged)
    }

    /// Publishes the final figures of the role.
    pub fn land(&mut self, meter: &UsageMeter) {
        self.status.usage = meter.read();
        self.enter(RolePhase::Landed);
    }

    /// Whether the plant whose run was joined lives: its blackboard alone outlives it, and another one may have its place.
    ///
    /// Before a run was joined: whether any plant lives.
    pub fn plant_lives(&self) -> bool {
        let instance = &self.config.instance;
        let is_there = instance.is_occupied(Role::Plant)
            // The number is missing in the instant before the plant has written it.
            && (self.plant_pid == 0 || instance.pid_of(Role::Plant).is_none_or(|pid| u64::from(pid) == self.plant_pid));
        let has_process = || Path::new(&format!("/proc/{}", self.plant_pid)).exists();
        // If another program has removed the locks, its process alone shows it.
        is_there || !self.lock.is_in_place() && has_process()
    }
}

/// Logs how the flight ended; the loop is over, so this delays nothing.
pub fn log_landing(role: Role, run: &Run) {
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

/// The wall clock [ns since 1970].
pub fn wall_ns() -> u64 {
    let since_1970 = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX)
}
