//! report.html as a browser shows it: complete, readable on a telephone and a desk, by day and by night.
//!
//! The browser is Chromium, named by `IRONBIRD_CHROMIUM` or found. Where there is none, what needs it is left out, and
//! says so.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use crate::browser::{chromium, look};
use crate::rig::{Rig, wait_until};
use messages::role::{Role, STAGES};
use report::miss_causes::MissCause;
use report::outages::{CauseCount, OutageCase, OutageSection, TimelineStage, TimelineTick};
use report::render::flight;
use report::schema::{LateStretchSection, Report, RunLength};
use serde_json::Value;

const PLOTS: [&str; 45] = [
    "roll",
    "pitch",
    "yaw",
    "x",
    "y",
    "z",
    "position-error",
    "rate-error",
    "distance",
    "thrust",
    "torque",
    "rotors",
    "i_r",
    "k_r",
    "delta",
    "i_r-error",
    "k_r-error",
    "delta-error",
    "outer-acceleration_wanted_x_m_s2",
    "outer-acceleration_wanted_y_m_s2",
    "outer-acceleration_wanted_z_m_s2",
    "inner-rate_error_x_rad_s",
    "inner-rate_error_y_rad_s",
    "inner-rate_error_z_rad_s",
    "inner-rotor_inertia_kg_m2",
    "inner-rotational_drag_nm_s",
    "inner-disturbance_gain_rad_s2",
    "mixer-roll_pitch_share",
    "mixer-yaw_share",
    "path-xy",
    "path-xz",
    "path-yz",
    "histogram-loop",
    "histogram-hop",
    "histogram-compute",
    "histogram-busy",
    "waterfall-p50",
    "waterfall-p99",
    "loop",
    "curve-loop",
    "curve-hop",
    "curve-compute",
    "curve-busy",
    "v",
    "v-change",
];

/// Plots of a flight by the clock with late commands.
const LATE_PLOTS: [&str; 10] = [
    "wake",
    "curve-wake",
    "curve-period",
    "histogram-wake",
    "histogram-period",
    "histogram-deadline",
    "miss-runs",
    "late",
    "outage-1",
    "outage-2",
];

/// A word that nothing may break, and that would do harm where it is not escaped.
const HOSTILE: &str = "</title></svg><script>throw 1</script>\"'&<b>";

const SWAPS: [&str; 4] = [
    "--fault",
    "gyro_noise_rad_s=0.01@tick500",
    "--fault",
    "rotational_drag_nm_s=0.525@tick1000",
];

/// A flight in lockstep with two swaps, one of which the theorem does not cover.
fn flight(rig: &Rig) -> PathBuf {
    rig.run(
        "fly",
        [&["--pace", "lockstep", "--duration", "2s"], &SWAPS[..]].concat(),
    )
    .expect(0);
    rig.out().join("latest")
}

/// The same by the clock, in slow motion, with the machine's floors beside.
fn slow_flight(rig: &Rig) -> PathBuf {
    let beside = [
        "--config",
        &rig.slow(2),
        "--duration",
        "2s",
        "--floor",
        "1s",
    ];
    let ended = rig.run("fly", [&beside[..], &SWAPS[..]].concat()).expect(0);
    ended
        .says("\nFloors    at p50, p99, p99.9: wake.plant is ")
        .says("raw futex ring")
        .says("bare timer");
    rig.out().join("latest")
}

/// A flight's report with all that a bad day adds: late commands, a refused step, hostile words.
fn bad_day(directory: &Path) -> Report {
    let mut report = Report::read(&directory.join("report.json")).unwrap();
    report.run.instance = HOSTILE.into();
    report.verdict.gates[0].value = HOSTILE.into();
    report.swaps[0].changes[0].name = HOSTILE.into();
    report.run.laws.get_mut("inner").unwrap().telemetry[5].unit = HOSTILE.into();
    let step = report.roles.get_mut("plant").unwrap().realtime.first_mut();
    if let Some(step) = step {
        (step.granted, step.refused) = (false, Some(HOSTILE.into()));
    }
    let deadlines = &mut report.deadlines;
    let stretch = |i: u64| LateStretchSection {
        tick: 400 * i,
        time_s: 0.4 * i as f64,
        length_ticks: i,
        late_us: 30.0 * 7_f64.powi(i32::try_from(i).unwrap()),
    };
    deadlines.stretches = (1..=4).map(stretch).collect();
    deadlines.runs = vec![
        RunLength {
            length_ticks: 1,
            count: 3,
        },
        RunLength {
            length_ticks: 400,
            count: 12_345,
        },
    ];
    let outages = CauseCount {
        class: MissCause::StoppedOrDead,
        stage: Some("inner".into()),
        outages: 2,
        missed: 401,
    };
    report.autopsy = OutageSection {
        unmeasured: 0,
        classes: vec![outages],
        pending: 3,
        longest: None,
        worst: vec![outage(1_234_567, 98_765), outage(70, 2)],
    };
    report
}

