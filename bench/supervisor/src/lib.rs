//! The supervisor of a flight.
//!
//! It starts the five processes of a flight, restarts those that fail (with `--on-death restart`), injects process
//! faults, and ends the processes with the flight. It does not run any loop itself, does not record (`recorder`), and
//! prints no report (`ironbird fly`). Start reading in `flight_supervisor`, whose `Phase` is the life of a flight.

pub mod child_process;
pub mod cpu_load;
pub mod dashboard;
pub mod exit_report;
mod fault_injector;
mod flight_supervisor;
mod hang_detector;
mod recordings;
mod restarts;
mod status_line;
pub mod stop_requests;

use std::path::Path;

use analysis::schema::Report;
use errors::Failure;
use ipc::instance::Instance;
use ipc::{Wire, recorder_depth};

use config::Settings;
use exit_report::Outcome;
use flight_supervisor::FlightSupervisor;
use recorder::kernel_trace::remove_leftovers;
use recorder::run_directory::RunDirectory;
use stop_requests::StopRequests;

pub use flight_supervisor::{FlightOptions, ServerProcess};

/// A flight that has a report: the last one that the recorder wrote.
pub struct FinishedFlight {
    pub directory: RunDirectory,
    pub outcome: Outcome,
    pub report: Report,
}

/// Flies until every process has ended. The calling thread must stay until then.
pub fn fly(
    settings: &Settings,
    options: &FlightOptions,
    requests: &mut StopRequests,
) -> Result<FinishedFlight, Failure> {
    let instance = Instance::new(&options.instance)?;
    // If another supervisor flies it already, that is the error.
    if !instance.is_alive() {
        let depth = recorder_depth(settings.wall_period_ns());
        instance.check_shared_memory(Wire::needed_bytes(settings.rt.channels, depth))?;
    }
    instance.prepare()?;
    let lock = instance.lock_launcher()?;
    let ended = supervise(&instance, settings, options, requests);
    drop(lock);
    remove_leftovers(&instance);
    let ((directory, report), outcome) = ended?;
    if let Some(report) = report {
        return Ok(FinishedFlight {
            directory,
            outcome,
            report,
        });
    }
    let failure = outcome.failure(&directory.path);
    if outcome.is_over() {
        // Refused, interrupted or failed: the messages of its processes have been passed on.
        directory.discard();
    }
    if !directory.path.exists() {
        return Err(failure);
    }
    Err(failure.append(&format!(
        "; {} has what was recorded",
        directory.path.display()
    )))
}

fn supervise(
    instance: &Instance,
    settings: &Settings,
    options: &FlightOptions,
    requests: &mut StopRequests,
) -> Result<((RunDirectory, Option<Report>), Outcome), Failure> {
    let out = Path::new(&settings.recorder.out);
    let directory = RunDirectory::create(out, settings, instance.name())?;
    match FlightSupervisor::start(instance, &directory, settings, options) {
        Ok(mut supervisor) => {
            let outcome = supervisor.run(requests)?;
            Ok((supervisor.recordings.settle()?, outcome))
        }
        Err(failure) => {
            directory.discard();
            requests.poll();
            Err(failure.broken_off(requests.is_requested))
        }
    }
}
