//! The processes of a flight as children of the supervisor: how they are started, signalled, waited for and named.

use std::fs::File;
use std::io::{Read as _, Seek as _};
use std::os::fd::{AsFd as _, OwnedFd};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ipc::clock::{now_ns, timespec};
use messages::role::{Channel, Replica, Role};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io;
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, kill_process, kill_process_group, pidfd_open,
    pidfd_send_signal, waitid,
};

use errors::{Failure, InFile as _};
use recorder::run_directory::RunDirectory;

/// How long processes may take to end after a request.
pub(super) const STOP_TIMEOUT: Duration = Duration::from_secs(5);
/// How long processes may take to end after the flight: longer than a recorder waits for a disk that does not respond.
pub(super) const LANDING_TIMEOUT: Duration = Duration::from_secs(30);

const LOOK_EVERY: Duration = Duration::from_millis(10);
/// Most of a program's output that is read.
const MOST_OUTPUT: u64 = 16 << 20;

/// What messages call the process of a role.
pub(super) fn title(replica: Replica) -> String {
    let Replica { role, channel } = replica;
    match (role, channel) {
        (Role::Record, _) => "recorder".into(),
        (_, Channel::A) => format!("{role} process"),
        _ => format!("{role} process of channel {channel}"),
    }
}

/// The file that receives the standard error of a role's processes.
pub(super) fn log_path(directory: &Path, replica: Replica) -> PathBuf {
    directory.join(format!("{replica}.log"))
}

pub(super) struct Spawner {
    pub(super) executable: PathBuf,
    pub(super) instance: String,
    pub(super) settings_file: PathBuf,
    pub(super) directory: PathBuf,
    pub(super) states: Option<PathBuf>,
    /// Processors that a flight may use, if this process keeps to some of them.
    pub(super) allowed_cpus: Vec<usize>,
}

impl Spawner {
    /// Starts a role; a recorder writes into `recording`. The log of the role is appended to.
    pub(super) fn start(
        &self,
        replica: Replica,
        recording: &RunDirectory,
    ) -> Result<Child, Failure> {
        let mut command = self.command(replica)?;
        command.stdin(Stdio::null());
        if replica.role == Role::Record {
            let memory = recording.memory.try_clone();
            command.stdin(memory.in_file("record into", &recording.path)?);
            command.arg("--run-dir").arg(&recording.path);
            // Only the first recorder writes the file of --states, which begins with the flight.
            let is_first = recording.path == self.directory;
            if let Some(states) = self.states.as_ref().filter(|_| is_first) {
                command.arg("--states").arg(states);
            }
        }
        command.spawn().map_err(|e| {
            let title = title(replica);
            Failure::failed(format!("cannot start the {title}: {e}")).help(
                "a flight has five processes of some threads each, and three more for each further channel: see \
                 `ulimit -u` and `ulimit -v`",
            )
        })
    }

    fn command(&self, replica: Replica) -> Result<Command, Failure> {
        let log_path = log_path(&self.directory, replica);
        let log = File::options()
            .create(true)
            .append(true)
            .open(&log_path)
            .in_file("write", &log_path)?;
        let mut command = process::signals::child(&self.executable, replica.role.name());
        command
            .args((replica.channel != Channel::A).then(|| format!("--channel={}", replica.channel)))
            .arg("--config")
            .arg(&self.settings_file)
            .args(["--instance", &self.instance])
            .envs(plugin::answers())
            .args((!self.allowed_cpus.is_empty()).then(|| {
                let cpus: Vec<String> = self.allowed_cpus.iter().map(usize::to_string).collect();
                format!("--allowed-cpus={}", cpus.join(","))
            }))
            .stdout(Stdio::null())
            .stderr(log)
            // Ctrl-C in a terminal reaches the supervisor alone, which then ends the roles in order.
            .process_group(0);
        Ok(command)
    }
}

/// Children that have not been reaped: signals reach them and no other process, and their ends end a wait.
#[derive(Default)]
pub(super) struct ChildWatch(Vec<Watched>);

struct Watched {
    pid: u32,
    /// The kernel makes it readable when the process has ended. `None` before Linux 5.3, or without a free descriptor.
    descriptor: Option<OwnedFd>,
    has_ended: bool,
}

