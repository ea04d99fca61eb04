//! The dashboard's loop in a terminal. It restores the terminal when it ends.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use ipc::instance::Instance;
use process::signals::stop_signals;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process};
use signal_hook::iterator::Signals;

use crate::inject::{When, injected};
use crate::watch::dashboard_model::Model;
use crate::watch::feed::Feed;
use crate::watch::keys::Action;
use crate::watch::screen::draw;
use errors::{Failure, INTERRUPTED, OK};

/// How long to wait for a key before draining the feed.
const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// How long the loop may take to end after a signal.
const EXIT_TIMEOUT: Duration = Duration::from_millis(500);
/// How often to check whether the terminal still exists.
const LOOK_EVERY: Duration = Duration::from_millis(100);
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// Shows the model until the user leaves or, if a supervisor started the dashboard, until the flight ends.
pub fn run(
    model: &mut Model,
    feed: &mut Feed,
    instance: &Instance,
    launcher: Option<u32>,
    stop: &AtomicBool,
) -> Result<u8, Failure> {
    exit_when_terminal_closes()?;
    let mut terminal = ratatui::try_init().map_err(|e| {
        Failure::failed(format!("cannot use the terminal: {e}")).help("ironbird watch --plain")
    })?;
    let outcome = show(
        &mut terminal,
        model,
        feed,
        &Outside {
            instance,
            launcher,
            stop,
        },
    );
    let restored = terminal.show_cursor().and_then(|()| ratatui::try_restore());
    // Dropping it would restore a second time, print an error, and panic without a terminal to print to.
    std::mem::forget(terminal);
    // Errors of a terminal that is being closed do not matter.
    if stop.load(Ordering::Relaxed) || is_closed() {
        return Ok(INTERRUPTED);
    }
    let broken = |e| Failure::failed(format!("cannot give the terminal back: {e}"));
    outcome.and_then(|code| restored.map(|()| code).map_err(broken))
}

/// Ends the process if the terminal is closed and the loop hangs: crossterm then reads end-of-file forever. A signal
/// tells that the terminal is closed, or its state if SIGHUP is ignored or goes to another process.
fn exit_when_terminal_closes() -> Result<(), Failure> {
    let failed = |e| Failure::failed(format!("cannot handle signals: {e}"));
    let mut signals = Signals::new(stop_signals()).map_err(failed)?;
    let leave = move || {
        while signals.pending().next().is_none() && !is_closed() {
            sleep(LOOK_EVERY);
        }
        sleep(EXIT_TIMEOUT);
        // A closed terminal needs no restoring.
        let _ = ratatui::try_restore();
        std::process::exit(i32::from(INTERRUPTED));
    };
    std::thread::Builder::new()
        .spawn(leave)
        .map(|_| ())
        .map_err(failed)
}

/// Whether the other end of the terminal is closed.
fn is_closed() -> bool {
    let stdin = std::io::stdin();
    let mut looked_at = [PollFd::new(&stdin, PollFlags::empty())];
    let at_once = Timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    poll(&mut looked_at, Some(&at_once)).is_ok() && looked_at[0].revents().contains(PollFlags::HUP)
}

struct Outside<'a> {
    instance: &'a Instance,
    launcher: Option<u32>,
    stop: &'a AtomicBool,
}

fn show(
    terminal: &mut DefaultTerminal,
    model: &mut Model,
    feed: &mut Feed,
    outside: &Outside<'_>,
) -> Result<u8, Failure> {
    let broken = |e| Failure::failed(format!("cannot use the terminal: {e}"));
    let (sender, answers) = mpsc::channel::<Result<String, Failure>>();
    let mut next_draw = Instant::now();
    loop {
        if outside.stop.load(Ordering::Relaxed) {
            return Ok(INTERRUPTED);
        }
        feed.look(model)?;
        while let Ok(answer) = answers.try_recv() {
            model.answer(answer);
        }
        if outside.launcher.is_some()
            && model
                .flight
                .as_ref()
                .is_some_and(|flight| flight.ending.is_some())
        {
            return Ok(OK);
        }
        if Instant::now() >= next_draw {
            terminal.draw(|frame| draw(model, frame)).map_err(broken)?;
            next_draw = Instant::now() + DRAW_EVERY;
        }
        if !event::poll(DRAIN_EVERY).map_err(broken)? {
            continue;
        }
        // Show the effect of a key at once.
        next_draw = Instant::now();
        let Event::Key(key) = event::read().map_err(broken)? else {
            continue;
        };
        match model.key(key) {
            Action::None => {}
            Action::Quit => return Ok(OK),
            Action::EndFlight => end_flight(outside.launcher),
            Action::Reset => model.reset()?,
            Action::Inject(changes, lasts) => {
                let instance = outside.instance.clone();
                // The plant may answer late; the dashboard continues meanwhile.
                let asking = sender.clone();
                let ask_it = move || {
                    // The receiver is gone if the user has left the dashboard.
                    let _ = asking.send(injected(
                        &instance,
                        &changes,
                        When::In(Duration::ZERO),
                        lasts,
                    ));
                };
                if let Err(e) = std::thread::Builder::new().spawn(ask_it) {
                    model.answer(Err(Failure::failed(format!(
                        "cannot start a thread to ask the plant: {e}"
                    ))));
                }
            }
        }
    }
}

/// Sends the supervisor SIGINT, as Ctrl-C would without the dashboard.
fn end_flight(launcher: Option<u32>) {
    let launcher = launcher
        .and_then(|pid| i32::try_from(pid).ok())
        .and_then(Pid::from_raw);
    if let Some(launcher) = launcher {
        // It may have ended meanwhile.
        let _ = kill_process(launcher, Signal::INT);
    }
}
