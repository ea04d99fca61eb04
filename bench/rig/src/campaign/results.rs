//! `ironbird campaign report`: the results of the rows recorded so far.

use campaign::aggregate;
use campaign::results_document::document;
use campaign::rows::Rows;
use errors::{Failure, OK, check_writable, write_text};
use report::json;

use super::directory;
use super::status::found;
use crate::cli::{CampaignReportArgs, DiffFormat};
use crate::output::{print, say};

/// Prints the report, and writes its page.
pub(super) fn report(args: &CampaignReportArgs) -> Result<u8, Failure> {
    check_writable("--page", args.page.as_deref())?;
    let plan = directory::plan(&args.directory)?;
    let found = found(&plan, &args.directory);
    if found.whole.is_empty() {
        return Err(Failure::failed(format!(
            "{}: no flight is there yet",
            args.directory.display()
        ))
        .help(format!(
            "`ironbird campaign status {}` says why",
            args.directory.display()
        )));
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
    let findings = aggregate::of(&plan.campaign, &plan.identity, &rows, false)?;
    let document = document(&findings, &args.directory.display().to_string());
    if let Some(path) = &args.page {
        write_text(path, &document.html())?;
    }
    match args.format {
        DiffFormat::Text => print(&document.text())?,
        DiffFormat::Json => print(
            &(json::to_string(&findings).map_err(|e| Failure::failed(e.to_string()))? + "\n"),
        )?,
    }
    Ok(OK)
}
