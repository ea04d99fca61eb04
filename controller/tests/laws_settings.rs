//! Settings of the laws besides the paper's: descriptions that hold together, and refusals that say what to do.

use control_api::description::{Settings, Value};
use control_api::law::{Law, Rig};
use controller::laws::{Estimating, Geometric, Indi, Pid};
use messages::parameters::Parameter;

fn refusal<L: Law>(rig: &Rig, values: &[(&'static str, Value)]) -> String {
    match L::new(rig, &Settings::new(values.to_vec())) {
        Ok(_) => panic!("{} takes {values:?}", L::DESCRIPTION.name),
        Err(refused) => refused.to_string(),
    }
}

/// Each part stands in the refusal: the name, the value, what is allowed, what to do.
fn says(refusal: &str, parts: &[&str]) {
    for part in parts {
        assert!(refusal.contains(part), "`{part}` is not in: {refusal}");
    }
}

#[test]
fn settings_that_cannot_fly_are_refused() {
    let three = Value::Three;
    let late = [("rate_1_s", three([40.0, 620.0, 20.0]))];
    let late_says = [
        "rate_1_s = 620 1/s (pitch)",
        "below 618.0 1/s",
        "lower rate_1_s",
    ];
    let fast = |name| [(name, three([50.0, 8.0, 3.0]))];
    let fast_says = [
        "= 50 (roll) is above rate_1_s = 40",
        "up to 40",
        "raise rate_1_s",
    ];
    let filter = [("filter_rad_s", Value::Number(1600.0))];
    let filter_says = [
        "filter_rad_s = 1600 rad/s",
        "1570.8 rad/s",
        "lower filter_rad_s",
    ];
    let crossed = [
        ("acceleration_z_min_g", Value::Number(1.0)),
        ("acceleration_z_max_g", Value::Number(1.0)),
    ];
    let crossed_says = ["acceleration_z_min_g = 1 must be below acceleration_z_max_g = 1"];
    let rig = Rig::default();
    says(&refusal::<Geometric>(&rig, &late), &late_says);
    says(&refusal::<Indi>(&rig, &late), &late_says);
    says(&refusal::<Pid>(&rig, &late), &late_says);
    says(
        &refusal::<Geometric>(&rig, &fast("attitude_rad_s")),
        &fast_says,
    );
    says(&refusal::<Indi>(&rig, &fast("attitude_1_s")), &fast_says);
    says(&refusal::<Pid>(&rig, &fast("attitude_1_s")), &fast_says);
    says(&refusal::<Indi>(&rig, &filter), &filter_says);
    says(&refusal::<Pid>(&rig, &filter), &filter_says);
    says(&refusal::<Estimating>(&rig, &crossed), &crossed_says);
    says(&refusal::<Geometric>(&rig, &crossed), &crossed_says);
    let slow = Rig {
        period_s: 0.02,
        ..rig
    };
    let slow_says = [
        "rate_1_s = 40 1/s (roll)",
        "period_s of 0.02",
        "below 30.9 1/s",
    ];
    says(&refusal::<Indi>(&slow, &[]), &slow_says);
    let mut draggy = rig;
    draggy
        .airframe
        .set(Parameter::TranslationalDrag, 5.3)
        .unwrap();
    let draggy_says = [
        "translational_drag_kg_s / mass_kg = 10.192 1/s",
        "up to 10 1/s",
    ];
    says(&refusal::<Estimating>(&draggy, &[]), &draggy_says);
}
