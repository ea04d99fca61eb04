//! Loads a library and asks it for its table.
#![allow(
    unsafe_code,
    reason = "a foreign library's code runs; each use says what is promised"
)]

use std::env;
use std::ffi::{CString, c_char};
use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};

use errors::Failure;
use ironbird_law::abi::IronbirdLaw;
use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};

use crate::call::Call;
use crate::python;

/// The environment variable that names the library which makes laws of Python files.
pub const PYTHON_ADAPTER: &str = "IRONBIRD_PYTHON_ADAPTER";
const ADAPTER_FILE: &str = "libironbird_python.so";
const BUILD_ADAPTER: &str = "python/build (`ironbird docs python`)";
const ANOTHER_ADAPTER: &str = "build it: python/build (`ironbird docs python`); name it with IRONBIRD_PYTHON_ADAPTER, or unset \
                               that where it lies beside the executable";

const PYTHON_PAGE: &str = "`ironbird docs python` says what a law in Python is, and what it needs";

/// How long a refusal may be [bytes], with the NUL.
pub(crate) const REFUSAL_BYTES: usize = 1024;

pub(crate) fn unusable(file: &Path, what: &str) -> Failure {
    Failure::usage(format!("{}: {what}", words(file)))
}

pub(crate) fn words(file: &Path) -> String {
    format!("the law {}", file.display())
}

pub(crate) fn is_for_python(file: &Path) -> bool {
    file.extension().is_some_and(|ending| ending == "py")
}

/// The table of a file, which the user has named so.
///
/// `law` is what it is called where a call of it fails.
pub(crate) fn table(
    file: &Path,
    named: &Path,
    law: &'static str,
) -> Result<*const IronbirdLaw, Failure> {
    if is_for_python(file) {
        of_script(file, named, law)
    } else {
        of_library(file, named, law)
    }
}

fn of_library(file: &Path, named: &Path, law: &'static str) -> Result<*const IronbirdLaw, Failure> {
    let library = loaded(file, law).map_err(|why| {
        unusable(named, &why)
            .help("`ldd FILE` shows the libraries that it needs; link what is missing: cc ... -lm")
    })?;
    type Law = unsafe extern "C" fn() -> *const IronbirdLaw;
    // SAFETY: the header declares the function so; a library that exports another one of the name breaks that promise.
    let Some(law_of) = (unsafe { exported::<Law>(library, b"ironbird_law\0") }) else {
        return Err(unusable(named, "it exports no function `ironbird_law`")
            .help("define it as ironbird_law.h declares it; in C++ include the header, which makes it extern \"C\""));
    };
    if !is_code(law_of as usize) {
        return Err(
            unusable(named, "its `ironbird_law` is data, and not a function")
                .help("define it as ironbird_law.h declares it: a function that returns the table"),
        );
    }
    // SAFETY: as above.
    Ok(Call::new(law, "as it was asked for its law").wait(|| unsafe { law_of() }))
}

fn of_script(file: &Path, named: &Path, law: &'static str) -> Result<*const IronbirdLaw, Failure> {
    let adapter = adapter(named)?;
    let of_adapter = format!("the adapter for laws in Python, {}", adapter.display());
    let useless = |why: &str| Failure::usage(format!("{of_adapter}: {why}")).help(ANOTHER_ADAPTER);
    let called: &'static str = of_adapter.clone().leak();
    // Before its Python, the adapter misses symbols; one that another program has made may need none.
    let library = match loaded(&adapter, called) {
        Ok(library) => library,
        Err(_) => {
            python::load().map_err(|why| unusable(named, &why).help(PYTHON_PAGE))?;
            loaded(&adapter, called).map_err(|why| useless(&why))?
        }
    };
    type Open = unsafe extern "C" fn(*const c_char, *mut c_char, u64) -> *const IronbirdLaw;
    // SAFETY: the header declares the function so; a library that exports another one of the name breaks that promise.
    let Some(open) = (unsafe { exported::<Open>(library, b"ironbird_law_open\0") }) else {
        return Err(useless(
            "it makes no laws of files: it exports no function `ironbird_law_open`",
        ));
    };
    let Ok(path) = CString::new(file.as_os_str().as_bytes()) else {
        return Err(unusable(named, "its path has a NUL byte"));
    };
    let mut refusal = Refusal::new();
    let (text, size) = refusal.buffer();
    // SAFETY: the path and the buffer live for the time of the call, and the buffer has the size that is said.
    let table =
        Call::new(law, "as it was opened").wait(|| unsafe { open(path.as_ptr(), text, size) });
    if table.is_null() {
        return Err(unusable(named, &refusal.text()).help(PYTHON_PAGE));
    }
    Ok(table)
}