impl ChildWatch {
    pub(super) fn watch(&mut self, child: &Child) {
        let descriptor =
            pid_of(child.id()).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        self.0.push(Watched {
            pid: child.id(),
            descriptor,
            has_ended: false,
        });
    }

    /// Sends a signal to a child. Fails if the child has ended. All signals but SIGKILL also go to the programs that the child
    /// has started, such as a firmware; the kernel kills a firmware when its parent dies.
    pub(super) fn signal(&self, pid: u32, signal: Signal) -> io::Result<()> {
        let watched = self.0.iter().find(|watched| watched.pid == pid);
        let descriptor = &watched.ok_or(io::Errno::SRCH)?.descriptor;
        // The number is the child's, and its group's, until it has been reaped.
        let pid = pid_of(pid).ok_or(io::Errno::SRCH)?;
        match descriptor {
            Some(descriptor) => pidfd_send_signal(descriptor, signal)?,
            None => kill_process(pid, signal)?,
        }
        if signal != Signal::KILL {
            let _ = kill_process_group(pid, signal);
        }
        Ok(())
    }

    /// Waits until an instant, or until a child has ended; returns whether one has. A signal to this process may end
    /// the wait early.
    ///
    /// Each end ends one wait. A child that cannot be reaped yet, as under a debugger, does not end the next one.
    pub(super) fn wait_until(&mut self, instant_ns: u64) -> bool {
        let (mut waiting, mut ends): (Vec<&mut bool>, Vec<PollFd<'_>>) = (Vec::new(), Vec::new());
        for watched in self.0.iter_mut().filter(|watched| !watched.has_ended) {
            if let Some(descriptor) = &watched.descriptor {
                waiting.push(&mut watched.has_ended);
                ends.push(PollFd::from_borrowed_fd(descriptor.as_fd(), PollFlags::IN));
            }
        }
        let time = timespec(instant_ns.saturating_sub(now_ns()));
        let has_ended = poll(&mut ends, Some(&time)).is_ok_and(|ended| ended > 0);
        for (ended, end) in waiting.into_iter().zip(&ends) {
            *ended = has_ended && !end.revents().is_empty();
        }
        has_ended
    }

    /// Reaps a child that has ended, after killing what is left of its process group: a law's code may have started
    /// processes. `None` while the child lives.
    pub(super) fn reap(&mut self, child: &mut Child) -> std::io::Result<Option<ExitStatus>> {
        const HAS_ENDED: WaitIdOptions = WaitIdOptions::EXITED
            .union(WaitIdOptions::NOHANG)
            .union(WaitIdOptions::NOWAIT);
        // Until the child has been reaped, its group's number is not reused.
        if let Some(pid) = pid_of(child.id())
            && let Ok(Some(_)) = waitid(WaitId::Pid(pid), HAS_ENDED)
        {
            // Usually the group is empty by now.
            let _ = kill_process_group(pid, Signal::KILL);
        }
        let status = child.try_wait()?;
        if status.is_some() {
            self.0.retain(|watched| watched.pid != child.id());
        }
        Ok(status)
    }
}

/// Reaps the releaser process of a killed child; returns whether there is none any more.
pub(super) fn reap_left(pid: u32) -> bool {
    let options = WaitIdOptions::EXITED.union(WaitIdOptions::NOHANG);
    let waited = pid_of(pid).map(|pid| waitid(WaitId::Pid(pid), options));
    !matches!(waited, Some(Ok(None)))
}

pub(super) fn terminate(child: &Child) {
    if let Some(pid) = pid_of(child.id()) {
        // It may have ended meanwhile; its number is not reused before it is reaped.
        let _ = kill_process(pid, Signal::TERM);
    }
}

/// Kills a child. Only a process that has ended already resists.
pub(super) fn kill(child: &mut Child) {
    let _ = child.kill();
}

pub(super) fn kill_and_reap(child: &mut Child) {
    kill(child);
    let _ = child.wait();
}

/// Ends a child: with SIGTERM, and with SIGKILL if it still runs after `limit`.
pub fn end(child: &mut Child, limit: Duration) {
    terminate(child);
    if wait_at_most(child, limit).is_none() {
        kill_and_reap(child);
    }
}

/// Runs a program and returns its output. Kills it if it still runs after `limit`, and whatever it started in any case.
pub fn output_within(command: &mut Command, limit: Duration) -> std::io::Result<Output> {
    // Files: a pipe would be full, or held open by a process that is left.
    let mut files = [tempfile::tempfile()?, tempfile::tempfile()?];
    let [stdout, stderr] = files.each_ref().map(File::try_clone);
    let command = command.stdin(Stdio::null()).process_group(0);
    let mut child = command.stdout(stdout?).stderr(stderr?).spawn()?;
    let mut children = ChildWatch::default();
    children.watch(&child);
    let until = Instant::now() + limit;
    let status = loop {
        if let Some(status) = children.reap(&mut child)? {
            break status;
        }
        if Instant::now() >= until {
            kill(&mut child);
        }
        sleep(LOOK_EVERY);
    };
    let [stdout, stderr] = files.each_mut().map(|file| {
        let mut bytes = Vec::new();
        file.rewind()?;
        file.take(MOST_OUTPUT).read_to_end(&mut bytes)?;
        Ok::<_, std::io::Error>(bytes)
    });
    Ok(Output {
        status,
        stdout: stdout?,
        stderr: stderr?,
    })
}

/// The exit status of a child; none if it still runs after `limit`.
pub fn wait_at_most(child: &mut Child, limit: Duration) -> Option<ExitStatus> {
    let until = Instant::now() + limit;
    loop {
        match child.try_wait() {
            Ok(None) if Instant::now() < until => sleep(LOOK_EVERY),
            Ok(status) => return status,
            Err(_) => return None,
        }
    }
}

fn pid_of(number: u32) -> Option<Pid> {
    i32::try_from(number).ok().and_then(Pid::from_raw)
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader};

