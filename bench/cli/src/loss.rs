//! Examines why a flight was lost, in a process of its own: a law from a library may end it.

use std::io::Read as _;
use std::path::Path;
use std::process::Stdio;
use std::thread::sleep;
use std::time::{Duration, Instant};

use analysis::schema::LossSection;
use errors::output::print;
use errors::{Failure, OK};
use host::own_executable;

/// The simulations of a flight take a fraction of its time.
const LIMIT: Duration = Duration::from_secs(60);

/// The section on the loss of a flight, by its directory.
pub fn examine(directory: &Path) -> Result<LossSection, Failure> {
    let failed = |e: std::io::Error| Failure::failed(format!("its simulation: {e}"));
    let mut child = process::signals::child(&own_executable()?, "examine-loss")
        .arg(directory.join(flight_log::FILE))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(failed)?;
    let until = Instant::now() + LIMIT;
    let status = loop {
        if let Some(status) = child.try_wait().map_err(failed)? {
            break status;
        }
        if Instant::now() > until {
            child.kill().map_err(failed)?;
        }
        sleep(Duration::from_millis(10));
    };
    let (mut section, mut complaint) = (String::new(), String::new());
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    if let Some((mut stdout, mut stderr)) = stdout.zip(stderr) {
        stdout.read_to_string(&mut section).map_err(failed)?;
        stderr.read_to_string(&mut complaint).map_err(failed)?;
    }
    serde_json::from_str(&section).map_err(|_| {
        let complaint = complaint.trim();
        Failure::failed(match complaint.strip_prefix("error: ") {
            Some(why) => why.to_owned(),
            None => format!("its simulation ended with {status}: {complaint}"),
        })
    })
}

/// Prints the section on the loss of the flight of a log, as JSON.
pub fn print_section(log: &Path) -> Result<u8, Failure> {
    let section = replay::loss::examine(log)?;
    let text = serde_json::to_string(&section).map_err(|e| Failure::failed(e.to_string()))?;
    print(&(text + "\n"))?;
    Ok(OK)
}
