//! Starts the process of a role.

use std::fs::File;
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use model::role::Role;
use wire::instance::Instance;

use crate::cli::FlyArgs;
use crate::fly::ending::{log_path, process};
use crate::run_directory::RunDirectory;
use failure::{Failure, InFile as _};

/// What all processes of a flight are started with.
pub(super) struct Starter {
    pub(super) executable: PathBuf,
    instance: String,
    settings_file: PathBuf,
    /// Where the processes' words go.
    pub(super) directory: PathBuf,
    states: Option<PathBuf>,
}

impl Starter {
    pub(super) fn new(executable: PathBuf, instance: &Instance, directory: &RunDirectory, args: &FlyArgs) -> Self {
        Self {
            executable,
            instance: instance.name().into(),
            settings_file: directory.settings_file(),
            directory: directory.path.clone(),
            states: args.recorder.states.clone(),
        }
    }

    /// Starts a role, whose recorder writes into a flight's directory. What a process of the role said before stays.
    pub(super) fn start(&self, role: Role, recording: &RunDirectory) -> Result<Child, Failure> {
        let mut command = self.command(role)?;
        if role == Role::Record {
            command.arg("--run-dir").arg(&recording.path);
            // The states that were asked for elsewhere are those of the flight's beginning.
            if let Some(states) = self.states.as_ref().filter(|_| recording.path == self.directory) {
                command.arg("--states").arg(states);
            }
        }
        spawn(&process(role), command.stdin(Stdio::null()))
    }

    /// Starts a spare of a stage, which waits for a byte.
    pub(super) fn start_spare(&self, role: Role) -> Result<Child, Failure> {
        spawn(&format!("spare of the {}", process(role)), self.command(role)?.arg("--spare").stdin(Stdio::piped()))
    }

    fn command(&self, role: Role) -> Result<Command, Failure> {
        let log_path = log_path(&self.directory, role);
        let log = File::options().create(true).append(true).open(&log_path).in_file("write", &log_path)?;
        let mut command = Command::new(&self.executable);
        command
            .arg(role.name())
            .arg("--config")
            .arg(&self.settings_file)
            .args(["--instance", &self.instance])
            .args(["--launcher", &std::process::id().to_string()])
            .stdout(Stdio::null())
            .stderr(log)
            // Ctrl-C in a terminal reaches the launcher alone, which then ends the roles in order.
            .process_group(0);
        Ok(command)
    }
}

fn spawn(what: &str, command: &mut Command) -> Result<Child, Failure> {
    command.spawn().map_err(|e| {
        Failure::failed(format!("cannot start the {what}: {e}")).help(
            "a flight has five processes of some threads each, and three spares with --on-death restart: see \
                   `ulimit -u`, and `ulimit -v`",
        )
    })
}
