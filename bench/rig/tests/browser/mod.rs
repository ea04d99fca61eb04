//! What Chromium shows of a page: a script in a copy of the page looks at it and writes what it has seen into the page.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::rig::{Rig, lacks_tool};

/// Names under which Chromium is installed.
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];
const LOOK: &str = include_str!("look.js");
const PROBE: &str = include_str!("probe.html");

/// The executable: the one that `IRONBIRD_CHROMIUM` names, which must be there, or one that is found.
pub fn chromium() -> Option<String> {
    let answers = |name: &str| {
        let version = Command::new(name).arg("--version").output();
        version.is_ok_and(|output| output.status.success())
    };
    if let Ok(named) = std::env::var("IRONBIRD_CHROMIUM") {
        assert!(answers(&named), "IRONBIRD_CHROMIUM: {named} does not start");
        return Some(named);
    }
    let found = NAMES.into_iter().find(|name| answers(name));
    if found.is_none() {
        lacks_tool("report.html is not opened in a browser: Chromium is not installed");
    }
    found.map(str::to_owned)
}

/// Opens a page of so many pixels, by day or by night: what the script saw, and what the browser complained about.
pub fn look(
    rig: &Rig,
    chromium: &str,
    page: &Path,
    width: u32,
    dark: bool,
) -> (Value, Vec<String>) {
    let html = fs::read_to_string(page).unwrap();
    let probe = PROBE.replace(
        "LOOK",
        LOOK.split_once('\n')
            .unwrap()
            .1
            .trim()
            .trim_end_matches(';'),
    );
    let probed = rig.path("probed.html");
    fs::write(&probed, html.replace("</body>", &(probe + "</body>"))).unwrap();
    let output = Command::new(chromium)
        .args("--headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage".split(' '))
        .args(
            "--no-first-run --enable-logging=stderr --virtual-time-budget=5000 --dump-dom"
                .split(' '),
        )
        .arg(format!("--user-data-dir={}", rig.file("profile")))
        .arg(format!("--window-size={width},900"))
        .arg(format!(
            "--blink-settings=preferredColorScheme={}",
            u8::from(!dark)
        ))
        .arg(format!("file://{}", probed.display()))
        .output()
        .unwrap();
    let shown = String::from_utf8_lossy(&output.stdout);
    let seen = shown
        .split_once("<pre id=\"seen\">")
        .and_then(|(_, rest)| rest.split_once("</pre>"))
        .unwrap_or_else(|| panic!("{} is not shown: {output:?}", page.display()));
    let seen = seen
        .0
        .replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&amp;", "&");
    let said = String::from_utf8_lossy(&output.stderr);
    let complaints = said.lines().filter(|line| line.contains("CONSOLE"));
    (
        serde_json::from_str(&seen).unwrap(),
        complaints.map(str::to_owned).collect(),
    )
}
