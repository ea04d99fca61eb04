//! What the system has run out of, when the middleware only reports a failure.

use std::fs;
use std::io;
use std::path::Path;

use rustix::fs::{StatVfs, StatVfsMountFlags, statvfs};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};

/// Where Linux keeps POSIX shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Files that opening one service may take, and room for them [bytes]. What failed for want of the last one has given
/// the others back.
const FILES_OF_A_SERVICE: u64 = 8;
const ROOM_OF_A_SERVICE: u64 = 1 << 20;

/// More than the longest file of shared memory has [bytes].
const FILE_BYTES: u64 = 16 << 20;

/// What there is no more of, and how to get more.
pub(crate) struct Shortage {
    pub(crate) used_up: String,
    pub(crate) remedy: String,
}

/// What this process has too little of to open a service, whose files lie in a directory and in shared memory.
pub(crate) fn shortage<'a>(places: impl IntoIterator<Item = &'a Path>) -> Option<Shortage> {
    of_files()
        .or_else(of_length)
        .or_else(|| places.into_iter().find_map(of_room))
}

/// The remedy where the system itself says that something is used up.
pub(crate) fn remedy(error: &io::Error) -> Option<String> {
    match Errno::from_io_error(error)? {
        Errno::MFILE => Some(more_files()),
        Errno::NFILE => {
            Some("end other processes, or raise the limit of the system: sysctl fs.file-max".into())
        }
        Errno::NOSPC | Errno::DQUOT => {
            Some("remove what fills the file system, or enlarge it".into())
        }
        _ => None,
    }
}

fn of_files() -> Option<Shortage> {
    let limit = getrlimit(Resource::Nofile).current?;
    let open = match fs::read_dir("/proc/self/fd") {
        Ok(entries) => entries.count() as u64,
        Err(e) => {
            let e = Errno::from_io_error(&e);
            return matches!(e, Some(Errno::MFILE)).then(|| no_files(limit, limit));
        }
    };
    (open + FILES_OF_A_SERVICE > limit).then(|| no_files(open, limit))
}

fn no_files(open: u64, limit: u64) -> Shortage {
    let used_up = format!(
        "too many open files: {open} of the {limit} that this process may have (ulimit -n)"
    );
    Shortage {
        used_up,
        remedy: more_files(),
    }
}

fn more_files() -> String {
    "raise the limit before the start: ulimit -n 1024".into()
}

/// Shared memory is made of files, whose length the user's limit holds for.
fn of_length() -> Option<Shortage> {
    let limit = getrlimit(Resource::Fsize)
        .current
        .filter(|limit| *limit < FILE_BYTES)?;
    Some(Shortage {
        used_up: format!(
            "a file of shared memory may have {} KiB in this process (ulimit -f)",
            limit >> 10
        ),
        remedy: "raise the limit before the start: ulimit -f unlimited".into(),
    })
}

fn of_room(place: &Path) -> Option<Shortage> {
    lack_of_room(place, &statvfs(place).ok()?)
}

fn lack_of_room(place: &Path, system: &StatVfs) -> Option<Shortage> {
    let place = place.display();
    let shortage = |used_up, remedy| Some(Shortage { used_up, remedy });
    let free = system.f_bavail * system.f_frsize;
    if system.f_flag.contains(StatVfsMountFlags::RDONLY) {
        shortage(
            format!("the file system of {place} is mounted read-only"),
            format!("mount it writable: mount -o remount,rw {place}"),
        )
    // Some file systems count no inodes.
    } else if system.f_files > 0 && system.f_favail < FILES_OF_A_SERVICE {
        shortage(
            format!(
                "too few inodes are left on the file system of {place}: {}",
                system.f_favail
            ),
            format!("remove files from it, or give it more inodes: df -i {place}"),
        )
    } else if free < ROOM_OF_A_SERVICE {
        shortage(
            format!(
                "too little space is left on the file system of {place}: {} KiB",
                free >> 10
            ),
            format!("remove what fills it, or enlarge it: df -h {place}"),
        )
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_only_file_system_gets_the_advice_to_mount_it_writable() {
        let place = Path::new(SHARED_MEMORY);
        let mut system = statvfs("/proc").unwrap();
        (system.f_files, system.f_bavail, system.f_frsize) = (0, 1 << 20, 4096);
        system.f_flag = StatVfsMountFlags::empty();
        assert!(lack_of_room(place, &system).is_none());
        system.f_flag = StatVfsMountFlags::RDONLY;
        let Shortage { used_up, remedy } = lack_of_room(place, &system).unwrap();
        assert_eq!(used_up, "the file system of /dev/shm is mounted read-only");
        assert!(remedy.contains("remount,rw /dev/shm"), "{remedy}");
    }
}
