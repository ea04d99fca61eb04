//! The executable `ironbird`: one command per job, one role per process.

use std::process::ExitCode;

use errors::output::{print, say};
use errors::{Failure, OK};
use ironbird::cli::{BridgeTo, Cli, Command, commands, fly, roles};
use ironbird::floor;
use ironbird::{
    campaign, clean, compare, doctor, export, fault_text, laws, loss, manual, margin, new_law,
    params, report_command, resource_limits, runs,
};
use messages::role::Role;
use process::signals::{end_with_launcher, forget_inherited};

#[cfg(feature = "instrumented")]
process::count_allocations!();

fn main() -> ExitCode {
    plugin::set_python_environment();
    flight_log::build::set_executable(ironbird::build::here());
    let started = forget_inherited()
        .map_err(Failure::from)
        .and_then(|()| resource_limits::check());
    plugin::leave(match started.and_then(|()| run(&Cli::read()?)) {
        Ok(code) => code,
        Err(failure) => {
            say(&failure.text());
            failure.code
        }
    })
}

fn run(cli: &Cli) -> Result<u8, Failure> {
    end_with_launcher(cli.launcher)?;
    plugin::set_laws_run(match &cli.command {
        Command::Simulate(_) | Command::Replay(_) | Command::Compare(_) => {
            plugin::LawsRun::InOneChild
        }
        Command::Margin(_) | Command::Campaign(_) | Command::Laws(_) => plugin::LawsRun::InOneChild,
        _ => plugin::LawsRun::AskedInChildren,
    });
    match &cli.command {
        Command::Fly(args) => fly::fly(args),
        Command::Watch(args) => args.watch(),
        #[cfg(feature = "foxglove")]
        Command::Bridge(BridgeTo::Foxglove(args)) => live::bridge::foxglove(&args.options()),
        #[cfg(not(feature = "foxglove"))]
        Command::Bridge(BridgeTo::Foxglove(_)) => Err(Failure::usage(
            "this build of ironbird has no bridge to Foxglove",
        )
        .help("build one that has: cargo run --release --features foxglove -- bridge foxglove")),
        Command::Bridge(BridgeTo::Mavlink(args)) => args.serve(),
        Command::Inject(args) => commands::inject(args),
        Command::Switch(args) => commands::inject(&args.clone().into()),
        Command::Params(args) => params::params(args),
        Command::Faults => print(&fault_text::text()).map(|()| OK),
        Command::Laws(args) => laws::laws(args),
        Command::New(args) => new_law::new(args),
        Command::Report(args) => report_command::show(args),
        Command::Export(args) => export::export(args),
        Command::Replay(args) => commands::replay(args),
        Command::Runs(args) => runs::runs(args),
        Command::Simulate(args) => commands::simulate(args),
        Command::Compare(args) => compare::compare(args),
        Command::Margin(args) => margin::margin(args),
        Command::Campaign(command) => campaign::campaign(command),
        Command::Floor(args) => floor::floor(args),
        Command::Doctor(args) => doctor::doctor(args),
        Command::Clean(args) => clean::clean(*args),
        Command::Docs(args) => manual::docs(args),
        Command::Completions(args) => manual::completions(args),
        Command::Man(args) => manual::man(args),
        Command::Plant(args) => roles::play(Role::Plant, args),
        Command::Outer(args) => roles::play(Role::Outer, args),
        Command::Inner(args) => roles::play(Role::Inner, args),
        Command::Mixer(args) => roles::play(Role::Mixer, args),
        Command::Record(args) => roles::record(args),
        Command::RingHop(args) => floor::ring_hop(args),
        Command::CpuLoad(args) => commands::cpu_load(args),
        Command::ExamineLoss { log } => loss::print_section(log),
    }
}
