//! How a process of the ring waits and wakes the next one: by eventfd or by futex.

use std::os::fd::{AsFd as _, OwnedFd};
use std::process::Stdio;
use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::ValueEnum;
use ipc::clock::timespec;
use ipc::sys::WakePage;
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::io::Errno;
use rustix::thread::futex;

use errors::Failure;

/// What wakes the next process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WakeMechanism {
    /// A counter of the kernel: one `write` to ring, one `read` to wait.
    Eventfd,
    /// A word in shared memory: one `futex` call to ring, one to wait.
    Futex,
}

/// Ends the ring in the place of a token; the largest number that an eventfd takes.
pub const END: u64 = u64::MAX - 1;

/// The place of a process in the ring: what it waits on and what it rings.
#[derive(Debug)]
pub enum Link {
    Eventfd {
        own: OwnedFd,
        next: OwnedFd,
    },
    /// Two bells of a shared page.
    Futex {
        page: WakePage,
        /// Number of the bell waited on.
        own: usize,
        next: usize,
        /// How often the own bell had rung when it was last heard.
        heard: u32,
    },
}

fn failed(what: &str) -> impl Fn(Errno) -> Failure {
    move |e| Failure::failed(format!("{what}: {e}"))
}

impl Link {
    /// The link of a process that was started by [`Links::of`]: its end of the ring are its standard streams.
    pub fn inherited(
        wake: WakeMechanism,
        position: usize,
        processes: usize,
    ) -> Result<Self, Failure> {
        let not_ours = |e| {
            Failure::usage(format!(
                "standard input and output are no link of a ring: {e}"
            ))
            .help("`ironbird doctor` starts these processes by itself")
        };
        let (stdin, stdout) = (std::io::stdin(), std::io::stdout());
        match wake {
            WakeMechanism::Eventfd => Ok(Self::Eventfd {
                own: stdin.as_fd().try_clone_to_owned().map_err(not_ours)?,
                next: stdout.as_fd().try_clone_to_owned().map_err(not_ours)?,
            }),
            WakeMechanism::Futex => {
                let page = WakePage::map(stdin.as_fd()).map_err(not_ours)?;
                Ok(Self::Futex {
                    page,
                    own: position,
                    next: (position + 1) % processes,
                    heard: 0,
                })
            }
        }
    }

    /// Hands a token to the next process.
    pub fn ring(&self, token: u64) -> Result<(), Failure> {
        match self {
            Self::Eventfd { next, .. } => rustix::io::write(next, &token.to_ne_bytes())
                .map(|_| ())
                .map_err(failed("cannot ring an eventfd")),
            Self::Futex { page, next, .. } => {
                let bell = &page[*next];
                bell.token.store(token, Ordering::Relaxed);
                bell.rung.fetch_add(1, Ordering::Release);
                futex::wake(&bell.rung, futex::Flags::empty(), 1)
                    .map(|_| ())
                    .map_err(failed("cannot wake a futex"))
            }
        }
    }

    /// Waits for a token, for ever or until the patience is at its end.
    pub fn wait(&mut self, patience: Option<Duration>) -> Result<u64, Failure> {
        let patience = patience
            .map(|patience| timespec(u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX)));
        let silent = || Failure::failed("a process of the ring hangs or has died");
        match self {
            Self::Eventfd { own, .. } => {
                if let Some(patience) = patience {
                    let ready = poll(&mut [PollFd::new(own, PollFlags::IN)], Some(&patience));
                    if ready.map_err(failed("cannot wait for an eventfd"))? == 0 {
                        return Err(silent());
                    }
                }
                let mut token = [0; 8];
                let read =
                    rustix::io::read(own, &mut token).map_err(failed("cannot read an eventfd"))?;
                if read < token.len() {
                    Err(silent())
                } else {
                    Ok(u64::from_ne_bytes(token))
                }
            }
            Self::Futex {
                page, own, heard, ..
            } => {
                let bell = &page[*own];
                loop {
                    let rung = bell.rung.load(Ordering::Acquire);
                    if rung != *heard {
                        *heard = rung;
                        return Ok(bell.token.load(Ordering::Relaxed));
                    }
                    match futex::wait(&bell.rung, futex::Flags::empty(), rung, patience.as_ref()) {
                        Ok(()) | Err(Errno::AGAIN | Errno::INTR) => {}
                        Err(Errno::TIMEDOUT) => return Err(silent()),
                        Err(e) => return Err(failed("cannot wait for a futex")(e)),
                    }
                }
            }
        }
    }
}

/// Every link of a ring, in the process that starts the others.
#[derive(Debug)]
pub enum Links {
    Eventfd(Vec<OwnedFd>),
    /// A page with a bell per process.
    Futex {
        /// Its file, which each process maps.
        file: OwnedFd,
        processes: usize,
    },
}

impl Links {
    /// Makes the links of a ring of `processes`.
    pub fn new(wake: WakeMechanism, processes: usize) -> Result<Self, Failure> {
        match wake {
            WakeMechanism::Eventfd => (0..processes)
                .map(|_| {
                    eventfd(0, EventfdFlags::CLOEXEC).map_err(failed("cannot make an eventfd"))
                })
                .collect::<Result<_, _>>()
                .map(Self::Eventfd),
            WakeMechanism::Futex => {
                let memory = failed("cannot make a memory file");
                let file = memfd_create(
                    "ironbird-ring",
                    MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING,
                )
                .map_err(&memory)?;
                ftruncate(&file, WakePage::BYTES as u64).map_err(&memory)?;
                fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)
                    .map_err(&memory)?;
                Ok(Self::Futex { file, processes })
            }
        }
    }

    /// The link of the process that made them, the first of the ring.
    pub fn first(&self) -> Result<Link, Failure> {
        match self {
            Self::Eventfd(counters) => Ok(Link::Eventfd {
                own: clone(&counters[0])?,
                next: clone(&counters[1])?,
            }),
            Self::Futex { file, .. } => {
                let page = WakePage::map(file.as_fd())
                    .map_err(|e| Failure::failed(format!("cannot map a memory file: {e}")))?;
                Ok(Link::Futex {
                    page,
                    own: 0,
                    next: 1,
                    heard: 0,
                })
            }
        }
    }

    /// Standard input and output of another process of the ring.
    pub fn of(&self, position: usize) -> Result<(Stdio, Stdio), Failure> {
        Ok(match self {
            Self::Eventfd(counters) => {
                let next = (position + 1) % counters.len();
                (
                    clone(&counters[position])?.into(),
                    clone(&counters[next])?.into(),
                )
            }
            Self::Futex { file, .. } => (clone(file)?.into(), Stdio::null()),
        })
    }

    #[must_use]
    pub const fn wake(&self) -> WakeMechanism {
        match self {
            Self::Eventfd(_) => WakeMechanism::Eventfd,
            Self::Futex { .. } => WakeMechanism::Futex,
        }
    }

    #[must_use]
    pub const fn processes(&self) -> usize {
        match self {
            Self::Eventfd(counters) => counters.len(),
            Self::Futex { processes, .. } => *processes,
        }
    }
}

fn clone(descriptor: &OwnedFd) -> Result<OwnedFd, Failure> {
    descriptor
        .try_clone()
        .map_err(|e| Failure::failed(format!("cannot duplicate a descriptor: {e}")))
}
