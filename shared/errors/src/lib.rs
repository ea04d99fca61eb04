//! How a command fails: exit code, what happened, what to do about it.

pub mod output;

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;
use std::{fmt, fs, io};

use rustix::fs::{Access, OFlags, access, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::process::geteuid;

/// Exit code of a run or command that did what it should.
pub const OK: u8 = 0;
pub const FAILED: u8 = 1;
/// A flag, a key, a file or a name is wrong; nothing was started.
pub const USAGE: u8 = 2;
/// The flight ended, and a gate did not hold; the machine cannot fly in real time.
pub const GATE: u8 = 3;
pub const NO_REAL_TIME: u8 = 4;
/// Another instance runs, or shared memory is in the way.
pub const OCCUPIED: u8 = 5;
pub const INTERRUPTED: u8 = 130;

#[derive(Debug)]
pub struct Failure {
    pub code: u8,
    message: String,
    help: Option<String>,
}

impl Failure {
    pub fn new(code: u8, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            help: None,
        }
    }

    /// A mistake in what the user typed.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(USAGE, message)
    }

    pub fn failed(message: impl Into<String>) -> Self {
        Self::new(FAILED, message)
    }

    pub fn append(mut self, more: &str) -> Self {
        self.message.push_str(more);
        self
    }

    /// With another exit code, unless that one is [`OK`].
    pub const fn or_code(mut self, code: u8) -> Self {
        if code != OK {
            self.code = code;
        }
        self
    }

    /// What a call says that a signal has broken off: an interruption, whatever it was in the middle of.
    pub fn broken_off(self, by_signal: bool) -> Self {
        if by_signal && self.code == FAILED {
            Self::new(INTERRUPTED, format!("interrupted: {self}"))
        } else {
            self
        }
    }

    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }
}