/// An outage in which the inner loop is stopped, and the mixer goes on without it for a while.
fn outage(tick: u64, ticks: u64) -> OutageCase {
    let ends = [tick, tick + ticks - 1].map(|end| end - 1..=end + 2);
    let shown: BTreeSet<u64> = ends.into_iter().flatten().collect();
    let stages = |shown: u64| -> Vec<TimelineStage> {
        let is_out = (tick..tick + ticks).contains(&shown);
        let worked = STAGES
            .into_iter()
            .filter(|role| !is_out || (*role != Role::Inner && shown != tick + ticks - 1));
        let begin_us = (shown as f64 - tick as f64) * 2_000.0;
        let stage = |role: Role| TimelineStage {
            role: role.name().into(),
            wake_us: begin_us
                + if is_out && role == Role::Mixer {
                    1_800.0
                } else {
                    50.0 + 30.0 * f64::from(role as u8)
                },
            send_us: begin_us
                + if is_out && role == Role::Mixer {
                    2_100.0
                } else {
                    70.0 + 30.0 * f64::from(role as u8)
                },
            is_fresh: !is_out || role != Role::Mixer,
        };
        worked.map(stage).collect()
    };
    OutageCase {
        faults: vec!["setpoint.drop=0.1".into()],
        tick,
        time_s: tick as f64 * 1e-3,
        ticks,
        missed: ticks,
        delay_us: ticks as f64 * 2_000.0,
        due_us: 80.0,
        class: MissCause::StoppedOrDead,
        stage: Some("inner".into()),
        evidence: HOSTILE.into(),
        ran: Vec::new(),
        timeline: shown
            .into_iter()
            .map(|it| TimelineTick {
                tick: it,
                missed: (tick..tick + ticks).contains(&it),
                stages: stages(it),
            })
            .collect(),
    }
}

fn list(found: &Value) -> Vec<&str> {
    found
        .as_array()
        .unwrap()
        .iter()
        .map(|value| value.as_str().unwrap())
        .collect()
}

/// Opens a page on a desk and on a telephone, by day and by night; it must be whole and readable in each.
fn inspect(rig: &Rig, chromium: &str, page: &Path, plots: &[&str]) -> Value {
    let mut grounds = Vec::new();
    let mut last = Value::Null;
    for (width, dark) in [(1400, false), (1400, true), (400, false), (400, true)] {
        let case = format!("{} at {width} pixels, dark: {dark}", page.display());
        let (seen, complaints) = look(rig, chromium, page, width, dark);
        assert_eq!(list(&seen["faults"]), Vec::<&str>::new(), "{case}");
        assert_eq!(complaints, Vec::<String>::new(), "{case}");
        assert_eq!(list(&seen["requests"]), Vec::<&str>::new(), "{case}");
        // Its own script, and the one that looks.
        assert_eq!(seen["scripts"], 2, "{case}");
        assert!(seen["texts"].as_u64().unwrap() > 300, "{case}");
        let drawn = list(&seen["plots"]);
        for plot in plots {
            let count = drawn.iter().filter(|name| *name == plot).count();
            assert_eq!(count, 1, "{plot} in {case}: {drawn:?}");
        }
        // What the page says of the plot's middle.
        let readout = list(&seen["readout"]).join(" ");
        for word in ["time ", "reference ", "actual "] {
            assert!(readout.contains(word), "{case}: {readout}");
        }
        grounds.push(seen["ground"].clone());
        last = seen;
    }
    assert_eq!((&grounds[0], &grounds[1]), (&grounds[2], &grounds[3]));
    assert_ne!(grounds[0], grounds[1], "day and night look the same");
    last
}

#[test]
#[ignore = "long: part of the gate"]
fn the_page_is_whole_and_readable_by_day_and_by_night() {
    let Some(chromium) = chromium() else {
        return;
    };
    let rig = Rig::new("page");
    let directory = flight(&rig);
    let plots = [&PLOTS[..], &["violations-gyro_noise"]].concat();
    inspect(&rig, &chromium, &directory.join("report.html"), &plots);

    let page = rig.path("bad.html");
    fs::write(&page, flight::page(&bad_day(&slow_flight(&rig)))).unwrap();
    let seen = inspect(&rig, &chromium, &page, &[&PLOTS[..], &LATE_PLOTS].concat());
    let text = seen["text"].as_str().unwrap();
    assert!(
        text.contains(HOSTILE),
        "hostile words are shown as they are"
    );
    // The lines of missed deadlines can be switched off.
    let [shown, hidden] = ["shown", "hidden"].map(|key| list(&seen[key]));
    assert!(
        shown.len() > 20 && shown.iter().all(|it| *it == "inline"),
        "{shown:?}"
    );
    assert!(
        hidden.len() > 20 && hidden.iter().all(|it| *it == "none"),
        "{hidden:?}"
    );
}

