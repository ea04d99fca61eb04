//! Opens directories and files of an instance safely.
//!
//! They are opened without following links, and checked before they are used. Names under /tmp and in /dev/shm can be
//! guessed, so another user may have put something there first. What is not this user's, or can be written by others,
//! is refused.

use std::ffi::OsString;
use std::fs::File;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStringExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Dir, FileType, Mode, OFlags, Stat, fstat, openat, statat};
use rustix::io::Errno;
use rustix::process::geteuid;

use crate::error::Error;

const OTHERS_WRITE: u32 = 0o022;
const OTHERS_MAY: u32 = 0o077;
/// In a directory with this bit, only the owner of an entry may remove or rename it.
const STICKY: u32 = 0o1000;
/// Files are opened neither through a link, nor waiting for the other end of a pipe.
const SAFELY: OFlags = OFlags::NOFOLLOW
    .union(OFlags::CLOEXEC)
    .union(OFlags::NONBLOCK);

#[derive(Debug)]
pub(crate) struct Directory {
    descriptor: OwnedFd,
    path: PathBuf,
}

impl Directory {
    pub(super) fn open(path: &Path) -> Result<Option<Self>, Error> {
        Self::open_at(CWD, path, path.to_owned())
    }

    pub(super) fn open_below(&self, name: &Path) -> Result<Option<Self>, Error> {
        Self::open_at(self.descriptor.as_fd(), name, self.path.join(name))
    }

    fn open_at(at: BorrowedFd<'_>, name: &Path, path: PathBuf) -> Result<Option<Self>, Error> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | SAFELY;
        match openat(at, name, flags, Mode::empty()) {
            Ok(descriptor) => Ok(Some(Self { descriptor, path })),
            Err(Errno::NOENT) => Ok(None),
            Err(Errno::NOTDIR | Errno::LOOP) if is_link(&path) => {
                Err(not_ours(path, "it is a symbolic link"))
            }
            Err(Errno::NOTDIR) => Err(not_ours(path, "it is no directory")),
            Err(e) => Err(Error::path(path, e)),
        }
    }

    pub(super) fn check_private(&self) -> Result<(), Error> {
        let stat = self.stat()?;
        check_owner(&stat, &self.path)?;
        check_mode(&stat, &self.path)
    }

    /// Refuses a root in which another user could exchange an instance's directory.
    ///
    /// One that everybody may write is good enough when it is sticky, as /tmp is; the system's own are root's.
    pub(super) fn check_root(&self) -> Result<(), Error> {
        let stat = self.stat()?;
        if stat.st_uid != 0 {
            check_owner(&stat, &self.path)?;
        }
        match stat.st_mode & STICKY {
            0 => check_mode(&stat, &self.path),
            _ => Ok(()),
        }
    }