    use super::*;

    #[test]
    fn what_a_program_writes_is_read_however_much_it_is_and_whatever_it_leaves() {
        let script = "head -c 200000 /dev/zero >&2; echo done; sleep 600 & exit 7";
        let mut shell = Command::new("sh");
        let output = output_within(shell.args(["-c", script]), Duration::from_secs(60)).unwrap();
        assert_eq!(
            (output.status.code(), &*output.stdout),
            (Some(7), &b"done\n"[..])
        );
        assert_eq!(output.stderr.len(), 200_000);
        let output = output_within(Command::new("sleep").arg("600"), Duration::ZERO).unwrap();
        assert_eq!(output.status.code(), None);
    }

    fn sleeper() -> Child {
        Command::new("sleep").arg("600").spawn().unwrap()
    }

    #[test]
    fn a_program_that_a_child_has_started_stops_and_continues_with_it() {
        let mut shell = Command::new("sh");
        shell.args(["-c", "sleep 600 & echo $!; wait"]);
        shell.process_group(0).stdout(Stdio::piped());
        let mut child = shell.spawn().unwrap();
        let mut started = String::new();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        out.read_line(&mut started).unwrap();
        let mut children = ChildWatch::default();
        children.watch(&child);
        for (signal, state) in [(Signal::STOP, 'T'), (Signal::CONT, 'S')] {
            children.signal(child.id(), signal).unwrap();
            let file = format!("/proc/{}/stat", started.trim());
            let is_so = || {
                std::fs::read_to_string(&file)
                    .unwrap()
                    .contains(&format!(") {state} "))
            };
            let until = Instant::now() + Duration::from_secs(60);
            while !is_so() && Instant::now() < until {
                std::thread::yield_now();
            }
            assert!(is_so(), "{signal:?}");
        }
        let _ = kill_process_group(pid_of(child.id()).unwrap(), Signal::KILL);
        child.wait().unwrap();
    }

    #[test]
    fn a_wait_ends_with_a_child_and_otherwise_at_its_instant() {
        let mut child = sleeper();
        let mut children = ChildWatch::default();
        children.watch(&child);
        let soon = now_ns() + 20_000_000;
        assert!(!children.wait_until(soon) && now_ns() >= soon);
        child.kill().unwrap();
        let late = now_ns() + 60_000_000_000;
        assert!(children.wait_until(late) && now_ns() < late);
        assert!(
            !children.wait_until(now_ns() + 1_000_000),
            "the end of an unreaped child ends one wait only"
        );
        child.wait().unwrap();
    }
}
