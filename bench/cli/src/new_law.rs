//! `ironbird new law`: creates a folder with a law that builds and flies, for the user to change.

use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use errors::{Failure, OK};
use messages::role::Role;

use config::law_settings::known;
use errors::output::print;

/// Longest name [bytes]: that of the interface.
const NAME_BYTES: usize = 40;

/// Names that a Rust package cannot have, or that would hide what every package uses.
const RESERVED: &str = "\
    abstract alloc as async await become box break const continue core crate do dyn else \
    enum extern false fn for gen if impl in ironbird_law let loop macro match mod move mut \
    priv proc_macro pub ref return self static std struct super test trait true";

/// Files of the folder: the tag of the laws that have it, its path, and its template. Files that start with `#!` are
/// executable.
const FILES: [(&str, &str, &str); 19] = [
    ("all", "README.md", include_str!("new_law/README.md")),
    (
        "all",
        "settings.toml",
        include_str!("new_law/settings.toml"),
    ),
    ("all", "test", include_str!("new_law/test")),
    ("c", "law.c", include_str!("new_law/law.c.in")),
    ("c", "build", include_str!("new_law/build_c")),
    ("c", ".gitignore", "law.so\nruns\n"),
    ("c", "ironbird_law.h", HEADERS[0]),
    ("c", "ironbird_attitude.h", HEADERS[1]),
    ("rust", "src/lib.rs", include_str!("new_law/law.rs.in")),
    ("rust", "Cargo.toml", include_str!("new_law/Cargo.toml.in")),
    ("rust", "build", include_str!("new_law/build_rust")),
    ("rust", ".gitignore", "law.so\ntarget\nruns\n"),
    (
        "rust",
        "ironbird_law/Cargo.toml",
        include_str!("new_law/ironbird_law.toml"),
    ),
    ("rust", "ironbird_law/src/lib.rs", CRATE[0]),
    ("rust", "ironbird_law/src/abi.rs", CRATE[1]),
    ("rust", "ironbird_law/src/border.rs", CRATE[2]),
    ("rust", "ironbird_law/src/law.rs", CRATE[3]),
    ("python", "law.py", include_str!("new_law/law.py.in")),
    ("python", ".gitignore", "__pycache__\nruns\n"),
];

/// The interface in C with the attitude loop, and the crate `ironbird_law`.
const HEADERS: [&str; 2] = [
    include_str!("../../../shared/ironbird_law/include/ironbird_law.h"),
    include_str!("../../../shared/ironbird_law/include/ironbird_attitude.h"),
];
const CRATE: [&str; 4] = [
    include_str!("../../../shared/ironbird_law/src/lib.rs"),
    include_str!("../../../shared/ironbird_law/src/abi.rs"),
    include_str!("../../../shared/ironbird_law/src/border.rs"),
    include_str!("../../../shared/ironbird_law/src/law.rs"),
];

#[derive(Clone, Debug, Subcommand)]
pub enum NewCommand {
    /// A law of your own: a folder that builds, flies and has a test.
    Law(NewLawArgs),
}