#[test]
fn a_browser_is_opened_or_it_is_said_why_not() {
    let rig = Rig::new("open");
    let (opened, tools) = (rig.path("opened"), rig.path("tools"));
    fs::create_dir(&tools).unwrap();
    let program = |name: &str, text: &str| {
        let path = tools.join(name);
        fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
        path
    };
    let browser = program(
        "browser",
        &format!(
            "echo \"$1\" > {0}.draft; /bin/mv {0}.draft {0}",
            opened.display()
        ),
    );
    let run = |command: &str, args: &[&str], browser: &Path| {
        let mut process = rig.command(command, args);
        process.env("BROWSER", browser).env("PATH", &tools);
        rig.launch(process).end()
    };
    let shown = || wait_until("the page to be opened", || fs::read_to_string(&opened).ok());

    let lockstep = ["--pace", "lockstep", "--duration", "0.1s", "--open"];
    let flown = run("fly", &lockstep, &browser)
        .expect(0)
        .says("RESULT status=PASS");
    let page = rig
        .out()
        .join("latest")
        .canonicalize()
        .unwrap()
        .join("report.html");
    assert_eq!(shown(), format!("{}\n", page.display()));
    flown.complains(&format!("gave {} to ", page.display()));
    fs::remove_file(&opened).unwrap();
    run("report", &["--open"], &browser)
        .expect(0)
        .complains(&format!("gave {} to ", page.display()));
    assert_eq!(shown(), format!("{}\n", page.display()));
    fs::remove_file(&opened).unwrap();

    let missing = tools.join("missing");
    run("report", &["--open"], &missing)
        .expect(1)
        .complains(&format!(
            "cannot open {} with BROWSER={}",
            page.display(),
            missing.display()
        ))
        .complains("BROWSER must name a program that takes a file");
    let none = Path::new("");
    run("report", &["--open"], none)
        .expect(1)
        .complains("in a browser: neither xdg-open nor gio nor kde-open is installed")
        .complains("set BROWSER to a browser");
    program("xdg-open", "exit 3");
    run("report", &["--open"], none)
        .expect(1)
        .complains(&format!("cannot open {} in a browser: ", page.display()));
    // A flight that has passed is flown, whatever became of its page.
    run("fly", &lockstep, none)
        .expect(1)
        .says("RESULT status=PASS")
        .complains("set BROWSER to a browser");
    fs::copy(&browser, tools.join("xdg-open")).unwrap();
    run("report", &["--open"], none).expect(0);
    shown();

    run("report", &["--open", "--format", "html"], none)
        .expect(2)
        .complains("'--open' cannot be used with '--format");
    fs::remove_file(rig.out().join("latest/report.html")).unwrap();
    run("report", &["--open"], none)
        .expect(2)
        .complains("holds no page yet")
        .complains("--format html > report.html");
}

#[test]
fn the_look_finds_what_is_wrong() {
    let Some(chromium) = chromium() else {
        return;
    };
    let rig = Rig::new("look");
    let page = rig.path("wrong.html");
    let wrong = r##"<!DOCTYPE html><html><head><style>body { background: #ffffff; margin: 0; }</style></head><body>
        <p style="white-space: nowrap">a line that is much too long for a telephone and for every browser that has no narrower window than 500 pixels, and cannot be broken anywhere</p>
        <p style="color: #dddddd">pale</p>
        <figure><svg role="img" aria-label="plot" viewBox="0 0 400 100" width="380">
        <text x="390" y="20">cut off</text><text x="10" y="50">one on</text><text x="12" y="51">another</text>
        <path class="line" d=""></path></svg></figure>
        <nav><a href="#nowhere">to nowhere</a></nav><p style="height: 3000px"></p>
        <img src="https://example.invalid/x.png"><script>console.error("told")</script></body></html>"##;
    fs::write(&page, wrong).unwrap();
    let (seen, complaints) = look(&rig, &chromium, &page, 400, false);
    let faults = list(&seen["faults"]).join("\n");
    for fault in [
        "leaves the page",
        "is cut in plot",
        "overlaps",
        "a line of plot is empty",
        "contrast",
        "the contents stand at",
        "nothing is at #nowhere",
    ] {
        assert!(faults.contains(fault), "no `{fault}` among\n{faults}");
    }
    let complaints = complaints.join("\n") + &seen["requests"].to_string();
    assert!(
        complaints.contains("told") && complaints.contains("example.invalid"),
        "{complaints}"
    );
}

#[test]
fn the_page_is_made_of_report_json_alone() {
    let rig = Rig::new("json");
    let directory = flight(&rig);
    let written = fs::read_to_string(directory.join("report.html")).unwrap();
    assert_eq!(rig.ok("report --format html").stdout, written);
    assert!(
        written.starts_with("<!DOCTYPE html>")
            && !written.contains("http://")
            && !written.contains("https://")
    );
    let hostile = flight::page(&bad_day(&directory));
    assert_eq!(hostile.matches("<script").count(), 1, "words are escaped");
    assert!(!hostile.contains("throw 1</script>"), "words are escaped");
    // Small enough to be sent, and to be written without being noticed.
    for (file, most) in [
        ("report.html", 1_500_000),
        ("report.json", 1_500_000),
        ("flight.svg", 300_000),
    ] {
        let length = fs::metadata(directory.join(file)).unwrap().len();
        assert!(length < most, "{file} has {length} bytes");
    }
}
