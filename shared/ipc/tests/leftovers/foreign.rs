//! What ironbird has not made: it stays, wherever it lies, and is named.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::{chown, symlink};
use std::path::Path;

use ipc::Wire;
use ipc::instance::SHARED_MEMORY;

use crate::common::Site;
use crate::{hold_everything_and_be_killed, segments};

const OTHER_USER: u32 = 65534;

#[test]
fn in_shared_memory_only_files_of_this_user_are_removed() {
    let site = Site::new();
    hold_everything_and_be_killed(&site.instance);
    let ours = segments(&site.instance);
    let name =
        |what: &str| Path::new(SHARED_MEMORY).join(format!("{}{what}", site.instance.prefix()));
    symlink("/nowhere", name("link")).unwrap();
    fs::create_dir(name("directory")).unwrap();
    fs::write(name("file"), "of another user").unwrap();
    let is_of_other_user = chown(name("file"), Some(OTHER_USER), Some(OTHER_USER)).is_ok();
    let removed = BTreeSet::from_iter(site.instance.remove_leftovers().unwrap());
    let exists = |what| name(what).symlink_metadata().is_ok();
    let kept = ["link", "directory", "file"].map(exists);
    let refused = Wire::open(&site.instance).map(drop);
    fs::remove_file(name("link")).unwrap();
    fs::remove_dir(name("directory")).unwrap();
    let _ = fs::remove_file(name("file"));
    assert!(ours.is_subset(&removed) && ours.iter().all(|path| !path.exists()));
    assert_eq!(kept, [true, true, is_of_other_user]);
    let error = refused.unwrap_err();
    assert!(
        error
            .to_string()
            .contains("it has a name of this instance, and is no file of this user"),
        "{error}"
    );
    drop(site.wire());
}
