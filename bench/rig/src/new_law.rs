//! `ironbird new law`: a folder with a law that builds and flies, to be changed into the user's own.

use std::fs;
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use errors::{Failure, OK};
use messages::role::Role;

use crate::output::print;
use crate::settings::law_settings::known;

/// What a law's name is replaced by in the templates.
const NAME: &str = "my_law";

/// Longest name [bytes]: that of the interface.
const NAME_BYTES: usize = 40;

/// Names that a Rust package cannot have, or that would hide what every package uses.
const RESERVED: &str = "\
    abstract alloc as async await become box break const continue core crate do dyn else \
    enum extern false fn for gen if impl in ironbird_law let loop macro match mod move mut \
    priv proc_macro pub ref return self static std struct super test trait true";

/// What to begin.
#[derive(Clone, Debug, Subcommand)]
pub enum NewCommand {
    /// A law of your own: a folder that builds, flies and has a test.
    Law(NewLawArgs),
}

/// Flags of `new law`.
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

/// Role of a law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LawRole {
    /// Position: thrust and attitude wanted.
    Outer,
    /// Attitude and rates: thrust and torque.
    Inner,
    /// Rotor speeds.
    Mixer,
}

/// Language of a law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Language {
    /// A crate without dependencies.
    Rust,
    /// C11, one file.
    C,
    /// One file; not real-time.
    Python,
}

