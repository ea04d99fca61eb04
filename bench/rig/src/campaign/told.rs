//! `ironbird campaign report`: what the rows that are there show.

use campaign::findings;
use campaign::rows::Rows;
use failure::{Failure, OK, check_writable, write_text};
use report::json;

use super::directory;
use super::status::found;
use crate::cli::{CampaignReportArgs, DiffFormat};
use crate::output::{print, say};

/// Reports.
///
/// # Errors
/// Usage: a directory of no campaign, or without rows. A file that cannot be read or written.
pub(super) fn report(args: &CampaignReportArgs) -> Result<u8, Failure> {
    check_writable("--page", args.page.as_deref())?;
    let plan = directory::plan(&args.directory)?;
    let found = found(&plan, &args.directory);
    if found.whole.is_empty() {
        return Err(Failure::failed(format!("{}: no flight is there yet", args.directory.display()))
            .help(format!("`ironbird campaign status {}` says why", args.directory.display())));
    }
    if found.whole.len() as u64 != plan.campaign.chunks() {
        say(&format!(
            "warning: {} of {} files of rows are whole; the others are left out\n",
            found.whole.len(),
            plan.campaign.chunks()
        ));
    }
    let rows = Rows::new(&args.directory, found.whole);
    let findings = findings::of(&plan.campaign, &plan.identity, &rows, args.exact)?;
    if let Some(path) = &args.page {
        write_text(path, &findings::page::render(&findings))?;
    }
    match args.format {
        DiffFormat::Text => print(&findings::text::render(&findings, &args.directory.display().to_string()))?,
        DiffFormat::Json => print(&(json::to_string(&findings).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
    }
    Ok(OK)
}
