//! `ironbird completions` and `ironbird man`: what a shell and `man` know of the command line, made from it.

use std::fs;
use std::path::PathBuf;

use clap::{Args, Command, CommandFactory as _};
use clap_complete::Shell;
use clap_mangen::Man;

use crate::cli::Cli;
use crate::output::print;
use failure::{Failure, InFile as _, OK};

/// Name of the executable.
const NAME: &str = "ironbird";

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
    /// Print the page of this command, as in `report diff` [default: of ironbird].
    #[arg(value_name = "COMMAND", conflicts_with = "to")]
    pub command: Vec<String>,
    /// Write the pages of ironbird and of every command into this directory, as for /usr/local/share/man/man1.
    #[arg(long, value_name = "DIR")]
    pub to: Option<PathBuf>,
}

/// Prints the completions of a shell.
///
/// # Errors
/// [`Failure`] where they cannot be printed.
pub fn completions(args: &CompletionsArgs) -> Result<u8, Failure> {
    let shown = Cli::command().get_subcommands().filter(|it| !it.is_hide_set()).cloned().collect::<Vec<_>>();
    let mut script = Vec::new();
    let mut cli = Command::new(NAME).version(env!("CARGO_PKG_VERSION")).subcommands(shown);
    clap_complete::generate(args.shell, &mut cli, NAME, &mut script);
    print(&text(script)?)?;
    Ok(OK)
}

/// Prints a manual page, or writes all of them.
///
/// # Errors
/// Usage, where there is no such command, or the directory cannot be written.
pub fn man(args: &ManArgs) -> Result<u8, Failure> {
    let mut cli = Cli::command();
    // Tells every command its full name.
    cli.build();
    match &args.to {
        Some(directory) => {
            fs::create_dir_all(directory).map_err(|e| {
                Failure::usage(format!("cannot write manual pages into {}: {e}", directory.display()))
                    .help("name a directory that you can write: --to DIR")
            })?;
            for command in all(&cli) {
                let path = directory.join(format!("{}.1", page_name(command)));
                fs::write(&path, page(command)?).in_file("write", &path)?;
            }
        }
        None => print(&page(find(&cli, &args.command)?)?)?,
    }
    Ok(OK)
}

/// A command, its commands, and so on, but for those that are hidden.
fn all(command: &Command) -> Vec<&Command> {
    let shown = command.get_subcommands().filter(|it| !it.is_hide_set() && it.get_name() != "help");
    std::iter::once(command).chain(shown.flat_map(all)).collect()
}

fn find<'a>(cli: &'a Command, words: &[String]) -> Result<&'a Command, Failure> {
    let name = [&[NAME.to_owned()], words].concat().join("-");
    let commands = all(cli);
    commands.iter().find(|command| page_name(command) == name).copied().ok_or_else(|| {
        let known: Vec<String> =
            commands[1..].iter().map(|it| page_name(it)[NAME.len() + 1..].replace('-', " ")).collect();
        Failure::usage(format!("ironbird has no command `{}`", words.join(" ")))
            .help(format!("name one of: {}", known.join(", ")))
    })
}

/// As in `ironbird-report-diff`.
fn page_name(command: &Command) -> String {
    command.get_display_name().unwrap_or(command.get_name()).to_owned()
}

fn page(command: &Command) -> Result<String, Failure> {
    let man = Man::new(command.clone().disable_help_subcommand(true))
        .title(page_name(command))
        .source(concat!("ironbird ", env!("CARGO_PKG_VERSION")));
    let mut page = Vec::new();
    man.render(&mut page).map_err(|e| Failure::failed(format!("cannot make the manual page: {e}")))?;
    text(page)
}

fn text(bytes: Vec<u8>) -> Result<String, Failure> {
    String::from_utf8(bytes).map_err(|e| Failure::failed(format!("the text is broken: {e}")))
}
