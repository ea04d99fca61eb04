//! Finds what killed processes left of an instance, and removes it file by file.
//!
//! It removes only what is below a directory with our mark and has one of our names: our locks, and the middleware's
//! files with the instance's prefix. A directory is removed when it is empty.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::AtFlags;

use super::directory::{Directory, EntryKind, not_ours};
use super::locks::{Door, IN_USE, LAUNCHER, is_marked, is_ours, lock_name, try_lock};
use super::root::root;
use super::{Instance, MARK, SHARED_MEMORY, shared_memory};
use crate::error::Error;
use messages::role::{MOST_CHANNELS, Replica, Role};

const SERVICES: &str = "services";
const NODES: &str = "nodes";
/// End of the name of the segment in which it counts its nodes.
const NODE_COUNTER: &[u8] = b".global_mgmt";

#[derive(Debug, Default)]
pub(super) struct Contents {
    files: Vec<PathBuf>,
    /// Those that are empty without our files, inner ones first.
    directories: Vec<PathBuf>,
    pub(super) foreign: Vec<PathBuf>,
}

/// Which directory of an instance it is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    Instance,
    Services,
    Nodes,
    Node,
}

/// Whether a file of this name may be ours.
fn file_is_ours(place: Place, name: &str, prefix: &str) -> bool {
    if place != Place::Instance {
        return name.starts_with(prefix);
    }
    let is_role = |replica: Replica| lock_name(&replica.to_string()) == name;
    Replica::all(MOST_CHANNELS).any(is_role)
        || [LAUNCHER, IN_USE].map(lock_name).contains(&name.into())
}

fn place_below(place: Place, name: &str) -> Option<Place> {
    match place {
        Place::Instance if name == SERVICES => Some(Place::Services),
        Place::Instance if name == NODES => Some(Place::Nodes),
        Place::Nodes if name.bytes().all(|byte| byte.is_ascii_digit()) => Some(Place::Node),
        _ => None,
    }
}

impl Instance {
    /// Every instance under the root path whose plant runs now.
    pub fn flying() -> Vec<Self> {
        let mut instances = Self::known();
        instances.retain(|instance| instance.is_occupied(Role::Plant));
        instances
    }

    /// Every instance that has a directory of ours under the root path, or shared memory, in order of name.
    pub fn known() -> Vec<Self> {
        let Ok(root) = root() else { return Vec::new() };
        let open = |path: &Path| Directory::open(path).ok().flatten();
        let list = |directory: Option<Directory>| {
            let names = directory.and_then(|directory| directory.names().ok());
            let names = names.unwrap_or_default().into_iter();
            names.filter_map(|name| name.into_string().ok())
        };
        let is_ours = |name: &String| open(&root.join(name)).is_some_and(|it| is_ours(&it));
        let beginning = Self::prefix_of_root(&root);
        let of_segment = |name: String| {
            let (name, _) = name.strip_prefix(&beginning)?.split_once('.')?;
            Some(name.to_owned())
        };
        let mut names: BTreeSet<String> = list(open(&root)).filter(is_ours).collect();
        names.extend(list(shared_memory().ok().flatten()).filter_map(of_segment));
        let instances = names.iter().map(|name| Self::under(&root, name));
        instances.filter_map(Result::ok).collect()
    }

    /// What is left of the instance when no process lives that uses it: its segments in shared memory, then its
    /// directory, or what of it is ours.
    pub fn leftovers(&self) -> Vec<PathBuf> {
        match self.door_of_ours() {
            Ok(Some(door)) if !self.is_used(&door) => {
                let contents = self.contents(&door);
                contents.map_or_else(|_| Vec::new(), |all| self.paths(&all))
            }
            // The directory was removed by hand, and the segments are left.
            Ok(None) if self.has_only_memory() => self.paths_of_segments(),
            _ => Vec::new(),
        }
    }

    /// What lies in its directory and is not ours: it stays.
    pub fn foreign(&self) -> Vec<PathBuf> {
        let Ok(Some(door)) = self.door_of_ours() else {
            return Vec::new();
        };
        let foreign = self.contents(&door).unwrap_or_default().foreign;
        let path = |path| self.directory().join(path);
        foreign.iter().map(path).collect()
    }

