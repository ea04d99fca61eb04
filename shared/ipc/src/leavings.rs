//! What dead processes left in the middleware, removed before it does any harm.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use iceoryx2::node::{CleanupState, NodeState};
use iceoryx2::prelude::{CallbackProgression, Config, Node, ipc};

use crate::error::Error;
use crate::instance::{Instance, Lock};

/// How long processes that were killed may take to be gone, and how often that is looked for.
const DYING: Duration = Duration::from_millis(200);
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// How long somebody else may take to remove what a dead process left.
const REMOVING: Duration = Duration::from_secs(1);

/// Comes to use the shared memory of an instance: alone, where all others that it was left by are dead.
///
/// Of several processes that are killed, the last one may still be dying.
pub(super) fn enter(instance: &Instance, config: &Config) -> Result<Lock, Error> {
    let start = Instant::now();
    loop {
        let in_use = instance.enter()?;
        if nodes(config).1 == 0 || start.elapsed() >= DYING {
            return Ok(in_use);
        }
        drop(in_use);
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Removes what dead processes left beside living ones; says how many there were.
pub(super) fn remove(node: &Node<ipc::Service>, instance: &Instance) -> u64 {
    if nodes(node.config()).1 == 0 {
        return 0;
    }
    let CleanupState {
        cleanups,
        failed_cleanups,
    } = node.blocking_cleanup_dead_nodes(REMOVING);
    cleanups + remove_rest(node, instance, failed_cleanups)
}

/// The same without a look for services that were being made: each look at all nodes takes its time.
pub(super) fn remove_of_ports(node: &Node<ipc::Service>, instance: &Instance) {
    let failed = node.blocking_cleanup_dead_nodes(REMOVING).failed_cleanups;
    if failed > 0 {
        remove_rest(node, instance, failed);
    }
}

fn remove_rest(node: &Node<ipc::Service>, instance: &Instance, failed_cleanups: u64) -> u64 {
    remove_half_made(node, instance);
    // The middleware may not have come past such a service.
    if failed_cleanups == 0 {
        0
    } else {
        node.blocking_cleanup_dead_nodes(REMOVING).cleanups
    }
}

/// Removes services that their makers died over, of which the middleware thinks that they are still being made.
pub(super) fn remove_half_made(node: &Node<ipc::Service>, instance: &Instance) {
    // What resists is in the way of whoever opens it, who says so.
    let _ = instance.remove_orphans(|| nodes(node.config()).0);
}

/// Names of the nodes that may be alive, and the number of those that are dead.
fn nodes(config: &Config) -> (BTreeSet<String>, u64) {
    let (mut living, mut dead) = (BTreeSet::new(), 0);
    // Where they cannot be listed, nothing is removed.
    let _ = Node::<ipc::Service>::list(config, |state| {
        match state {
            NodeState::Dead(_) => dead += 1,
            state => {
                living.insert(state.node_id().value().to_string());
            }
        }
        CallbackProgression::Continue
    });
    (living, dead)
}