#[derive(Clone, Debug, Args)]
pub struct NewLawArgs {
    /// Name of the law, in snake_case.
    #[arg(value_name = "NAME")]
    pub name: String,
    /// Its role in the loop.
    #[arg(long, value_enum)]
    pub role: LawRole,
    /// The language that it is written in.
    #[arg(long, value_enum)]
    pub lang: Language,
    /// Directory in which the folder is made [default: this one].
    #[arg(
        long,
        value_name = "DIR",
        default_value = ".",
        hide_default_value = true
    )]
    pub to: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LawRole {
    /// Position: desired thrust and attitude.
    Outer,
    /// Attitude and rates: thrust and torque.
    Inner,
    /// Rotor speeds.
    Mixer,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Language {
    /// A crate without dependencies.
    Rust,
    /// C11, one file.
    C,
    /// One file; not real-time.
    Python,
}

/// Creates the folder.
pub fn new(NewCommand::Law(args): &NewCommand) -> Result<u8, Failure> {
    check(&args.name)?;
    let (role, folder) = (args.role.role(), args.to.join(&args.name));
    let failed = |path: &Path, e: &io::Error| {
        let failure = Failure::usage(format!("{} cannot be made: {e}", path.display()));
        failure.help(match e.kind() {
            io::ErrorKind::NotFound => "make the directory that --to names first",
            io::ErrorKind::StorageFull => "free space, or choose another disk: --to DIR",
            _ => "choose another name, or --to DIR, the directory to make the folder in",
        })
    };
    let files = files(args)?;
    fs::create_dir(&folder).map_err(|e| failed(&folder, &e))?;
    for (name, text) in files {
        let path = folder.join(name);
        let directory = path.parent().unwrap_or(&folder);
        let mode = if text.starts_with("#!") { 0o755 } else { 0o644 };
        fs::create_dir_all(directory)
            .and_then(|()| fs::write(&path, text))
            .and_then(|()| fs::set_permissions(&path, Permissions::from_mode(mode)))
            .map_err(|e| {
                let _ = fs::remove_dir_all(&folder);
                failed(&path, &e)
            })?;
    }
    let build = match args.lang {
        Language::Python if plugin::has_python_adapter() => "",
        Language::Python => {
            "    python/build    # once, in ironbird's sources: the adapter for laws in Python is not built here\n"
        }
        Language::Rust | Language::C => "    ./build\n",
    };
    let folder = folder.display();
    print(&format!(
        "{folder}: a new law. Next:\n    cd {folder}\n{build}    ironbird simulate --{role} .\n"
    ))?;
    Ok(OK)
}

fn check(name: &str) -> Result<(), Failure> {
    let is_allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let starts_with_letter = name.starts_with(|first: char| first.is_ascii_lowercase());
    if !starts_with_letter || !name.chars().all(is_allowed) || name.len() > NAME_BYTES {
        let failure = Failure::usage(format!(
            "`{name}` cannot be a law's name: allowed are up to {NAME_BYTES} of a to z, 0 to 9 and _, with a letter first"
        ));
        return Err(match name.contains('/') {
            true => failure.help("--to DIR names the directory to make the folder in"),
            false => failure,
        });
    }
    if RESERVED.split(' ').any(|word| word == name) {
        let what = format!("`{name}` cannot be a law's name: it is a word of Rust");
        return Err(Failure::usage(what).help("choose another, as in my_law"));
    }
    let mut built_in = [Role::Outer, Role::Inner, Role::Mixer]
        .into_iter()
        .flat_map(known);
    if built_in.any(|law| law.name == name) {
        let what = format!("a law named `{name}` comes with the rig");
        return Err(
            Failure::usage(what).help("choose another name, as in my_law: both can then be flown")
        );
    }
    Ok(())
}

impl LawRole {
    const fn role(self) -> Role {
        match self {
            Self::Outer => Role::Outer,
            Self::Inner => Role::Inner,
            Self::Mixer => Role::Mixer,
        }
    }
}

fn files(args: &NewLawArgs) -> Result<Vec<(&'static str, String)>, Failure> {
    let role = args.role.role().name();
    let (language, source) = match args.lang {
        Language::Rust => ("rust", "src/lib.rs"),
        Language::C => ("c", "law.c"),
        Language::Python if args.role == LawRole::Mixer => {
            let what = "there is no mixer in Python: outer and inner laws can be in Python";
            let help = "--lang c or --lang rust, or --role outer or inner";
            return Err(Failure::usage(what).help(help));
        }
        Language::Python => ("python", "law.py"),
    };
    let tags = [role, language, "all"];
    let fill = |(_, path, template): &(&str, &'static str, &str)| {
        // The interface and its headers are copied as they are.
        if path.starts_with("ironbird_") {
            return (*path, (*template).to_owned());
        }
        let text = selected(template, &tags);
        let text = text.replace("ROLE", role).replace("FILE", source);
        (*path, text.replace("my_law", &args.name))
    };
    let files = FILES.iter().filter(|(tag, ..)| tags.contains(tag));
    Ok(files.map(fill).collect())
}

/// The lines of a template that have one of some tags: those after a line `@outer`, `@inner mixer`, `@rust` or `@all` have
/// its tags.
fn selected(template: &str, tags: &[&str]) -> String {
    let mut is_selected = true;
    let mut text = String::new();
    for line in template.lines() {
        if let Some(line_tags) = line.strip_prefix('@') {
            is_selected = line_tags.split(' ').any(|tag| tags.contains(&tag));
        } else if is_selected {
            text += line;
            text.push('\n');
        }
    }
    text
}
