//! What a launcher does to a flight by plan, or by `inject`: stops and kills processes, keeps their processor busy.
//!
//! Everything is due at the beginning of a tick on the clock. The launcher rests here between two looks at its flight.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use model::boards::{Run, RunPhase};
use model::fault::live::{LIVE, LiveBoard, LiveFault, NOTICE_TICKS, Trouble};
use model::grid::{Grid, Pace};
use model::messages::NO_TICK;
use role::rt::loops_cpu;
use rustix::process::{Pid, Signal, kill_process};
use wire::clock::{now_ns, sleep_until};
use wire::instance::Instance;
use wire::{BoardReader, Wire};

use crate::fault::Fault;
use crate::fault::live::planned_again;
use crate::fly::ends::Ends;
use crate::fly::signal_at::send_at;
use crate::output::say;
use crate::settings::Settings;
use failure::Failure;

/// How often it looks for what was injected, at the most and at the least: four times between an injection and its first
/// tick, where that is possible.
const LOOK_EVERY_NS: RangeInclusive<u64> = 1_000_000..=20_000_000;
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
    /// Who keeps the processor busy, each with its fault.
    burdens: Vec<(LiveFault, Child)>,
    /// Processes that were killed, each with the tick.
    killed: Vec<(u32, u64)>,
    /// The flight ends: nothing is begun any more.
    is_released: bool,
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
            is_released: false,
        })
    }

    /// The tick in which a process was killed by plan.
    pub(super) fn killed(&self, pid: u32) -> Option<u64> {
        self.killed.iter().find(|(it, _)| *it == pid).map(|(_, tick)| *tick)
    }

    /// Rests for a time, or until a process has ended, and does meanwhile what is due. `run` is what was last seen of the
    /// flight.
    pub(super) fn rest(&mut self, wire: &Wire, run: Option<&Run>, time: Duration, ends: &mut Ends) {
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
            let grid = grid.filter(|_| !self.is_released);
            if let Some((run, grid)) = &grid {
                self.look(wire, grid);
                self.strike(run, grid);
            }
            let now = now_ns();
            if now >= until {
                return;
            }
            let next = self.due.iter().map(|(at, _)| at.saturating_sub(AIM_NS)).min().unwrap_or(u64::MAX);
            let next = grid.map_or(u64::MAX, |(_, grid)| next.min(now + look_every_ns(&grid)));
            if ends.wait_until(next.min(until)) {
                return;
            }
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
        if fault.ends {
            self.call_off(&fault);
        }
        let ahead_ns = match fault.trouble {
            Trouble::Messages { .. } | Trouble::Late { .. } => return,
            Trouble::Hog { .. } | Trouble::Load { .. } if !fault.ends => START_AHEAD_NS,
            _ => 0,
        };
        self.due.push((begin_ns.saturating_sub(ahead_ns), Act::Strike(fault)));
    }

    /// What an end names and what has not begun by then never begins.
    fn call_off(&mut self, end: &LiveFault) {
        let never_begins =
            |fault: &LiveFault| !fault.ends && fault.trouble.is_like(&end.trouble) && fault.span.from >= end.span.from;
        self.due.retain(|(_, act)| !matches!(act, Act::Strike(fault) if never_begins(fault)));
        // Those that were started ahead.
        self.burdens.extract_if(.., |(fault, _)| never_begins(fault)).for_each(|(_, child)| kill(child));
    }

    fn strike(&mut self, run: &Run, grid: &Grid) {
        let now = now_ns();
        let is_due = |(at, _): &mut (u64, Act)| *at <= now + AIM_NS;
        let mut due: Vec<(u64, Act)> = self.due.extract_if(.., is_due).collect();
        due.sort_by_key(|(at, _)| *at);
        for (at, act) in due {
            let struck = match act {
                Act::Strike(fault) => {
                    if let Some(late) = lateness(&fault, grid.tick_at(now)) {
                        say(&late);
                    }
                    self.strike_with(&fault, run, grid)
                }
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
        match trouble {
            Trouble::Hog { .. } | Trouble::Load { .. } if *ends => {
                wait_until(grid.begin_of(tick));
                let is_ended =
                    |(other, _): &mut (LiveFault, Child)| other.trouble.is_like(trouble) && other.span.from < tick;
                self.burdens.extract_if(.., is_ended).for_each(|(_, child)| kill(child));
                Ok(())
            }
            Trouble::Hog { priority } => self.burden(fault, *priority, 1.0, run, grid),
            Trouble::Load { share } => self.burden(fault, 0, *share, run, grid),
            Trouble::Stop { role, for_ns } => {
                let pid = send_at(&self.instance, run, tick, *role, Signal::STOP)?;
                let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
                self.stopped.extend(pid);
                // The time is one of the flight, which may be in slow motion.
                let slowdown = run.period_ns / run.sample_time_ns.max(1);
                let until_ns = grid.begin_of(tick).saturating_add(for_ns.saturating_mul(slowdown));
                self.due.extend(pid.map(|pid| (until_ns, Act::Continue(pid))));
                Ok(())
            }
            Trouble::Kill { role } => {
                let pid = send_at(&self.instance, run, tick, *role, Signal::KILL)?;
                self.killed.push((pid, tick));
                Ok(())
            }
            Trouble::Messages { .. } | Trouble::Late { .. } => Ok(()),
        }
    }

    /// Starts a process that keeps the processor busy in some ticks, and no longer than the flight.
    fn burden(&mut self, fault: &LiveFault, priority: u64, share: f64, run: &Run, grid: &Grid) -> Result<(), Failure> {
        let span = fault.span;
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
        self.burdens.push((*fault, child));
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
        self.is_released = true;
        self.due.clear();
        while let Some(pid) = self.stopped.pop() {
            let _ = kill_process(pid, Signal::CONT);
        }
        self.burdens.drain(..).for_each(|(_, child)| kill(child));
    }
}

impl Drop for Striker {
    fn drop(&mut self) {
        self.release();
    }
}

/// How often it looks for what was injected [ns].
fn look_every_ns(grid: &Grid) -> u64 {
    (NOTICE_TICKS.saturating_mul(grid.period_ns) / 4).clamp(*LOOK_EVERY_NS.start(), *LOOK_EVERY_NS.end())
}

/// What is said of a fault whose tick is over.
fn lateness(fault: &LiveFault, tick: u64) -> Option<String> {
    let late = tick.checked_sub(fault.span.from).filter(|late| *late > 0)?;
    let what: Vec<String> = planned_again(&[*fault]).iter().map(Fault::to_string).collect();
    Some(format!("the fault {} strikes {late} ticks late: the launcher was told, or came to it, late\n", what.concat()))
}

fn wait_until(instant_ns: u64) {
    while now_ns() < instant_ns {
        // A signal to this process may end the sleep.
        sleep_until(instant_ns);
    }
}

fn kill(mut child: Child) {
    // Only a process that has ended already resists.
    let _ = child.kill();
    let _ = child.wait();
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::fault::Span;
    use model::role::Role;

    /// Hands a striker of a flight with two planned loads to a test, with its wire and its run, and tidies up behind it.
    fn on_site(test: impl FnOnce(&Wire, &mut Striker, &Run)) {
        let root = tempfile::Builder::new().prefix("ib-").tempdir_in("/tmp").unwrap();
        let instance = Instance::under(root.path(), "striker").unwrap();
        let faults = vec!["cpu.load=0.5@tick0..tick4500", "cpu.load=0.4@tick5000"];
        let settings = Settings::resolve(None, &vec![("flight.faults", faults.into())]).unwrap();
        let mut striker = Striker::new(&instance, Path::new("/bin/sleep"), &settings).unwrap();
        let run = Run {
            phase: RunPhase::Flying as u64,
            launcher_pid: u64::from(std::process::id()),
            t0_ns: now_ns(),
            period_ns: 1_000_000,
            sample_time_ns: 1_000_000,
            last_tick: 9000,
            tick: 0,
            ..Run::default()
        };
        let wire = Wire::open(&instance).unwrap();
        test(&wire, &mut striker, &run);
        drop((striker, wire));
        instance.remove_leftovers().unwrap();
    }

    #[test]
    fn nothing_is_begun_once_the_flight_ends() {
        on_site(|wire, striker, run| {
            striker.rest(wire, Some(run), Duration::from_millis(1), &mut Ends::default());
            assert_eq!((striker.burdens.len(), striker.due.len()), (1, 1));
            striker.release();
            let span = Span { from: 0, to: Span::FOR_GOOD };
            striker.planned.push(LiveFault { trouble: Trouble::Load { share: 0.5 }, ends: false, span });
            striker.rest(wire, Some(run), Duration::from_millis(1), &mut Ends::default());
            assert_eq!((striker.burdens.len(), striker.due.len()), (0, 0));
        });
    }

    #[test]
    fn an_end_takes_back_what_is_still_to_come_and_leaves_what_is_on_until_then() {
        on_site(|wire, striker, run| {
            striker.rest(wire, Some(run), Duration::from_millis(1), &mut Ends::default());
            let Pace::Realtime(grid) = run.pace() else { panic!() };
            let trouble = Trouble::Load { share: 1.0 };
            striker.take(LiveFault { trouble, ends: true, span: Span { from: 4000, to: 4001 } }, &grid);
            let [(_, Act::Strike(left))] = striker.due[..] else { panic!("{:?}", striker.due) };
            assert!(left.ends && striker.burdens.len() == 1, "{left:?}");
        });
    }

    #[test]
    fn it_looks_often_enough_for_the_notice_that_stages_have() {
        for (period_ns, every_ns) in
            [(50_000, 1_000_000), (100_000, 1_600_000), (1_000_000, 16_000_000), (10_000_000, 20_000_000)]
        {
            assert_eq!(look_every_ns(&Grid { t0_ns: 0, period_ns }), every_ns);
        }
    }

    #[test]
    fn what_strikes_late_says_so() {
        let trouble = Trouble::Stop { role: Role::Inner, for_ns: 20_000_000 };
        let fault = LiveFault { trouble, ends: false, span: Span { from: 100, to: 101 } };
        assert_eq!([99, 100].map(|tick| lateness(&fault, tick)), [None, None]);
        let said = lateness(&fault, 107).unwrap();
        assert!(said.starts_with("the fault inner.stop=20ms@tick100 strikes 7 ticks late"), "{said}");
    }
}
