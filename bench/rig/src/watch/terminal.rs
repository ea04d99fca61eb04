//! The dashboard's loop in a terminal. It restores the terminal when it ends.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use role::stop::stop_signals;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process};
use signal_hook::iterator::Signals;
use wire::instance::Instance;

use crate::inject::{When, injected};
use crate::watch::draw::draw;
use crate::watch::feed::Feed;
use crate::watch::keys::Action;
use crate::watch::model::Model;
use failure::{Failure, INTERRUPTED, OK};

/// How long it waits for a key before it drains the feed.
const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// How long the loop may take to see that it shall end.
const LEAVING: Duration = Duration::from_millis(500);
/// How often it is looked whether the terminal is still there.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How often it draws.
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// Shows the model until the user leaves; under a launcher, until the flight ends.
///
/// # Errors
/// Those of the terminal and the feed.
pub fn run(
    model: &mut Model,
    feed: &mut Feed,
    instance: &Instance,
    launcher: Option<u32>,
    stop: &AtomicBool,
) -> Result<u8, Failure> {
    leave_a_closed_one()?;
    let mut terminal = ratatui::try_init()
        .map_err(|e| Failure::failed(format!("cannot use the terminal: {e}")).help("ironbird watch --plain"))?;
    let outcome = show(&mut terminal, model, feed, &Outside { instance, launcher, stop });
    let restored = terminal.show_cursor().and_then(|()| ratatui::try_restore());
    // Dropped, it would try once more, print why it cannot, and panic where there is no terminal to print to.
    std::mem::forget(terminal);
    // What a terminal refuses that is being closed is no failure.
    if stop.load(Ordering::Relaxed) || is_closed() {
        return Ok(INTERRUPTED);
    }
    let broken = |e| Failure::failed(format!("cannot give the terminal back: {e}"));
    outcome.and_then(|code| restored.map(|()| code).map_err(broken))
}

/// Ends the process even where the loop does not, which a closed terminal holds: crossterm reads its end for ever. That
/// it is closed, a signal says, or the terminal itself where SIGHUP is ignored or goes to another process.
fn leave_a_closed_one() -> Result<(), Failure> {
    let failed = |e| Failure::failed(format!("cannot handle signals: {e}"));
    let mut signals = Signals::new(stop_signals()).map_err(failed)?;
    let leave = move || {
        while signals.pending().next().is_none() && !is_closed() {
            sleep(LOOK_EVERY);
        }
        sleep(LEAVING);
        // A terminal that is no more has nothing to restore.
        let _ = ratatui::try_restore();
        std::process::exit(i32::from(INTERRUPTED));
    };
    std::thread::Builder::new().spawn(leave).map(|_| ()).map_err(failed)
}

/// Whether nobody holds the other end of the terminal any more.
fn is_closed() -> bool {
    let stdin = std::io::stdin();
    let mut looked_at = [PollFd::new(&stdin, PollFlags::empty())];
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut looked_at, Some(&at_once)).is_ok() && looked_at[0].revents().contains(PollFlags::HUP)
}

/// What the loop knows of the outside.
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
        if outside.launcher.is_some() && model.flight.as_ref().is_some_and(|flight| flight.ending.is_some()) {
            return Ok(OK);
        }
        if Instant::now() >= next_draw {
            terminal.draw(|frame| draw(model, frame)).map_err(broken)?;
            next_draw = Instant::now() + DRAW_EVERY;
        }
        if !event::poll(DRAIN_EVERY).map_err(broken)? {
            continue;
        }
        // What the user did is seen at once.
        next_draw = Instant::now();
        let Event::Key(key) = event::read().map_err(broken)? else { continue };
        match model.key(key) {
            Action::None => {}
            Action::Quit => return Ok(OK),
            Action::EndFlight => end_flight(outside.launcher),
            Action::Reset => model.reset()?,
            Action::Inject(changes, lasts) => {
                let instance = outside.instance.clone();
                // The plant may take its time, and the dashboard goes on.
                let asking = sender.clone();
                let ask_it = move || {
                    // Nobody is left to tell when the dashboard has been left.
                    let _ = asking.send(injected(&instance, &changes, When::In(Duration::ZERO), lasts));
                };
                if let Err(e) = std::thread::Builder::new().spawn(ask_it) {
                    model.answer(Err(Failure::failed(format!("cannot start a thread to ask the plant: {e}"))));
                }
            }
        }
    }
}

/// Tells the launcher what Ctrl-C tells it in a terminal that nobody else has taken.
fn end_flight(launcher: Option<u32>) {
    let launcher = launcher.and_then(|pid| i32::try_from(pid).ok()).and_then(Pid::from_raw);
    if let Some(launcher) = launcher {
        // It may have ended meanwhile.
        let _ = kill_process(launcher, Signal::INT);
    }
}
