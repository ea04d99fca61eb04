//! `ironbird watch`: shows a flight live, without touching a loop.
//!
//! ```text
//! recorder, boards --feed--> model --draw--> terminal        (or --plain--> a line per second)
//!                    keys -----^  \--inject--> the plant's desk
//! ```

pub mod dashboard_model;
pub mod feed;
pub mod keys;
pub mod line_output;
pub mod screen;
mod terminal;

use std::io::{self, IsTerminal as _};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use ipc::instance::Instance;
use process::signals::{end_with_launcher, stop_signals};

use crate::cli::WatchArgs;
use dashboard_model::Model;
use errors::Failure;
use feed::Feed;

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
        return line_output::run(&mut model, &mut feed, &stop);
    }
    terminal::run(&mut model, &mut feed, &instance, args.launcher, &stop)
}
