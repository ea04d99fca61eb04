//! What a file is before it is loaded: a whole ELF library for this machine.
//!
//! The loader checks little of this itself. It maps a truncated file, and the process dies at the first page that is
//! missing.

/// Why a file cannot be loaded, and what to do.
type Refusal = (String, &'static str);

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

pub fn check(file: &[u8]) -> Result<(), Refusal> {
    const HEADER: u64 = 64;
    const PROGRAM_HEADER: u64 = 56;
    const LOADED: [u8; 4] = 1_u32.to_le_bytes();
    if !file.starts_with(b"\x7fELF") {
        let what = "it is not a shared library: its first bytes are not those of ELF";
        let build = "build one: cc -std=c11 -O2 -fPIC -shared -o libmy.so my.c; a law in Python is a file that ends in .py";
        return Err((what.into(), build));
    }
    let length = file.len() as u64;
    let truncated = |needs: u64| {
        let what = format!("it is truncated: it has {length} bytes, and needs at least {needs}");
        Err((what, "copy or build it again"))
    };
    if length < HEADER {
        return truncated(HEADER);
    }
    let word = |at: usize| u16::from_le_bytes([file[at], file[at + 1]]);
    let long = |at: usize| u64::from_le_bytes(*file[at..].first_chunk().unwrap_or(&[0xff; 8]));
    let (arch, machine) = (std::env::consts::ARCH, word(18));
    let name = MACHINES.iter().find(|(number, _)| *number == machine);
    let name = name.map_or_else(|| format!("ELF machine {machine}"), |it| it.1.into());
    if (file[4], file[5]) != (2, 1) || name != arch {
        let bits = if file[4] == 1 { ", 32 bits" } else { "" };
        let order = if file[5] == 2 { ", big-endian" } else { "" };
        let what = format!("it was built for {name}{bits}{order}, and this machine is {arch}");
        return Err((what, "build it on this machine, or for it"));
    }
    let kind = match word(16) {
        3 => None,
        1 => Some("an object file"),
        2 => Some("an executable"),
        4 => Some("a core dump"),
        _ => Some("an ELF file of another kind"),
    };
    if let Some(kind) = kind {
        let what = format!("it is {kind}, not a shared library");
        let remedy = "link it as a library: cc -shared -fPIC -o libmy.so my.c";
        return Err((what, remedy));
    }
    let table = long(32);
    for entry in 0..u64::from(word(56)) {
        let at = table.saturating_add(entry * PROGRAM_HEADER);
        let end = at.saturating_add(PROGRAM_HEADER);
        if end > length {
            return truncated(end);
        }
        let at = at as usize;
        let needs = long(at + 8).saturating_add(long(at + 32));
        if file[at..].starts_with(&LOADED) && needs > length {
            return truncated(needs);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::{env, fs};

    use super::*;

    /// The C library of this process, with some bytes changed.
    fn library(at: usize, bytes: &[u8]) -> Vec<u8> {
        let maps = fs::read_to_string("/proc/self/maps").unwrap();
        let mut words = maps.split_whitespace();
        let mut file = fs::read(words.find(|word| word.contains("/libc.so")).unwrap()).unwrap();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    }

    fn refusal(file: &[u8]) -> String {
        check(file).map_or_else(|(what, _)| what, |()| "none".into())
    }

    #[test]
    fn whatever_is_cut_off_or_changed_is_refused_and_never_a_panic() {
        let whole = library(0, &[]);
        assert_eq!(check(&whole), Ok(()));
        for length in (0..2000).chain([whole.len() / 2]) {
            let expected = if length < 4 {
                "not those of ELF"
            } else {
                "it is truncated"
            };
            assert!(refusal(&whole[..length]).contains(expected), "{length}");
        }
        // The header, and behind it the table that it leads to.
        let mut changed = whole.clone();
        for at in 0..1024 {
            for byte in [0, 1, 0x7f, 0x80, 0xff] {
                changed[at] = byte;
                let _ = check(&changed);
            }
            changed[at] = whole[at];
        }
        let far = library(32, &u64::MAX.to_le_bytes());
        assert!(
            refusal(&far).contains("it is truncated"),
            "a table beyond every file"
        );
    }

    #[test]
    fn a_file_that_is_no_library_for_this_machine_is_named() {
        let (arch, other) = (env::consts::ARCH, env::consts::ARCH == "aarch64");
        let (number, name) = if other {
            (62_u16, "x86_64")
        } else {
            (183, "aarch64")
        };
        let built = |words: &str| format!("it was built for {words}, and this machine is {arch}");
        for (at, bytes, expected) in [
            (18, number.to_le_bytes(), built(name)),
            (18, [0xee, 0xee], built("ELF machine 61166")),
            (4, [1, 1], built(&format!("{arch}, 32 bits"))),
            (4, [2, 2], built(&format!("{arch}, big-endian"))),
            (
                16,
                [1, 0],
                "it is an object file, not a shared library".into(),
            ),
            (
                16,
                [2, 0],
                "it is an executable, not a shared library".into(),
            ),
        ] {
            assert_eq!(refusal(&library(at, &bytes)), expected);
        }
    }
}
