//! The executable `ironbird`: one command per job, one role per process.

use std::process::ExitCode;

use clap::Parser as _;
use failure::Failure;
use ironbird::cli::{BridgeTo, Cli, Command};
use ironbird::fault::listing;
use ironbird::floor::{command, hop};
use ironbird::output::say;
use ironbird::{
    campaign, clean, compare, doctor, export, fly, inject, laws, limits, manual, margin, new_law, params, replay,
    roles, runs, show_report, simulate, watch,
};
use model::role::Role;
use role::signals::forget_inherited;

role::count_allocations!();
law_library::name_exits!();

fn main() -> ExitCode {
    let started = forget_inherited().map_err(Failure::from).and_then(|()| limits::heed());
    law_library::leave(match started.and_then(|()| run(&Cli::parse())) {
        Ok(code) => code,
        Err(failure) => {
            say(&failure.told());
            failure.code
        }
    })
}

fn run(cli: &Cli) -> Result<u8, Failure> {
    match &cli.command {
        Command::Fly(args) => fly::fly(args),
        Command::Watch(args) => watch::watch(args),
        #[cfg(feature = "foxglove")]
        Command::Bridge(BridgeTo::Foxglove(args)) => ironbird::bridge::foxglove(args),
        #[cfg(not(feature = "foxglove"))]
        Command::Bridge(BridgeTo::Foxglove(_)) => {
            Err(Failure::usage("this build of ironbird has no bridge to Foxglove")
                .help("build one that has: cargo run --release --features foxglove -- bridge foxglove"))
        }
        Command::Inject(args) => inject::inject(args),
        Command::Params(args) => params::params(args),
        Command::Faults => listing::faults(),
        Command::Laws(args) => laws::laws(args),
        Command::New(args) => new_law::new(args),
        Command::Report(args) => show_report::show(args),
        Command::Export(args) => export::export(args),
        Command::Replay(args) => replay::replay(args),
        Command::Runs(args) => runs::runs(args),
        Command::Simulate(args) => simulate::simulate(args),
        Command::Compare(args) => compare::compare(args),
        Command::Margin(args) => margin::margin(args),
        Command::Campaign(command) => campaign::campaign(command),
        Command::Floor(args) => command::floor(args),
        Command::Doctor(args) => doctor::doctor(args),
        Command::Clean(args) => clean::clean(*args),
        Command::Completions(args) => manual::completions(args),
        Command::Man(args) => manual::man(args),
        Command::Plant(args) => roles::play(Role::Plant, args),
        Command::Outer(args) => roles::play(Role::Outer, args),
        Command::Inner(args) => roles::play(Role::Inner, args),
        Command::Mixer(args) => roles::play(Role::Mixer, args),
        Command::Record(args) => roles::record(args),
        Command::RingHop(args) => hop::hop(args),
    }
}
