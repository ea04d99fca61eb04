//! The reports of two recorded flights, their comparison, and what `compare` and `margin` show are as in `snapshots/`:
//! `INSTA_UPDATE=always cargo test -p render` accepts a change.
//!
//! `reports/` holds `margins.json`, of `margin --inner adaptive --inner pid --phases 2 --longest 60ms --only inner --only
//! rotor_speeds --format json`, and report.json, without most points of the plots, and run.json of
//! * `outages`: `fly --duration 400ms --rt off --on-death restart --outer estimating --fault inner.stop=20ms@100ms --fault
//!   mass_kg=0.6~50ms@180ms --fault state.drop=0.2@200ms..240ms --fault mixer.kill@280ms --gate theorem --max-miss-rate 10
//!   --max-tracking-error 0.1`,
//! * `lockstep`: `fly --pace lockstep --duration 300ms --inner indi --airframe crazyflie --fault mass_kg=+10%@100ms`.

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::fs;
use std::path::{Path, PathBuf};

use analysis::comparison::{
    Comparison, Effort, ErrorFigures, Fault, Figures, Flight, Laws, Outcome, POWER, SCHEMA,
    TRUE_ERROR,
};
use analysis::diff::{ComparedRun, compare};
use analysis::faults::{AppliedSwap, InjectedFault, ProcessFailure};
use analysis::margin::Margins;
use analysis::schema::{AngleErrors, FlightStatus, FlightVerdict, RedundancySection, Report};
use analysis::traces::{Group, Trace};
use hashed::hashed;
use render::brief::Left;
use render::cases::Cases;
use render::{brief, comparison, diff, files, flight, junit, margin, page, sentences};

fn recorded(flight: &str, file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/reports")
        .join(flight)
        .join(file)
}

/// One element a line, without the scripts and styles that are files of their own.
fn in_lines(page: &str) -> String {
    page.replace(include_str!("../src/page.css"), "")
        .replace(include_str!("../src/plot.css"), "")
        .replace(include_str!("../src/readout.js"), "")
        .replace(include_str!("../src/replay.js"), "")
        .replace(include_str!("../src/vehicle.js"), "")
        .replace("><", ">\n<")
}

/// The headings of a page or picture, and how many elements of each kind are in it.
fn outline(page: &str) -> String {
    let is_heading = |line: &&str| {
        let headings = [
            "<h1",
            "<h2",
            "<h3",
            "<text class=\"title\"",
            "<text class=\"heading\"",
        ];
        headings.iter().any(|heading| line.starts_with(heading))
    };
    let mut outline: String = page
        .lines()
        .filter(is_heading)
        .map(|line| format!("{line}\n"))
        .collect();
    for element in [
        "text", "path", "line", "rect", "circle", "figure", "tr", "td", "li", "a", "script",
    ] {
        let count = page.lines().filter(|line| {
            let name = line
                .strip_prefix('<')
                .and_then(|line| line.split([' ', '>']).next());
            name == Some(element)
        });
        outline += &format!("{element} {}\n", count.count());
    }
    outline
}

/// The first lines of each block of a report.
fn beginnings(report: &str) -> String {
    let blocks = report
        .split("\n\n")
        .map(|block| block.lines().take(12).collect::<Vec<_>>().join("\n"));
    blocks.collect::<Vec<_>>().join("\n\n")
}

#[test]
fn reports_are_their_snapshots() {
    let of_both = ["brief.txt", "report.txt"];
    let more = ["flight.svg", "junit.xml", "report.html"];
    for (name, more) in [("outages", &more[..]), ("lockstep", &[])] {
        let mut report = Report::read(&recorded(name, "report.json")).unwrap();
        let written = tempfile::tempdir().unwrap();
        files::write_all(&mut report, written.path());
        junit::write(&report, &written.path().join("junit.xml")).unwrap();
        let left = Left {
            page: Some("report.html".into()),
            log: None,
            run: None,
        };
        let summary = brief::render(&report, &left) + &flight::result_line(&report, name);
        fs::write(written.path().join("brief.txt"), summary).unwrap();
        for file in of_both.iter().chain(more) {
            let text = in_lines(&fs::read_to_string(written.path().join(file)).unwrap());
            let name = format!("{name}.{file}");
            let text = match *file {
                "report.html" | "flight.svg" => hashed(&name, &text, &outline(&text)),
                "report.txt" => hashed(&name, &text, &beginnings(&text)),
                _ => text,
            };
            insta::assert_snapshot!(name, text);
        }
    }
}

