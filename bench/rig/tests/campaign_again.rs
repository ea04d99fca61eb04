//! Flights of campaigns flown again: lost ones too, in real time, and a share of all as an audit.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::fs;
use std::path::Path;

use crate::rig::Rig;
use serde_json::Value;

/// Flights that are lost in every way: too far away, upside down, fallen onto the ground, and some that are not.
const LOST: &str = r#"
[campaign]
name = "lost"
flights = 6
chunk = 4

[flight]
trajectory = "fast"
duration_s = 2.0

[[fault]]
what = "rotor_efficiency_1"
value = { grid = [0.1, 0.5, 1.0] }
at_s = { uniform = [0.2, 0.9] }

[arms.near]
"flight.position_error_max_m" = 0.5
[arms.far]
"flight.position_error_max_m" = 100.0
[arms.ground]
"flight.position_error_max_m" = 100.0
"ground.contact" = "plane"
"#;

/// `ironbird campaign run` of a text.
fn flown(rig: &Rig, text: &str) -> String {
    let (file, out) = (rig.settings(text), rig.file("rows"));
    rig.run("campaign", &["run", &file, "--out", &out]).expect(0);
    out
}

/// `ironbird campaign fly` into the rig's own directory of runs.
fn again(rig: &Rig, rows: &str, flight: &str, arm: &str, more: &[&str]) -> rig::Ended {
    let runs = rig.out();
    let told = ["--arm", arm, "--out", runs.to_str().unwrap(), "--instance", rig.instance.as_str()];
    rig.run("campaign", &[&["fly", rows, flight][..], &told, more].concat())
}

#[test]
fn a_flight_whose_stage_was_out_is_flown_again_in_one_process_as_its_row_was() {
    let rig = Rig::new("out");
    let text = "[campaign]\nname = \"out\"\nflights = 2\n[flight]\nduration_s = 1.0\n[[fault]]\nwhat = \"inner.stop\"\n\
                value = { uniform = [0.01, 0.02] }\nat_s = { uniform = [0.2, 0.6] }\n";
    let out = flown(&rig, text);
    let ended = again(&rig, &out, "1", "base", &[]).expect(0).says("out-1-base: settings.toml, states.csv, flight.svg");
    ended.says("as in the campaign's row");
    let left = rig.out().join("out-1-base");
    assert!(fs::read_to_string(left.join("settings.toml")).unwrap().contains("inner.stop="));
    assert!(fs::read_to_string(left.join("states.csv")).unwrap().lines().count() > 10);
    assert!(fs::read_to_string(left.join("flight.svg")).unwrap().contains("</svg>"));
}

#[test]
fn a_lost_flight_ends_again_where_its_rows_flight_ended() {
    let rig = Rig::new("lost");
    let out = flown(&rig, LOST);
    let report = rig.run("campaign", &["report", &out, "--format", "json"]).expect(0).json();
    let worst = report["worst"].as_array().unwrap();
    let mut reasons = Vec::new();
    for flight in worst {
        let lost = flight["lost"].as_str().unwrap();
        let reason = ["position error", "tilt", "ground"].into_iter().find(|reason| lost.contains(reason));
        let Some(reason) = reason.filter(|reason| reasons.iter().filter(|known| *known == reason).count() < 2) else {
            continue;
        };
        reasons.push(reason);
        let (number, arm) = (flight["flight"].to_string(), flight["arm"].as_str().unwrap());
        again(&rig, &out, &number, arm, &[]).expect(0).says(", as in the campaign's row, which is no success by");
        rig.run("replay", &["--verify"]).expect(0).says("identical");
    }
    reasons.dedup();
    assert!(reasons.len() >= 2 && reasons.contains(&"position error"), "{reasons:?} of {worst:?}");
    rig.assert_nothing_left();
}

#[test]
fn a_flight_flies_again_in_real_time() {
    let rig = Rig::new("live");
    let out = flown(&rig, LOST);
    let live = again(&rig, &out, "2", "far", &["--live"]);
    let report: Value =
        serde_json::from_str(&fs::read_to_string(rig.out().join("latest/report.json")).unwrap()).unwrap();
    assert_eq!(report["run"]["wall_period_us"], 1000.0, "not in lockstep: {live}");
    assert!(rig.out().join("latest/report.html").exists());
    // What a loaded machine makes of a flight in real time is no verdict; that it flew is.
    assert!(live.code.is_some_and(|code| [0, 3].contains(&code)) && !live.stdout.contains("campaign's row"), "{live}");
    rig.assert_nothing_left();
}

#[test]
fn an_audit_flies_a_share_again_and_finds_a_row_that_is_not_its_flights() {
    let rig = Rig::new("audit");
    let out = flown(&rig, LOST);
    let audit = |args: &[&str]| rig.run("campaign", &[&["report", out.as_str(), "--jobs", "2"][..], args].concat());
    audit(&["--audit", "1"]).expect(0).says("Audit: 6 flights flown again, 18 rows: identical");
    let some = audit(&["--audit", "0.5", "--format", "json"]).expect(0).json();
    let flights = some["audit"]["flights"].as_u64().unwrap();
    assert!((1..6).contains(&flights) && some["audit"]["rows"] == 3 * flights, "{some}");
    audit(&["--audit", "1e-9"]).expect(0).says("Audit: 1 flight flown again, 3 rows: identical");
    for wrong in ["0", "1.5", "x"] {
        audit(&["--audit", wrong]).expect(2).complains("write a share above 0 and up to 1");
    }
    // A machine that computes otherwise, by a file that says it is whole: that of other draws.
    let other = LOST.replace("[campaign]\n", "[campaign]\nseed = 2\n");
    let (file, elsewhere) = (rig.settings(&other), rig.file("elsewhere"));
    rig.run("campaign", &["run", &file, "--out", &elsewhere]).expect(0);
    forge(Path::new(&elsewhere), Path::new(&out));
    let found = audit(&["--audit", "1"]).expect(3).says("Audit: 6 flights flown again, 18 rows: 12 differ");
    found.says("flight 0 by near: flight.seed is ").says(" in its row, and ");
    audit(&["--audit", "1", "--page", &rig.file("page.html")]).expect(3);
    assert!(fs::read_to_string(rig.path("page.html")).unwrap().contains("12 differ"));
}

/// Writes the first chunk of a campaign as if it were that of another.
fn forge(from: &Path, to: &Path) {
    use arrow_array::RecordBatch;
    use campaign::chunk::{Identity, path_of, told, writer};
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    let facts: Value = serde_json::from_str(&fs::read_to_string(to.join("campaign.json")).unwrap()).unwrap();
    let said = |key: &str| facts[key].as_str().unwrap().to_owned();
    let identity = Identity { name: "lost".into(), campaign: said("campaign"), build: said("build") };
    let file = fs::File::open(path_of(from, 0)).unwrap();
    let mut reader = ParquetRecordBatchReaderBuilder::try_new(file).unwrap().with_batch_size(100).build().unwrap();
    let rows: RecordBatch = reader.next().unwrap().unwrap();
    let like = RecordBatch::new_empty(rows.schema());
    let told = told(&identity, Some((0, 0..4)), Some(&rows));
    let mut writer = writer(fs::File::create(path_of(to, 0)).unwrap(), &like, told).unwrap();
    writer.write(&rows).unwrap();
    writer.close().unwrap();
}
