//! `ironbird campaign`: many flights of one file, in this process's threads, and what they show.
//!
//! The file, its draws and its tables are the crate `campaign`. Here is what flies: each flight is that of `ironbird
//! simulate` with the same settings, bit for bit.

mod again;
mod array;
mod audit;
mod check;
mod directory;
mod flown;
mod plan;
mod progress;
mod run;
mod status;
mod submit;
mod told;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use failure::Failure;
use role::stop::stop_signals;
use signal_hook::flag;

use crate::cli::CampaignCommand;

/// Does what a command says.
///
/// # Errors
/// Usage: what is wrong with the file, with its lines. A file that cannot be written; an interruption.
pub fn campaign(command: &CampaignCommand) -> Result<u8, Failure> {
    match command {
        CampaignCommand::Run(args) => run::run(args),
        CampaignCommand::Check(args) => check::check(args),
        CampaignCommand::Status(args) => status::status(args),
        CampaignCommand::Merge(args) => status::merge(args),
        CampaignCommand::Report(args) => told::report(args),
        CampaignCommand::Submit(args) => submit::submit(args),
        CampaignCommand::Fly(args) => again::fly(args),
    }
}

/// What a signal that asks for the end sets.
///
/// # Errors
/// The system handles no more signals.
fn hear_stop() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in stop_signals() {
        flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    }
    Ok(stop)
}
