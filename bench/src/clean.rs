//! `ironbird clean`: removes what killed processes left, and says what it removed.

use shared::instance::{Instance, root_path};
use shared::wire::Wire;

use crate::failure::{Failure, OK};

/// Removes leftovers of every instance.
///
/// # Errors
/// [`Failure`] names what resisted.
pub fn clean() -> Result<u8, Failure> {
    let instances = Instance::known();
    let mut anything = false;
    for instance in &instances {
        if instance.is_alive() {
            // Others of it live: only the remains of dead processes go.
            let wire = Wire::open(instance)?;
            println!("instance `{}` is alive; removed the remains of {} dead processes", instance.name(), wire.cleaned);
            anything = true;
            continue;
        }
        for path in instance.remove_leftovers()? {
            println!("removed {}", path.display());
            anything = true;
        }
    }
    if !anything {
        println!("nothing to remove under {} and in /dev/shm", root_path().display());
    }
    Ok(OK)
}
