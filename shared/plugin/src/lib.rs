//! Laws of shared libraries: opened, checked, described, flown.
//!
//! ```text
//!   file --object--> is it a library that this machine can load?      nothing of it has run yet
//!        --loader--> loaded; its table, by `ironbird_law` or through the adapter of its language
//!        --table---> version, sizes, role, functions; its words copied into a description
//!        --instance> laws of a role, as the rig holds those that are built in
//! ```
//!
//! A library is loaded once in a process, and never unloaded. Its functions are called through `call`, and `crash` names
//! the law in whose call a process dies. A process that only asks what a law is has a child process load it
//! (`child`). It knows no tick and no port. Start reading in [`open`].

mod answer;
mod call;
mod child;
mod crash;
mod instance;
mod loader;
mod modes;
mod object;
mod process_exit;
mod python;
mod table;
pub mod trial;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use control_api::description::Description;
use errors::{Failure, open_file};
use ironbird_law::abi::IronbirdLaw;
use messages::role::Role;
use sha2::{Digest as _, Sha256};

use crate::answer::Answer;
use crate::call::Call;
use crate::child::{asks_children, go_on_in_child, note_exit_code};
use crate::loader::{unusable, words};

pub use child::{LawsRun, ask, set_laws_run};
pub use loader::{PYTHON_ADAPTER, has_python_adapter};
pub use python::set_environment as set_python_environment;

/// Longest file that is read [bytes].
const MOST_BYTES: u64 = 1 << 30;

/// Permission of every user to write. That of the file's group is usual: it is often the user's own.
const EVERYBODY_WRITES: u32 = 0o002;

#[derive(Debug)]
pub struct Library {
    pub file: PathBuf,
    pub sha256: String,
    pub description: &'static Description,
    pub not_real_time: bool,
    /// Whether it can be copied for a warm-up run.
    pub is_rehearsed: bool,
    /// Description as text, as a child process answers it.
    answer: String,
    /// `None` until this process has loaded it.
    table: OnceLock<&'static IronbirdLaw>,
    content: Content,
    /// The law and its role, with its file.
    pub words: &'static str,
    /// Ticks after which the thread computed in another way than before.
    modes_put_back: AtomicU64,
}

/// A content of a file, as the system tells it from others without reading: device, inode, length [bytes], and when it
/// was changed last [s, ns].
type Content = (u64, u64, u64, [i64; 2]);

static LOADED: Mutex<Vec<&'static Library>> = Mutex::new(Vec::new());

/// What the folder of a law holds, once it is built: the file of the law.
const IN_FOLDER: [&str; 2] = ["law.so", "law.py"];

/// Whether the name of a law is that of a file, or of a folder with one: by a folder in it, or by its ending.
pub fn is_file(law: &str) -> bool {
    law.contains('/') || law.starts_with('.') || Path::new(law).extension().is_some()
}

/// The law's file in a folder; the file itself, where it is none.
fn in_folder(named: &Path) -> Result<PathBuf, Failure> {
    if !named.is_dir() {
        return Ok(named.to_owned());
    }
    let files = IN_FOLDER.map(|name| named.join(name));
    files.into_iter().find(|file| file.exists()).ok_or_else(|| {
        let build = named.join("build");
        let remedy = match build.exists() {
            true => format!("build it first: {}", build.display()),
            false => "name a folder that `ironbird new law` has made, or the law's file".to_owned(),
        };
        let what = format!("the folder has no {}", IN_FOLDER.join(" and no "));
        unusable(named, &what).help(remedy)
    })
}

pub fn open(role: Role, file: &Path) -> Result<&'static Library, Failure> {
    let library = load(file)?;
    let is = library.description.role;
    if is == role {
        return Ok(library);
    }
    let name = library.description.name;
    let what = format!("`{name}` is a law of the role {is}, and not of {role}");
    Err(unusable(file, &what).help(format!("fly it with --{is} {}", file.display())))
}

/// The law of a file, whatever its role.
pub fn load(file: &Path) -> Result<&'static Library, Failure> {
    let named = file;
    let unread = |e: io::Error| unread(named, &e);
    let file = in_folder(named)?.canonicalize().map_err(unread)?;
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    let content = content_of(&file).map_err(unread)?;
    if let Some(library) = loaded.iter().find(|library| library.file == file) {
        return if library.content == content {
            Ok(library)
        } else {
            Err(changed(named, "since it was loaded"))
        };
    }
    let opened = open_file(&file).map_err(unread)?;
    let mode = opened.metadata().map_err(unread)?.permissions().mode() & 0o7777;
    if mode & EVERYBODY_WRITES != 0 {
        let what = format!("every user may write it, and it is code: its mode is {mode:04o}");
        let remedy = format!(
            "chmod o-w {}; where files have no modes, copy it to where they do",
            file.display()
        );
        return Err(unusable(named, &what).help(remedy));
    }
    let bytes = read(opened).map_err(unread)?;
    let digest = Sha256::digest(&bytes);
    let sha256: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    if !loader::is_for_python(&file) {
        object::check(&bytes).map_err(|(what, remedy)| unusable(named, &what).help(remedy))?;
    }
    drop(bytes);
    let table = OnceLock::new();
    let answer = if asks_children() {
        let asked = || ask(&words(named), || Ok(read_law(&file, named)?.1));
        given_answer(&sha256).map_or_else(asked, Ok)?
    } else {
        go_on_in_child()?;
        let (loaded, answer) = read_law(&file, named)?;
        let _ = table.set(loaded);
        answer
    };
    // The sum is that of what was read, and the loader has read once more.
    if content_of(&file).ok() != Some(content) {
        return Err(changed(named, "while it was loaded"));
    }
    let law: Answer = serde_json::from_str(&answer)
        .map_err(|e| unusable(named, &format!("its description cannot be read: {e}")))?;
    let description = law.description().map_err(|what| unusable(named, &what))?;
    let description: &'static Description = Box::leak(Box::new(description));
    let library = Library {
        words: format!(
            "{} law `{}` ({})",
            description.role,
            description.name,
            file.display()
        )
        .leak(),
        file,
        sha256,
        description,
        not_real_time: law.not_real_time,
        is_rehearsed: law.is_rehearsed,
        answer,
        table,
        content,
        modes_put_back: AtomicU64::new(0),
    };
    let library: &'static Library = Box::leak(Box::new(library));
    loaded.push(library);
    Ok(library)
}