impl Failure {
    /// The failure as a command prints it: what happened, and below it what to do.
    pub fn told(&self) -> String {
        let help = self
            .help
            .as_ref()
            .map_or_else(String::new, |help| format!(" help: {help}\n"));
        format!(
            "error: {}\n{}",
            shortened(&harmless(&self.message)),
            harmless(&help)
        )
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

pub fn errno_text(errno: i64) -> String {
    i32::try_from(errno).map_or_else(
        |_| "unknown".into(),
        |number| io::Error::from_raw_os_error(number).to_string(),
    )
}

/// Names the file in an I/O failure.
pub trait InFile<T> {
    fn in_file(self, doing: &str, path: &Path) -> Result<T, Failure>;
}

impl<T, E: fmt::Display> InFile<T> for Result<T, E> {
    fn in_file(self, doing: &str, path: &Path) -> Result<T, Failure> {
        self.map_err(|e| Failure::failed(format!("cannot {doing} {}: {e}", path.display())))
    }
}

/// Longest message that is told in full [characters]; of a longer one, as much of its begin and its end.
const MOST_TOLD: usize = 3000;
const BEGIN_TOLD: usize = 1500;
const END_TOLD: usize = 1000;

/// The begin and the end of what is too long: it may quote a line of a file, and a line has no longest length.
fn shortened(message: &str) -> String {
    let characters = message.chars().count();
    if characters <= MOST_TOLD {
        return message.to_owned();
    }
    let begin: String = message.chars().take(BEGIN_TOLD).collect();
    let end: String = message.chars().skip(characters - END_TOLD).collect();
    format!(
        "{begin} ({} characters left out) {end}",
        characters - BEGIN_TOLD - END_TOLD
    )
}

/// Characters that have a terminal show what follows in another order than it stands.
const TURNING: [char; 12] = [
    '\u{61c}', '\u{200e}', '\u{200f}', '\u{202a}', '\u{202b}', '\u{202c}', '\u{202d}', '\u{202e}',
    '\u{2066}', '\u{2067}', '\u{2068}', '\u{2069}',
];

/// A text that a terminal shows and does not obey: names and files are anybody's.
pub fn harmless(text: &str) -> String {
    let shown = |c: char| match c {
        '\n' | '\t' => c.to_string(),
        c if c.is_control() || TURNING.contains(&c) => c.escape_default().to_string(),
        c => c.to_string(),
    };
    text.chars().map(shown).collect()
}

/// Opens a file to be read, if it is one: a pipe may have no writer, and a device no end.
pub fn open_file(path: &Path) -> io::Result<File> {
    // Opening a pipe waits for its writer otherwise.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(OFlags::NONBLOCK.bits().cast_signed())
        .open(path)?;
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    Err(io::Error::new(
        io::ErrorKind::InvalidInput,
        "it is not a regular file",
    ))
}

/// Largest text that is read [bytes]: ten times the largest that is written. As JSON it takes up to 17 times as much
/// memory.
const TEXT_BYTES: u64 = 16 << 20;

/// A text file, opened as by [`open_file`].
pub fn read_text(doing: &str, path: &Path) -> Result<String, Failure> {
    let file = open_file(path).in_file(doing, path)?;
    let length = file.metadata().in_file(doing, path)?.len();
    if length > TEXT_BYTES {
        let why = format!(
            "it is {} MiB long, and at most {} are read",
            length >> 20,
            TEXT_BYTES >> 20
        );
        return Err(why).in_file(doing, path);
    }
    io::read_to_string(file).in_file(doing, path)
}

/// Opens a file for writing, empty; creates it if it is missing. A pipe must have a reader. A link is followed only if
/// this user or root created it.
pub fn create_file(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    // Without NONBLOCK, opening a pipe waits for its reader.
    let mut flags = OFlags::NONBLOCK;
    if !is_own_link(path, geteuid().as_raw()) {
        flags |= OFlags::NOFOLLOW;
    }
    let file = options
        .custom_flags(flags.bits().cast_signed())
        .open(path)
        .map_err(|e| {
            let errno = e.raw_os_error();
            if errno == Some(Errno::NXIO.raw_os_error()) {
                io::Error::new(e.kind(), "it is a pipe that nobody reads")
            } else if errno == Some(Errno::LOOP.raw_os_error()) {
                io::Error::new(e.kind(), "it is a link that another user created")
            } else {
                e
            }
        })?;
    // From here on, writing waits for a slow reader.
    fcntl_setfl(&file, fcntl_getfl(&file)? - OFlags::NONBLOCK)?;
    Ok(file)
}

fn is_own_link(path: &Path, user: u32) -> bool {
    fs::symlink_metadata(path)
        .is_ok_and(|file| file.is_symlink() && (file.uid() == user || file.uid() == 0))
}

/// Writes a text into a file, opened as by [`create_file`].
pub fn write_text(path: &Path, text: &str) -> Result<(), Failure> {
    create_file(path)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .in_file("write", path)
}

/// A new file in place of what has the name: a link is not followed, and a pipe not waited for.
pub fn replace(path: &Path) -> Result<File, Failure> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e).in_file("write", path),
        _ => File::create_new(path).in_file("write", path),
    }
}

