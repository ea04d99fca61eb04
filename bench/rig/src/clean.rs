//! `ironbird clean`: removes what killed processes left behind, and lists it.

use ipc::Wire;
use ipc::instance::{Instance, root_path};

use crate::cli::CleanArgs;
use crate::output::print;
use crate::record::kernel_trace;
use errors::{Failure, OK};
use host::trace;

pub fn clean(args: CleanArgs) -> Result<u8, Failure> {
    let mut text = String::new();
    for instance in Instance::known() {
        text += &if args.dry_run {
            announce(&instance)
        } else {
            remove(&instance)?
        };
        for path in instance.foreign() {
            let kept = if args.dry_run { "would keep" } else { "kept" };
            text += &format!("{kept} {}: not created by ironbird\n", path.display());
        }
        if let Some(refusal) = instance.refusal() {
            let (kept, name) = (
                if args.dry_run { "would keep" } else { "kept" },
                instance.name(),
            );
            text += &format!("{kept} the shared memory of instance `{name}`: {refusal}\n");
        }
    }
    for ring in kernel_trace::leftovers() {
        text += &if args.dry_run {
            format!("would remove the kernel's trace {ring}\n")
        } else {
            trace::remove_left(&ring).map_or_else(
                |e| format!("kept the kernel's trace {ring}: {e}\n"),
                |()| format!("removed the kernel's trace {ring}\n"),
            )
        };
    }
    if text.is_empty() {
        text = format!(
            "nothing to remove under {} and in /dev/shm\n",
            root_path().display()
        );
    }
    print(&text)?;
    Ok(OK)
}

fn remove(instance: &Instance) -> Result<String, Failure> {
    if instance.is_alive() {
        // Some of its processes still run: only the remains of dead ones are removed.
        let wire = Wire::open(instance)?;
        let (name, cleaned) = (instance.name(), wire.cleaned);
        return Ok(format!(
            "instance `{name}` is alive; removed the remains of {cleaned} dead processes\n"
        ));
    }
    Ok(instance
        .remove_leftovers()?
        .iter()
        .map(|path| format!("removed {}\n", path.display()))
        .collect())
}

fn announce(instance: &Instance) -> String {
    if instance.is_alive() {
        return format!(
            "instance `{}` is alive; would remove the remains of dead processes\n",
            instance.name()
        );
    }
    instance
        .leftovers()
        .iter()
        .map(|path| format!("would remove {}\n", path.display()))
        .collect()
}
