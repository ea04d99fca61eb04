//! The kernel's trace of the loops' processor beside a flight.

use std::io::ErrorKind;

use failure::Failure;
use machine::trace::{self, TRACEFS, Trace};
use report::autopsy::runners::Slice;
use wire::instance::Instance;

/// The trace, where it is asked for.
#[derive(Debug, Default)]
pub struct Traced(Option<Trace>);

impl Traced {
    /// Starts it, if it is asked for.
    ///
    /// # Errors
    /// [`Failure`] names what the kernel refuses, and what to do.
    pub fn begin(is_asked: bool, instance: &Instance, processor: Option<u64>) -> Result<Self, Failure> {
        let begin = || Trace::begin(&ring_of(instance), processor).map_err(|e| refused(&e));
        is_asked.then(begin).transpose().map(Self)
    }

    /// What ran since the last time. A trace that can no longer be read explains nothing more, and ends.
    ///
    /// # Errors
    /// [`Failure`] names what the kernel refuses, once.
    pub fn take(&mut self) -> Result<Vec<Slice>, Failure> {
        let Some(trace) = &mut self.0 else { return Ok(Vec::new()) };
        trace.take().map_err(|e| {
            self.0 = None;
            Failure::failed(format!("cannot read it: {e}"))
        })
    }
}

/// Whether a flight can be traced here.
///
/// # Errors
/// [`Failure`] names what the kernel refuses, and what to do.
pub fn check(is_asked: bool) -> Result<(), Failure> {
    if !is_asked {
        return Ok(());
    }
    // A name that `clean` knows, where this is killed meanwhile.
    let name = format!("{}try-{}", Instance::root_prefix()?, std::process::id());
    Trace::begin(&name, None).map(drop).map_err(|e| refused(&e))
}

/// The name of an instance's ring; instances of one name under two roots stay apart.
fn ring_of(instance: &Instance) -> String {
    instance.prefix().trim_end_matches('.').to_owned()
}

/// Removes the ring that a killed recorder of an instance has left; one that is being read stays.
pub fn remove_left(instance: &Instance) {
    let _ = trace::remove_left(&ring_of(instance));
}

/// The rings of this root's instances that do not live.
#[must_use]
pub fn left() -> Vec<String> {
    let alive: Vec<String> = Instance::known().iter().filter(|it| it.is_alive()).map(ring_of).collect();
    let rings = Instance::root_prefix().map(|prefix| trace::rings(&prefix)).unwrap_or_default();
    rings.into_iter().filter(|ring| !alive.contains(ring)).collect()
}

/// What is said where the kernel traces nothing for us.
fn refused(error: &std::io::Error) -> Failure {
    let failure = Failure::failed(format!("cannot trace the loops' processor: {error}"));
    if error.kind() == ErrorKind::AlreadyExists {
        return failure
            .help("somebody reads the trace that a killed flight has left; end that program, or fly without --trace");
    }
    failure.help(format!(
        "as root: mount -t tracefs nodev {TRACEFS}, and fly as root or `chgrp -R` it to a group of yours; without root, \
         fly without --trace: the report then tells causes from counters alone"
    ))
}
