//! Flags of the commands for the machine and the shell: `floor`, `doctor`, `clean`, `completions`, `man`.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

use crate::cli::values;

#[derive(Clone, Debug, Args)]
pub struct FloorArgs {
    /// Pairs of measurements; fewer than 6 give no verdict.
    #[arg(long, default_value_t = 6, allow_hyphen_values = true, value_parser = values::within(1..=1000_u32))]
    pub pairs: u32,
    /// Length of each measurement [s]; less than 11 s is too short for a 99.9th percentile at 1 kHz.
    #[arg(long, default_value_t = 11, allow_hyphen_values = true, value_parser = values::within(1..=3600_u64))]
    pub seconds: u64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// Flags of the flights, as in `-- --rate 2k`.
    #[arg(last = true, value_name = "FLAGS")]
    pub flags: Vec<String>,
}

/// Flags of the hidden `ring-hop`.
#[derive(Clone, Debug, Args)]
pub struct HopArgs {
    /// Position in the ring.
    #[arg(long)]
    pub position: usize,
    /// Number of processes in the ring.
    #[arg(long)]
    pub processes: usize,
    #[arg(long)]
    pub cpu: usize,
    /// SCHED_FIFO priority; 0 is SCHED_OTHER.
    #[arg(long)]
    pub priority: i32,
    /// Iterations of arithmetic between being woken and waking the next process.
    #[arg(long)]
    pub work: u64,
}

/// Flags of the hidden `cpu-load`.
#[derive(Clone, Debug, Args)]
pub struct CpuLoadArgs {
    #[arg(long)]
    pub cpu: usize,
    /// SCHED_FIFO priority; 0 is SCHED_OTHER.
    #[arg(long)]
    pub priority: i32,
    /// Share of the time in which it is busy.
    #[arg(long)]
    pub share: f64,
    /// When it begins, on CLOCK_MONOTONIC [ns].
    #[arg(long)]
    pub from_ns: u64,
    /// When it ends [ns].
    #[arg(long)]
    pub until_ns: u64,
    /// Name of the instance that it disturbs, shown in the list of processes.
    #[arg(long)]
    pub instance: String,
}

#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// Measure the timer and the ring for this long each: 0.001 to 3600 s.
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 5.0,
        allow_hyphen_values = true
    )]
    pub seconds: f64,
    /// CPU of the four loops [default: the highest-numbered one].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::processor)]
    pub cpu: Option<u16>,
}

#[derive(Clone, Copy, Debug, Args)]
pub struct CompletionsArgs {
    #[arg(value_enum)]
    pub shell: Shell,
}

#[derive(Clone, Debug, Args)]
pub struct DocsArgs {
    /// Page to print, for example `measuring` [default: the folder, as in: cp -r "$(ironbird docs)/examples" .].
    pub page: Option<String>,
}

#[derive(Clone, Debug, Args)]
pub struct ManArgs {
    /// Command whose page to print, for example `report diff` [default: ironbird itself].
    #[arg(value_name = "COMMAND", conflicts_with = "to")]
    pub command: Vec<String>,
    /// Write the pages of all commands to this directory, for example /usr/local/share/man/man1.
    #[arg(long, value_name = "DIR")]
    pub to: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, Args)]
pub struct CleanArgs {
    /// Print what would be removed, and remove nothing.
    #[arg(long)]
    pub dry_run: bool,
}