/// Loads a file; returns its table, and what it says of itself.
fn read_law(file: &Path, named: &Path) -> Result<(&'static IronbirdLaw, String), Failure> {
    crash::name_laws();
    let called: &'static str = words(named).leak();
    let table = loader::table(file, named, called)?;
    let described = Call::new(called, "as its table was read").wait(|| table::described(table));
    let (table, answer) = described.map_err(|what| {
        unusable(named, &what).help(
            "the author of the law corrects that; `ironbird docs laws` says what the rig reads",
        )
    })?;
    Ok((table, answer.text()))
}

/// The environment variable by which a process hands the answers of laws on, by the SHA-256 of their files.
const ANSWERS: &str = "IRONBIRD_LAWS";
/// The system takes no longer variable [bytes].
const ANSWERS_MAX: usize = 100_000;

/// Descriptions of the loaded laws, as an environment variable for processes that then need not ask again.
pub fn answers() -> Option<(&'static str, String)> {
    let loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    let answers = loaded.iter().map(|it| (&it.sha256, &it.answer));
    let answers: BTreeMap<_, _> = answers.collect();
    let text = serde_json::to_string(&answers).ok()?;
    (!answers.is_empty() && text.len() <= ANSWERS_MAX).then_some((ANSWERS, text))
}

fn given_answer(sha256: &str) -> Option<String> {
    let text = std::env::var(ANSWERS).ok()?;
    let mut answers: BTreeMap<String, String> = serde_json::from_str(&text).ok()?;
    answers.remove(sha256)
}

impl Library {
    /// Its table, for which this process loads it, if it has not yet.
    fn table(&self) -> Result<&'static IronbirdLaw, Failure> {
        if let Some(table) = self.table.get() {
            return Ok(table);
        }
        let (table, answer) = read_law(&self.file, &self.file)?;
        if content_of(&self.file).ok() != Some(self.content) {
            return Err(changed(&self.file, "since it was described"));
        }
        if answer != self.answer {
            return Err(unusable(&self.file, "it describes itself in two ways"));
        }
        Ok(self.table.get_or_init(|| table))
    }

    /// Whether a name means its file: the file itself, or the folder that it is the law of.
    pub fn is_at(&self, named: &Path) -> bool {
        in_folder(named).is_ok_and(|file| file.canonicalize().is_ok_and(|file| file == self.file))
    }

    /// The warning about a law that left floating-point modes changed.
    pub fn changed_modes_warning(&self) -> Option<String> {
        let ticks = self.modes_put_back.load(Ordering::Relaxed);
        (ticks > 0).then(|| {
            format!(
                "the {} left floating-point modes changed (rounding, small numbers or traps) after {ticks} of its ticks; \
                 the rig put them back each time",
                self.words
            )
        })
    }
}

/// Ends the process as a return from `main` would, but without the exit handlers of libraries: no library is
/// unloaded, and a law's exit handler cannot change the result of the flight. Warns first of each law that left
/// floating-point modes changed.
pub fn leave(code: u8) -> ExitCode {
    let loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    let warnings = loaded
        .iter()
        .filter_map(|it| it.changed_modes_warning())
        .collect();
    drop(loaded);
    note_exit_code(code);
    crash::leave(code, warnings)
}

fn read(file: File) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MOST_BYTES {
        let mib = MOST_BYTES >> 20;
        return Err(io::Error::other(format!("it is longer than {mib} MiB")));
    }
    Ok(bytes)
}

fn content_of(file: &Path) -> io::Result<Content> {
    let facts = fs::metadata(file)?;
    let changed = [facts.mtime(), facts.mtime_nsec()];
    Ok((facts.dev(), facts.ino(), facts.len(), changed))
}

fn changed(file: &Path, when: &str) -> Failure {
    let what =
        format!("the file has changed {when}: what flies would not be what its SHA-256 says");
    unusable(file, &what)
        .help("start again when it is built: a process loads the file of a law once")
}

fn unread(file: &Path, why: &io::Error) -> Failure {
    Failure::usage(format!("cannot read the law {}: {why}", file.display())).help(
        "name a folder that `ironbird new law` has made, or the file of a law: LAW.py or LAW.so",
    )
}