/// A file of the folder: its path, its text, whether it can be run.
type File = (&'static str, String, bool);

/// Makes the folder.
///
/// # Errors
/// Usage: the name cannot be one, or there is no law of the role in the language. Input: the folder exists already, or
/// cannot be written.
pub fn new(command: &NewCommand) -> Result<u8, Failure> {
    let NewCommand::Law(args) = command;
    check(&args.name)?;
    let files = files(args)?;
    let folder = args.to.join(&args.name);
    let failed = |path: &Path, e: &io::Error| {
        let failure = Failure::usage(format!("{} cannot be made: {e}", path.display()));
        match e.kind() {
            io::ErrorKind::NotFound => failure.help("make the directory that --to names first"),
            _ => failure
                .help("choose another name, or --to DIR, the directory to make the folder in"),
        }
    };
    fs::create_dir(&folder).map_err(|e| failed(&folder, &e))?;
    for (name, text, runs) in files {
        let path = folder.join(name);
        let written = path
            .parent()
            .map_or(Ok(()), fs::create_dir_all)
            .and_then(|()| fs::write(&path, text));
        let mode = if runs { 0o755 } else { 0o644 };
        written
            .and_then(|()| fs::set_permissions(&path, fs::Permissions::from_mode(mode)))
            .map_err(|e| failed(&path, &e))?;
    }
    let build = match args.lang {
        Language::Python if plugin::has_python_adapter() => "",
        Language::Python => {
            "    python/build    # once, in ironbird's sources: the adapter for laws in Python is not built here\n"
        }
        Language::Rust | Language::C => "    ./build\n",
    };
    let (role, shown) = (args.role.role(), folder.display());
    print(&format!(
        "{shown}: a new law. Next:\n    cd {shown}\n{build}    ironbird simulate --{role} .\n"
    ))?;
    Ok(OK)
}

/// Refuses what cannot be a law's name.
fn check(name: &str) -> Result<(), Failure> {
    let is_snake_case = name.starts_with(|first: char| first.is_ascii_lowercase())
        && name
            .chars()
            .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    if !is_snake_case || name.len() > NAME_BYTES {
        let failure = Failure::usage(format!(
            "`{name}` cannot be a law's name: allowed are up to {NAME_BYTES} of a to z, 0 to 9 and _, with a letter first"
        ));
        return Err(match name.contains('/') {
            true => failure.help("--to DIR names the directory to make the folder in"),
            false => failure,
        });
    }
    if RESERVED.split(' ').any(|word| word == name) {
        return Err(Failure::usage(format!(
            "`{name}` cannot be a law's name: it is a word of Rust"
        ))
        .help("choose another, as in my_law"));
    }
    let is_built_in = [Role::Outer, Role::Inner, Role::Mixer]
        .iter()
        .any(|role| known(*role).iter().any(|law| law.name == name));
    if is_built_in {
        return Err(
            Failure::usage(format!("a law named `{name}` comes with the rig")).help(
                "choose another name, as in my_law: both can then be flown beside each other",
            ),
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

    /// The settings of the templates of the role, as lines of the settings file.
    const fn settings(self) -> &'static str {
        match self {
            Self::Outer => {
                "position_1_s2 = 6.0 # acceleration per error of position [1/s^2]\n\
                 velocity_1_s = 4.0 # acceleration per error of velocity [1/s]\n"
            }
            Self::Inner => {
                "attitude_1_s = 12.0 # rate per error of attitude [1/s]\n\
                 rate_1_s = 60.0 # acceleration per error of rate [1/s]\n"
            }
            Self::Mixer => "",
        }
    }
}

fn files(args: &NewLawArgs) -> Result<Vec<File>, Failure> {
    let (build, source) = match args.lang {
        Language::Rust => (
            "    ./build                        # make law.so of it, with cargo\n",
            "src/lib.rs",
        ),
        Language::C => (
            "    ./build                        # make law.so of it, with the compiler that CC names, or cc\n",
            "law.c",
        ),
        Language::Python => ("", "law.py"),
    };
    let fill = |text: &str| {
        let text = text.replace("ROLE", &args.role.role().to_string());
        let text = text
            .replace("BUILD\n", build)
            .replace("FILE", source)
            .replace("SETTINGS\n", args.role.settings());
        text.replace(NAME, &args.name)
    };
    let mut files = vec![
        ("README.md", fill(include_str!("new_law/README.md")), false),
        (
            "settings.toml",
            fill(include_str!("new_law/settings.toml")),
            false,
        ),
        ("test", fill(include_str!("new_law/test")), true),
    ];
    let law =
        |template: &str| for_role(template, args.role.role().name()).replace(NAME, &args.name);
    let shared = |name, text: &str| (name, text.to_owned(), false);
    match args.lang {
        Language::C => files.extend([
            ("law.c", law(include_str!("new_law/law.c.in")), false),
            ("build", include_str!("new_law/build_c").into(), true),
            (".gitignore", "law.so\nruns\n".into(), false),
            shared(
                "ironbird_law.h",
                include_str!("../../../shared/ironbird_law/include/ironbird_law.h"),
            ),
        ]),
        Language::Rust => files.extend([
            ("src/lib.rs", law(include_str!("new_law/law.rs.in")), false),
            (
                "Cargo.toml",
                fill(include_str!("new_law/Cargo.toml.in")),
                false,
            ),
            ("build", fill(include_str!("new_law/build_rust")), true),
            (".gitignore", "law.so\ntarget\nruns\n".into(), false),
            shared(
                "ironbird_law/Cargo.toml",
                include_str!("new_law/ironbird_law.toml"),
            ),
            shared(
                "ironbird_law/src/lib.rs",
                include_str!("../../../shared/ironbird_law/src/lib.rs"),
            ),
            shared(
                "ironbird_law/src/abi.rs",
                include_str!("../../../shared/ironbird_law/src/abi.rs"),
            ),
            shared(
                "ironbird_law/src/border.rs",
                include_str!("../../../shared/ironbird_law/src/border.rs"),
            ),
        ]),
        Language::Python if args.role == LawRole::Mixer => {
            return Err(Failure::usage(
                "there is no mixer in Python: outer and inner laws can be in Python",
            )
            .help("--lang c or --lang rust, or --role outer or inner"));
        }
        Language::Python => files.extend([
            ("law.py", law(include_str!("new_law/law.py.in")), false),
            (".gitignore", "__pycache__\nruns\n".into(), false),
        ]),
    }
    Ok(files)
}

/// A template for a role. Lines behind `@outer`, `@inner mixer` and the like are for these roles, those behind `@all` for
/// every one.
fn for_role(template: &str, role: &str) -> String {
    let mut is_meant = true;
    let mut text = String::new();
    for line in template.lines() {
        match line.strip_prefix('@') {
            Some(roles) => is_meant = roles.split(' ').any(|it| it == role || it == "all"),
            None if is_meant => {
                text.push_str(line);
                text.push('\n');
            }
            None => {}
        }
    }
    text
}
