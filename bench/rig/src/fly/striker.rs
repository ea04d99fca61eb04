//! What a launcher does to a flight by plan, or by `inject`: stops and kills processes, keeps their processor busy.
//!
//! Everything is due at the beginning of a tick on the clock. The launcher rests here between two looks at its flight.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use model::boards::{Run, RunPhase};
use model::fault::Span;
use model::fault::live::{LIVE, LiveBoard, LiveFault, Trouble};
use model::grid::{Grid, Pace};
use model::messages::NO_TICK;
use role::rt::loops_cpu;
use rustix::process::{Pid, Signal, kill_process};
use wire::clock::{now_ns, sleep_until};
use wire::instance::Instance;
use wire::{BoardReader, Wire};

use crate::fly::signal_at::send_at;
use crate::output::say;
use crate::settings::Settings;
use failure::Failure;

/// How often it looks for what was injected: more often than in the time between an injection and its first tick.
const LOOK_EVERY_NS: u64 = 20_000_000;
/// How long before its first tick a process is started that keeps the processor busy [ns].
const START_AHEAD_NS: u64 = 300_000_000;
/// How long before a tick the wait for a signal begins [ns].
const AIM_NS: u64 = 2_000_000;

/// The faults that are the launcher's.
pub(super) struct Striker {
    instance: Instance,
    executable: PathBuf,
    cpu: usize,
    /// Those of the settings, until the flight has a clock.
    planned: Vec<LiveFault>,
    board: Option<BoardReader<LiveBoard>>,
    /// How many of the board's were looked at.
    looked_at: usize,
    /// What is to come, each at its instant [ns].
    due: Vec<(u64, Act)>,
    stopped: Vec<Pid>,
    burdens: Vec<(Trouble, Child)>,
    /// Processes that were killed, each with the tick.
    killed: Vec<(u32, u64)>,
}

#[derive(Clone, Copy, Debug)]
enum Act {
    Strike(LiveFault),
    Continue(Pid),
}

