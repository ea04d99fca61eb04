//! `ironbird watch`: shows a flight live, without affecting the control loops.
//!
//! ```text
//! recorder, blackboards --feed--> model --draw--> terminal   (or --plain--> one line per second)
//!                         keys ---^  \--inject--> the plant's parameter server
//! ```

pub mod dashboard_model;
pub(crate) mod feed;
mod screen;
mod terminal;
#[cfg(test)]
mod tests;

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ipc::instance::Instance;
use process::signals::stop_flag;

use crate::observation::DRAIN_EVERY;
use analysis::phrase::count;
use analysis::schema::NOT_FRESH;
use analysis::series::{Series, Statistics};
use dashboard_model::{Model, WatchedFlight};
use errors::output::{has_screen, print, say};
use errors::{Failure, INTERRUPTED, OK};
use feed::Feed;

const PRINT_EVERY: Duration = Duration::from_secs(1);

pub fn watch(instance: &str, is_plain: bool, launcher: Option<u32>) -> Result<u8, Failure> {
    let instance = Instance::new(instance)?;
    let stop = stop_flag()?;
    // https://no-color.org
    let colours = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let mut model = Model::new(instance.name(), launcher.is_some(), colours);
    let mut feed = Feed::new(instance);
    if is_plain || !has_screen(&io::stdout()) || !has_screen(&io::stdin()) {
        return print_lines(&mut model, &mut feed, &stop);
    }
    terminal::run(&mut model, &mut feed, launcher, &stop)
}

/// Prints lines until the flight ends.
fn print_lines(model: &mut Model, feed: &mut Feed, stop: &AtomicBool) -> Result<u8, Failure> {
    feed.update(model)?;
    if !model.launched && model.flight.is_none() {
        let instance = &model.instance;
        say(&format!(
            "waiting for instance `{instance}` to fly (ironbird fly)\n"
        ));
    }
    let mut next = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        feed.update(model)?;
        if let Some(flight) = &model.flight {
            if let Some(ending) = flight.ending {
                print(&format!("{}   {}\n", line(flight), ending.name()))?;
                return Ok(OK);
            }
            if Instant::now() >= next && flight.rotor_speeds.is_some() {
                next = Instant::now() + PRINT_EVERY;
                print(&(line(flight) + "\n"))?;
            }
        }
        sleep(DRAIN_EVERY);
    }
    Ok(INTERRUPTED)
}

/// The state of the flight in one line.
fn line(flight: &WatchedFlight) -> String {
    let (tick, statistics) = (flight.tick(), &flight.statistics);
    let time_s = flight.run.flight_time_s(tick);
    let error_m = statistics.flight().position_error_final_m;
    let mut line = format!("tick {tick}   {time_s:.1} s   error {error_m:.4} m");
    let histogram = statistics.series.flight(Series::Loop);
    if let Some(histogram) = histogram.filter(|histogram| !histogram.is_empty()) {
        let Statistics { p50_us, p99_us, .. } = Statistics::of("loop", histogram);
        line += &format!("   loop p50 {p50_us:.1} p99 {p99_us:.1} us");
    }
    let (_, not_fresh) = flight.verdicts();
    line += &format!("   {} {NOT_FRESH}", not_fresh.ticks);
    if let Some(monitor) = &flight.monitor {
        let (v, unexplained) = (monitor.v, monitor.violations[0]);
        let violations: u64 = monitor.violations.iter().sum();
        line += &format!(
            "   V {v:.3e} rad^2/s^2   violations {violations} ({unexplained} unexplained)"
        );
    }
    if let Some(tick) = flight.lost_at() {
        line += &format!("   no recorder: as of tick {tick}, not watched since");
    }
    match flight.lost() {
        0 => line,
        lost => format!("{line}   not seen {}", count(lost, "message")),
    }
}
