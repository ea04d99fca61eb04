//! report.html as a browser shows it: complete, readable on a phone and on a desktop screen, in the light and the dark theme.
//!
//! The browser is Chromium, named by `IRONBIRD_CHROMIUM` or found; without it, the tests that need it are skipped.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::LazyLock;

use crate::rig::{Rig, lacks_tool};
use analysis::schema::Report;
use render::page;
use serde_json::Value;

/// Plots of every flight, of one in lockstep, and of one in real time with late commands.
const PLOTS: [&str; 3] = [
    "roll pitch yaw x y z position-error rate-error distance thrust torque rotors i_r k_r delta \
     outer-acceleration_wanted_x_m_s2 outer-acceleration_wanted_y_m_s2 outer-acceleration_wanted_z_m_s2 \
     inner-rate_error_x_rad_s inner-rate_error_y_rad_s inner-rate_error_z_rad_s inner-rotor_inertia_kg_m2 \
     inner-rotational_drag_nm_s inner-disturbance_gain_rad_s2 mixer-roll_pitch_share mixer-yaw_share mixer-thrust_excess_share path-xy path-xz \
     path-yz histogram-loop histogram-hop histogram-compute histogram-busy waterfall-p50 waterfall-p99 loop curve-loop \
     curve-hop curve-compute curve-busy v v-change",
    "violations-gyro_noise",
    "wake curve-wake curve-period histogram-wake histogram-period histogram-deadline miss-runs late outage-1 outage-2",
];

/// A word that nothing may break, and that would do harm if it were not escaped.
const HOSTILE: &str = "</title></svg><script>throw 1</script>\"'&<b>";

/// Two swaps, one of which the theorem does not cover.
const SWAPS: &str = "--duration 2s --fault gyro_noise_rad_s=0.01@tick500 --fault rotational_drag_nm_s=0.525@tick1000";

/// What the tests look at of a flight's directory.
struct Flown {
    page: String,
    /// The same, made from report.json alone.
    again: String,
    hostile: String,
    /// Of report.html, report.json and flight.svg [bytes].
    lengths: [u64; 3],
}

impl Flown {
    fn of(rig: &Rig) -> Self {
        let latest = rig.out().join("latest");
        let length = |file| fs::metadata(latest.join(file)).unwrap().len();
        Self {
            page: rig.flown("report.html"),
            again: rig.ok("report --format html").stdout,
            hostile: hostile_page(&latest),
            lengths: ["report.html", "report.json", "flight.svg"].map(length),
        }
    }
}

static IN_LOCKSTEP: LazyLock<Flown> = LazyLock::new(|| {
    let rig = Rig::new("page");
    rig.ok(&format!("fly --pace lockstep {SWAPS}"));
    Flown::of(&rig)
});

/// A flight in slow motion with two outages, and with baselines of the machine.
static LATE: LazyLock<Flown> = LazyLock::new(|| {
    let rig = Rig::new("page");
    let outages = "--fault inner.stop=20ms@tick700 --fault mixer.stop=20ms@tick1500";
    rig.ok(&format!(
        "fly --config {} --floor 1s {outages} {SWAPS}",
        rig.slow(2)
    ))
    .says("\nFloors    at p50, p99, p99.9: wake.plant is ")
    .says("raw futex ring")
    .says("bare timer");
    Flown::of(&rig)
});

/// The page of a flight with hostile words and a refused real-time step.
fn hostile_page(directory: &Path) -> String {
    let mut report = Report::read(&directory.join("report.json")).unwrap();
    report.run.instance = HOSTILE.into();
    report.verdict.gates[0].value = HOSTILE.into();
    report.swaps[0].changes[0].name = HOSTILE.into();
    let inner = report.run.laws.get_mut("inner").unwrap();
    inner.telemetry[5].unit = HOSTILE.into();
    for step in report
        .roles
        .values_mut()
        .flat_map(|role| role.realtime.first_mut())
    {
        (step.granted, step.refused) = (false, Some(HOSTILE.into()));
    }
    for outage in &mut report.autopsy.worst {
        outage.evidence = HOSTILE.into();
    }
    page::render(&report)
}

pub fn chromium() -> Option<String> {
    let starts = |name: &&str| {
        let version = Command::new(name).arg("--version").output();
        version.is_ok_and(|output| output.status.success())
    };
    if let Ok(named) = std::env::var("IRONBIRD_CHROMIUM") {
        assert!(
            starts(&named.as_str()),
            "IRONBIRD_CHROMIUM: {named} does not start"
        );
        return Some(named);
    }
    let mut names = ["chromium", "chromium-browser", "google-chrome"].into_iter();
    let found = names.find(starts);
    if found.is_none() {
        lacks_tool("pages are not opened in a browser: Chromium is not installed");
    }
    found.map(str::to_owned)
}

