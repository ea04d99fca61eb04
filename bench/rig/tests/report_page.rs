//! report.html as a browser shows it: complete, readable on a telephone and a desk, by day, by night and on paper.
//!
//! The browser is Chromium, named by `IRONBIRD_CHROMIUM` or found. Where there is none, what needs it is left out, and
//! says so.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use crate::browser::Browser;
use crate::rig::{Rig, wait_until};
use model::role::{Role, STAGES};
use report::autopsy::classes::Class;
use report::autopsy::section::{Case, ClassCount, Section, TimelineStage, TimelineTick};
use report::page;
use report::schema::{LateStretchSection, Report, RunLength};
use serde_json::{Value, json};

const LOOK: &str = include_str!("browser/look.js");

/// Plots of every flight.
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

const SWAPS: [&str; 4] = ["--fault", "gyro_noise_rad_s=0.01@tick500", "--fault", "rotational_drag_nm_s=0.525@tick1000"];

/// A flight in lockstep with two swaps, one of which the theorem does not cover.
fn flight(rig: &Rig) -> PathBuf {
    rig.run("fly", &[&["--pace", "lockstep", "--duration", "2s"], &SWAPS[..]].concat()).expect(0);
    rig.out().join("latest")
}

/// The same by the clock, in slow motion, with the machine's floors beside.
fn slow_flight(rig: &Rig) -> PathBuf {
    let beside = ["--config", &rig.slow(2), "--duration", "2s", "--floor", "1s"];
    let ended = rig.run("fly", &[&beside[..], &SWAPS[..]].concat()).expect(0);
    ended.says("\nFloors    at p50, p99, p99.9: wake.plant is ").says("raw futex ring").says("bare timer");
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
    deadlines.runs = vec![RunLength { length_ticks: 1, count: 3 }, RunLength { length_ticks: 400, count: 12_345 }];
    let outages = ClassCount { class: Class::StoppedOrDead, stage: Some("inner".into()), outages: 2, missed: 401 };
    report.autopsy = Section {
        unmeasured: 0,
        classes: vec![outages],
        pending: 3,
        longest: None,
        worst: vec![outage(1_234_567, 98_765), outage(70, 2)],
    };
    report
}

/// An outage in which the inner loop is stopped, and the mixer goes on without it for a while.
fn outage(tick: u64, ticks: u64) -> Case {
    let ends = [tick, tick + ticks - 1].map(|end| end - 1..=end + 2);
    let shown: BTreeSet<u64> = ends.into_iter().flatten().collect();
    let stages = |shown: u64| -> Vec<TimelineStage> {
        let is_out = (tick..tick + ticks).contains(&shown);
        let worked = STAGES.into_iter().filter(|role| !is_out || (*role != Role::Inner && shown != tick + ticks - 1));
        let begin_us = (shown as f64 - tick as f64) * 2_000.0;
        let stage = |role: Role| TimelineStage {
            role: role.name().into(),
            wake_us: begin_us
                + if is_out && role == Role::Mixer { 1_800.0 } else { 50.0 + 30.0 * f64::from(role as u8) },
            send_us: begin_us
                + if is_out && role == Role::Mixer { 2_100.0 } else { 70.0 + 30.0 * f64::from(role as u8) },
            is_fresh: !is_out || role != Role::Mixer,
        };
        worked.map(stage).collect()
    };
    Case {
        faults: vec!["setpoint.drop=0.1".into()],
        tick,
        time_s: tick as f64 * 1e-3,
        ticks,
        missed: ticks,
        delay_us: ticks as f64 * 2_000.0,
        due_us: 80.0,
        class: Class::StoppedOrDead,
        stage: Some("inner".into()),
        evidence: HOSTILE.into(),
        ran: Vec::new(),
        timeline: shown
            .into_iter()
            .map(|it| TimelineTick { tick: it, missed: (tick..tick + ticks).contains(&it), stages: stages(it) })
            .collect(),
    }
}

