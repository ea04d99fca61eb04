//! `ironbird campaign report`: what the rows that are there show.

use campaign::findings;
use campaign::rows::Rows;
use failure::{Failure, GATE, OK, check_writable, write_text};
use report::json;

use super::status::found;
use super::{audit, directory};
use crate::cli::{CampaignReportArgs, DiffFormat};
use crate::output::{print, say};
use crate::parallel::processors;

/// Reports; exit code 3 where an audit finds rows that are not those of their flights.
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
    let whole = found.whole;
    let rows = Rows::new(&args.directory, whole.iter().copied());
    let mut findings = findings::of(&plan.campaign, &plan.identity, &rows, args.exact)?;
    if let Some(share) = args.audit {
        let jobs = args.jobs.unwrap_or_else(processors);
        findings.audit = Some(audit::audit(&plan, &args.directory, &whole, share, jobs)?);
    }
    if let Some(path) = &args.page {
        write_text(path, &findings::page::render(&findings))?;
    }
    match args.format {
        DiffFormat::Text => print(&findings::text::render(&findings, &args.directory.display().to_string()))?,
        DiffFormat::Json => print(&(json::to_string(&findings).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
    }
    Ok(if findings.audit.is_some_and(|audit| audit.differ > 0) { GATE } else { OK })
}
