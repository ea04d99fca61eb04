//! `--open`: opens a flight's page, or its live page, in the user's browser.

use std::env;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::Path;
use std::time::Duration;

use errors::output::say;
use errors::{Failure, InFile as _};

/// How long to wait for an error of the program that opens files. If it still runs then, it shows the page.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);

pub fn open_page(directory: &Path) -> Result<(), Failure> {
    let page = directory.join("report.html");
    if !page.is_file() {
        let what = format!("{} holds no page yet", directory.display());
        return Err(Failure::usage(what).help(
            "the page is written at the end of a flight; if the recorder died earlier, \
             `ironbird report RUN --format html > report.html` creates it from the last report",
        ));
    }
    // A browser that already runs has another working directory.
    let page = page.canonicalize().in_file("open", &page)?;
    let help = "set BROWSER to a browser; without a screen, copy the page to another machine: it is a single file and needs no \
                network";
    open_with(page.as_os_str(), help)
}

/// Opens the address of a page.
pub fn open_address(address: &str) -> Result<(), Failure> {
    let help = "set BROWSER to a browser, or open the address yourself";
    open_with(address.as_ref(), help)
}

/// Opens a file or an address in the browser that BROWSER names, or in the system's.
fn open_with(page: &OsStr, help: &str) -> Result<(), Failure> {
    let path = page.display();
    let browser = env::var("BROWSER").unwrap_or_default();
    if !browser.is_empty() {
        open::with_detached(page, &browser).map_err(|e| {
            Failure::failed(format!("cannot open {path} with BROWSER={browser}: {e}"))
                .help("BROWSER must name a program that takes a file")
        })?;
        say(&format!("gave {path} to {browser}\n"));
        return Ok(());
    }
    open::that_detached_with_timeout(page, OPEN_TIMEOUT).map_err(|e| {
        let why = match e.kind() {
            ErrorKind::NotFound => "neither xdg-open nor gio nor kde-open is installed".into(),
            ErrorKind::Other => "the system's file opener found no browser".into(),
            _ => e.to_string(),
        };
        Failure::failed(format!("cannot open {path} in a browser: {why}")).help(help)
    })?;
    say(&format!("opened {path}\n"));
    Ok(())
}