fn list(found: &Value) -> Vec<&str> {
    found.as_array().unwrap().iter().map(|value| value.as_str().unwrap()).collect()
}

/// Opens a page in all the ways it can be looked at; it must be whole and readable in each.
fn inspect(browser: &mut Browser, page: &Path, plots: &[&str]) {
    let mut grounds = Vec::new();
    for (width, scheme, medium) in [
        (1400, "light", "screen"),
        (1400, "dark", "screen"),
        (400, "light", "screen"),
        (400, "dark", "screen"),
        (960, "light", "screen"),
        (740, "dark", "print"),
    ] {
        let case = format!("{} at {width} pixels, {scheme}, {medium}", page.display());
        browser.show(page, width, scheme, medium);
        let seen = browser.evaluate(LOOK);
        assert_eq!(list(&seen["faults"]), Vec::<&str>::new(), "{case}");
        assert_eq!(browser.complaints(), Vec::<String>::new(), "{case}");
        assert_eq!(seen["scripts"], 1, "{case}");
        assert!(seen["texts"].as_u64().unwrap() > 300, "{case}: {} pieces of text", seen["texts"]);
        let drawn = list(&seen["plots"]);
        for plot in plots {
            assert_eq!(drawn.iter().filter(|name| *name == plot).count(), 1, "{plot} in {case}: {drawn:?}");
        }
        grounds.push(seen["ground"].clone());
    }
    assert_eq!((&grounds[0], &grounds[1]), (&grounds[2], &grounds[3]));
    assert_ne!(grounds[0], grounds[1], "day and night look the same");
}

#[test]
#[ignore = "long: part of the gate"]
fn the_page_is_whole_and_readable_by_day_by_night_and_on_paper() {
    let Some(mut browser) = Browser::open() else { return };
    let rig = Rig::new("page");
    let directory = flight(&rig);
    inspect(&mut browser, &directory.join("report.html"), &[&PLOTS[..], &["violations-gyro_noise"]].concat());

    let page = rig.path("bad.html");
    fs::write(&page, page::render(&bad_day(&slow_flight(&rig)))).unwrap();
    inspect(&mut browser, &page, &[&PLOTS[..], &LATE_PLOTS].concat());
    let text = browser.evaluate("document.body.innerText");
    assert!(text.as_str().unwrap().contains(HOSTILE), "hostile words are shown as they are");
    lines_of_missed_deadlines_can_be_switched_off(&mut browser, &page);

    // What chromium prints.
    let pdf = browser.call("Page.printToPDF", &json!({}));
    assert!(pdf["data"].as_str().unwrap().starts_with("JVBERi"), "a PDF in base 64");
}

/// Also where no script may run.
fn lines_of_missed_deadlines_can_be_switched_off(browser: &mut Browser, page: &Path) {
    browser.call("Emulation.setScriptExecutionDisabled", &json!({"value": true}));
    browser.show(page, 1400, "light", "screen");
    let shown = "[...document.querySelectorAll('svg g.missed')].map((it) => getComputedStyle(it).display)";
    let before = browser.evaluate(shown);
    assert!(list(&before).len() > 20 && list(&before).iter().all(|display| *display == "inline"), "{before}");
    browser.evaluate("document.querySelector('#miss-lines').click()");
    let after = browser.evaluate(shown);
    assert!(list(&after).len() > 20 && list(&after).iter().all(|display| *display == "none"), "{after}");
    browser.call("Emulation.setScriptExecutionDisabled", &json!({"value": false}));
}

