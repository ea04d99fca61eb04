//! `--open`: shows a flight's page in the user's browser.

use std::env;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Duration;

use crate::output::say;
use failure::{Failure, InFile as _};

/// How long a program that opens files may take to say that it cannot; one that still runs shows the page.
const PATIENCE: Duration = Duration::from_secs(3);

/// Has the page of a flight opened, and says which, and by whom where somebody named it.
///
/// # Errors
/// Usage, where there is no page yet; [`Failure`] where nothing could show it.
pub fn open_page(directory: &Path) -> Result<(), Failure> {
    let page = directory.join("report.html");
    if !page.is_file() {
        return Err(Failure::usage(format!("{} holds no page yet", directory.display())).help(
            "a flight has its page when it has ended; where its recorder died before, \
             `ironbird report RUN --format html > report.html` draws it from the last report",
        ));
    }
    // A browser that runs already has another working directory.
    let page = page.canonicalize().in_file("open", &page)?;
    let shown = page.display();
    if let Some(browser) = env::var("BROWSER").ok().filter(|browser| !browser.is_empty()) {
        open::with_detached(&page, &browser)
            .map_err(|e| Failure::failed(format!("cannot open {shown} with BROWSER={browser}: {e}")))
            .map_err(|failure| failure.help("BROWSER names a program that takes a file"))?;
        // What it does with the page, it does not say.
        say(&format!("gave {shown} to {browser}\n"));
    } else {
        open::that_detached_with_timeout(&page, PATIENCE).map_err(|e| refused(&page, &e))?;
        say(&format!("opened {shown}\n"));
    }
    Ok(())
}

fn refused(page: &Path, error: &io::Error) -> Failure {
    let why = match error.kind() {
        ErrorKind::NotFound => "neither xdg-open nor gio nor kde-open is installed".to_owned(),
        // The library's words name a number of the system's.
        ErrorKind::Other => "the system's program that opens files has found no browser".to_owned(),
        _ => error.to_string(),
    };
    Failure::failed(format!("cannot open {} in a browser: {why}", page.display())).help(
        "set BROWSER to a browser's program; where there is no screen, copy the page to where there is one: \
         it is one file and needs no network",
    )
}
