//! A role's place in the rig: from the start of its process to the moment its loop is armed.
//!
//! ```text
//! Starting --ports made, real time engaged--> Ready --plant announces t_0--> Armed --plant keeps to it--> Flying --> Landed
//! ```
//!
//! The plant opens a run when every role is ready with the same settings, and announces t_0 so early that all
//! have armed before it; when one has not, it announces a later t_0. A role that starts while the plant flies
//! joins the run at the present tick.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::launcher::end_with_launcher;
use crate::patience::Patience;
use crate::rt::{Engaged, UsageMeter, settle};
use crate::stop::{ends_at_once, stop_signals};
use model::boards::{Ending, RUN, RolePhase, Run, RunPhase, SETTINGS, SettingsText, Status};
use model::flight_plan::FlightPlan;
use model::grid::Pace;
use model::inspection::Expected;
use model::realtime;
use model::role::{ROLES, Role};
use model::settings_text::{differences, fingerprint};
use wire::clock::now_ns;
use wire::error::Error;
use wire::instance::{Instance, Lock, check_shared_memory};
use wire::{Board, BoardReader, Wire};

/// What a role's process is started with.
#[derive(Clone, Debug)]
pub struct Orders {
    /// The instance that it belongs to.
    pub instance: Instance,
    /// What to ask of the system.
    pub rt: realtime::Settings,
    /// The settings that all roles of a run must share: one `key = value` a line.
    pub settings: String,
    /// Process number of the launcher, whose death ends the role; `None` when started by hand.
    pub launcher: Option<u32>,
}

/// How often a waiting role looks at the boards.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// From the announcement of t_0 to t_0 [ns].
const ANNOUNCE_NS: u64 = 200_000_000;
/// Roles must have armed this long before t_0 [ns] for the plant to keep to it; else it announces another one.
const ARMED_BEFORE_NS: u64 = 40_000_000;
/// Roles enter their loops this long before t_0 [ns].
const SETTLED_BEFORE_NS: u64 = 20_000_000;

/// Name of a role's status board.
#[must_use]
pub fn status_board(role: Role) -> String {
    format!("status/{role}")
}

/// A role's place.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Station {
    role: Role,
    orders: Orders,
    wire: Wire,
    board: Board<Status>,
    stop: Arc<AtomicBool>,
    engaged: Option<Engaged>,
    /// The role's status; published by [`Station::publish_status`].
    pub status: Status,
    // Last: everything else is released before somebody else may take the place.
    _lock: Lock,
}

/// A run that the station has armed for.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Armed {
    /// What moves its ticks on.
    pub pace: Pace,
    /// What its messages carry.
    pub expected: Expected,
    /// Last tick that is to be flown.
    pub last_tick: u64,
    /// First tick that this role works.
    pub first_tick: u64,
    /// The plant's board of the run.
    pub run: BoardReader<Run>,
}

/// A run that the plant has opened.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Opened {
    /// What moves its ticks on.
    pub pace: Pace,
    /// What its messages carry.
    pub expected: Expected,
    /// The plant's board of the run, and what is on it.
    pub board: Board<Run>,
    /// What is on the board.
    pub run: Run,
    /// The other roles' boards, in the order of [`ROLES`].
    pub crew: Vec<BoardReader<Status>>,
    _settings: Board<SettingsText>,
}

