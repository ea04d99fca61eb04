//! `ironbird completions` and `ironbird man`: generated from the command line's definition.

use std::fs;
use std::path::{Component, Path};

use clap::{Command, CommandFactory as _};
use clap_mangen::Man;

use crate::cli::{Cli, CompletionsArgs, DocsArgs, ManArgs};
use crate::export::create_for;
use analysis::phrase::list;
use config::law_settings::meant_or_known;
use errors::output::print;
use errors::{Failure, InFile as _, OK, read_text};

const NAME: &str = "ironbird";

/// Prints a page, or where they are: in a package beside the executable, or in the source tree that it was built in.
pub fn docs(args: &DocsArgs) -> Result<u8, Failure> {
    let executable = std::env::current_exe().unwrap_or_default();
    let places = ["../share/doc/ironbird", "../.."].iter();
    let mut folders =
        places.filter_map(|place| executable.parent()?.join(place).canonicalize().ok());
    let found = folders.find(|folder| folder.join("docs/architecture.md").is_file());
    let folder = found.ok_or_else(|| {
        Failure::failed(format!("no documentation beside {}", executable.display())).help(
            "it is in share/doc/ironbird of each package, and in the folder docs of the source tree",
        )
    })?;
    let Some(page) = &args.page else {
        print(&format!("{}\n", folder.display()))?;
        return Ok(OK);
    };
    print(&page_of(&folder.join("docs"), page)?)?;
    Ok(OK)
}

/// The text of a page in the folder of the pages.
pub fn page_of(pages: &Path, name: &str) -> Result<String, Failure> {
    let name = name.strip_suffix(".md").unwrap_or(name);
    let path = match name {
        "README" => pages.with_file_name("README.md"),
        _ => pages.join(format!("{name}.md")),
    };
    let is_below = |part| matches!(part, Component::Normal(_));
    if Path::new(name).components().all(is_below) && path.is_file() {
        return read_text("read the page", &path);
    }
    let files = fs::read_dir(pages).in_file("read", pages)?.flatten();
    let names = files.filter_map(|it| it.file_name().into_string().ok());
    let mut names: Vec<String> = names
        .filter_map(|name| name.strip_suffix(".md").map(str::to_owned))
        .collect();
    names.sort();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let known = meant_or_known(name, &names);
    let what = format!("no page is named `{name}`{known}");
    Err(Failure::usage(what).help("`ironbird docs` prints the folder with all pages"))
}

pub fn completions(args: &CompletionsArgs) -> Result<u8, Failure> {
    let cli = Cli::command();
    let visible = cli.get_subcommands().filter(|it| !it.is_hide_set());
    let mut cli = Command::new(NAME)
        .version(env!("CARGO_PKG_VERSION"))
        .subcommands(visible.cloned());
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut cli, NAME, &mut script);
    print(&text(script)?)?;
    Ok(OK)
}

/// Prints one manual page, or writes all of them to a directory.
pub fn man(args: &ManArgs) -> Result<u8, Failure> {
    let mut cli = Cli::command();
    // Gives every command its full name.
    cli.build();
    let Some(directory) = &args.to else {
        print(&page(find(&cli, &args.command)?)?)?;
        return Ok(OK);
    };
    create_for("write manual pages", directory, "--to")?;
    for command in all(&cli) {
        let path = directory.join(format!("{}.1", page_name(command)));
        fs::write(&path, page(command)?).in_file("write", &path)?;
    }
    Ok(OK)
}

/// A command and all its subcommands, except hidden ones.
pub fn all(command: &Command) -> Vec<&Command> {
    let is_visible = |it: &&Command| !it.is_hide_set() && it.get_name() != "help";
    let visible = command.get_subcommands().filter(is_visible);
    std::iter::once(command)
        .chain(visible.flat_map(all))
        .collect()
}

fn find<'a>(cli: &'a Command, words: &[String]) -> Result<&'a Command, Failure> {
    let name = [&[NAME.to_owned()], words].concat().join("-");
    let commands = all(cli);
    let named = commands.iter().find(|command| page_name(command) == name);
    named.copied().ok_or_else(|| {
        let short = |it: &&Command| page_name(it)[NAME.len() + 1..].replace('-', " ");
        let known = list(commands[1..].iter().map(short));
        Failure::usage(format!("ironbird has no command `{}`", words.join(" ")))
            .help(format!("name one of: {known}"))
    })
}

/// The command's full name, with `-` between its words.
pub fn page_name(command: &Command) -> &str {
    command.get_display_name().unwrap_or(command.get_name())
}

fn page(command: &Command) -> Result<String, Failure> {
    let man = Man::new(command.clone().disable_help_subcommand(true))
        .title(page_name(command))
        .source(concat!("ironbird ", env!("CARGO_PKG_VERSION")));
    let mut page = Vec::new();
    man.render(&mut page)
        .map_err(|e| Failure::failed(format!("cannot make the manual page: {e}")))?;
    text(page)
}

fn text(bytes: Vec<u8>) -> Result<String, Failure> {
    String::from_utf8(bytes)
        .map_err(|e| Failure::failed(format!("the generated text is not UTF-8: {e}")))
}
