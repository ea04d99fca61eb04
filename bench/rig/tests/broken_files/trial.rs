//! One kind of file for a while: broken, read, and watched for panics, hangs and memory.

use std::any::Any;
use std::fs;
use std::io::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::thread::sleep;
use std::time::{Duration, Instant};

use errors::Failure;

use crate::recorded::Dice;

/// Ends a reader that hangs: far beyond what any of these files takes.
const HANGS: Duration = Duration::from_secs(60);
/// Memory that reading a file of at most 2 MiB may take [bytes]: a record of a log may announce 256 MiB.
const MOST_BYTES: u64 = 600 << 20;
/// Longest words of a refusal [characters].
const MOST_WORDS: usize = 4000;

/// Memory is that of the process, so that one kind is tried after the other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
/// Panics of all threads: a reader may have threads of its own.
static PANICS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// A kind of file, and how it is read.
pub struct Trial<'a> {
    pub kind: &'static str,
    /// What a file of it is called.
    pub file: &'static str,
    /// What a refusal of it is about: the file, or what it describes.
    pub about: &'static str,
    /// Files that are read as they are.
    pub good: &'a [Vec<u8>],
    pub change: &'a dyn Fn(&mut Dice, &[u8]) -> Vec<u8>,
    /// Reads a file, and does with it what commands do.
    pub read: &'a dyn Fn(&Path) -> Result<(), Failure>,
}

/// What reading has come to so far.
#[derive(Default)]
struct Tally {
    files: u64,
    read: u64,
    slowest: (Duration, String),
    largest: (u64, String),
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().expect(variable))
}

/// Files that once were trouble, and others that are odd.
fn corpus(kind: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/broken_files/corpus")
        .join(kind);
    let mut files: Vec<PathBuf> = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let named = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
    files
        .iter()
        .map(|path| (named(path), fs::read(path).unwrap()))
        .collect()
}

impl Trial<'_> {
    /// Tries files for `IRONBIRD_BROKEN_S` seconds (1), beginning with the dice `IRONBIRD_BROKEN_SEED` (1).
    pub fn run(&self) {
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        hear_panics();
        let place = tempfile::Builder::new()
            .prefix("ib")
            .tempdir_in("/dev/shm")
            .unwrap();
        let path = place.path().join(self.file);
        let watched = Watched::begin(self.kind, &path);
        let mut tally = Tally::default();
        for (i, good) in self.good.iter().enumerate() {
            let read = self.one(&path, good, &format!("good-{i}"), &watched, &mut tally);
            read.unwrap_or_else(|failure| {
                panic!(
                    "{}: good file {i} is refused: {}",
                    self.kind,
                    failure.told()
                )
            });
        }
        let corpus = corpus(self.kind);
        for (name, bytes) in &corpus {
            let _ = self.one(&path, bytes, name, &watched, &mut tally);
        }
        let files: Vec<&[u8]> = self
            .good
            .iter()
            .chain(corpus.iter().map(|(_, bytes)| bytes))
            .map(Vec::as_slice)
            .collect();
        let (seed, begin) = (number("IRONBIRD_BROKEN_SEED", 1), Instant::now());
        let length = Duration::from_secs(number("IRONBIRD_BROKEN_S", 1));
        for i in 0.. {
            if begin.elapsed() > length {
                break;
            }
            let mut dice = Dice(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(i));
            dice.roll(2);
            let file = files[dice.roll(files.len() as u64) as usize];
            let bytes = (self.change)(&mut dice, file);
            let _ = self.one(&path, &bytes, &format!("{seed}-{i}"), &watched, &mut tally);
        }
        let ((time, slow), (memory, large)) = (&tally.slowest, &tally.largest);
        let (kind, files, read) = (self.kind, tally.files, tally.read);
        let _ = writeln!(
            std::io::stderr().lock(),
            "{kind}: {files} files, {read} of them read; slowest {slow}: {} ms; largest {large}: {} MiB",
            time.as_millis(),
            memory >> 20
        );
    }

    fn one(
        &self,
        path: &Path,
        bytes: &[u8],
        name: &str,
        watched: &Watched,
        tally: &mut Tally,
    ) -> Result<(), Failure> {
        fs::write(path, bytes).unwrap();
        PANICS
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
        let before = memory(true);
        let begin = watched.begins(name);
        let answer = catch_unwind(AssertUnwindSafe(|| (self.read)(path)));
        let took = watched.ends(begin);
        let grown = memory(false).saturating_sub(before);
        let panics = std::mem::take(&mut *PANICS.lock().unwrap_or_else(PoisonError::into_inner));
        let answer = answer.map_err(|panic| words_of(&*panic));
        let wrong = match &answer {
            Err(panic) => Some(format!("it panics: {panic}")),
            _ if !panics.is_empty() => Some(format!("it panics: {}", panics.join("; "))),
            _ if grown > MOST_BYTES => Some(format!("it takes {} MiB", grown >> 20)),
            Ok(Err(failure)) => ill_told(failure, self.about),
            Ok(Ok(())) => None,
        };
        if let Some(wrong) = wrong {
            panic!(
                "{} {name}: {wrong}; the file is {}",
                self.kind,
                kept(self.kind, name, self.file, bytes).display()
            );
        }
        tally.files += 1;
        tally.read += u64::from(matches!(answer, Ok(Ok(()))));
        if took > tally.slowest.0 {
            tally.slowest = (took, name.to_owned());
        }
        if grown > tally.largest.0 {
            tally.largest = (grown, name.to_owned());
        }
        answer.unwrap_or(Ok(()))
    }
}