#[test]
fn the_page_reads_out_what_the_pointer_is_at() {
    let Some(mut browser) = Browser::open() else { return };
    let rig = Rig::new("read");
    let directory = flight(&rig);
    let report = Report::read(&directory.join("report.json")).unwrap();
    browser.show(&directory.join("report.html"), 1400, "light", "screen");

    let highest = report.distributions.iter().find(|series| series.name == "loop").unwrap();
    let highest = highest.bins.iter().max_by_key(|bin| bin.count).unwrap();
    let words = pointed_at(&mut browser, "histogram-loop", HIGHEST_BIN);
    let [latency, count] = &words[..] else { panic!("{words:?}") };
    let us = number_in(latency, "latency ", " us");
    assert!((highest.from_us * 0.99..highest.below_us * 1.01).contains(&us), "{words:?} in {highest:?}");
    let count = number_in(count, "loop ", "");
    assert!((count / highest.count as f64 - 1.0).abs() < 0.01, "{words:?} in {highest:?}");

    // The swap at tick 500, and both lines.
    let words = pointed_at(&mut browser, "z", AT_SWAP);
    let [time, reference, actual, swap] = &words[..] else { panic!("{words:?}") };
    assert!((number_in(time, "time ", " s") - 0.5).abs() < 0.01, "{words:?}");
    assert!(reference.starts_with("reference ") && actual.starts_with("actual "), "{words:?}");
    assert!(swap.contains("swap at 0.500 s: gyro_noise_rad_s"), "{words:?}");
    browser.show(&directory.join("report.html"), 400, "light", "screen");
    pointed_at(&mut browser, "z", AT_SWAP);
    let room = browser.evaluate(
        "[document.querySelector('.readout'), document.querySelector('[data-plot=z]')]
            .map((it) => it.getBoundingClientRect()).map((it) => [it.left, it.right])",
    );
    let side = |of: usize, side: usize| room[of][side].as_f64().unwrap();
    assert!(side(1, 0) <= side(0, 0) && side(0, 1) <= side(1, 1), "the read-out leaves its figure: {room}");
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

/// Place of the highest bin, in the picture's coordinates.
const HIGHEST_BIN: &str = "(() => {
    const all = svg.querySelector('path.steps').getAttribute('d').split(/[ML]/).slice(1).map((it) => it.split(' ').map(Number));
    const top = Math.min(...all.map((it) => it[1])), at = all.filter((it) => it[1] === top);
    return (at[0][0] + at[1][0]) / 2;
})()";
/// Likewise of the first swap.
const AT_SWAP: &str = "Number(svg.querySelector('path.vertical.swap').getAttribute('d').slice(1).split(' ')[0])";

/// What the page says when the pointer is at a place of a plot.
fn pointed_at(browser: &mut Browser, plot: &str, place: &str) -> Vec<String> {
    let at = browser.evaluate(&format!(
        "(() => {{
            const svg = document.querySelector('[data-plot={plot}] svg');
            svg.scrollIntoView({{ block: 'center' }});
            const room = svg.getBoundingClientRect(), x = {place};
            return [room.left + x * room.width / svg.viewBox.baseVal.width, room.top + room.height / 2];
        }})()"
    ));
    browser.call("Input.dispatchMouseEvent", &json!({"type": "mouseMoved", "x": at[0], "y": at[1]}));
    let words = "[...document.querySelectorAll('.readout div')].map((it) => it.textContent)";
    list(&browser.evaluate(words)).into_iter().map(str::to_owned).collect()
}

