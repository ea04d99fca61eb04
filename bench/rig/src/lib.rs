//! The rig: launches, injects, records, reports; flies the stages in one process or four.

#[cfg(feature = "foxglove")]
pub mod bridge;
pub mod browser;
pub mod build;
pub mod campaign;
pub mod clean;
pub mod cli;
pub mod combinations;
pub mod compare;
pub mod doctor;
pub mod export;
pub mod fault_text;
pub mod floor;
pub mod inject;
pub mod laws;
pub mod manual;
pub mod margin;
pub mod new_law;
pub mod observation;
pub mod parallel;
pub mod params;
pub mod progress;
pub mod report_command;
pub mod resource_limits;
pub mod runs;
pub mod watch;
