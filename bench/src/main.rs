//! The executable `ironbird`: one command for every job, one role for every process.

use std::process::ExitCode;

use bench::cli::{BridgeTo, Cli, Command};
use bench::failure::Failure;
use bench::floor::{command, hop};
use bench::log::export;
use bench::{bridge, clean, doctor, fly, inject, params, replay, roles, show_report, simulate, watch};
use clap::Parser as _;
use shared::role::Role;
use shared::rt::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    // Refused only where a hook is set already.
    let _ = miette::set_hook(Box::new(|_| Box::new(unwrapped())));
    match run(&Cli::parse()) {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            let code = failure.code;
            eprintln!("{:?}", miette::Report::new(failure));
            ExitCode::from(code)
        }
    }
}

/// A terminal wraps by itself, and in a file a wrapped path is a broken one.
fn unwrapped() -> miette::MietteHandler {
    miette::MietteHandlerOpts::new().wrap_lines(false).build()
}

fn run(cli: &Cli) -> Result<u8, Failure> {
    match &cli.command {
        Command::Fly(args) => fly::fly(args),
        Command::Watch(args) => watch::watch(args),
        Command::Bridge(BridgeTo::Foxglove(args)) => bridge::foxglove(args),
        Command::Inject(args) => inject::inject(args),
        Command::Params(args) => params::params(args),
        Command::Report(args) => show_report::show(args),
        Command::Export(args) => export::export(args),
        Command::Replay(args) => replay::replay(args),
        Command::Simulate(args) => simulate::simulate(args),
        Command::Floor(args) => command::floor(args),
        Command::Doctor(args) => doctor::doctor(args),
        Command::Clean => clean::clean(),
        Command::Plant(args) => roles::play(Role::Plant, args),
        Command::Outer(args) => roles::play(Role::Outer, args),
        Command::Inner(args) => roles::play(Role::Inner, args),
        Command::Mixer(args) => roles::play(Role::Mixer, args),
        Command::Record(args) => roles::record(args),
        Command::RingHop(args) => hop::hop(args),
    }
}
