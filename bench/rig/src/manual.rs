//! `ironbird completions` and `ironbird man`: what a shell and `man` know of the command line, made from it.

use std::io;
use std::path::PathBuf;

use clap::{Args, Command, CommandFactory as _};
use clap_complete::Shell;
use clap_mangen::Man;

use crate::cli::Cli;
use crate::output::print;
use failure::{Failure, OK};

/// Flags of `completions`.
#[derive(Clone, Copy, Debug, Args)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Flags of `man`.
#[derive(Clone, Debug, Args)]
pub struct ManArgs {
    /// Print the page of this command [default: of ironbird].
    #[arg(value_name = "COMMAND", conflicts_with = "to")]
    pub command: Option<String>,
    /// Write the pages of ironbird and of every command into this directory, as for /usr/local/share/man/man1.
    #[arg(long, value_name = "DIR")]
    pub to: Option<PathBuf>,
}

/// Prints the completions of a shell.
///
/// # Errors
/// [`Failure`] where they cannot be printed.
pub fn completions(args: &CompletionsArgs) -> Result<u8, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "ironbird", &mut script);
    print(&text(script)?)?;
    Ok(OK)
}

/// Prints a manual page, or writes all of them.
///
/// # Errors
/// Usage, where there is no such command, or the directory cannot be written.
pub fn man(args: &ManArgs) -> Result<u8, Failure> {
    if let Some(directory) = &args.to {
        clap_mangen::generate_to(Cli::command(), directory).map_err(|e| {
            Failure::usage(format!("cannot write manual pages into {}: {e}", directory.display()))
                .help("name a directory that is there and that you can write: --to DIR")
        })?;
        return Ok(OK);
    }
    let page = match &args.command {
        None => Cli::command(),
        Some(name) => command(name)?,
    };
    let mut out = Vec::new();
    Man::new(page).render(&mut out).map_err(|e: io::Error| Failure::failed(format!("cannot make the page: {e}")))?;
    print(&text(out)?)?;
    Ok(OK)
}

/// A command, which knows that it is one of ironbird's.
fn command(name: &str) -> Result<Command, Failure> {
    let mut cli = Cli::command();
    cli.build();
    let known: Vec<&str> = cli.get_subcommands().filter(|it| !it.is_hide_set()).map(Command::get_name).collect();
    if !known.contains(&name) {
        return Err(Failure::usage(format!("ironbird has no command `{name}`"))
            .help(format!("name one of {}", known.join(", "))));
    }
    Ok(cli.find_subcommand(name).cloned().unwrap_or_default().disable_help_subcommand(true))
}

fn text(bytes: Vec<u8>) -> Result<String, Failure> {
    String::from_utf8(bytes).map_err(|e| Failure::failed(format!("the text is broken: {e}")))
}
