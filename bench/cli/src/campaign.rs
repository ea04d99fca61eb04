//! `ironbird campaign`: many flights of one file, in this process's threads, and their results.
//!
//! The file, its draws and its tables are the crate `campaign`. Here is what flies: each flight is that of `ironbird
//! simulate` with the same settings, bit for bit.

mod refly;
mod run;
mod status;
mod submit;

use errors::Failure;

use crate::cli::CampaignCommand;

pub fn campaign(command: &CampaignCommand) -> Result<u8, Failure> {
    match command {
        CampaignCommand::Run(args) => run::run(args),
        CampaignCommand::Check(args) => run::check(args),
        CampaignCommand::Status(args) => status::status(args),
        CampaignCommand::Merge(args) => status::merge(args),
        CampaignCommand::Report(args) => status::report(args),
        CampaignCommand::Submit(args) => submit::submit(args),
        CampaignCommand::Fly(args) => refly::fly(args),
    }
}