/// Runs the library's initialisers, and finds every symbol that it needs now: none is looked for in flight.
fn loaded(file: &Path, law: &'static str) -> Result<Library, String> {
    let load = Call::new(law, "as it was loaded");
    // SAFETY: the user has named the file as code to be run.
    let library = load.wait(|| unsafe { Library::open(Some(file), RTLD_NOW | RTLD_LOCAL) });
    library.map_err(|e| format!("it cannot be loaded: {}", innermost(&e)))
}

/// A symbol of a library, which is never unloaded.
///
/// # Safety
/// `T` is the symbol's type.
unsafe fn exported<T: Copy>(library: Library, name: &[u8]) -> Option<T> {
    // SAFETY: promised by the caller.
    let symbol = unsafe { library.get::<T>(name) }.ok().map(|it| *it);
    std::mem::forget(library);
    symbol
}

/// Whether this process may execute what is at an address.
fn is_code(address: usize) -> bool {
    let holds = |line: &str| {
        let (range, rest) = line.split_once(' ')?;
        let (start, end) = range.split_once('-')?;
        let [start, end] = [start, end].map(|hex| usize::from_str_radix(hex, 16).ok());
        Some((start?..end?).contains(&address) && rest.get(2..3) == Some("x"))
    };
    // A path in it may be no UTF-8.
    let mappings = fs::read("/proc/self/maps").unwrap_or_default();
    String::from_utf8_lossy(&mappings)
        .lines()
        .any(|line| holds(line) == Some(true))
}

fn innermost(error: &dyn std::error::Error) -> String {
    error.source().map_or_else(|| error.to_string(), innermost)
}

fn adapter(script: &Path) -> Result<PathBuf, Failure> {
    if let Some(named) = env::var_os(PYTHON_ADAPTER).map(PathBuf::from) {
        if named.is_file() {
            return Ok(named);
        }
        let file = named.display();
        let what = format!("{PYTHON_ADAPTER} names {file}, and there is no such file");
        return Err(Failure::usage(what).help(ANOTHER_ADAPTER));
    }
    let executable = env::current_exe().ok();
    let folder = executable.as_deref().and_then(Path::parent);
    let folder = folder.unwrap_or(Path::new("/"));
    let places = ["", "../lib/ironbird"].map(|place| folder.join(place).join(ADAPTER_FILE));
    if let Some(adapter) = places.iter().find(|place| place.is_file()) {
        return Ok(adapter.clone());
    }
    let [beside, installed] = places.map(|it| it.display().to_string());
    let what =
        format!("a law in Python needs {ADAPTER_FILE}, which is not at {beside} or {installed}");
    let remedy = format!("build it: {BUILD_ADAPTER}; or name it with {PYTHON_ADAPTER}");
    Err(unusable(script, &what).help(remedy))
}

/// Whether a law in Python can fly: the adapter is where it is looked for.
pub fn has_python_adapter() -> bool {
    adapter(Path::new("")).is_ok()
}

pub(crate) struct Refusal([u8; REFUSAL_BYTES]);

impl Refusal {
    pub(crate) const fn new() -> Self {
        Self([0; REFUSAL_BYTES])
    }

    pub(crate) fn buffer(&mut self) -> (*mut c_char, u64) {
        (self.0.as_mut_ptr().cast(), self.0.len() as u64)
    }

    pub(crate) fn text(&self) -> String {
        let written = self.0.split(|byte| *byte == 0).next().unwrap_or_default();
        let text = String::from_utf8_lossy(written).trim().to_owned();
        if text.is_empty() {
            "it refuses, and does not say why".into()
        } else {
            text
        }
    }
}
