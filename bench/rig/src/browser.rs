//! `--open`: opens a flight's page in the user's browser.

use std::env;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Duration;

use crate::output::say;
use errors::{Failure, InFile as _};

/// How long to wait for an error of the program that opens files. If it still runs then, it shows the page.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);

/// Opens the page of a flight and prints its path.
pub fn open_page(directory: &Path) -> Result<(), Failure> {
    let page = directory.join("report.html");
    if !page.is_file() {
        return Err(
            Failure::usage(format!("{} holds no page yet", directory.display())).help(
                "the page is written at the end of a flight; if the recorder died earlier, \
             `ironbird report RUN --format html > report.html` creates it from the last report",
            ),
        );
    }
    // A browser that already runs has another working directory.
    let page = page.canonicalize().in_file("open", &page)?;
    let shown = page.display();
    if let Some(browser) = env::var("BROWSER")
        .ok()
        .filter(|browser| !browser.is_empty())
    {
        open::with_detached(&page, &browser)
            .map_err(|e| {
                Failure::failed(format!("cannot open {shown} with BROWSER={browser}: {e}"))
            })
            .map_err(|failure| failure.help("BROWSER must name a program that takes a file"))?;
        say(&format!("gave {shown} to {browser}\n"));
    } else {
        open::that_detached_with_timeout(&page, OPEN_TIMEOUT).map_err(|e| refused(&page, &e))?;
        say(&format!("opened {shown}\n"));
    }
    Ok(())
}

fn refused(page: &Path, error: &io::Error) -> Failure {
    let why = match error.kind() {
        ErrorKind::NotFound => "neither xdg-open nor gio nor kde-open is installed".to_owned(),
        ErrorKind::Other => "the system's file opener found no browser".to_owned(),
        _ => error.to_string(),
    };
    Failure::failed(format!(
        "cannot open {} in a browser: {why}",
        page.display()
    ))
    .help(
        "set BROWSER to a browser; without a screen, copy the page to another machine: \
         it is a single file and needs no network",
    )
}