    /// Why nothing is removed of an instance that has segments in shared memory: its directory is not to be used.
    pub fn refusal(&self) -> Option<Error> {
        if self.has_only_memory() || self.segments().is_empty() {
            return None;
        }
        let directory = match Directory::open(&self.directory()) {
            Ok(directory) => directory?,
            Err(refusal) => return Some(refusal),
        };
        let why = "it has lost the mark that ironbird made it";
        match directory.check_private() {
            Ok(()) if is_marked(&directory) => None,
            Ok(()) => Some(not_ours(self.directory(), why)),
            Err(refusal) => Some(refusal),
        }
    }

    /// Removes what is left of the instance when no process lives that uses it, and says what it removed.
    pub fn remove_leftovers(&self) -> Result<Vec<PathBuf>, Error> {
        let mut removed = Vec::new();
        if self.has_only_memory() {
            // It was removed by hand, and the segments are left.
            removed = self.paths_of_segments();
            if removed.is_empty() {
                return Ok(removed);
            }
            self.prepare()?;
        }
        // No process enters meanwhile.
        let Some(door) = self.door_of_ours()? else {
            return Ok(Vec::new());
        };
        if self.is_used(&door) {
            return Ok(Vec::new());
        }
        let contents = self.contents(&door)?;
        if removed.is_empty() {
            removed = self.paths(&contents);
        }
        self.remove_segments()?;
        self.remove(&door, &contents)?;
        if contents.foreign.is_empty() {
            door.directory.remove(Path::new(MARK), AtFlags::empty())?;
            if std::fs::remove_dir(self.directory()).is_err() {
                // Something was put into it in this instant: it stays ours.
                door.directory.new_file(MARK)?;
            }
        }
        Ok(removed)
    }

    /// Whether any process of the instance lives, or uses its shared memory.
    fn is_used(&self, door: &Door) -> bool {
        let name = lock_name(IN_USE);
        let is_free = |file: Option<File>| match file {
            Some(file) => try_lock(&file, &self.directory().join(&name)),
            None => Ok(true),
        };
        let is_free = door.directory.file(&name).and_then(is_free);
        // If that cannot be read, it may be.
        self.is_alive() || !is_free.unwrap_or(false) || self.is_memory_used().unwrap_or(true)
    }

    /// Whether it has no directory, and no process uses its shared memory.
    fn has_only_memory(&self) -> bool {
        let directory = self.directory().symlink_metadata();
        directory.is_err_and(|e| e.kind() == io::ErrorKind::NotFound)
            && !self.is_memory_used().unwrap_or(true)
    }

    /// Removes what dead processes left in the shared memory and of the middleware's files.
    pub(super) fn remove_memory(&self, door: &Door) -> Result<(), Error> {
        let mut contents = self.contents(door)?;
        contents
            .files
            .retain(|path| path.starts_with(SERVICES) || path.starts_with(NODES));
        self.remove_segments()?;
        self.remove(door, &contents)
    }

    fn remove(&self, door: &Door, contents: &Contents) -> Result<(), Error> {
        for file in &contents.files {
            door.directory.remove(file, AtFlags::empty())?;
        }
        for directory in &contents.directories {
            door.directory.remove(directory, AtFlags::REMOVEDIR)?;
        }
        Ok(())
    }

    /// Removes the files of services that no living node has a share in: their maker died before it was done.
    ///
    /// A node has a share from before it makes a service, so `living` is called after the services were
    /// listed. A file that another process removes and makes anew meanwhile is another file.
    pub(crate) fn remove_orphans(
        &self,
        living: impl FnOnce() -> BTreeSet<String>,
    ) -> Result<(), Error> {
        let door = self.door()?;
        let prefix = self.prefix();
        let Some(services) = door.directory.open_below(Path::new(SERVICES))? else {
            return Ok(());
        };
        let names = services.names()?.into_iter();
        let names = names.filter_map(|name| name.into_string().ok());
        let services_before: Vec<_> = names
            .filter(|name| name.starts_with(&prefix) && name.ends_with(".service"))
            .map(|name| (services.identity(Path::new(&name)), name))
            .collect();
        let living = living();
        for (identity, name) in services_before {
            let is_shared = |node: &String| {
                let share = Path::new(NODES).join(node).join(format!("{name}_tag"));
                door.directory.kind(&share) != EntryKind::Gone
            };
            let file = Path::new(&name);
            if !living.iter().any(is_shared) && services.identity(file) == identity {
                services.remove(file, AtFlags::empty())?;
            }
        }
        Ok(())
    }

    fn paths(&self, contents: &Contents) -> Vec<PathBuf> {
        let (mut paths, directory) = (self.paths_of_segments(), self.directory());
        if contents.foreign.is_empty() {
            paths.push(directory);
        } else {
            paths.extend(contents.files.iter().map(|path| directory.join(path)));
        }
        paths
    }

