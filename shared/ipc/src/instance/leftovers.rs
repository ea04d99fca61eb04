//! Finds what killed processes left of an instance, and removes it file by file.
//!
//! It removes only what is below a directory with our mark and has one of our names: our locks, and the middleware's
//! files with the instance's prefix. A directory is removed when it is empty.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use rustix::fs::AtFlags;

use super::directory::{Directory, EntryKind, not_ours};
use super::locks::{Door, IN_USE, LAUNCHER, is_marked, lock_name, try_lock};
use super::root::root;
use super::{Instance, MARK, SHARED_MEMORY, shared_memory};
use crate::error::Error;
use messages::role::{ROLES, Role};

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

/// Where a directory stands, which says what may lie in it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    Instance,
    Services,
    Nodes,
    Node,
}

/// Whether a file of this name may be ours, or which place a directory of this name is.
fn file_is_ours(place: Place, name: &str, prefix: &str) -> bool {
    match place {
        Place::Instance => {
            let mut roles = ROLES
                .iter()
                .map(|role| role.name())
                .chain([LAUNCHER, IN_USE]);
            roles.any(|role| lock_name(role) == name)
        }
        // Service files; node monitors; what a node is, what it uses.
        Place::Services | Place::Nodes | Place::Node => name.starts_with(prefix),
    }
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
        Self::known()
            .into_iter()
            .filter(|instance| instance.is_occupied(Role::Plant))
            .collect()
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
        let is_ours = |name: &String| {
            open(&root.join(name))
                .is_some_and(|directory| directory.check_private().is_ok() && is_marked(&directory))
        };
        let beginning = Self::prefix_of_root(&root);
        let of_segment = |name: String| {
            let (name, _) = name.strip_prefix(&beginning)?.split_once('.')?;
            Some(name.to_owned())
        };
        let directories = list(open(&root)).filter(is_ours);
        let segments = list(shared_memory().ok().flatten()).filter_map(of_segment);
        let mut names: Vec<String> = directories.chain(segments).collect();
        names.sort();
        names.dedup();
        names
            .iter()
            .filter_map(|name| Self::under(&root, name).ok())
            .collect()
    }

    /// What is left of the instance when no process lives that uses it: its segments in shared memory, then its
    /// directory, or what of it is ours.
    pub fn leftovers(&self) -> Vec<PathBuf> {
        match self.door_of_ours() {
            Ok(Some(door)) if !self.is_used(&door) => self
                .contents(&door)
                .map(|all| self.paths(&all))
                .unwrap_or_default(),
            // Whoever removed the directory left the segments.
            Ok(None) if self.has_no_directory() => self.paths_of_segments(),
            _ => Vec::new(),
        }
    }

    /// What lies in its directory and is not ours: it stays.
    pub fn foreign(&self) -> Vec<PathBuf> {
        let Ok(Some(door)) = self.door_of_ours() else {
            return Vec::new();
        };
        let foreign = self.contents(&door).unwrap_or_default().foreign;
        foreign
            .iter()
            .map(|path| self.directory().join(path))
            .collect()
    }

    /// Why nothing is removed of an instance that has segments in shared memory: its directory is not to be used.
    pub fn refusal(&self) -> Option<Error> {
        if self.has_no_directory() || self.segments().is_empty() {
            return None;
        }
        let directory = match Directory::open(&self.directory()) {
            Ok(directory) => directory?,
            Err(refusal) => return Some(refusal),
        };
        let unmarked = || {
            not_ours(
                self.directory(),
                "it has lost the mark that ironbird made it",
            )
        };
        directory
            .check_private()
            .err()
            .or_else(|| (!is_marked(&directory)).then(unmarked))
    }

    /// Removes what is left of the instance when no process lives that uses it, and says what it removed.
    pub fn remove_leftovers(&self) -> Result<Vec<PathBuf>, Error> {
        let mut removed = Vec::new();
        if self.has_no_directory() {
            // Whoever removed it left the segments.
            removed = self.paths_of_segments();
            if removed.is_empty() {
                return Ok(removed);
            }
            self.prepare()?;
        }
        // Nobody comes meanwhile.
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
        let is_free = |file: Option<File>| {
            file.map_or(Ok(true), |file| {
                try_lock(&file, &self.directory().join(&name))
            })
        };
        // Where that cannot be seen, it may be.
        self.is_alive()
            || !door
                .directory
                .file(&name)
                .and_then(is_free)
                .unwrap_or(false)
    }

    fn has_no_directory(&self) -> bool {
        self.directory()
            .symlink_metadata()
            .is_err_and(|e| e.kind() == io::ErrorKind::NotFound)
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
    /// A node has a share from before it makes a service, so that `living` nodes are asked for after the services were
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
        let found: Vec<_> = services
            .names()?
            .into_iter()
            .filter_map(|name| name.into_string().ok())
            .filter(|name| name.starts_with(&prefix))
            .map(|name| (services.identity(Path::new(&name)), name))
            .collect();
        let living = living();
        let has_share = |node: &String, share: &Path| {
            door.directory
                .kind(&Path::new(NODES).join(node).join(share))
                != EntryKind::Gone
        };
        for (identity, name) in found {
            let Some(service) = name.strip_suffix(".service") else {
                continue;
            };
            let share = PathBuf::from(format!("{service}.service_tag"));
            let name = Path::new(&name);
            if !living.iter().any(|node| has_share(node, &share))
                && services.identity(name) == identity
            {
                services.remove(name, AtFlags::empty())?;
            }
        }
        Ok(())
    }

    fn paths(&self, contents: &Contents) -> Vec<PathBuf> {
        let directory = self.directory();
        let rest = if contents.foreign.is_empty() {
            vec![directory]
        } else {
            contents
                .files
                .iter()
                .map(|path| directory.join(path))
                .collect()
        };
        self.paths_of_segments().into_iter().chain(rest).collect()
    }

    fn paths_of_segments(&self) -> Vec<PathBuf> {
        self.segments()
            .into_iter()
            .map(|name| Path::new(SHARED_MEMORY).join(name))
            .collect()
    }

    pub(super) fn contents(&self, door: &Door) -> Result<Contents, Error> {
        let mut contents = Contents::default();
        look_into(
            &door.directory,
            Path::new(""),
            Place::Instance,
            &self.prefix(),
            &mut contents,
        )?;
        if !is_marked(&door.directory) {
            // Without our mark, a name proves nothing.
            let (ours, foreign) = contents
                .files
                .into_iter()
                .partition(|path| may_be_a_lock(&door.directory, path));
            contents.files = ours;
            contents.foreign.extend::<Vec<_>>(foreign);
        }
        Ok(contents)
    }

    /// Names of its segments in shared memory: regular files of this user with its prefix.
    pub(super) fn segments(&self) -> Vec<OsString> {
        self.in_shared_memory(|kind| matches!(kind, EntryKind::File { .. }))
    }

    /// Refuses shared memory in which somebody else uses the instance's prefix.
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

/// Whether a file holds what a lock does: a process number, or nothing.
fn may_be_a_lock(directory: &Directory, path: &Path) -> bool {
    const LONGEST: u64 = 32;
    let Some(file) = path
        .to_str()
        .and_then(|name| directory.file(name).ok().flatten())
    else {
        return false;
    };
    let mut bytes = Vec::new();
    file.take(LONGEST).read_to_end(&mut bytes).is_ok()
        && bytes
            .iter()
            .all(|byte| byte.is_ascii_digit() || *byte == b'\n')
}

/// Sorts what lies in a directory; says whether all of it is ours.
fn look_into(
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
                all_ours &= look_into(&inner, &below, place, prefix, contents)?;
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
