//! Findings about memory: locking, size of shared memory, and leftovers in it.

use ipc::Wire;

use crate::doctor::kernel::LIMITS;
use crate::{Machine, shared_memory_path};
use report::finding::Finding;

/// What the role with most memory locks [bytes]: address space, which is what the limit counts.
const LOCKED_BYTES: u64 = 192 << 20;
const MIB: u64 = 1 << 20;
const CAP_IPC_LOCK: u32 = 14;

#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    vec![lock(machine), space(machine), leftovers(machine)]
}

fn lock(machine: &Machine) -> Finding {
    let why = "a page that the kernel has taken back is a page fault in the middle of a tick";
    if machine.has_capability(CAP_IPC_LOCK) {
        return Finding::ok("memory lock", "without limit (CAP_IPC_LOCK)", why);
    }
    match machine.limit("Max locked memory") {
        Some(limit) if limit < LOCKED_BYTES => Finding::ok(
            "memory lock",
            format!(
                "RLIMIT_MEMLOCK {} MiB, a loop needs up to {} MiB",
                limit / MIB,
                LOCKED_BYTES / MIB
            ),
            why,
        )
        .softens(LIMITS),
        Some(limit) => Finding::ok(
            "memory lock",
            format!("RLIMIT_MEMLOCK {} MiB", limit / MIB),
            why,
        ),
        None => Finding::ok("memory lock", "RLIMIT_MEMLOCK unlimited", why),
    }
}

fn space(machine: &Machine) -> Finding {
    let path = shared_memory_path();
    let why = "messages lie there; where it is full, the first touch of a page kills the process";
    let needed = Wire::needed_bytes();
    match machine.answers.shared_memory_free_bytes {
        None => Finding::ok("shared memory", format!("{path} is not there"), why)
            .blocks(format!("sudo mount -t tmpfs -o size=256M tmpfs {path}")),
        Some(free) => {
            let found = format!(
                "{} MiB free in {path}, a flight needs {}",
                free / MIB,
                needed.div_ceil(MIB)
            );
            let finding = Finding::ok("shared memory", found, why);
            if free < needed {
                finding.blocks(format!(
                    "sudo mount -o remount,size=256M {path} (docker: --shm-size 256m)"
                ))
            } else {
                finding
            }
        }
    }
}

fn leftovers(machine: &Machine) -> Finding {
    let why =
        "what killed processes left takes up shared memory until the next flight of the same name";
    match machine.answers.leftovers.as_slice() {
        [] => Finding::ok("leftovers", "none", why),
        [first, others @ ..] => {
            let more = if others.is_empty() {
                String::new()
            } else {
                format!(" and {} more", others.len())
            };
            Finding::ok("leftovers", format!("{}{more}", first.display()), why)
                .could_be_better("ironbird clean")
        }
    }
}
