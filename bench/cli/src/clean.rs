//! `ironbird clean`: removes what killed processes left behind, and lists it.

use std::{fs, io};

use ipc::Wire;
use ipc::instance::{Instance, root_path};

use crate::cli::CleanArgs;
use errors::output::print;
use errors::{Failure, InFile as _, OK};
use host::trace;
use recorder::kernel_trace;

pub fn clean(CleanArgs { dry_run, .. }: CleanArgs) -> Result<u8, Failure> {
    let (removed, kept) = match dry_run {
        true => ("would remove", "would keep"),
        false => ("removed", "kept"),
    };
    let root = root_path();
    match fs::read_dir(&root) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e).in_file("look into", &root)?,
        _ => {}
    }
    let mut text = String::new();
    for instance in Instance::known() {
        let name = instance.name();
        if instance.is_alive() {
            // Some of its processes still run: only the remains of dead ones are removed.
            let number = match dry_run {
                true => String::new(),
                false => format!("{} ", Wire::open(&instance)?.cleaned),
            };
            text += &format!(
                "instance `{name}` is alive; {removed} the remains of {number}dead processes\n"
            );
        } else {
            let paths = match dry_run {
                true => instance.leftovers(),
                false => instance.remove_leftovers()?,
            };
            for path in paths {
                text += &format!("{removed} {}\n", path.display());
            }
        }
        for path in instance.foreign() {
            text += &format!("{kept} {}: not created by ironbird\n", path.display());
        }
        if let Some(refusal) = instance.refusal() {
            text += &format!("{kept} the shared memory of instance `{name}`: {refusal}\n");
        }
    }
    for ring in kernel_trace::leftovers() {
        let result = match dry_run {
            true => Ok(()),
            false => trace::remove_left(&ring),
        };
        text += &match result {
            Ok(()) => format!("{removed} the kernel's trace {ring}\n"),
            Err(e) => format!("{kept} the kernel's trace {ring}: {e}\n"),
        };
    }
    if text.is_empty() {
        let root = root.display();
        text = format!("nothing to remove under {root} and in /dev/shm\n");
    }
    print(&text)?;
    Ok(OK)
}