    pub(super) fn names(&self) -> Result<Vec<OsString>, Error> {
        let failed = |e: Errno| Error::system(format!("cannot list {}", self.path.display()), e);
        let mut names = Vec::new();
        for entry in Dir::read_from(&self.descriptor).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name().to_bytes().to_vec();
            if name != b"." && name != b".." {
                names.push(OsString::from_vec(name));
            }
        }
        names.sort();
        Ok(names)
    }

    pub(super) fn kind(&self, name: &Path) -> EntryKind {
        match statat(&self.descriptor, name, AtFlags::SYMLINK_NOFOLLOW) {
            Err(Errno::NOENT) => EntryKind::Gone,
            Ok(stat) if stat.st_uid != geteuid().as_raw() => EntryKind::Foreign,
            Ok(stat) => match FileType::from_raw_mode(stat.st_mode) {
                FileType::RegularFile => EntryKind::File {
                    bytes: u64::try_from(stat.st_blocks).unwrap_or(0) * 512,
                },
                FileType::Directory => EntryKind::Directory,
                _ => EntryKind::Foreign,
            },
            Err(_) => EntryKind::Foreign,
        }
    }

    /// What tells an entry from another one of its name; `None` where nothing is.
    pub(super) fn identity(&self, name: &Path) -> Option<(u64, u64)> {
        let stat = statat(&self.descriptor, name, AtFlags::SYMLINK_NOFOLLOW).ok()?;
        Some((stat.st_dev, stat.st_ino))
    }

    /// Takes from others what they may do with a file of ours; one that is still being made has nothing for them.
    pub(super) fn close_to_others(&self, name: &Path) -> Result<(), Error> {
        let close = || {
            let file = openat(
                &self.descriptor,
                name,
                OFlags::RDONLY | SAFELY,
                Mode::empty(),
            )?;
            let stat = fstat(&file)?;
            if stat.st_uid == geteuid().as_raw() && stat.st_mode & OTHERS_MAY != 0 {
                rustix::fs::fchmod(&file, PRIVATE_FILE)?;
            }
            Ok(())
        };
        match close() {
            Ok(()) | Err(Errno::NOENT | Errno::ACCESS) => Ok(()),
            Err(e) => {
                let path = self.path.join(name);
                Err(Error::system(
                    format!("cannot close {} to others", path.display()),
                    e,
                ))
            }
        }
    }

    /// Opens a file of ours in it, for reading and writing; `None` where nothing is.
    pub(crate) fn file(&self, name: &str) -> Result<Option<File>, Error> {
        let path = self.path.join(name);
        match openat(&self.descriptor, name, OFlags::RDWR | SAFELY, Mode::empty()) {
            Ok(descriptor) => {
                let file = File::from(descriptor);
                check_file(&file, &path)?;
                Ok(Some(file))
            }
            Err(Errno::NOENT) => Ok(None),
            Err(Errno::LOOP) => Err(not_ours(path, "it is a symbolic link")),
            // A socket, a directory, a file of another user.
            Err(e) => Err(Error::path(path, e)),
        }
    }

    /// Opens a file of ours in it, and makes it where nothing is.
    pub(crate) fn file_or_new(&self, name: &str) -> Result<File, Error> {
        loop {
            // One that is there is opened without O_CREAT, so that it is the check below which refuses it, in words.
            if let Some(file) = self.file(name)? {
                return Ok(file);
            }
            if let Some(file) = self.new_file(name)? {
                return Ok(file);
            }
        }
    }

    pub(crate) fn new_file(&self, name: &str) -> Result<Option<File>, Error> {
        let flags = OFlags::RDWR | OFlags::CREATE | OFlags::EXCL | SAFELY;
        match openat(&self.descriptor, name, flags, PRIVATE_FILE) {
            Ok(descriptor) => Ok(Some(File::from(descriptor))),
            Err(Errno::EXIST) => Ok(None),
            Err(e) => Err(Error::path(self.path.join(name), e)),
        }
    }

    /// Removes an entry; that it has gone already is as good.
    pub(super) fn remove(&self, name: &Path, flags: AtFlags) -> Result<(), Error> {
        match rustix::fs::unlinkat(&self.descriptor, name, flags) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(e) => {
                let path = self.path.join(name);
                Err(Error::system(
                    format!("cannot remove {}", path.display()),
                    e,
                ))
            }
        }
    }

    /// Takes write and read permission from others, on a directory that an older build has made.
    pub(super) fn make_private(&self) -> Result<(), Error> {
        rustix::fs::fchmod(&self.descriptor, PRIVATE_DIRECTORY)
            .map_err(|e| Error::path(self.path.clone(), e))
    }

    fn stat(&self) -> Result<Stat, Error> {
        fstat(&self.descriptor).map_err(|e| Error::path(self.path.clone(), e))
    }
}

impl AsFd for Directory {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.descriptor.as_fd()
    }
}

const PRIVATE_FILE: Mode = Mode::RUSR.union(Mode::WUSR);
pub(super) const PRIVATE_DIRECTORY: Mode = Mode::RWXU;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EntryKind {
    Gone,
    /// A regular file of this user, and the room that it takes.
    File {
        bytes: u64,
    },
    Directory,
    /// A link, a socket, a pipe, a device, or another user's.
    Foreign,
}

/// Refuses what is no regular file, and a file that another user owns or may write.
fn check_file(file: &File, path: &Path) -> Result<(), Error> {
    let stat = fstat(file).map_err(|e| Error::path(path, e))?;
    if FileType::from_raw_mode(stat.st_mode) != FileType::RegularFile {
        return Err(not_ours(path, "it is no regular file"));
    }
    check_owner(&stat, path)?;
    check_mode(&stat, path)
}

fn check_owner(stat: &Stat, path: &Path) -> Result<(), Error> {
    let (owner, user) = (stat.st_uid, geteuid().as_raw());
    if owner == user {
        return Ok(());
    }
    let why = format!("it belongs to user {owner}, and this process is user {user}");
    Err(not_ours(path, why))
}

fn check_mode(stat: &Stat, path: &Path) -> Result<(), Error> {
    if stat.st_mode & OTHERS_WRITE == 0 {
        return Ok(());
    }
    let mode = stat.st_mode & 0o7777;
    let why = format!("others may write it: its mode is {mode:04o}");
    Err(not_ours(path, why))
}

pub(super) fn not_ours(path: impl Into<PathBuf>, why: impl Into<String>) -> Error {
    Error::NotOurs {
        path: path.into(),
        why: why.into(),
    }
}

pub(crate) fn is_at(file: impl AsFd, path: &Path) -> bool {
    let there = statat(CWD, path, AtFlags::SYMLINK_NOFOLLOW);
    matches!((fstat(file), there), (Ok(ours), Ok(there)) if is_same(&ours, &there))
}

fn is_same(one: &Stat, other: &Stat) -> bool {
    (one.st_dev, one.st_ino) == (other.st_dev, other.st_ino)
}

fn is_link(path: &Path) -> bool {
    path.symlink_metadata()
        .is_ok_and(|there| there.is_symlink())
}