impl Station {
    /// Takes the place of a role.
    ///
    /// # Errors
    /// [`Error::Occupied`] where somebody has it; [`Error::RootPath`], [`Error::Wire`], [`Error::System`].
    pub fn take(role: Role, orders: Orders) -> Result<Self, Error> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in stop_signals() {
            let failed = |e| Error::system("cannot handle signals", e);
            if ends_at_once(signal) {
                // In this order the second signal finds the flag set by the first, and ends the process at once.
                signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop)).map_err(failed)?;
            }
            signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(failed)?;
        }
        end_with_launcher(orders.launcher)?;
        check_shared_memory(Wire::needed_bytes())?;
        orders.instance.prepare()?;
        let lock = orders.instance.lock(role)?;
        let wire = Wire::open(&orders.instance)?;
        let board = wire.board(&status_board(role))?;
        let status = Status {
            pid: u64::from(std::process::id()),
            epoch: now_ns(),
            settings: fingerprint(&orders.settings),
            ..Status::default()
        };
        board.put(status);
        Ok(Self { role, orders, wire, board, stop, engaged: None, status, _lock: lock })
    }

    /// The wire to make ports on.
    #[must_use]
    pub const fn wire(&self) -> &Wire {
        &self.wire
    }

    /// Whether a signal has asked the process to end.
    #[must_use]
    pub fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The flag that signals set, for other threads of the process.
    #[must_use]
    pub fn stop_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// Writes the status on the board.
    pub fn publish_status(&self) {
        self.board.put(self.status);
    }

    /// Publishes the status; asks the plant for an end when a signal has asked for one.
    pub fn pass_on_stop(&mut self) {
        if self.stop_requested() && self.status.wants_end == Ending::None as u64 {
            self.status.wants_end = Ending::Interrupted as u64;
        }
        self.publish_status();
    }

    fn enter(&mut self, phase: RolePhase) {
        self.status.phase = phase as u64;
        self.publish_status();
    }

    /// Says that the ports are made, after real time is engaged.
    fn report_ready(&mut self) -> Result<(), Error> {
        let engaged = Engaged::engage(self.role, &self.orders.rt)?;
        self.status.grants = engaged.grants;
        self.engaged = Some(engaged);
        self.enter(RolePhase::Ready);
        Ok(())
    }

    /// The role's last word: its figures are final.
    pub fn land(&mut self, meter: &UsageMeter) {
        self.status.usage = meter.read();
        self.enter(RolePhase::Landed);
    }

    /// Joins the plant's run: waits for it, compares settings, arms the ports, waits for t_0.
    ///
    /// `arm` connects the ports to those of the other roles, which exist by then. It is given the wire, what messages
    /// carry, and the epoch of this sender.
    ///
    /// # Errors
    /// [`Error::SettingsDiffer`], [`Error::RealtimeRefused`], [`Error::Interrupted`], and those of `arm`.
    pub fn join(&mut self, mut arm: impl FnMut(&Wire, Expected, u64) -> Result<(), Error>) -> Result<Armed, Error> {
        self.report_ready()?;
        let mut patience = Patience::new(self.role);
        loop {
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            let board = self.wire.board_reader::<Run>(RUN)?;
            let Some(board) = board.filter(|board| board.get().phase() != RunPhase::Closed) else {
                patience.say(|| "the plant (`ironbird plant`)".into());
                sleep(10 * LOOK_EVERY);
                continue;
            };
            self.compare_settings()?;
            self.wait_while(&board, &mut patience, |run| run.phase() == RunPhase::Mustering);
            let run = board.get();
            let expected = Expected { run_id: run.run_id, settings: run.settings };
            let pace = run.pace();
            match run.phase() {
                // It has died, or has ended meanwhile.
                RunPhase::Mustering | RunPhase::Closed => {
                    sleep(LOOK_EVERY);
                    continue;
                }
                RunPhase::Opening => {
                    arm(&self.wire, expected, self.status.epoch)?;
                    settle()?;
                    self.status.armed_t0_ns = run.t0_ns;
                    self.enter(RolePhase::Armed);
                    // The plant keeps to this t_0 or announces another one: that it has passed says nothing.
                    let is_same = |now: &Run| now.t0_ns == run.t0_ns;
                    let is_open = |now: &Run| now.phase() == RunPhase::Opening;
                    self.wait_while(&board, &mut patience, |now| is_open(now) && is_same(now));
                    let now = board.get();
                    if is_open(&now) || !is_same(&now) {
                        continue;
                    }
                    while now_ns() + SETTLED_BEFORE_NS < run.t0_ns {
                        sleep(LOOK_EVERY);
                    }
                }
                RunPhase::Flying => {
                    arm(&self.wire, expected, self.status.epoch)?;
                    settle()?;
                }
            }
            let first_tick = match pace {
                Pace::Realtime(grid) if now_ns() >= grid.t0_ns => grid.tick_at(now_ns()) + 1,
                // The plant waits for the command of its newest tick, which nobody has worked yet.
                Pace::Lockstep if run.phase() == RunPhase::Flying => board.get().tick,
                Pace::Realtime(_) | Pace::Lockstep => 0,
            };
            self.enter(RolePhase::Flying);
            return Ok(Armed { pace, expected, last_tick: run.last_tick, first_tick, run: board });
        }
    }

    /// Waits while the plant lives and says on its board what is waited through.
    fn wait_while(&self, board: &BoardReader<Run>, patience: &mut Patience, says: impl Fn(&Run) -> bool) {
        while says(&board.get()) && !self.stop_requested() && self.plant_lives() {
            patience.say(|| "the plant to open the run".into());
            sleep(LOOK_EVERY);
        }
    }

    /// Whether the plant's process lives; its board alone outlives it.
    #[must_use]
    pub fn plant_lives(&self) -> bool {
        self.orders.instance.is_occupied(Role::Plant)
    }

    fn compare_settings(&self) -> Result<(), Error> {
        let Some(board) = self.wire.board_reader::<SettingsText>(SETTINGS)? else { return Ok(()) };
        let theirs = board.get();
        let differences = differences(&self.orders.settings, theirs.text(), self.role);
        if theirs.text().is_empty() || differences.is_empty() {
            return Ok(());
        }
        Err(Error::SettingsDiffer { role: self.role, differences: differences.join("; ") })
    }

    /// Opens a run: waits until every role is ready, announces t_0, and waits until all have armed for it.
    ///
    /// # Errors
    /// [`Error::RealtimeRefused`], [`Error::Interrupted`], and those of `arm`.
    pub fn open_run(
        &mut self,
        plan: FlightPlan,
        mut arm: impl FnMut(Expected, u64) -> Result<(), Error>,
    ) -> Result<Opened, Error> {
        let board = self.wire.board::<Run>(RUN)?;
        let settings = self.wire.board::<SettingsText>(SETTINGS)?;
        let text = SettingsText::new(&self.orders.settings)
            .ok_or_else(|| Error::Absent { what: "the settings are too long for their board".into() })?;
        settings.put(text);
        let FlightPlan { last_tick, sample_time_ns, wall_period_ns: period_ns } = plan;
        let settings_now = self.status.settings;
        let mut run = Run { settings: settings_now, period_ns, sample_time_ns, last_tick, ..Run::default() };
        board.put(run);
        self.report_ready()?;
        let crew = self.muster()?;
        run.phase = RunPhase::Opening as u64;
        run.run_id = wall_ns();
        let expected = Expected { run_id: run.run_id, settings: run.settings };
        loop {
            run.t0_ns = now_ns() + ANNOUNCE_NS;
            run.t0_wall_ns = wall_ns() + ANNOUNCE_NS;
            board.put(run);
            arm(expected, self.status.epoch)?;
            settle()?;
            if self.all_arm(&crew, run.t0_ns)? {
                break;
            }
        }
        run.phase = RunPhase::Flying as u64;
        board.put(run);
        self.status.armed_t0_ns = run.t0_ns;
        self.enter(RolePhase::Flying);
        Ok(Opened { pace: run.pace(), expected, board, run, crew, _settings: settings })
    }

    /// Waits until all other roles are ready with the plant's settings.
    fn muster(&self) -> Result<Vec<BoardReader<Status>>, Error> {
        let mut patience = Patience::new(self.role);
        loop {
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            let mut crew = Vec::new();
            let mut missing = Vec::new();
            for role in ROLES.into_iter().filter(|role| *role != Role::Plant) {
                let board = self.wire.board_reader::<Status>(&status_board(role))?;
                let ready = |board: &BoardReader<Status>| {
                    let status = board.get();
                    status.phase() == RolePhase::Ready && status.settings == self.status.settings
                };
                match board.filter(|board| self.orders.instance.is_occupied(role) && ready(board)) {
                    Some(board) => crew.push(board),
                    None => missing.push(role.name()),
                }
            }
            if missing.is_empty() {
                return Ok(crew);
            }
            patience.say(|| {
                format!("{} (each with the plant's settings: `ironbird {}` ...)", missing.join(", "), missing[0])
            });
            sleep(5 * LOOK_EVERY);
        }
    }

    /// Whether all have armed for t_0 early enough.
    fn all_arm(&self, crew: &[BoardReader<Status>], t0_ns: u64) -> Result<bool, Error> {
        loop {
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            if now_ns() + ARMED_BEFORE_NS >= t0_ns {
                return Ok(false);
            }
            if crew.iter().all(|board| board.get().armed_t0_ns == t0_ns) {
                return Ok(now_ns() + ARMED_BEFORE_NS < t0_ns);
            }
            sleep(LOOK_EVERY);
        }
    }
}

impl Opened {
    /// Newest tick that the recorder has taken in: it counts them as ticks run.
    #[must_use]
    pub fn recorded_tick(&self) -> u64 {
        self.crew.last().map_or(0, |recorder| recorder.get().ticks_run)
    }

    /// The first end that another role asks for.
    #[must_use]
    pub fn wanted_end(&self) -> Option<Ending> {
        self.crew.iter().find_map(|board| Ending::from_wire(board.get().wants_end).filter(|end| *end != Ending::None))
    }
}

/// The wall clock [ns since 1970].
#[must_use]
pub fn wall_ns() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX)
}
