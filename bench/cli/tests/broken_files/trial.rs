//! One kind of file for a while: broken, read, and watched for panics, hangs and memory.

use std::fs;
use std::io::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, MutexGuard, Once, PoisonError};
use std::time::{Duration, Instant};

use errors::Failure;

use fastrand::Rng;

/// Ends a reader that hangs: far beyond what any of these files takes.
const HANGS: Duration = Duration::from_secs(60);
/// Memory that reading a file of at most 2 MiB may take [bytes]: a record of a log may announce 256 MiB.
const MOST_BYTES: u64 = 600 << 20;
/// Longest refusal [characters].
const MOST_CHARACTERS: usize = 4000;

/// Memory is that of the process, so that one kind is tried after the other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
/// Panics of all threads: a reader may have threads of its own.
static PANICS: Mutex<Vec<String>> = Mutex::new(Vec::new());

fn lock<T>(mutex: &'static Mutex<T>) -> MutexGuard<'static, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One kind of file: those that are read as they are, how they are broken, and what reads them.
pub struct Trial<'a> {
    pub kind: &'static str,
    pub file: &'static str,
    pub good: &'a [Vec<u8>],
    pub change: &'a dyn Fn(&mut Rng, &[u8]) -> Vec<u8>,
    pub read: &'a dyn Fn(&Path) -> Result<(), Failure>,
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().expect(variable))
}

/// Files that once caused trouble, and others that are odd.
fn corpus(kind: &str) -> Vec<(String, Vec<u8>)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/broken_files/corpus");
    let files = fs::read_dir(Path::new(folder).join(kind))
        .into_iter()
        .flatten();
    let mut paths: Vec<PathBuf> = files.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let named = |path: &PathBuf| (path.display().to_string(), fs::read(path).unwrap());
    paths.iter().map(named).collect()
}

impl Trial<'_> {
    /// Tries files for `IRONBIRD_BROKEN_S` seconds (1), beginning with the seed `IRONBIRD_BROKEN_SEED` (1).
    pub fn run(&self) {
        let _alone = lock(&ONE_AT_A_TIME);
        collect_panics();
        let place = tempfile::Builder::new()
            .prefix("ib")
            .tempdir_in("/dev/shm")
            .unwrap();
        let path = place.path().join(self.file);
        let (begins, watchdog) = channel::<String>();
        let (kind, watched) = (self.kind, path.clone());
        std::thread::spawn(move || {
            let mut name = String::new();
            loop {
                match watchdog.recv_timeout(HANGS) {
                    Ok(next) => name = next,
                    Err(RecvTimeoutError::Disconnected) => return,
                    Err(RecvTimeoutError::Timeout) => {
                        let file = watched.display();
                        let _ =
                            writeln!(std::io::stderr(), "{kind} {name} hangs; the file is {file}");
                        std::process::abort();
                    }
                }
            }
        });
        let read = |name: String, bytes: &[u8]| {
            begins.send(name.clone()).unwrap();
            self.read_one(&path, bytes, &name)
        };
        for (i, good) in self.good.iter().enumerate() {
            if let Err(failure) = read(format!("good-{i}"), good) {
                panic!("{kind}: good file {i} is refused: {}", failure.text());
            }
        }
        let corpus = corpus(kind);
        for (name, bytes) in &corpus {
            let _ = read(name.clone(), bytes);
        }
        let mut known: Vec<&[u8]> = self.good.iter().map(Vec::as_slice).collect();
        known.extend(corpus.iter().map(|(_, bytes)| bytes.as_slice()));
        let (seed, begin) = (number("IRONBIRD_BROKEN_SEED", 1), Instant::now());
        let length = Duration::from_secs(number("IRONBIRD_BROKEN_S", 1));
        for i in (0..).take_while(|_| begin.elapsed() <= length) {
            let mut dice = Rng::with_seed(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(i));
            let file = known[dice.u64(..known.len() as u64) as usize];
            let _ = read(format!("{seed}-{i}"), &(self.change)(&mut dice, file));
        }
    }

    /// Reads a file. Panics and keeps the file if something is wrong.
    fn read_one(&self, path: &Path, bytes: &[u8], name: &str) -> Result<(), Failure> {
        fs::write(path, bytes).unwrap();
        lock(&PANICS).clear();
        let before = memory(true);
        let answer = catch_unwind(AssertUnwindSafe(|| (self.read)(path)));
        let grown = memory(false).saturating_sub(before);
        let panics = std::mem::take(&mut *lock(&PANICS));
        let wrong = match &answer {
            _ if !panics.is_empty() => Some(format!("it panics: {}", panics.join("; "))),
            _ if grown > MOST_BYTES => Some(format!("it takes {} MiB", grown >> 20)),
            Ok(Err(failure)) => self.bad_refusal(failure),
            _ => None,
        };
        if let Some(wrong) = wrong {
            let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("broken_files");
            fs::create_dir_all(&folder).unwrap();
            let name = name.rsplit('/').next().unwrap();
            let kept = folder.join(format!("{}-{name}-{}", self.kind, self.file));
            fs::write(&kept, bytes).unwrap();
            panic!(
                "{} {name}: {wrong}; the file is {}",
                self.kind,
                kept.display()
            );
        }
        answer.unwrap_or(Ok(()))
    }

    fn bad_refusal(&self, failure: &Failure) -> Option<String> {
        let said = failure.text();
        let start: String = said.chars().take(300).collect();
        let is_obeyed = |c: char| c.is_control() && !"\n\t".contains(c) || c == '\u{202e}';
        // An airframe is named by what it describes.
        let about = if self.kind == "airframe" {
            "airframe"
        } else {
            self.file
        };
        if said.chars().count() > MOST_CHARACTERS {
            Some(format!("its refusal has {} bytes: {start} ...", said.len()))
        } else if said.contains(is_obeyed) {
            Some(format!(
                "its refusal has characters that a terminal obeys: {start:?}"
            ))
        } else if !said.contains(about) {
            Some(format!("its refusal does not name `{about}`: {start}"))
        } else {
            None
        }
    }
}

fn collect_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            lock(&PANICS).push(panic.to_string());
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