#[test]
fn a_flight_in_lockstep_ends_after_its_faults_and_not_when_the_clock_says() {
    let mut report = Report::read(&recorded("lockstep", "report.json")).unwrap();
    assert!(report.ticks.elapsed_s < 0.1);
    let page = page::render(&report);
    let place = |page: &str, text| page.find(text).unwrap_or_else(|| panic!("no {text}"));
    assert!(place(&page, "<time>0.100 s") < place(&page, "<time>0.301 s"));
    // However many faults there are before them, the end of a process and of the flight are shown.
    let fault = |tick| InjectedFault::new("state.drop=0.1".into(), tick, None, 1e-3);
    report.faults = (0..20).map(fault).collect();
    report.redundancy = Some(RedundancySection::default());
    report.deaths = vec![ProcessFailure {
        role: "inner".into(),
        time_s: 0.2,
        ..ProcessFailure::default()
    }];
    let page = page::render(&report);
    assert!(place(&page, "a.inner at tick 0") < place(&page, "<time>0.301 s"));
    let left_out = "What happened; 9 more events are in the sections below";
    place(&page, left_out);
    // The summary of a lost flight has the parameter changes that came last.
    report.words.flight.word = FlightVerdict::Lost;
    let swap = |time_s| AppliedSwap {
        time_s,
        ..report.swaps[0].clone()
    };
    report.swaps = [0.1, 0.2, 0.25].map(swap).into();
    report.run.period_us = 312.5;
    let summary = brief::render(&report, &Left::default());
    for text in ["0.0297 at 0.250", "T = 312.5 us"] {
        let summary = summary.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(summary.contains(text), "{summary}");
    }
}

#[test]
fn the_recorded_causes_decide_what_to_do_next() {
    let mut report = Report::read(&recorded("outages", "report.json")).unwrap();
    let next = |report: &Report| {
        let steps = sentences::next_steps(report, None).into_iter();
        steps.map(|(command, _)| command).collect::<Vec<_>>()
    };
    let deaths = "ironbird report --section deaths";
    let outages = "ironbird report --section outages";
    report.words.flight.word = FlightVerdict::Lost;
    let (margin, doctor) = ("ironbird margin", "ironbird doctor");
    assert_eq!(next(&report), [deaths, margin, doctor]);
    // A fault was on in each outage.
    let worst = &mut report.autopsy.worst;
    worst
        .iter_mut()
        .for_each(|it| it.faults = vec!["inner.kill".into()]);
    assert_eq!(next(&report), [deaths, margin, outages]);
    report.deaths.clear();
    report.run.laws.get_mut("inner").unwrap().first_not_finite = Some(7);
    assert_eq!(next(&report), ["ironbird replay latest", outages]);
    // The failure of a role explains that an aborted flight is late: nothing points at the machine.
    report.verdict.status = FlightStatus::Aborted;
    report.autopsy.worst.clear();
    assert_eq!(next(&report), ["ironbird replay latest"]);
    // Commands for another flight than the latest one name it.
    let run = Some("elsewhere/7".to_owned());
    let summary = brief::render(
        &report,
        &Left {
            run,
            ..Left::default()
        },
    );
    for command in ["replay elsewhere/7", "report elsewhere/7 --full"] {
        assert!(
            summary.contains(&format!("ironbird {command}")),
            "{summary}"
        );
    }
}

#[test]
fn the_comparison_of_two_flights_is_its_snapshot() {
    let [a, b] = ["lockstep", "outages"].map(|flight| ComparedRun {
        run: flight.into(),
        report: Report::read(&recorded(flight, "report.json")).unwrap(),
        facts: serde_json::from_str(&fs::read_to_string(recorded(flight, "run.json")).unwrap())
            .unwrap(),
    });
    insta::assert_snapshot!(diff::render(&compare(&[a], &[b])));
}

#[test]
fn the_margins_of_two_laws_are_their_snapshot() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reports/margins.json");
    let mut margins: Margins = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let document = margin::document(&margins);
    insta::assert_snapshot!("margins.txt", document.text());
    let page = in_lines(&document.html());
    insta::assert_snapshot!(
        "margins.html",
        hashed("margins.html", &page, &outline(&page))
    );
    // An axis without a margin is the worst one, for the delay and for the gain.
    margins.laws[1].predicted.unsettled = vec!["yaw".into()];
    let document = margin::document(&margins);
    for text in [document.text(), document.html()] {
        assert_eq!(
            text.matches("none: yaw does not settle").count(),
            2,
            "{text}"
        );
    }
}

