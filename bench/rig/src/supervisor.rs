//! The supervisor of a flight: `ironbird fly`.
//!
//! It starts the five processes of a flight, restarts those that fail (with `--on-death restart`), injects process
//! faults, ends the processes with the flight, and completes the report. It does not run any loop itself (`roles`) and
//! does not record (`record`). Start reading in `flight_supervisor`, whose `Phase` is the life of a flight.

mod child_process;
pub mod cpu_load;
mod exit_report;
mod fault_injector;
mod flight_supervisor;
pub mod fly_command;
mod hang_detector;
mod recordings;
mod restarts;
mod status_line;
mod stop_requests;