/// Opens a copy of a page with a script that inspects it: what the script found, and what the browser complained about.
fn look(rig: &Rig, chromium: &str, html: &str, width: u32, dark: bool) -> (Value, String) {
    let (_, script) = include_str!("browser/look.js").split_once('\n').unwrap();
    let script = script.trim().trim_end_matches(';');
    let probe = include_str!("browser/probe.html").replace("LOOK", script);
    let probed = rig.file("probed.html");
    // With a virtual time, frames of the display may not come.
    let frames = "<body><script>requestAnimationFrame = (draw) => setTimeout(draw);</script>";
    let html = html.replacen("<body>", frames, 1);
    fs::write(&probed, html.replace("</body>", &(probe + "</body>"))).unwrap();
    let flags = "--headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run --enable-logging=stderr \
        --virtual-time-budget=5000 --dump-dom";
    let output = Command::new(chromium)
        .args(flags.split_whitespace())
        .arg(format!("--user-data-dir={}", rig.file("profile")))
        .arg(format!("--window-size={width},900"))
        .arg(format!(
            "--blink-settings=preferredColorScheme={}",
            u8::from(!dark)
        ))
        .arg(format!("file://{probed}"))
        .output()
        .unwrap();
    let dom = String::from_utf8_lossy(&output.stdout);
    let found = dom.split_once("<pre id=\"seen\">");
    let found = found.and_then(|(_, rest)| rest.split_once("</pre>"));
    let (found, _) = found.unwrap_or_else(|| panic!("nothing found: {output:?}"));
    let found = found
        .replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&amp;", "&");
    let messages = String::from_utf8_lossy(&output.stderr);
    let complaints = messages.lines().filter(|line| line.contains("CONSOLE"));
    (serde_json::from_str(&found).unwrap(), complaints.collect())
}

fn texts(found: &Value) -> Vec<&str> {
    let texts = found.as_array().unwrap().iter();
    texts.map(|text| text.as_str().unwrap()).collect()
}

#[test]
#[ignore = "long: part of the gate"]
fn pages_are_complete_and_readable_by_day_and_by_night() {
    let Some(chromium) = chromium() else {
        return;
    };
    let rig = Rig::new("page");
    let all = [(1400, false), (400, true), (400, false), (1400, true)];
    for (page, has_late, cases) in [
        (&IN_LOCKSTEP.page, false, &all[..]),
        (&LATE.hostile, true, &all[..3]),
    ] {
        let mut grounds = [None, None];
        for &(width, dark) in cases {
            let case = format!("late: {has_late}, {width} pixels, dark: {dark}");
            let (found, complaints) = look(&rig, &chromium, page, width, dark);
            assert_eq!(texts(&found["faults"]), [""; 0], "{case}");
            assert_eq!(complaints, "", "{case}");
            assert_eq!(texts(&found["requests"]), [""; 0], "{case}");
            // The page's own scripts with the flight's data, and two that inspect.
            assert_eq!(found["scripts"], 5, "{case}");
            assert!(found["texts"].as_u64().unwrap() > 300, "{case}");
            // What the page shows of the plot's middle.
            let readout = texts(&found["readout"]).join(" ");
            let mut words = ["time ", "reference ", "actual "].iter();
            assert!(
                words.all(|word| readout.contains(word)),
                "{case}: {readout}"
            );
            let [whole, zoomed, again] = found["zoomed"].as_array().unwrap().as_slice() else {
                panic!("{case}: {found}");
            };
            assert_eq!(
                whole, again,
                "{case}: a double click shows the whole flight"
            );
            let seconds = |label: &&str| label.parse::<f64>().unwrap();
            let least = texts(zoomed).first().map(seconds);
            assert!(least > Some(0.9), "{case}: {zoomed} of 2 s");
            let [begin, end] = [0, 1].map(|i| found["drawn"][i].as_u64().unwrap());
            assert!(
                1000 < begin && begin < end,
                "{case}: pictures of {begin}, {end} bytes"
            );
            let ground = grounds[usize::from(dark)].get_or_insert(found["ground"].clone());
            assert_eq!(*ground, found["ground"], "{case}");
            if has_late {
                assert!(found["text"].as_str().unwrap().contains(HOSTILE), "{case}");
                // The lines of missed deadlines can be switched off.
                for (key, style) in [("shown", "inline"), ("hidden", "none")] {
                    let lines = texts(&found[key]);
                    assert!(lines.len() > 20, "{case}: {lines:?}");
                    assert!(lines.iter().all(|line| *line == style), "{case}: {lines:?}");
                }
            }
        }
        assert_ne!(grounds[0], grounds[1], "day and night look the same");
    }
}

#[test]
fn the_page_has_all_plots_comes_from_report_json_alone_and_is_small() {
    for (flown, other) in [(&IN_LOCKSTEP, 1), (&LATE, 2)] {
        let written = &flown.page;
        assert_eq!(flown.again, *written);
        assert!(written.starts_with("<!DOCTYPE html>"));
        assert!(!written.contains("http://") && !written.contains("https://"));
        for plot in PLOTS[0].split(' ').chain(PLOTS[other].split(' ')) {
            let figures = written.matches(&format!("data-plot=\"{plot}\"")).count();
            assert_eq!(figures, 1, "{plot}");
        }
        let hostile = &flown.hostile;
        assert_eq!(hostile.matches("<script").count(), 3, "words are escaped");
        assert!(!hostile.contains("throw 1</script>"), "words are escaped");
        let [page, json, picture] = flown.lengths;
        let are_small = page.max(json) < 1_000_000 && picture < 300_000;
        assert!(are_small, "{page}, {json} and {picture} bytes");
    }
}