fn number_in(words: &str, before: &str, after: &str) -> f64 {
    let number = words.strip_prefix(before).and_then(|rest| rest.strip_suffix(after));
    number.and_then(|number| number.parse().ok()).unwrap_or_else(|| panic!("no {before}NUMBER{after} in {words}"))
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
    let browser = program("browser", &format!("echo \"$1\" > {0}.draft; /bin/mv {0}.draft {0}", opened.display()));
    let run = |command: &str, args: &[&str], browser: &Path| {
        let mut process = rig.command(command, args);
        process.env("BROWSER", browser).env("PATH", &tools);
        rig.launch(process).end()
    };
    let shown = || wait_until("the page to be opened", || fs::read_to_string(&opened).ok());

    let lockstep = ["--pace", "lockstep", "--duration", "0.1s", "--open"];
    let flown = run("fly", &lockstep, &browser).expect(0).says("RESULT status=PASS");
    let page = rig.out().join("latest").canonicalize().unwrap().join("report.html");
    assert_eq!(shown(), format!("{}\n", page.display()));
    flown.complains(&format!("gave {} to ", page.display()));
    fs::remove_file(&opened).unwrap();
    run("report", &["--open"], &browser).expect(0).complains(&format!("gave {} to ", page.display()));
    assert_eq!(shown(), format!("{}\n", page.display()));
    fs::remove_file(&opened).unwrap();

    let missing = tools.join("missing");
    run("report", &["--open"], &missing)
        .expect(1)
        .complains(&format!("cannot open {} with BROWSER={}", page.display(), missing.display()))
        .complains("BROWSER names a program that takes a file");
    let none = Path::new("");
    run("report", &["--open"], none)
        .expect(1)
        .complains("in a browser: neither xdg-open nor gio nor kde-open is installed")
        .complains("set BROWSER to a browser's program");
    program("xdg-open", "exit 3");
    run("report", &["--open"], none).expect(1).complains(&format!("cannot open {} in a browser: ", page.display()));
    // A flight that has passed is flown, whatever became of its page.
    run("fly", &lockstep, none).expect(1).says("RESULT status=PASS").complains("set BROWSER to a browser's program");
    fs::copy(&browser, tools.join("xdg-open")).unwrap();
    run("report", &["--open"], none).expect(0);
    shown();

    run("report", &["--open", "--format", "html"], none).expect(2).complains("'--open' cannot be used with '--format");
    fs::remove_file(rig.out().join("latest/report.html")).unwrap();
    run("report", &["--open"], none).expect(2).complains("holds no page yet").complains("--format html > report.html");
}

#[test]
fn the_look_finds_what_is_wrong() {
    let Some(mut browser) = Browser::open() else { return };
    let rig = Rig::new("look");
    let page = rig.path("wrong.html");
    let wrong = r##"<!DOCTYPE html><html><head><style>body { background: #ffffff; margin: 0; }</style></head><body>
        <p style="white-space: nowrap">a line that is much too long for a telephone and cannot be broken anywhere</p>
        <p style="color: #dddddd">pale</p>
        <figure><svg role="img" aria-label="plot" viewBox="0 0 400 100" width="380">
        <text x="390" y="20">cut off</text><text x="10" y="50">one on</text><text x="12" y="51">another</text>
        <path class="line" d=""></path></svg></figure>
        <nav><a href="#nowhere">to nowhere</a></nav><p style="height: 3000px"></p>
        <img src="https://example.invalid/x.png"><script>console.error("told")</script></body></html>"##;
    fs::write(&page, wrong).unwrap();
    browser.show(&page, 400, "light", "screen");
    let seen = browser.evaluate(LOOK);
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
    let complaints = browser.complaints().join("\n");
    assert!(complaints.contains("told") && complaints.contains("example.invalid"), "{complaints}");
}

#[test]
fn the_page_is_made_of_report_json_alone() {
    let rig = Rig::new("json");
    let directory = flight(&rig);
    let written = fs::read_to_string(directory.join("report.html")).unwrap();
    assert_eq!(rig.run("report", &["--format", "html"]).expect(0).stdout, written);
    assert!(written.starts_with("<!DOCTYPE html>") && !written.contains("http://") && !written.contains("https://"));
    let hostile = page::render(&bad_day(&directory));
    assert_eq!(hostile.matches("<script").count(), 1, "words are escaped");
    assert!(!hostile.contains("throw 1</script>"), "words are escaped");
    // Small enough to be sent, and to be written without being noticed.
    for (file, most) in [("report.html", 1_500_000), ("report.json", 1_500_000), ("flight.svg", 300_000)] {
        let length = fs::metadata(directory.join(file)).unwrap().len();
        assert!(length < most, "{file} has {length} bytes");
    }
}
