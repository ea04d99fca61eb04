//! `ironbird campaign status`, `merge` and `report`: which rows are there; all in one file; what they show.

use analysis::json;
use analysis::phrase::count;
use campaign::aggregate;
use campaign::chunk::{self, Rows, State};
use campaign::results_document::document;
use errors::{Failure, GATE, OK, check_writable, write_text};

use super::flight_settings::{Plan, plan_of};
use crate::cli::{CampaignDirectoryArgs, CampaignReportArgs, DiffFormat};
use errors::output::{print, say};

const MERGED: &str = "merged.parquet";

#[derive(Default)]
pub(super) struct Found {
    pub whole: Vec<u64>,
    missing: Vec<u64>,
    refused: Vec<(u64, String)>,
}

pub(super) fn found(plan: &Plan, directory: &std::path::Path) -> Found {
    let mut found = Found::default();
    for chunk in 0..plan.campaign.chunks() {
        match chunk::state(directory, &plan.campaign, &plan.identity, chunk) {
            State::Whole => found.whole.push(chunk),
            State::Missing => found.missing.push(chunk),
            State::Refused(why) => found.refused.push((chunk, why)),
        }
    }
    found
}

pub(super) fn status(args: &CampaignDirectoryArgs) -> Result<u8, Failure> {
    let plan = plan_of(&args.directory)?;
    let found = found(&plan, &args.directory);
    let (campaign, place) = (&plan.campaign, args.directory.display());
    let flown = found
        .whole
        .iter()
        .map(|chunk| campaign.flights_of(*chunk).count());
    let (flown, arms) = (
        flown.sum::<usize>(),
        count(campaign.arms.len() as u64, "arm"),
    );
    let mut text = format!(
        "{}: {flown} of {} flights, each by {arms}; {} of {} files are whole\n",
        campaign.name,
        campaign.flights,
        found.whole.len(),
        campaign.chunks()
    );
    if !found.missing.is_empty() {
        text += &format!("missing: chunks {}\n", ranges(&found.missing));
    }
    for (chunk, why) in &found.refused {
        let path = chunk::path_of(&args.directory, *chunk);
        text += &format!("{}: {why}\n", path.display());
    }
    for other in chunk::others(&args.directory, campaign)? {
        let path = args.directory.join(other);
        text += &format!("{}: none of this campaign's\n", path.display());
    }
    let is_whole = found.missing.is_empty() && found.refused.is_empty();
    if !is_whole {
        let file = plan.file.display();
        text += &format!("`ironbird campaign run {file} --out {place}` flies what is missing\n");
    }
    print(&text)?;
    Ok(if is_whole { OK } else { GATE })
}

/// Numbers, those that follow each other as one: `0-3, 7`.
pub(super) fn ranges(chunks: &[u64]) -> String {
    let mut ranges: Vec<[u64; 2]> = Vec::new();
    for chunk in chunks {
        match ranges.last_mut().filter(|last| last[1] + 1 == *chunk) {
            Some(last) => last[1] = *chunk,
            None => ranges.push([*chunk; 2]),
        }
    }
    let words = |[first, last]: &[u64; 2]| match first == last {
        true => first.to_string(),
        false => format!("{first}-{last}"),
    };
    ranges.iter().map(words).collect::<Vec<_>>().join(", ")
}

pub(super) fn merge(args: &CampaignDirectoryArgs) -> Result<u8, Failure> {
    let plan = plan_of(&args.directory)?;
    let whole = found(&plan, &args.directory).whole;
    let (place, files, chunks) = (
        args.directory.display(),
        whole.len(),
        plan.campaign.chunks(),
    );
    if files as u64 != chunks {
        return Err(Failure::failed(format!(
            "{place}: {files} of {chunks} files of rows are whole, so that there is nothing to merge yet"
        ))
        .help(format!("`ironbird campaign status {place}` says which are not")));
    }
    let to = args.directory.join(MERGED);
    let rows = Rows::new(&args.directory, whole).merge(&plan.campaign, &plan.identity, &to)?;
    print(&format!("{}: {}\n", to.display(), count(rows, "row")))?;
    Ok(OK)
}

/// Prints the results of the rows recorded so far, and writes their page.
pub(super) fn report(args: &CampaignReportArgs) -> Result<u8, Failure> {
    check_writable("--page", args.page.as_deref())?;
    let plan = plan_of(&args.directory)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_that_follow_each_other_are_one_range() {
        assert_eq!(ranges(&[0, 1, 2, 3, 7, 9, 10]), "0-3, 7, 9-10");
    }
}