    fn paths_of_segments(&self) -> Vec<PathBuf> {
        let segments = self.segments().into_iter();
        let path = |name| Path::new(SHARED_MEMORY).join(name);
        segments.map(path).collect()
    }

    pub(super) fn contents(&self, door: &Door) -> Result<Contents, Error> {
        let (mut contents, prefix) = (Contents::default(), self.prefix());
        let (here, place) = (Path::new(""), Place::Instance);
        sort_entries(&door.directory, here, place, &prefix, &mut contents)?;
        if !is_marked(&door.directory) {
            // Without the mark, a name proves nothing: the mark is written before all other files.
            contents.foreign.append(&mut contents.files);
        }
        Ok(contents)
    }

    /// Names of its segments in shared memory: regular files of this user with its prefix.
    pub(super) fn segments(&self) -> Vec<OsString> {
        self.in_shared_memory(|kind| matches!(kind, EntryKind::File { .. }))
    }

    /// Refuses shared memory in which another user has the instance's prefix.
    pub(crate) fn check_segments(&self) -> Result<(), Error> {
        let foreign =
            self.in_shared_memory(|kind| matches!(kind, EntryKind::Directory | EntryKind::Foreign));
        match foreign.first() {
            None => Ok(()),
            Some(name) => Err(not_ours(
                Path::new(SHARED_MEMORY).join(name),
                "it has a name of this instance, and is no file of this user",
            )),
        }
    }

    /// Closes to others what the middleware opens to everybody: its counter of nodes, which anybody could shrink, so
    /// that who reads it dies. Whatever else is open to others is refused where it is used.
    pub(crate) fn close_node_counter(&self) -> Result<(), Error> {
        let Some(memory) = shared_memory()? else {
            return Ok(());
        };
        let segments = self.segments();
        let mut counters = segments
            .iter()
            .filter(|name| name.as_encoded_bytes().ends_with(NODE_COUNTER));
        counters.try_for_each(|name| memory.close_to_others(Path::new(name)))
    }

    pub(super) fn owned_bytes(&self) -> u64 {
        let Ok(Some(memory)) = shared_memory() else {
            return 0;
        };
        let bytes = |name: &OsString| match memory.kind(Path::new(name)) {
            EntryKind::File { bytes } => bytes,
            _ => 0,
        };
        self.segments().iter().map(bytes).sum()
    }

    fn in_shared_memory(&self, wanted: impl Fn(EntryKind) -> bool) -> Vec<OsString> {
        let Ok(Some(memory)) = shared_memory() else {
            return Vec::new();
        };
        let prefix = self.prefix();
        let mut names = memory.names().unwrap_or_default();
        names.retain(|name| {
            name.as_encoded_bytes().starts_with(prefix.as_bytes())
                && wanted(memory.kind(Path::new(name)))
        });
        names
    }

    fn remove_segments(&self) -> Result<(), Error> {
        let Some(memory) = shared_memory()? else {
            return Ok(());
        };
        self.segments()
            .iter()
            .try_for_each(|name| memory.remove(Path::new(name), AtFlags::empty()))
    }
}

/// Sorts the entries of a directory; returns whether all of them are ours.
fn sort_entries(
    directory: &Directory,
    path: &Path,
    place: Place,
    prefix: &str,
    contents: &mut Contents,
) -> Result<bool, Error> {
    let mut all_ours = true;
    for name in directory.names()? {
        let (below, text) = (path.join(&name), name.to_str().unwrap_or_default());
        let inner = match directory.kind(Path::new(&name)) {
            EntryKind::Gone => continue,
            // It goes last.
            EntryKind::File { .. } if place == Place::Instance && text == MARK => continue,
            EntryKind::File { .. } if file_is_ours(place, text, prefix) => {
                contents.files.push(below);
                continue;
            }
            EntryKind::Directory => place_below(place, text),
            EntryKind::File { .. } | EntryKind::Foreign => None,
        };
        if let Some(place) = inner {
            if let Some(inner) = directory.open_below(Path::new(&name))? {
                all_ours &= sort_entries(&inner, &below, place, prefix, contents)?;
            }
        } else {
            all_ours = false;
            contents.foreign.push(below);
        }
    }
    if all_ours && place != Place::Instance {
        contents.directories.push(path.to_owned());
    }
    Ok(all_ours)
}
