//! The commands of the executable `ironbird`: flags ([`cli`]), and what each command prints.
//!
//! It owns the command line. What a command does is in the crates below: settings in `config`, flights in `supervisor`,
//! `recorder` and `sim`, studies in `experiments`, running flights in `live`. Start reading in [`cli::Command`].

pub mod browser;
pub mod build;
pub mod campaign;
pub mod clean;
pub mod cli;
pub mod compare;
pub mod doctor;
pub mod export;
pub mod fault_text;
pub mod floor;
pub mod laws;
pub mod loss;
pub mod manual;
pub mod margin;
pub mod new_law;
pub mod params;
pub mod report_command;
pub mod resource_limits;
pub mod runs;
pub mod table_file;