impl Striker {
    /// Of a flight that has not begun.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub(super) fn new(instance: &Instance, executable: &Path, settings: &Settings) -> Result<Self, Failure> {
        Ok(Self {
            instance: instance.clone(),
            executable: executable.to_owned(),
            cpu: settings.realtime()?.cpu.unwrap_or_else(loops_cpu),
            planned: settings.planned()?.acts,
            board: None,
            looked_at: 0,
            due: Vec::new(),
            stopped: Vec::new(),
            burdens: Vec::new(),
            killed: Vec::new(),
        })
    }

    /// The tick in which a process was killed by plan.
    pub(super) fn killed(&self, pid: u32) -> Option<u64> {
        self.killed.iter().find(|(it, _)| *it == pid).map(|(_, tick)| *tick)
    }

    /// Rests for a time, and does meanwhile what is due. `run` is what was last seen of the flight.
    pub(super) fn rest(&mut self, wire: &Wire, run: Option<&Run>, time: Duration) {
        let until = now_ns() + u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        loop {
            let run = run.filter(|run| run.launcher_pid == u64::from(std::process::id()));
            let grid = match run.filter(|run| run.phase() == RunPhase::Flying && run.tick != NO_TICK) {
                Some(run) => match run.pace() {
                    Pace::Realtime(grid) => Some((run, grid)),
                    Pace::Lockstep => None,
                },
                None => None,
            };
            if run.is_some_and(|run| run.phase() == RunPhase::Closed) {
                self.release();
            }
            if let Some((run, grid)) = &grid {
                self.look(wire, grid);
                self.strike(run, grid);
            }
            let now = now_ns();
            if now >= until {
                return;
            }
            let next = self.due.iter().map(|(at, _)| at.saturating_sub(AIM_NS)).min().unwrap_or(u64::MAX);
            let next = if grid.is_some() { next.min(now + LOOK_EVERY_NS) } else { u64::MAX };
            sleep_until(next.min(until));
        }
    }

    /// Takes what was planned, and what was injected since.
    fn look(&mut self, wire: &Wire, grid: &Grid) {
        // Those whose time is over; why one has failed it has said itself.
        self.burdens.retain_mut(|(_, child)| matches!(child.try_wait(), Ok(None)));
        for fault in std::mem::take(&mut self.planned) {
            self.take(fault, grid);
        }
        if self.board.is_none() {
            // Where it cannot be read, nothing is injected; the stages say so themselves.
            self.board = wire.board_reader(LIVE).ok().flatten();
        }
        let Some(board) = self.board.as_ref().map(BoardReader::get) else { return };
        let news: Vec<LiveFault> = board.iter().skip(self.looked_at).collect();
        self.looked_at += news.len();
        news.into_iter().for_each(|fault| self.take(fault, grid));
    }

    fn take(&mut self, fault: LiveFault, grid: &Grid) {
        let begin_ns = grid.begin_of(fault.span.from);
        let ahead_ns = match fault.trouble {
            Trouble::Messages { .. } | Trouble::Late { .. } => return,
            Trouble::Hog { .. } | Trouble::Load { .. } if !fault.ends => START_AHEAD_NS,
            _ => 0,
        };
        self.due.push((begin_ns.saturating_sub(ahead_ns), Act::Strike(fault)));
    }

    fn strike(&mut self, run: &Run, grid: &Grid) {
        let now = now_ns();
        let is_due = |(at, _): &mut (u64, Act)| *at <= now + AIM_NS;
        let mut due: Vec<(u64, Act)> = self.due.extract_if(.., is_due).collect();
        due.sort_by_key(|(at, _)| *at);
        for (at, act) in due {
            let struck = match act {
                Act::Strike(fault) => self.strike_with(&fault, run, grid),
                Act::Continue(pid) => {
                    wait_until(at);
                    self.go_on(pid);
                    Ok(())
                }
            };
            if let Err(failure) = struck {
                say(&format!("a fault does not strike: {failure}\n"));
            }
        }
    }

    fn strike_with(&mut self, fault: &LiveFault, run: &Run, grid: &Grid) -> Result<(), Failure> {
        let LiveFault { trouble, ends, span } = fault;
        let tick = span.from;
        match *trouble {
            Trouble::Hog { .. } | Trouble::Load { .. } if *ends => {
                wait_until(grid.begin_of(tick));
                self.burdens.extract_if(.., |(other, _)| other.is_like(trouble)).for_each(|(_, child)| end(child));
                Ok(())
            }
            Trouble::Hog { priority } => self.burden(trouble, priority, 1.0, *span, run, grid),
            Trouble::Load { share } => self.burden(trouble, 0, share, *span, run, grid),
            Trouble::Stop { role, for_ns } => {
                let pid = send_at(&self.instance, run, tick, role, Signal::STOP)?;
                let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
                self.stopped.extend(pid);
                // The time is one of the flight, which may be in slow motion.
                let slowdown = run.period_ns / run.sample_time_ns.max(1);
                let until_ns = grid.begin_of(tick).saturating_add(for_ns.saturating_mul(slowdown));
                self.due.extend(pid.map(|pid| (until_ns, Act::Continue(pid))));
                Ok(())
            }
            Trouble::Kill { role } => {
                let pid = send_at(&self.instance, run, tick, role, Signal::KILL)?;
                self.killed.push((pid, tick));
                Ok(())
            }
            Trouble::Messages { .. } | Trouble::Late { .. } => Ok(()),
        }
    }

    /// Starts a process that keeps the processor busy in some ticks, and no longer than the flight.
    fn burden(
        &mut self,
        trouble: &Trouble,
        priority: u64,
        share: f64,
        span: Span,
        run: &Run,
        grid: &Grid,
    ) -> Result<(), Failure> {
        let until_ns = grid.begin_of(span.to.min(run.last_tick + 1));
        let child = Command::new(&self.executable)
            .arg("burden")
            .args(["--cpu", &self.cpu.to_string(), "--priority", &priority.to_string()])
            .args(["--instance", self.instance.name()])
            .args(["--share", &share.to_string(), "--launcher", &std::process::id().to_string()])
            .args(["--from-ns", &grid.begin_of(span.from).to_string(), "--until-ns", &until_ns.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .map_err(|e| Failure::failed(format!("cannot start a process that keeps the processor busy: {e}")))?;
        self.burdens.push((*trouble, child));
        Ok(())
    }

    /// Has a process go on that was stopped here; one that has ended since has another's number, or none.
    fn go_on(&mut self, pid: Pid) {
        if let Some(place) = self.stopped.iter().position(|it| *it == pid) {
            self.stopped.swap_remove(place);
            let _ = kill_process(pid, Signal::CONT);
        }
    }

    /// Forgets a process that has ended.
    pub(super) fn forget(&mut self, pid: u32) {
        self.stopped.retain(|stopped| stopped.as_raw_nonzero().get().unsigned_abs() != pid);
    }

    /// Undoes what lasts, and does nothing more: the flight ends.
    pub(super) fn release(&mut self) {
        self.due.clear();
        while let Some(pid) = self.stopped.pop() {
            let _ = kill_process(pid, Signal::CONT);
        }
        self.burdens.drain(..).for_each(|(_, child)| end(child));
    }
}

impl Drop for Striker {
    fn drop(&mut self) {
        self.release();
    }
}

fn wait_until(instant_ns: u64) {
    while now_ns() < instant_ns {
        // A signal to this process may end the sleep.
        sleep_until(instant_ns);
    }
}

fn end(mut child: Child) {
    // Only a process that has ended already resists.
    let _ = child.kill();
    let _ = child.wait();
}