/// What is wrong with a refusal.
fn ill_told(failure: &Failure, about: &str) -> Option<String> {
    let told = failure.told();
    let start: String = told.chars().take(300).collect();
    if told.chars().count() > MOST_WORDS {
        return Some(format!(
            "its refusal is {} bytes long: {start} ...",
            told.len()
        ));
    }
    if told.contains(|c: char| c.is_control() && !"\n\t".contains(c) || c == '\u{202e}') {
        return Some(format!(
            "its refusal has characters that a terminal obeys: {start:?}"
        ));
    }
    (!told.contains(about)).then(|| format!("its refusal does not tell of `{about}`: {start}"))
}

/// Keeps a file that is trouble.
fn kept(kind: &str, name: &str, file: &str, bytes: &[u8]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("broken_files");
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join(format!("{kind}-{name}-{file}"));
    fs::write(&path, bytes).unwrap();
    path
}

fn words_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_default()
}

fn hear_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            PANICS
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(panic.to_string());
            before(panic);
        }));
    });
}

/// The most memory that this process has had since it was asked `anew` [bytes]; 0 where the kernel does not tell.
fn memory(anew: bool) -> u64 {
    if anew {
        let _ = fs::write("/proc/self/clear_refs", "5");
    }
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<u64>().ok())
        .map_or(0, |kib| kib << 10)
}

/// The file that is being read, since when; watched by a thread, which ends the process if that hangs.
struct Watched {
    now: Arc<Mutex<Option<(Instant, String)>>>,
}

impl Watched {
    fn begin(kind: &'static str, path: &Path) -> Self {
        let now = Arc::new(Mutex::new(None::<(Instant, String)>));
        let (looks_at, path) = (Arc::downgrade(&now), path.to_owned());
        std::thread::spawn(move || {
            while let Some(now) = looks_at.upgrade() {
                let hung = now
                    .lock()
                    .unwrap()
                    .as_ref()
                    .filter(|(since, _)| since.elapsed() > HANGS)
                    .cloned();
                if let Some((_, name)) = hung {
                    let bytes = fs::read(&path).unwrap_or_default();
                    let kept = kept(kind, &name, "hangs", &bytes);
                    let _ = writeln!(
                        std::io::stderr().lock(),
                        "{kind} {name} hangs; the file is {}",
                        kept.display()
                    );
                    std::process::abort();
                }
                drop(now);
                sleep(Duration::from_millis(200));
            }
        });
        Self { now }
    }

    fn begins(&self, name: &str) -> Instant {
        let begin = Instant::now();
        *self.now.lock().unwrap() = Some((begin, name.to_owned()));
        begin
    }

    fn ends(&self, begin: Instant) -> Duration {
        *self.now.lock().unwrap() = None;
        begin.elapsed()
    }
}
