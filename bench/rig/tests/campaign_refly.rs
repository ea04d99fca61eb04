//! Flights of campaigns flown again: lost ones too, in real time, and a share of all as an audit.

use crate::rig;

use std::fs;

use crate::rig::Rig;

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
    rig.ok(&format!("campaign run {file} --out {out}"));
    out
}

/// `ironbird campaign fly` into the rig's own directory of runs.
fn again(rig: &Rig, rows: &str, flight: &str, arm: &str, more: &[&str]) -> rig::Ended {
    let runs = rig.out();
    let told = [
        "--arm",
        arm,
        "--out",
        runs.to_str().unwrap(),
        "--instance",
        rig.instance.as_str(),
    ];
    rig.run(
        "campaign",
        [&["fly", rows, flight][..], &told, more].concat(),
    )
}

#[test]
fn a_flight_whose_stage_was_out_is_flown_again_in_one_process_as_its_row_was() {
    let rig = Rig::new("out");
    let text = "[campaign]\nname = \"out\"\nflights = 2\n[flight]\nduration_s = 1.0\n[[fault]]\nwhat = \"inner.stop\"\n\
                value = { uniform = [0.01, 0.02] }\nat_s = { uniform = [0.2, 0.6] }\n";
    let out = flown(&rig, text);
    let ended = again(&rig, &out, "1", "base", &[])
        .expect(0)
        .says("out-1-base: settings.toml, states.csv, flight.svg");
    ended.says("as in the campaign's row");
    let left = rig.out().join("out-1-base");
    assert!(
        fs::read_to_string(left.join("settings.toml"))
            .unwrap()
            .contains("inner.stop=")
    );
    assert!(
        fs::read_to_string(left.join("states.csv"))
            .unwrap()
            .lines()
            .count()
            > 10
    );
    assert!(
        fs::read_to_string(left.join("flight.svg"))
            .unwrap()
            .contains("</svg>")
    );
}

#[test]
fn a_lost_flight_ends_again_where_its_rows_flight_ended() {
    let rig = Rig::new("lost");
    let out = flown(&rig, LOST);
    let report = rig
        .ok(&format!("campaign report {out} --format json"))
        .json();
    let worst = report["worst"].as_array().unwrap();
    let mut reasons = Vec::new();
    for flight in worst {
        let lost = flight["lost"].as_str().unwrap();
        let reason = ["position error", "tilt", "ground"]
            .into_iter()
            .find(|reason| lost.contains(reason));
        let Some(reason) =
            reason.filter(|reason| reasons.iter().filter(|known| *known == reason).count() < 2)
        else {
            continue;
        };
        reasons.push(reason);
        let (number, arm) = (
            flight["flight"].to_string(),
            flight["arm"].as_str().unwrap(),
        );
        again(&rig, &out, &number, arm, &[])
            .expect(0)
            .says(", as in the campaign's row, which is no success by");
        rig.ok("replay --verify").says("identical");
    }
    reasons.dedup();
    assert!(
        reasons.len() >= 2 && reasons.contains(&"position error"),
        "{reasons:?} of {worst:?}"
    );
    rig.assert_nothing_left();
}
