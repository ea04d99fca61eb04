//! `ironbird watch`: shows a flight live, without touching a loop.
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
pub mod words;

use std::io::{self, IsTerminal as _};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use role::launcher::end_with_launcher;
use role::stop::stop_signals;
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
    let failed = |e| Failure::failed(format!("cannot handle signals: {e}"));
    for signal in stop_signals() {
        signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(failed)?;
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
