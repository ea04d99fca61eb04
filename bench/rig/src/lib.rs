//! The rig: launch, inject, record, report; flights of the four stages in one process or in four.

#[cfg(feature = "foxglove")]
pub mod bridge;
pub mod clean;
pub mod cli;
pub mod dashboard;
pub mod doctor;
pub mod export;
pub mod fault;
pub mod floor;
pub mod fly;
pub mod in_process;
pub mod inject;
pub mod limits;
pub mod observe;
pub mod output;
pub mod params;
pub mod record;
pub mod replay;
pub mod report_diff;
pub mod roles;
pub mod run_directory;
pub mod settings;
pub mod show_report;
pub mod simulate;
pub mod wall_time;
pub mod watch;
