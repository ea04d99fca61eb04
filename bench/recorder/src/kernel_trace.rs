//! The kernel's scheduler trace of the loops' CPU during a flight.

use std::io::ErrorKind;

use errors::Failure;
use host::trace::{self, TRACEFS, Trace};
use ipc::instance::Instance;

/// Starts the trace if `is_requested`.
pub fn start(
    is_requested: bool,
    instance: &Instance,
    processor: Option<u64>,
) -> Result<Option<Trace>, Failure> {
    let begin = || Trace::begin(&ring_of(instance), processor).map_err(|e| refused(&e));
    is_requested.then(begin).transpose()
}

/// Checks whether this machine permits a trace.
pub fn check(is_requested: bool) -> Result<(), Failure> {
    if !is_requested {
        return Ok(());
    }
    // `clean` recognizes this name if this process is killed meanwhile.
    let name = format!("{}try-{}", Instance::root_prefix()?, std::process::id());
    Trace::begin(&name, None).map(drop).map_err(|e| refused(&e))
}

/// The name of an instance's ring buffer, distinct for instances of one name under two roots.
fn ring_of(instance: &Instance) -> String {
    instance.prefix().trim_end_matches('.').to_owned()
}

/// Removes what the processes of an instance left, if none of them lives. What cannot be removed is found by the next
/// start, or by `ironbird clean`, which names it.
pub fn remove_leftovers(instance: &Instance) {
    let _ = instance.remove_leftovers();
    // Not if a program reads it.
    let _ = trace::remove_left(&ring_of(instance));
}

/// Ring buffers under this root without a running instance.
pub fn leftovers() -> Vec<String> {
    let alive: Vec<String> = Instance::known()
        .iter()
        .filter(|it| it.is_alive())
        .map(ring_of)
        .collect();
    let rings = Instance::root_prefix()
        .map(|prefix| trace::rings(&prefix))
        .unwrap_or_default();
    rings
        .into_iter()
        .filter(|ring| !alive.contains(ring))
        .collect()
}

fn refused(error: &std::io::Error) -> Failure {
    let failure = Failure::failed(format!("cannot trace the loops' processor: {error}"));
    if error.kind() == ErrorKind::AlreadyExists {
        return failure
            .help("another program reads the trace that a killed flight left behind; end that program, or fly without --trace");
    }
    failure.help(format!(
        "as root: mount -t tracefs nodev {TRACEFS}, then fly as root, or `chgrp -R` it to one of your groups; without root, \
         fly without --trace: the report then derives causes from counters only"
    ))
}
