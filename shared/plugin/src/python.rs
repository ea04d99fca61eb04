//! Finds the Python that a law flies with, and loads its shared library before the adapter, which is linked to none:
//! one adapter for every version.
#![allow(
    unsafe_code,
    reason = "the library of an interpreter is loaded; each use says what is promised"
)]

use std::env;
use std::ffi::{OsString, c_int};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

/// The Python whose packages a law uses; the adapter starts the interpreter as this one.
const PYTHON: &str = "IRONBIRD_PYTHON";
/// The directory of the active virtual environment.
const ENVIRONMENT: &str = "VIRTUAL_ENV";
/// Prints version, name and path of the shared library of a Python; no path if there is none.
const QUESTION: &str = "
import os, sys, sysconfig
assert sys.version_info >= (3, 11)
var = lambda name: sysconfig.get_config_var(name) or ''
folders = var('LIBDIR'), os.path.join(var('LIBDIR'), var('MULTIARCH')), os.path.join(sys.base_prefix, 'lib')
name = f'libpython{sys.version_info[0]}.{sys.version_info[1]}{sys.abiflags}.so'
files = (os.path.join(folder, file) for folder in folders for file in (var('INSTSONAME'), name + '.1.0', name))
is_library = lambda file: '.so' in file and os.path.isfile(file)
print('%d.%d' % sys.version_info[:2], name, next(filter(is_library, files), ''), sep='\\n')";

/// Loads the library with symbols that the adapter and packages such as numpy see. Within a Python, that one is used.
pub(crate) fn load() -> Result<(), String> {
    let process = Library::this();
    // SAFETY: the symbol is looked up, and not called.
    if unsafe { process.get::<unsafe extern "C" fn() -> c_int>(b"Py_IsInitialized\0") }.is_ok() {
        return Ok(());
    }
    let python = python()?;
    let place = python.display();
    let another = format!("name another Python with {PYTHON}");
    let answer = Command::new(&python)
        .args(["-I", "-S", "-c", QUESTION])
        .output()
        .map_err(|e| format!("a law in Python needs a Python, and {place} cannot be started ({e}): install one, or {another}"))?;
    let text = String::from_utf8_lossy(&answer.stdout);
    let [version, name, file] = text.lines().collect::<Vec<_>>()[..] else {
        return Err(format!(
            "{place} does not answer as a Python of version 3.11 or later: {another}"
        ));
    };
    if file.is_empty() {
        return Err(format!(
            "Python {version} ({place}) comes without its shared library {name}: install it (Debian: apt install \
             libpython{version}), or {another}"
        ));
    }
    // SAFETY: the user's own Python.
    let library = unsafe { Library::open(Some(file), RTLD_NOW | RTLD_GLOBAL) };
    // The library is never unloaded.
    std::mem::forget(library.map_err(|e| format!("{file} cannot be loaded ({e}): {another}"))?);
    Ok(())
}

/// Sets what the interpreter of a law reads of the environment. For the begin of `main`: where the process has more than
/// one thread, it sets nothing, and laws in Python are refused.
pub fn set_environment() {
    let threads = fs::read_dir("/proc/self/task").map_or(0, Iterator::count);
    // Why there is no Python is said where a law needs one.
    let Some(python) = python().ok().filter(|_| threads == 1) else {
        return;
    };
    let mut variables = vec![
        (PYTHON, python.into_os_string()),
        // The order of a set is the same in every process: a replay has the same bits.
        ("PYTHONHASHSEED", "0".into()),
    ];
    if ["LC_ALL", "LC_CTYPE", "LANG"].map(said) == [None, None, None] {
        // As Python itself does where no encoding of texts is given.
        variables.push(("LC_CTYPE", "C.UTF-8".into()));
    }
    for (variable, value) in variables {
        // SAFETY: no other thread reads the environment.
        unsafe { env::set_var(variable, value) };
    }
}

fn said(variable: &str) -> Option<OsString> {
    env::var_os(variable).filter(|value| !value.is_empty())
}

/// Python of the environment; else the one beside the executable, as in a virtual environment; else that of PATH.
fn python() -> Result<PathBuf, String> {
    let of_environment =
        || said(ENVIRONMENT).map(|it| (Path::new(&it).join("bin/python"), ENVIRONMENT));
    let named = said(PYTHON).map(|it| (it.into(), PYTHON));
    if let Some((path, variable)) = named.or_else(of_environment) {
        return match path.is_file() {
            true => Ok(path),
            false => Err(format!(
                "{variable} leads to {}, which is not there: name a Python, or unset it",
                path.display()
            )),
        };
    }
    let executable = env::current_exe().unwrap_or_default();
    let beside = executable.with_file_name("python3");
    let path = env::var_os("PATH").unwrap_or_default();
    let on_path = env::split_paths(&path).map(|folder| folder.join("python3"));
    Ok([beside]
        .into_iter()
        .chain(on_path)
        .find(|file| file.is_file())
        .unwrap_or_else(|| "python3".into()))
}
