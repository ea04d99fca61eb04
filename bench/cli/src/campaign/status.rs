//! `ironbird campaign status`, `merge` and `report`: which rows are there; all in one file; what they show.

use analysis::phrase::{count, list};
use std::path::Path;

use campaign::aggregate;
use campaign::chunk::{self, Rows, State};
use campaign::results_document::document;
use errors::{Failure, GATE, OK, check_outputs};

use crate::cli::{CampaignDirectoryArgs, CampaignReportArgs};
use crate::report_command::{exit_code, publish};
use errors::output::{print, say};
use experiments::campaign::flight_settings::{Plan, plan_of};
use render::document::Block;

const MERGED: &str = "merged.parquet";
/// The remedy for a file that cannot be read or written.
const FILES: &str = "`ironbird campaign status DIR` says which files of rows are whole; what is written needs room, and a directory \
                     that you can write";

/// The chunks that are whole, and the state of each other one.
pub(super) fn chunks(plan: &Plan, directory: &Path) -> (Vec<u64>, Vec<(u64, State)>) {
    let state = |chunk| chunk::state(directory, &plan.campaign, &plan.identity, chunk);
    let all = (0..plan.campaign.chunks()).map(|chunk| (chunk, state(chunk)));
    let (whole, others): (Vec<_>, _) = all.partition(|(_, state)| *state == State::Whole);
    let whole = whole.into_iter().map(|(chunk, _)| chunk);
    (whole.collect(), others)
}

pub(super) fn status(args: &CampaignDirectoryArgs) -> Result<u8, Failure> {
    let plan = plan_of(&args.directory)?;
    let (whole, others) = chunks(&plan, &args.directory);
    let (campaign, place) = (&plan.campaign, args.directory.display());
    let flown = whole.iter().map(|chunk| campaign.flights_of(*chunk));
    let mut text = format!(
        "{}: {} of {}, each by {}; {} of {} complete\n",
        campaign.name,
        flown.map(Iterator::count).sum::<usize>(),
        count(campaign.flights, "flight"),
        count(campaign.arms.len() as u64, "arm"),
        whole.len(),
        count(campaign.chunks(), "file")
    );
    let missing = others.iter().filter(|(_, state)| *state == State::Missing);
    let missing: Vec<u64> = missing.map(|(chunk, _)| *chunk).collect();
    if !missing.is_empty() {
        text += &format!("missing: chunks {}\n", ranges(&missing));
    }
    for (chunk, state) in &others {
        if let State::Refused(why) = state {
            let path = chunk::path_of(&args.directory, *chunk);
            text += &format!("{}: {why}\n", path.display());
        }
    }
    for other in chunk::others(&args.directory, campaign)? {
        let path = args.directory.join(other);
        text += &format!("{}: none of this campaign's\n", path.display());
    }
    if !others.is_empty() {
        let file = plan.file.display();
        text += &format!("`ironbird campaign run {file} --out {place}` flies what is missing\n");
    }
    print(&text)?;
    Ok(if others.is_empty() { OK } else { GATE })
}

/// Numbers, those that follow each other as one: `0-3, 7`.
pub(super) fn ranges(chunks: &[u64]) -> String {
    let ranges = chunks
        .chunk_by(|a, b| a + 1 == *b)
        .map(|range| match range {
            [first, .., last] => format!("{first}-{last}"),
            _ => range[0].to_string(),
        });
    list(ranges)
}

/// A campaign and its chunks that are whole; and how many that is, if some are not.
fn whole_chunks(directory: &Path) -> Result<(Plan, Vec<u64>, Option<String>), Failure> {
    let plan = plan_of(directory)?;
    let (whole, others) = chunks(&plan, directory);
    let (files, all) = (whole.len(), plan.campaign.chunks());
    let part = format!("{files} of {} complete", count(all, "row file"));
    Ok((plan, whole, Some(part).filter(|_| !others.is_empty())))
}

pub(super) fn merge(args: &CampaignDirectoryArgs) -> Result<u8, Failure> {
    let (plan, whole, part) = whole_chunks(&args.directory)?;
    if let Some(part) = part {
        let place = args.directory.display();
        let what = format!("{place}: {part}, so that there is nothing to merge yet");
        return Err(Failure::failed(what).help(format!(
            "`ironbird campaign status {place}` says which are not"
        )));
    }
    let to = args.directory.join(MERGED);
    let rows = Rows::new(&args.directory, whole);
    let rows = rows.merge(&plan.campaign, &plan.identity, &to);
    let rows = rows.map_err(|failure| failure.or_help(FILES))?;
    print(&format!("{}: {}\n", to.display(), count(rows, "row")))?;
    Ok(OK)
}

/// Prints the results of the rows recorded so far, and writes their page.
pub(super) fn report(args: &CampaignReportArgs) -> Result<u8, Failure> {
    let (plan, whole, part) = whole_chunks(&args.directory)?;
    check_outputs(&[("--page", args.page.as_deref())])?;
    let place = args.directory.display();
    if whole.is_empty() {
        return Err(Failure::failed(format!("{place}: no flight is there yet"))
            .help(format!("`ironbird campaign status {place}` says why")));
    }
    if let Some(part) = part {
        say(&format!("warning: {part}; the others are left out\n"));
    }
    let rows = Rows::new(&args.directory, whole);
    let results = aggregate::of(&plan.campaign, &plan.identity, &rows);
    let results = results.map_err(|failure| failure.or_help(FILES))?;
    let mut document = document(&results, &place.to_string());
    let lines = plan.text.lines().map(str::trim_end);
    let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
    let lines = Block::Items(lines.map(str::to_owned).collect());
    let title = "The campaign's file: what is drawn, and what counts as success";
    document
        .lead
        .push(Block::Details(title.into(), vec![lines]));
    publish(&document, &results, args.format, args.page.as_deref())?;
    let gates = args.min_success.into_iter().flat_map(|least| {
        let arms = results.arms.iter();
        arms.map(move |arm| arm.success_gate(least, results.planned))
    });
    Ok(exit_code(gates))
}