/// A flight with errors of this size and a fault at 1 s, until it is lost.
fn outcome(inner: &str, error_m: f64, lost_s: Option<f64>) -> Outcome {
    let error = |share: f64| ErrorFigures {
        rms_m: share * error_m,
        p99_m: 2.0 * share * error_m,
        worst_m: 3.0 * share * error_m,
    };
    let trace = |values: [f64; 3]| Trace {
        min: values.map(Some).into(),
        max: values.map(|value| Some(2.0 * value)).into(),
    };
    let channels = [
        (TRUE_ERROR, trace([1e-6, error_m, 0.5 * error_m])),
        (POWER, trace([1.0, 1.1, 1.05])),
    ];
    Outcome {
        laws: Laws {
            outer: "pd".into(),
            inner: inner.into(),
            mixer: "roll_pitch_first".into(),
        },
        preset: if inner == "indi" { "flight" } else { "soft" }.into(),
        ticks: lost_s.map_or(9001, |time_s| (1e3 * time_s) as u64),
        ended_early_s: lost_s,
        lost: lost_s.map(|_| "the flight left its envelope".into()),
        lost_s,
        unusable: Vec::from_iter(lost_s.map(|_| "a number that is not finite".into())),
        motion: None,
        figures: Figures {
            error: error(1.0),
            error_before: Some(error(0.01)),
            error_from_fault: Some(error(1.5)),
            error_after: lost_s.is_none().then(|| error(0.5)),
            yaw_error: Some(AngleErrors {
                rms_rad: 0.01,
                max_rad: 0.03,
                ..AngleErrors::default()
            }),
            tilt_error: None,
            recovery_s: vec![lost_s.is_none().then_some(10.0 * error_m)],
            effort: Effort {
                power: 1.01,
                agitation_rad_s: 20.0 * error_m,
                saturated_percent: 2.5,
            },
            trace: Some(Group {
                every_ticks: 1000,
                tick: vec![0, 1000, 2000],
                channels: channels
                    .map(|(name, trace)| (name.to_owned(), trace))
                    .into(),
            }),
        },
        outputs: "188be4ee61351ca4".into(),
    }
}

#[test]
fn the_comparison_of_laws_and_a_table_of_cases_are_their_snapshots() {
    let compared = |outcomes: Vec<Outcome>| Comparison {
        schema: SCHEMA,
        build: Default::default(),
        flight: Flight {
            trajectory: "lissajous".into(),
            airframe: "paper".into(),
            preset: "soft".into(),
            seed: 1,
            last_tick: 9000,
            period_s: 1e-3,
            bound_m: 0.05,
            bound_yaw_rad: 0.1,
            faults: vec![Fault {
                tick: 1000,
                time_s: 1.0,
                what: "mass_kg=+30%".into(),
            }],
        },
        outcomes,
    };
    let heavier = compared(vec![
        outcome("adaptive", 0.004, None),
        outcome("pid", 0.04, None),
        outcome("indi", 0.2, Some(2.5)),
    ]);
    // Commands that hardly change, and laws that share the first place.
    let light = compared(
        ["adaptive", "pid", "indi"]
            .map(|law| outcome(law, 0.003, None))
            .into(),
    );
    let document = comparison::document(&heavier);
    let page = in_lines(&document.html());
    let shown = document.text() + &outline(&page);
    insta::assert_snapshot!("comparison", hashed("comparison.html", &page, &shown));
    // Eight flights: of `indi` one is lost, the commands of `pid` differ from flight to flight.
    let repeated = (1..=8).map(|k| {
        compared(vec![
            outcome("adaptive", 0.004, None),
            outcome("pid", 0.004 * f64::from(k), None),
            outcome("indi", 0.2, (k == 5).then_some(2.5)),
        ])
    });
    let once = vec![
        ("heavier | 30 %".to_owned(), vec![heavier]),
        ("light".to_owned(), vec![light]),
    ];
    let eight_times = vec![("repeated".to_owned(), repeated.collect())];
    for (name, from_fault, rows) in [
        ("cases", false, once.clone()),
        ("cases_from_fault", true, once),
        ("cases_repeated", true, eight_times),
    ] {
        let cases = Cases {
            title: "Robustness".into(),
            from_fault,
            rows,
        };
        let [text, picture] = [cases.document().text(), in_lines(&cases.picture())];
        insta::assert_snapshot!(name, cases.markdown() + &cases.csv() + &text + &picture);
    }
}
