//! `ironbird new law`: a folder with a law that builds and flies, to be changed into the user's own.

use std::fs;
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use failure::{Failure, OK};
use model::role::Role;

use crate::output::print;
use crate::settings::laws::known;

/// What a law's name is replaced by in the templates.
const NAME: &str = "my_law";

/// Longest name [bytes]: that of the interface.
const NAME_BYTES: usize = 40;

/// Names that a Rust package cannot have, or that would hide what every package uses.
const TAKEN: [&str; 45] = [
    "abstract",
    "alloc",
    "as",
    "async",
    "await",
    "become",
    "box",
    "break",
    "const",
    "continue",
    "core",
    "crate",
    "do",
    "dyn",
    "else",
    "enum",
    "extern",
    "false",
    "fn",
    "for",
    "gen",
    "if",
    "impl",
    "in",
    "ironbird_law",
    "let",
    "loop",
    "macro",
    "match",
    "mod",
    "move",
    "mut",
    "priv",
    "proc_macro",
    "pub",
    "ref",
    "return",
    "self",
    "static",
    "std",
    "struct",
    "super",
    "test",
    "trait",
    "true",
];

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
    #[arg(long, value_name = "DIR", default_value = ".", hide_default_value = true)]
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
            _ => failure.help("choose another name, or --to DIR, the directory to make the folder in"),
        }
    };
    fs::create_dir(&folder).map_err(|e| failed(&folder, &e))?;
    for (name, text, runs) in files {
        let path = folder.join(name);
        let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&path, text));
        let mode = if runs { 0o755 } else { 0o644 };
        written
            .and_then(|()| fs::set_permissions(&path, fs::Permissions::from_mode(mode)))
            .map_err(|e| failed(&path, &e))?;
    }
    let build = if args.lang == Language::Python { "" } else { "    ./build\n" };
    let (role, shown) = (args.role.role(), folder.display());
    print(&format!("{shown}: a law that flies. Next:\n    cd {shown}\n{build}    ironbird simulate --{role} .\n"))?;
    Ok(OK)
}

/// Refuses what cannot be a law's name.
fn check(name: &str) -> Result<(), Failure> {
    let is_snake_case = name.starts_with(|first: char| first.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    if !is_snake_case || name.len() > NAME_BYTES {
        let failure = Failure::usage(format!(
            "`{name}` cannot be a law's name: allowed are up to {NAME_BYTES} of a to z, 0 to 9 and _, with a letter first"
        ));
        return Err(match name.contains('/') {
            true => failure.help("--to DIR names the directory to make the folder in"),
            false => failure,
        });
    }
    if TAKEN.contains(&name) {
        return Err(Failure::usage(format!("`{name}` cannot be a law's name: it is a word of Rust"))
            .help("choose another, as in my_law"));
    }
    let is_built_in =
        [Role::Outer, Role::Inner, Role::Mixer].iter().any(|role| known(*role).iter().any(|law| law.name == name));
    if is_built_in {
        return Err(Failure::usage(format!("a law named `{name}` comes with the rig"))
            .help("choose another name, as in my_law: both can then be flown beside each other"));
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

/// The files of the folder.
fn files(args: &NewLawArgs) -> Result<Vec<File>, Failure> {
    let (build, source) = match args.lang {
        Language::Rust => ("    ./build                        # make law.so of it, with cargo\n", "src/lib.rs"),
        Language::C => (
            "    ./build                        # make law.so of it, with the compiler that CC names, or cc\n",
            "law.c",
        ),
        Language::Python => ("", "law.py"),
    };
    let fill = |text: &str| {
        let text = text.replace("ROLE", &args.role.role().to_string());
        let text = text.replace("BUILD\n", build).replace("FILE", source).replace("SETTINGS\n", args.role.settings());
        text.replace(NAME, &args.name)
    };
    let mut files = vec![
        ("README.md", fill(include_str!("new_law/README.md")), false),
        ("settings.toml", fill(include_str!("new_law/settings.toml")), false),
        ("test", fill(include_str!("new_law/test")), true),
    ];
    let law = |outer, inner, mixer| match args.role {
        LawRole::Outer => outer,
        LawRole::Inner => inner,
        LawRole::Mixer => mixer,
    };
    match args.lang {
        Language::C => {
            let text = law(
                include_str!("new_law/c/outer.c"),
                include_str!("new_law/c/inner.c"),
                include_str!("new_law/c/mixer.c"),
            );
            files.push(("law.c", text.replace(NAME, &args.name), false));
            files.push(("build", include_str!("new_law/c/build").into(), true));
            files.push((".gitignore", "law.so\nruns\n".into(), false));
            files.push((
                "ironbird_law.h",
                include_str!("../../../shared/ironbird_law/include/ironbird_law.h").into(),
                false,
            ));
        }
        Language::Rust => {
            let text = law(
                include_str!("new_law/rust/outer.rs"),
                include_str!("new_law/rust/inner.rs"),
                include_str!("new_law/rust/mixer.rs"),
            );
            files.push(("src/lib.rs", text.replace(NAME, &args.name), false));
            files.push(("Cargo.toml", fill(include_str!("new_law/rust/Cargo.toml.in")), false));
            files.push(("build", fill(include_str!("new_law/rust/build")), true));
            files.push((".gitignore", "law.so\ntarget\nruns\n".into(), false));
            files.push(("ironbird_law/Cargo.toml", include_str!("new_law/rust/ironbird_law.toml").into(), false));
            files.push((
                "ironbird_law/src/lib.rs",
                include_str!("../../../shared/ironbird_law/src/lib.rs").into(),
                false,
            ));
            files.push((
                "ironbird_law/src/abi.rs",
                include_str!("../../../shared/ironbird_law/src/abi.rs").into(),
                false,
            ));
            files.push((
                "ironbird_law/src/border.rs",
                include_str!("../../../shared/ironbird_law/src/border.rs").into(),
                false,
            ));
        }
        Language::Python => {
            let text = match args.role {
                LawRole::Outer => include_str!("new_law/python/outer.py"),
                LawRole::Inner => include_str!("new_law/python/inner.py"),
                LawRole::Mixer => {
                    return Err(Failure::usage("there is no mixer in Python: outer and inner laws can be in Python")
                        .help("--lang c or --lang rust, or --role outer or inner"));
                }
            };
            files.push(("law.py", text.replace(NAME, &args.name), false));
        }
    }
    Ok(files)
}
