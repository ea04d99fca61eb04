//! `ironbird watch`: the flight, live; joins and leaves without touching a loop.
//!
//! ```text
//! recorder, boards --feed--> model --draw--> terminal        (or --plain--> a line per second)
//!                    keys -----^  \--inject--> the plant's desk
//! ```

pub mod draw;
pub mod feed;
pub mod keys;
pub mod model;
pub mod plain;
mod terminal;
pub mod trace;

use std::io::{self, IsTerminal as _};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use role::launcher::end_with_launcher;
use signal_hook::consts::{SIGINT, SIGTERM};
use wire::instance::Instance;

use crate::cli::WatchArgs;
use failure::Failure;
use feed::Feed;
use model::Model;

/// Watches.
///
/// # Errors
/// Usage; as many observers as may be; a terminal that cannot be used.
pub fn watch(args: &WatchArgs) -> Result<u8, Failure> {
    let instance = Instance::new(&args.instance)?;
    let stop = Arc::new(AtomicBool::new(false));
    // SIGHUP keeps its default: where the terminal has gone, crossterm would read its end for ever.
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    }
    end_with_launcher(args.launcher)?;
    // https://no-color.org
    let colours = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let mut model = Model::new(instance.name(), args.launcher.is_some(), colours);
    let mut feed = Feed::new(instance.clone());
    if args.plain || !io::stdout().is_terminal() || !io::stdin().is_terminal() {
        return plain::run(&mut model, &mut feed, &stop);
    }
    terminal::run(&mut model, &mut feed, &instance, args.launcher, &stop)
}
