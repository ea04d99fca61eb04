//! The dashboard's loop in a terminal. It restores the terminal when it ends.

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use ipc::clock::timespec;
use process::signals::stop_signals;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Pid, Signal, kill_process};
use signal_hook::iterator::Signals;

use super::feed::{Feed, LOOK_EVERY};
use crate::inject::{When, injected};
use crate::observation::DRAIN_EVERY;
use crate::watch::dashboard_model::{Action, Model};
use crate::watch::screen::draw;
use errors::{Failure, INTERRUPTED, OK};

/// How long the loop may take to end after a signal.
const EXIT_TIMEOUT: Duration = Duration::from_millis(500);
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// Shows the model until the user leaves or, if a supervisor started the dashboard, until the flight ends.
pub(super) fn run(
    model: &mut Model,
    feed: &mut Feed,
    launcher: Option<u32>,
    stop: &AtomicBool,
) -> Result<u8, Failure> {
    exit_when_terminal_closes()?;
    let mut terminal =
        ratatui::try_init().map_err(|e| unusable(e).help("ironbird watch --plain"))?;
    let outcome = show(&mut terminal, model, feed, launcher, stop);
    let restored = terminal.show_cursor().and_then(|()| ratatui::try_restore());
    // Dropping it would restore a second time, print an error, and panic without a terminal to print to.
    std::mem::forget(terminal);
    // Errors of a terminal that is being closed do not matter.
    if stop.load(Ordering::Relaxed) || is_closed() {
        return Ok(INTERRUPTED);
    }
    let code = outcome?;
    restored.map_err(|e| Failure::failed(format!("cannot give the terminal back: {e}")))?;
    Ok(code)
}

fn unusable(error: impl Display) -> Failure {
    Failure::failed(format!("cannot use the terminal: {error}"))
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
    thread::Builder::new().spawn(leave).map_err(failed)?;
    Ok(())
}

/// Whether the other end of the terminal is closed.
fn is_closed() -> bool {
    let stdin = std::io::stdin();
    let mut polled = [PollFd::new(&stdin, PollFlags::empty())];
    poll(&mut polled, Some(&timespec(0))).is_ok() && polled[0].revents().contains(PollFlags::HUP)
}

fn show(
    terminal: &mut DefaultTerminal,
    model: &mut Model,
    feed: &mut Feed,
    launcher: Option<u32>,
    stop: &AtomicBool,
) -> Result<u8, Failure> {
    let (sender, answers) = mpsc::channel::<Result<String, Failure>>();
    let mut next_draw = Instant::now();
    loop {
        if stop.load(Ordering::Relaxed) {
            return Ok(INTERRUPTED);
        }
        feed.update(model)?;
        answers.try_iter().for_each(|answer| model.answer(answer));
        if model.launched && model.flight.is_some() && !model.is_flying() {
            return Ok(OK);
        }
        if Instant::now() >= next_draw {
            terminal
                .draw(|frame| draw(model, frame))
                .map_err(unusable)?;
            next_draw = Instant::now() + DRAW_EVERY;
        }
        if !event::poll(DRAIN_EVERY).map_err(unusable)? {
            continue;
        }
        // Show the effect of a key at once.
        next_draw = Instant::now();
        let key = match event::read().map_err(unusable)? {
            Event::Key(key) => key,
            Event::Resize(..) => {
                terminal.clear().map_err(unusable)?;
                continue;
            }
            _ => continue,
        };
        match model.key(key) {
            Action::None => {}
            Action::Quit => return Ok(OK),
            Action::EndFlight => end_flight(launcher),
            Action::Reset => model.reset()?,
            Action::Inject(changes, lasts) => {
                let (instance, sender) = (feed.instance.clone(), sender.clone());
                // The plant may answer late; the dashboard continues meanwhile.
                let inject = move || {
                    let answer = injected(&instance, &changes, When::NOW, lasts);
                    // The receiver is gone if the user has left the dashboard.
                    let _ = sender.send(answer);
                };
                if let Err(e) = thread::Builder::new().spawn(inject) {
                    let what = format!("cannot start a thread to ask the plant: {e}");
                    model.answer(Err(Failure::failed(what)));
                }
            }
        }
    }
}

/// Sends the supervisor SIGINT, as Ctrl-C would without the dashboard.
fn end_flight(launcher: Option<u32>) {
    let pid = launcher.and_then(|pid| Pid::from_raw(pid.cast_signed()));
    // It may have ended meanwhile.
    let _ = pid.map(|pid| kill_process(pid, Signal::INT));
}
