//! The executable `ironbird`: one command per job, one role per process.

use std::process::ExitCode;

use clap::Parser as _;
use failure::Failure;
use ironbird::cli::{BridgeTo, Cli, Command};
use ironbird::floor::{command, hop};
use ironbird::output::say;
use ironbird::{
    clean, doctor, export, fly, inject, limits, manual, params, replay, roles, runs, show_report, simulate, watch,
};
use model::role::Role;
use role::rt::CountingAllocator;
use role::signals::forget_inherited;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    let started = forget_inherited().map_err(Failure::from).and_then(|()| limits::heed());
    match started.and_then(|()| run(&Cli::parse())) {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            say(&failure.told());
            ExitCode::from(failure.code)
        }
    }
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
        Command::Report(args) => show_report::show(args),
        Command::Export(args) => export::export(args),
        Command::Replay(args) => replay::replay(args),
        Command::Runs(args) => runs::runs(args),
        Command::Simulate(args) => simulate::simulate(args),
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
