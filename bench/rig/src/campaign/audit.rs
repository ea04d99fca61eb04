//! `ironbird campaign report --audit`: flies a share of the flights again, and holds them against their rows.

use std::path::Path;

use campaign::findings::{Audit, Difference};
use campaign::rows;
use failure::Failure;

use super::flown;
use super::plan::Plan;
use crate::parallel::asked_to_stop;
use crate::progress::Progress;

/// Differences that are told at the most.
const TOLD: usize = 10;

/// Flies a share of the flights of whole chunks again, at least one, each by all arms.
///
/// # Errors
/// An interruption; a file that cannot be read.
pub(super) fn audit(plan: &Plan, out: &Path, whole: &[u64], share: f64, jobs: usize) -> Result<Audit, Failure> {
    let (campaign, stop) = (&plan.campaign, asked_to_stop()?);
    let arms = campaign.arms.len();
    let mut drawn: Vec<u64> = whole.iter().flat_map(|chunk| campaign.audited(*chunk, share)).collect();
    if drawn.is_empty() {
        drawn.extend(whole.first().map(|chunk| campaign.flights_of(*chunk).start));
    }
    let mut progress = Progress::new((drawn.len() * arms) as u64, "flight");
    let mut audit = Audit { share, flights: drawn.len() as u64, rows: 0, differ: 0, differences: Vec::new() };
    for flights in drawn.chunk_by(|one, next| one / campaign.chunk == next / campaign.chunk) {
        let chunk = flights[0] / campaign.chunk;
        let rows: Vec<flown::Flight> =
            flights.iter().flat_map(|flight| (0..arms).map(move |arm| (*flight, arm))).collect();
        let again = flown::rows(plan, &rows, jobs, &stop, |done| progress.look(audit.rows + done))?;
        let places = rows.iter().map(|(flight, arm)| (flight % campaign.chunk) as usize * arms + arm);
        let kept = rows::cells_of(out, chunk, &places.collect::<Vec<_>>())?;
        audit.rows += rows.len() as u64;
        for ((row, kept), again) in again.iter().zip(kept).zip(rows::cells_again(campaign, &again)?) {
            let differs = kept.into_iter().zip(again).find(|((_, kept), (_, again))| kept != again);
            let Some(((column, kept), (_, again))) = differs else { continue };
            audit.differ += 1;
            if audit.differences.len() < TOLD {
                let arm = campaign.arms[row.arm].name.clone();
                audit.differences.push(Difference { flight: row.flight, arm, column, kept, again });
            }
        }
    }
    progress.clear();
    Ok(audit)
}
