//! What a file is before it is loaded: a whole ELF library for this machine.
//!
//! The loader checks little of this itself. It maps a truncated file, and the process dies at the first page that is
//! missing.

use std::fmt;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotLoaded {
    NotElf,
    /// It ends before what it says of itself.
    Truncated {
        holds: u64,
        needs: u64,
    },
    Machine(String),
    /// It is an ELF file of another kind.
    Kind(&'static str),
}

impl fmt::Display for NotLoaded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotElf => {
                f.write_str("it is not a shared library: its first bytes are not those of ELF")
            }
            Self::Truncated { holds, needs } => {
                write!(
                    f,
                    "it is truncated: it has {holds} bytes, and needs at least {needs}"
                )
            }
            Self::Machine(theirs) => {
                write!(
                    f,
                    "it was built for {theirs}, and this machine is {}",
                    std::env::consts::ARCH
                )
            }
            Self::Kind(kind) => write!(f, "it is {kind}, not a shared library"),
        }
    }
}

impl NotLoaded {
    pub(crate) const fn remedy(&self) -> &'static str {
        match self {
            Self::NotElf => {
                "build one: cc -std=c11 -O2 -fPIC -shared -o libmy.so my.c; a law in Python is a file that ends in .py"
            }
            Self::Truncated { .. } => "copy or build it again",
            Self::Machine(_) => "build it on this machine, or for it",
            Self::Kind(_) => "link it as a library: cc -shared -fPIC -o libmy.so my.c",
        }
    }
}

/// `e_machine` of this machine, and of those whose libraries are met most.
const MACHINES: [(u16, &str); 7] = [
    (3, "x86"),
    (40, "arm"),
    (62, "x86_64"),
    (183, "aarch64"),
    (243, "riscv64"),
    (21, "powerpc64"),
    (22, "s390x"),
];

pub fn check(file: &[u8]) -> Result<(), NotLoaded> {
    const HEADER: usize = 64;
    const PROGRAM_HEADER: usize = 56;
    const LOADED: u32 = 1;
    const SHARED: u16 = 3;
    if !file.starts_with(b"\x7fELF") {
        return Err(NotLoaded::NotElf);
    }
    let holds = file.len() as u64;
    let truncated = |needs: u64| NotLoaded::Truncated { holds, needs };
    let word = |at: usize| {
        file.get(at..at + 2)
            .map(|it| u16::from_le_bytes([it[0], it[1]]))
    };
    let machine = word(18).ok_or(truncated(HEADER as u64))?;
    let known = MACHINES.iter().find(|(number, _)| *number == machine);
    if (file[4], file[5]) != (2, 1) || known.map(|(_, name)| *name) != Some(std::env::consts::ARCH)
    {
        let bits = if file[4] == 1 { ", 32 bits" } else { "" };
        let order = if file[5] == 2 { ", big-endian" } else { "" };
        let name = known.map_or_else(
            || format!("ELF machine {machine}"),
            |(_, name)| (*name).to_owned(),
        );
        return Err(NotLoaded::Machine(format!("{name}{bits}{order}")));
    }
    let long = |at: usize| {
        file.get(at..at + 8)?
            .try_into()
            .ok()
            .map(u64::from_le_bytes)
    };
    let (kind, table, entries) = match (word(16), long(32), word(56)) {
        (Some(kind), Some(table), Some(entries)) if holds >= HEADER as u64 => {
            (kind, table, entries)
        }
        _ => return Err(truncated(HEADER as u64)),
    };
    match kind {
        SHARED => {}
        1 => return Err(NotLoaded::Kind("an object file")),
        2 => return Err(NotLoaded::Kind("an executable")),
        4 => return Err(NotLoaded::Kind("a core dump")),
        _ => return Err(NotLoaded::Kind("an ELF file of another kind")),
    }
    for entry in 0..u64::from(entries) {
        let at = table.saturating_add(entry * PROGRAM_HEADER as u64);
        let end = at.saturating_add(PROGRAM_HEADER as u64);
        if end > holds {
            return Err(truncated(end));
        }
        let at = at as usize;
        let is_loaded = file[at..at + 4] == LOADED.to_le_bytes();
        let needs = long(at + 8)
            .zip(long(at + 32))
            .map_or(u64::MAX, |(from, length)| from.saturating_add(length));
        if is_loaded && needs > holds {
            return Err(truncated(needs));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::{env, fs};

    use super::*;

    /// A library that is there: the C library of this process.
    fn library() -> Vec<u8> {
        let maps = fs::read_to_string("/proc/self/maps").unwrap();
        let file = maps
            .split_whitespace()
            .find(|word| word.contains("/libc.so"))
            .unwrap();
        fs::read(file).unwrap()
    }

    fn with(mut file: Vec<u8>, at: usize, bytes: &[u8]) -> Vec<u8> {
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    }

    #[test]
    fn whatever_is_cut_off_or_changed_is_refused_and_never_a_panic() {
        let whole = library();
        assert_eq!(check(&whole), Ok(()));
        let cut: Vec<_> = (0..2000)
            .chain([whole.len() / 2])
            .map(|length| check(&whole[..length]))
            .collect();
        assert!(cut[..4].iter().all(|it| *it == Err(NotLoaded::NotElf)));
        let is_cut = |it: &Result<(), NotLoaded>| matches!(it, Err(NotLoaded::Truncated { .. }));
        assert!(cut[4..].iter().all(is_cut));
        // The header, and behind it the table that it leads to.
        let mut changed = whole.clone();
        for at in 0..1024 {
            for byte in [0, 1, 0x7f, 0x80, 0xff] {
                changed[at] = byte;
                let _ = check(&changed);
            }
            changed[at] = whole[at];
        }
        let far = with(whole, 32, &u64::MAX.to_le_bytes());
        assert!(is_cut(&check(&far)), "a table beyond every file");
    }

    #[test]
    fn what_is_no_library_for_this_machine_is_told_as_what_it_is() {
        let other = if env::consts::ARCH == "aarch64" {
            (62_u16, "x86_64")
        } else {
            (183, "aarch64")
        };
        let machine = check(&with(library(), 18, &other.0.to_le_bytes()))
            .unwrap_err()
            .to_string();
        assert!(
            machine.contains(&format!(
                "built for {}, and this machine is {}",
                other.1,
                env::consts::ARCH
            )),
            "{machine}"
        );
        let told = |at, bytes: &[u8]| check(&with(library(), at, bytes)).unwrap_err().to_string();
        assert!(
            told(4, &[1]).contains(", 32 bits, and"),
            "{}",
            told(4, &[1])
        );
        assert!(told(5, &[2]).contains(", big-endian, and"));
        assert!(told(18, &[0xee, 0xee]).contains("built for ELF machine 61166, and"));
        assert_eq!(
            told(16, &[1, 0]),
            "it is an object file, not a shared library"
        );
        assert_eq!(
            told(16, &[2, 0]),
            "it is an executable, not a shared library"
        );
        assert_eq!(check(b"#!/bin/sh\n").unwrap_err(), NotLoaded::NotElf);
    }
}
