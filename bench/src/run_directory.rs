//! The directory of a flight: named by time, never overwritten, `latest` beside it.

use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::failure::{Failure, InFile as _};
use crate::record::host::Host;
use crate::settings::Settings;

/// A flight's directory.
#[derive(Clone, Debug)]
pub struct RunDirectory {
    /// Where it is.
    pub path: PathBuf,
}

/// What run.json says: enough to fly it again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFacts {
    /// Version of ironbird.
    pub version: String,
    /// Instance.
    pub instance: String,
    /// The settings that were flown.
    pub settings: Settings,
    /// The machine.
    pub host: Host,
}

impl RunDirectory {
    /// Makes a new directory below `out`, with run.json and settings.toml, and points `latest` at it.
    ///
    /// # Errors
    /// A usage [`Failure`] names the directory that cannot be made.
    pub fn create(out: &Path, settings: &Settings, instance: &str) -> Result<Self, Failure> {
        let refused = |e: io::Error| {
            Failure::usage(format!("cannot record into {}: {e}", out.display()))
                .help("name a directory that you can write: --out DIR")
        };
        fs::create_dir_all(out).map_err(refused)?;
        let stamp = jiff::Timestamp::now().strftime("%Y-%m-%dT%H-%M-%SZ").to_string();
        let mut name = stamp.clone();
        let mut copy = 1;
        let path = loop {
            let path = out.join(&name);
            match fs::create_dir(&path) {
                Ok(()) => break path,
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                    copy += 1;
                    name = format!("{stamp}-{copy}");
                }
                Err(e) => return Err(refused(e)),
            }
        };
        let facts = RunFacts {
            version: env!("CARGO_PKG_VERSION").into(),
            instance: instance.into(),
            settings: settings.clone(),
            host: Host::read(),
        };
        let file = path.join("run.json");
        let text = serde_json::to_string_pretty(&facts).in_file("write", &file)?;
        fs::write(&file, text + "\n").in_file("write", &file)?;
        let file = path.join("settings.toml");
        fs::write(&file, settings.commented()?).in_file("write", &file)?;
        // Replaced in one step, so that `latest` always leads somewhere.
        let draft = out.join(format!(".latest.{}", std::process::id()));
        symlink(&name, &draft).and_then(|()| fs::rename(&draft, out.join("latest"))).map_err(refused)?;
        Ok(Self { path })
    }

    /// The settings that a role of this flight is started with.
    #[must_use]
    pub fn settings_file(&self) -> PathBuf {
        self.path.join("settings.toml")
    }
}