/// Whether a file that a flag names can be written: asked before anything starts, and nothing is made by it.
pub fn check_writable(flag: &str, path: Option<&Path>) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    let asked = match fs::metadata(path) {
        Ok(file) if file.is_dir() => Err(Errno::ISDIR),
        // Nothing is opened: who reads a pipe would take that for all that comes.
        Ok(_) => access(path, Access::WRITE_OK),
        // It will be made.
        Err(_) => {
            let parent = path
                .parent()
                .filter(|parent| !parent.as_os_str().is_empty());
            access(
                parent.unwrap_or_else(|| Path::new(".")),
                Access::WRITE_OK | Access::EXEC_OK,
            )
        }
    };
    let refused = |e: Errno| {
        Failure::usage(format!(
            "{flag}: cannot write {}: {}",
            path.display(),
            io::Error::from(e)
        ))
        .help("name a file in a directory that is there and that you can write")
    };
    asked.map_err(refused)
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixListener;
    use std::process::Command;

    use super::*;

    fn make_pipe(path: &Path) {
        let made = Command::new("mkfifo").arg(path).status();
        assert!(made.unwrap().success());
    }

    #[test]
    fn a_text_is_read_from_a_regular_file_that_is_no_longer_than_a_text() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("text"), "words").unwrap();
        assert_eq!(read_text("read", &path("text")).unwrap(), "words");
        File::create(path("log"))
            .unwrap()
            .set_len(TEXT_BYTES)
            .unwrap();
        // Zeros are text.
        assert_eq!(
            read_text("read", &path("log")).unwrap().len() as u64,
            TEXT_BYTES
        );
        File::create(path("long"))
            .unwrap()
            .set_len(TEXT_BYTES + (1 << 20))
            .unwrap();
        fs::write(path("bytes"), [0xff]).unwrap();
        make_pipe(&path("pipe"));
        for (name, why) in [
            ("long", "it is 17 MiB long, and at most 16 are read"),
            ("bytes", "stream did not contain valid UTF-8"),
            ("pipe", "it is not a regular file"),
            (".", "it is not a regular file"),
            ("none", "No such file or directory (os error 2)"),
        ] {
            let failure = read_text("read the notes", &path(name))
                .map(drop)
                .unwrap_err();
            let told = format!("cannot read the notes {}: {why}", path(name).display());
            assert_eq!((failure.code, failure.to_string()), (FAILED, told));
        }
    }

    #[test]
    fn a_terminal_is_told_nothing_that_it_would_obey() {
        let told =
            harmless("a\tb\n\u{1b}[2J\r\u{7}\u{9b}31m\u{202e}txt.exe\u{2066}\u{e4}\u{1f600}");
        assert_eq!(
            told,
            "a\tb\n\\u{1b}[2J\\r\\u{7}\\u{9b}31m\\u{202e}txt.exe\\u{2066}\u{e4}\u{1f600}"
        );
    }

    #[test]
    fn of_a_message_without_end_the_begin_and_the_end_are_told() {
        let told = |length: usize| {
            Failure::usage(format!("begin{}end", "\u{e4}".repeat(length - 8)))
                .help("help")
                .told()
        };
        assert!(
            told(3000).starts_with("error: begin\u{e4}")
                && told(3000).ends_with("\u{e4}end\n help: help\n")
        );
        assert_eq!(
            told(3000).chars().count(),
            3000 + "error: \n help: help\n".len()
        );
        let long = told(1_000_000);
        assert!(
            long.contains("\u{e4} (997500 characters left out) \u{e4}")
                && long.ends_with("\u{e4}end\n help: help\n")
        );
        let escaped = Failure::usage("\u{1b}".repeat(1000)).told();
        assert!(
            escaped.contains("\\u{1b}\\u{1b}") && escaped.chars().count() < 2600,
            "{}",
            escaped.len()
        );
        assert!(
            long.starts_with("error: begin\u{e4}") && long.chars().count() < 2600,
            "{}",
            long.len()
        );
    }

    #[test]
    fn only_a_link_of_this_user_or_of_root_is_followed() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("target"), "before").unwrap();
        std::os::unix::fs::symlink(path("target"), path("link")).unwrap();
        let user = geteuid().as_raw();
        assert!(is_own_link(&path("link"), user));
        write_text(&path("link"), "through the link").unwrap();
        assert_eq!(
            fs::read_to_string(path("target")).unwrap(),
            "through the link"
        );
        // Only root can give a link away.
        if std::os::unix::fs::lchown(path("link"), Some(user + 4242), None).is_err() {
            return;
        }
        assert!(!is_own_link(&path("link"), user));
        let failure = write_text(&path("link"), "planted").unwrap_err();
        assert!(
            failure
                .to_string()
                .contains("a link that another user created"),
            "{failure}"
        );
        assert_eq!(
            fs::read_to_string(path("target")).unwrap(),
            "through the link"
        );
    }

    #[test]
    fn a_file_is_replaced_and_what_a_link_leads_to_stays() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("theirs"), "theirs").unwrap();
        std::os::unix::fs::symlink(path("theirs"), path("link")).unwrap();
        fs::write(path("old"), "much older").unwrap();
        let held = File::open(path("old")).unwrap();
        make_pipe(&path("pipe"));
        let _socket = UnixListener::bind(path("socket")).unwrap();
        for name in ["link", "old", "pipe", "socket", "new"] {
            replace(&path(name)).unwrap().write_all(b"ours").unwrap();
            assert_eq!(fs::read_to_string(path(name)).unwrap(), "ours", "{name}");
            assert!(path(name).symlink_metadata().unwrap().is_file(), "{name}");
        }
        assert_eq!(fs::read_to_string(path("theirs")).unwrap(), "theirs");
        // Who reads the old one still has it.
        assert_eq!(io::read_to_string(held).unwrap(), "much older");
        let failure = replace(directory.path()).unwrap_err().to_string();
        assert_eq!(
            failure,
            format!(
                "cannot write {}: Is a directory (os error 21)",
                directory.path().display()
            )
        );
    }
}
