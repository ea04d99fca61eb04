//! How a command fails: exit code, what happened, what to do about it.

pub mod output;

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write};
use std::ops::Range;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf, absolute};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::{fmt, fs, io};

use rustix::fs::{Access, OFlags, access, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::process::geteuid;
use serde::{Deserialize, Serialize};

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

#[derive(Debug, Serialize, Deserialize)]
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

    /// Adds a remedy, unless the failure has one.
    pub fn or_help(self, help: impl Into<String>) -> Self {
        match self.help {
            Some(_) => self,
            None => self.help(help),
        }
    }

    pub fn remedy(&self) -> Option<&str> {
        self.help.as_deref()
    }

    /// The failure as a command prints it: what happened, and below it what to do.
    pub fn text(&self) -> String {
        self.labelled("error")
    }

    /// The failure of a step without which the command goes on, as it is printed.
    pub fn warning(&self) -> String {
        self.labelled("warning")
    }

    fn labelled(&self, label: &str) -> String {
        let mut text = format!("{label}: {}\n", shortened(&harmless(&self.message), 3000));
        if let Some(help) = &self.help {
            text += &format!(" help: {}\n", shortened(&harmless(help), 900));
        }
        text
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

/// The beginning and the end of a text of more characters than `most`: it may quote a line of a file, of any length.
fn shortened(text: &str, most: usize) -> String {
    let (begins, ends) = (most / 2, most / 3);
    let length = text.chars().count();
    if length <= most {
        return text.to_owned();
    }
    let beginning: String = text.chars().take(begins).collect();
    let end: String = text.chars().skip(length - ends).collect();
    let omitted = length - begins - ends;
    format!("{beginning} ({omitted} characters left out) {end}")
}

/// The text without control characters, and without those that change the direction of text: names and files may have
/// any author. They are written as JSON does (`\u202e`), so that JSON stays what it is.
pub fn harmless(text: &str) -> String {
    let escaped = |c: char| match c {
        '\n' | '\t' => c.to_string(),
        '\r' => "\\r".to_owned(),
        '\u{61c}' | '\u{200e}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
            format!("\\u{:04x}", u32::from(c))
        }
        c if c.is_control() => format!("\\u{:04x}", u32::from(c)),
        c => c.to_string(),
    };
    text.chars().map(escaped).collect()
}

/// Files that this process has opened to be read: device and inode, and the time of the last change, because a new file
/// may have the inode of a deleted one.
static READ: Mutex<BTreeMap<[u64; 2], [i64; 2]>> = Mutex::new(BTreeMap::new());

fn identity(file: &fs::Metadata) -> ([u64; 2], [i64; 2]) {
    let changed = [file.mtime(), file.mtime_nsec()];
    ([file.dev(), file.ino()], changed)
}

/// How logs, laws and rows of campaigns begin.
const KEPT: [&[u8]; 3] = [b"\x89MCAP", b"\x7fELF", b"PAR1"];

/// Refuses what an output may not replace: a file that this process has read, a log, a law or rows of a campaign.
fn check_replaceable(path: &Path) -> io::Result<()> {
    let Ok(file) = fs::metadata(path) else {
        return Ok(());
    };
    let read = READ.lock().unwrap_or_else(PoisonError::into_inner);
    let mut begin = [0; 5];
    let begins = file.is_file() && File::open(path).is_ok_and(|mut it| it.read(&mut begin).is_ok());
    let (place, changed) = identity(&file);
    let why = if read.get(&place) == Some(&changed) {
        "this command reads it"
    } else if begins && KEPT.iter().any(|kept| begin.starts_with(kept)) {
        "it is a flight log, a law, or rows of a campaign"
    } else {
        return Ok(());
    };
    Err(io::Error::other(why))
}

/// Opens a file to be read, if it is one: a pipe may have no writer, and a device no end.
pub fn open_file(path: &Path) -> io::Result<File> {
    // Opening a pipe waits for its writer otherwise.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(OFlags::NONBLOCK.bits().cast_signed())
        .open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_file() {
        let mut read = READ.lock().unwrap_or_else(PoisonError::into_inner);
        read.extend([identity(&metadata)]);
        return Ok(file);
    }
    // Callers distinguish this error by its kind.
    Err(io::Error::new(
        io::ErrorKind::InvalidInput,
        "it is not a regular file",
    ))
}

pub const TOO_LARGE: &str = "a whole number beyond 9223372036854775807 cannot be read";

/// The message of a TOML parser in plain words: of a large number, its own names a type of Rust.
pub fn of_toml(message: &str) -> &str {
    match message {
        "duplicate key" => "this section or key is in the file twice: write it once",
        _ if is_of_large_number(message) => TOO_LARGE,
        _ => message,
    }
}

fn is_of_large_number(message: &str) -> bool {
    let parts = [
        "` as i128",
        "` as u128",
        "invalid value: integer `",
        "value was too large",
    ];
    parts.iter().any(|part| message.contains(part))
}

/// A mistake that a TOML parser found at a place in a text: the line, what it says, and the message.
pub fn toml_mistake(text: &str, message: &str, span: Option<Range<usize>>) -> String {
    const LONGEST: usize = 60;
    let line = line_of(text, span.unwrap_or_default().start);
    let source = text.lines().nth(line - 1).unwrap_or_default().trim();
    let mut what = of_toml(message).trim_end().replace('\n', ", ");
    for (term, plain) in [
        ("unknown field", "unknown key"),
        ("missing field", "missing key"),
        ("expected f64", "expected a number"),
        ("expected a map", "expected a section"),
    ] {
        what = what.replace(term, plain);
    }
    match source.len() {
        1..=LONGEST => format!("line {line}, `{source}`: {what}"),
        _ => format!("line {line}: {what}"),
    }
}

/// The line of a place in a text, from 1.
pub fn line_of(text: &str, start: usize) -> usize {
    let before = text.bytes().take(start);
    1 + before.filter(|byte| *byte == b'\n').count()
}

/// Largest text that is read [bytes]: ten times the largest that is written. As JSON it takes up to 17 times as much
/// memory.
const TEXT_BYTES: u64 = 16 << 20;

/// A text file, opened as by [`open_file`].
pub fn read_text(doing: &str, path: &Path) -> Result<String, Failure> {
    let file = open_file(path).in_file(doing, path)?;
    let length = file.metadata().in_file(doing, path)?.len();
    if length > TEXT_BYTES {
        let (mib, most) = (length >> 20, TEXT_BYTES >> 20);
        let why = format!("it is {mib} MiB long, and at most {most} are read");
        return Err(why).in_file(doing, path);
    }
    io::read_to_string(file).in_file(doing, path)
}

/// Opens a file for writing, empty; creates it if it is missing. A pipe must have a reader. A link is followed only if
/// this user or root created it. Inputs, logs, laws and rows are not replaced.
pub fn create_file(path: &Path) -> io::Result<File> {
    check_replaceable(path)?;
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    // Without NONBLOCK, opening a pipe waits for its reader.
    let mut flags = OFlags::NONBLOCK;
    let is_own = |file: fs::Metadata| [0, geteuid().as_raw()].contains(&file.uid());
    if !fs::symlink_metadata(path).is_ok_and(|it| it.is_symlink() && is_own(it)) {
        flags |= OFlags::NOFOLLOW;
    }
    let file = options
        .custom_flags(flags.bits().cast_signed())
        .open(path)
        .map_err(|e| match Errno::from_io_error(&e) {
            Some(Errno::NXIO) => io::Error::new(e.kind(), "it is a pipe without a reader"),
            Some(Errno::LOOP) => io::Error::new(e.kind(), "it is a link that another user created"),
            _ => e,
        })?;
    // From here on, writing waits for a slow reader.
    fcntl_setfl(&file, fcntl_getfl(&file)? - OFlags::NONBLOCK)?;
    Ok(file)
}

/// Writes a text into a file, whole or not at all; into a link, a pipe or a device as [`create_file`] opens it.
pub fn write_text(path: &Path, text: &str) -> Result<(), Failure> {
    let is_file = match fs::symlink_metadata(path) {
        Ok(there) => there.is_file(),
        Err(e) => e.kind() == io::ErrorKind::NotFound,
    };
    if !is_file {
        let created = create_file(path);
        let written = created.and_then(|mut file| file.write_all(text.as_bytes()));
        return written.in_file("write", path);
    }
    let written = check_replaceable(path).and_then(|()| {
        let mut file = AsideFile::create(path)?;
        file.write_all(text.as_bytes())?;
        file.keep()
    });
    written.in_file("write", path)
}

/// A file that is written under another name (`.aside`) until it is whole: a reader finds the old file or the new one,
/// never a part. It is removed if it is not kept. In place of a link, it replaces that.
#[derive(Debug)]
pub struct AsideFile {
    file: File,
    aside: PathBuf,
    path: PathBuf,
}

impl AsideFile {
    pub fn create(path: &Path) -> io::Result<Self> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let (process, number) = (std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{process}-{number}.aside"));
        let aside = path.with_file_name(name);
        let _ = fs::remove_file(&aside);
        Ok(Self {
            file: File::create_new(&aside)?,
            aside,
            path: path.to_owned(),
        })
    }

    /// Another handle of the file.
    pub fn file(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    /// Gives the file its name.
    pub fn keep(&self) -> io::Result<()> {
        fs::rename(&self.aside, &self.path)
    }
}

impl Write for AsideFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for AsideFile {
    fn drop(&mut self) {
        // A file that was kept has its own name by now.
        let _ = fs::remove_file(&self.aside);
    }
}

/// Writes an [`AsideFile`], has it synced, and keeps it. If only syncing fails, the file is replaced, and the reason
/// returned.
pub fn write_whole<E: fmt::Display>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<(), E>,
) -> Result<(), String> {
    let mut aside = AsideFile::create(path).map_err(|e| e.to_string())?;
    write(&mut aside.file).map_err(|e| e.to_string())?;
    let synced = aside.file.sync_all();
    aside.keep().map_err(|e| e.to_string())?;
    let of_directory = || match File::open(path.with_file_name("."))?.sync_all() {
        // Not every file system can.
        Err(e) if e.kind() == io::ErrorKind::InvalidInput => Ok(()),
        synced => synced,
    };
    let synced = synced.and_then(|()| of_directory());
    synced.map_err(|e| format!("it is not synced: {e}"))
}

/// Checks before anything starts that the files which flags name are different ones and can be written, without creating
/// them. What the command has read until then is not replaced.
pub fn check_outputs(named: &[(&str, Option<&Path>)]) -> Result<(), Failure> {
    // Of a device such as /dev/null, several may be one.
    let file = |path: &Path| match fs::canonicalize(path) {
        Ok(path) => Some(path).filter(|path| path.is_file()),
        Err(_) => absolute(path).ok(),
    };
    for (place, (flag, path)) in named.iter().enumerate() {
        let Some(path) = path else { continue };
        let checked = match fs::metadata(path) {
            Ok(file) if file.is_dir() => Err(Errno::ISDIR.into()),
            // A pipe is not opened: its reader would take that for all that comes.
            Ok(_) => access(*path, Access::WRITE_OK)
                .map_err(io::Error::from)
                .and_then(|()| check_replaceable(path)),
            // It will be created.
            Err(_) => {
                let parent = path.parent().filter(|it| !it.as_os_str().is_empty());
                let parent = parent.unwrap_or_else(|| Path::new("."));
                access(parent, Access::WRITE_OK | Access::EXEC_OK).map_err(io::Error::from)
            }
        };
        checked.map_err(|why| {
            Failure::usage(format!("{flag}: cannot write {}: {why}", path.display()))
                .help("name another file, in a directory that is there and that you can write")
        })?;
        let one = file(path);
        let is_same =
            |(_, path): &&(&str, Option<&Path>)| one.is_some() && path.and_then(file) == one;
        if let Some((other, _)) = named[place + 1..].iter().find(is_same) {
            let what = format!("{flag} and {other} name the same file");
            return Err(Failure::usage(what).help("name another file for one of them"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{lchown, symlink};
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
        let file = |name, length| File::create(path(name)).unwrap().set_len(length).unwrap();
        // Zeros are text.
        file("log", TEXT_BYTES);
        file("long", TEXT_BYTES + (1 << 20));
        let text = read_text("read", &path("log")).unwrap();
        assert_eq!(text.len() as u64, TEXT_BYTES);
        fs::write(path("bytes"), [0xff]).unwrap();
        make_pipe(&path("pipe"));
        for (name, why) in [
            ("long", "it is 17 MiB long, and at most 16 are read"),
            ("bytes", "stream did not contain valid UTF-8"),
            ("pipe", "it is not a regular file"),
            (".", "it is not a regular file"),
            ("none", "No such file or directory (os error 2)"),
        ] {
            let failure = read_text("read the notes", &path(name)).unwrap_err();
            let expected = format!("cannot read the notes {}: {why}", path(name).display());
            assert_eq!((failure.code, failure.to_string()), (FAILED, expected));
        }
    }

    #[test]
    fn control_sequences_do_not_reach_the_terminal() {
        let text = "a\tb\n\u{1b}[2J\r\u{7}\u{9b}31m\u{202e}txt.exe\u{2066}\u{e4}\u{1f600}";
        let expected = "a\tb\n\\u001b[2J\\r\\u0007\\u009b31m\\u202etxt.exe\\u2066\u{e4}\u{1f600}";
        assert_eq!(harmless(text), expected);
    }

    #[test]
    fn a_long_message_is_shortened_to_its_beginning_and_its_end() {
        let text = |length: usize| {
            let middle = "\u{e4}".repeat(length - 8);
            Failure::usage(format!("begin{middle}end")).text()
        };
        assert_eq!(text(3000).chars().count(), 3000 + "error: \n".len());
        let long = text(1_000_000);
        assert!(long.starts_with("error: begin\u{e4}") && long.ends_with("\u{e4}end\n"));
        assert!(long.contains("\u{e4} (997500 characters left out) \u{e4}"));
        let escaped = Failure::usage("\u{1b}".repeat(1000)).help("help").text();
        assert!(escaped.contains("\\u001b\\u001b") && escaped.ends_with("\n help: help\n"));
        assert!(escaped.chars().count() < 2600 && long.chars().count() < 2600);
        let help = Failure::usage("what").help("help".repeat(1000)).text();
        assert!(
            help.ends_with("help\n") && help.chars().count() < 850,
            "{help}"
        );
    }

    #[test]
    fn only_a_link_of_this_user_or_of_root_is_followed() {
        let directory = tempfile::tempdir().unwrap();
        let [target, link] = ["target", "link"].map(|name| directory.path().join(name));
        let content = || fs::read_to_string(&target).unwrap();
        symlink(&target, &link).unwrap();
        write_text(&link, "through the link").unwrap();
        assert_eq!(content(), "through the link");
        // Only root can give a link away.
        let user = geteuid().as_raw() + 4242;
        if lchown(&link, Some(user), None).is_ok() {
            let error = write_text(&link, "planted").unwrap_err().to_string();
            assert!(
                error.contains("a link that another user created"),
                "{error}"
            );
            assert_eq!(content(), "through the link");
        }
    }

    #[test]
    fn a_file_is_replaced_and_the_target_of_a_link_stays() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("theirs"), "theirs").unwrap();
        symlink(path("theirs"), path("link")).unwrap();
        fs::write(path("old"), "much older").unwrap();
        make_pipe(&path("pipe"));
        let _socket = UnixListener::bind(path("socket")).unwrap();
        for name in ["link", "old", "pipe", "socket", "new"] {
            let mut file = AsideFile::create(&path(name)).unwrap();
            file.write_all(b"ours").unwrap();
            if name == "old" {
                assert_eq!(fs::read_to_string(path(name)).unwrap(), "much older");
            }
            file.keep().unwrap();
            assert_eq!(fs::read_to_string(path(name)).unwrap(), "ours", "{name}");
            assert!(path(name).symlink_metadata().unwrap().is_file(), "{name}");
        }
        assert_eq!(fs::read_to_string(path("theirs")).unwrap(), "theirs");
        // A file that is not kept leaves nothing.
        let lost = AsideFile::create(&path("lost")).unwrap();
        drop(lost);
        let there: Vec<_> = fs::read_dir(directory.path()).unwrap().collect();
        assert_eq!(there.len(), 6);
        let failure = AsideFile::create(directory.path()).unwrap().keep();
        let failure = failure.unwrap_err().to_string();
        assert!(
            failure.ends_with("Is a directory (os error 21)"),
            "{failure}"
        );
    }
}
