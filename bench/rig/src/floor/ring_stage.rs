//! `ironbird ring-hop`: one process of the ring, started by the measuring process.

use ipc::clock::now_ns;
use process::rt::take_stand;
use process::signals::end_with_launcher;

use crate::cli::HopArgs;
use errors::{Failure, OK};
use host::floor::link::{END, Link};
use host::floor::work::Work;

/// Passes the token on until the ring ends.
pub fn run(args: &HopArgs) -> Result<u8, Failure> {
    end_with_launcher(Some(args.launcher))?;
    let mut link = Link::inherited(args.wake, args.position, args.processes)?;
    let work = Work {
        iterations: args.work,
    };
    let standing = take_stand(args.cpu, args.priority);
    if standing.priority != args.priority {
        return Err(Failure::failed(format!(
            "a process of the ring: {}",
            standing.refused.join(", ")
        )));
    }
    while link.wait(None)? != END {
        work.run();
        link.ring(now_ns())?;
    }
    Ok(OK)
}
