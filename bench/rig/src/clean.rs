//! `ironbird clean`: removes what killed processes left, and says what it removed.

use wire::Wire;
use wire::instance::{Instance, root_path};

use crate::output::print;
use failure::{Failure, OK};

/// Removes leftovers of every instance.
///
/// # Errors
/// [`Failure`] names what resisted.
pub fn clean() -> Result<u8, Failure> {
    let instances = Instance::known();
    let mut text = String::new();
    for instance in &instances {
        if instance.is_alive() {
            // Others of it live: only the remains of dead processes go.
            let wire = Wire::open(instance)?;
            text += &format!(
                "instance `{}` is alive; removed the remains of {} dead processes\n",
                instance.name(),
                wire.cleaned
            );
            continue;
        }
        for path in instance.remove_leftovers()? {
            text += &format!("removed {}\n", path.display());
        }
    }
    if text.is_empty() {
        text = format!("nothing to remove under {} and in /dev/shm\n", root_path().display());
    }
    print(&text)?;
    Ok(OK)
}
