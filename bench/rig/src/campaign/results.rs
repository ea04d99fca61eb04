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

pub(super) fn report(args: &CampaignReportArgs) -> Result<u8, Failure> {
    check_writable("--page", args.page.as_deref())?;
    let plan = directory::plan(&args.directory)?;
    let whole = found(&plan, &args.directory).whole;
    let (place, files, chunks) = (
        args.directory.display(),
        whole.len(),
        plan.campaign.chunks(),
    );
    if files == 0 {
        return Err(Failure::failed(format!("{place}: no flight is there yet"))
            .help(format!("`ironbird campaign status {place}` says why")));
    }
    if files as u64 != chunks {
        say(&format!(
            "warning: {files} of {chunks} files of rows are whole; the others are left out\n"
        ));
    }
    let rows = Rows::new(&args.directory, whole);
    let results = aggregate::of(&plan.campaign, &plan.identity, &rows)?;
    let document = document(&results, &place.to_string());
    if let Some(path) = &args.page {
        write_text(path, &document.html())?;
    }
    match args.format {
        DiffFormat::Text => print(&document.text())?,
        DiffFormat::Json => {
            let json = json::to_string(&results).map_err(|e| Failure::failed(e.to_string()))?;
            print(&(json + "\n"))?;
        }
    }
    Ok(OK)
}
