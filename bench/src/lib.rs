//! The rig: launch, inject, record, report; flights of the four stages in one process or in four.

pub mod clean;
pub mod cli;
pub mod failure;
pub mod fault;
pub mod fly;
pub mod in_process;
pub mod inject;
pub mod output;
pub mod params;
pub mod plot;
pub mod record;
pub mod roles;
pub mod run_directory;
pub mod settings;
pub mod show_report;
pub mod simulate;
