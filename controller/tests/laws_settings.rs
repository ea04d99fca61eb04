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

#[test]
fn settings_that_cannot_fly_are_refused_with_name_value_and_what_is_allowed() {
    let three = Value::Three;
    let late = [("rate_1_s", three([40.0, 620.0, 20.0]))];
    let late_says = "rate_1_s = 620 1/s (pitch) cannot fly at a period_s of 0.001: with a late command the rate loop is \
                     stable below 618.0 1/s; lower rate_1_s";
    let fast = |name| [(name, three([50.0, 8.0, 3.0]))];
    let fast_says = "(roll) is above rate_1_s = 40: the attitude loop must be the slower one, allowed is up to 40; lower";
    let filter = [("filter_rad_s", Value::Number(1600.0))];
    let filter_says = "up to a quarter of the sampling frequency, 1570.8 rad/s; lower filter_rad_s";
    let crossed =
        ["acceleration_z_min_g", "acceleration_z_max_g"].map(|name| (name, Value::Number(1.0)));
    let crossed_says = "acceleration_z_min_g = 1 must be below acceleration_z_max_g = 1";
    let rig = Rig::default();
    let slow = Rig {
        period_s: 0.02,
        ..rig
    };
    let mut draggy = rig;
    draggy
        .airframe
        .set(Parameter::TranslationalDrag, 5.3)
        .unwrap();
    for (refusal, expected) in [
        (refusal::<Geometric>(&rig, &late), late_says),
        (refusal::<Indi>(&rig, &late), late_says),
        (refusal::<Pid>(&rig, &late), late_says),
        (
            refusal::<Geometric>(&rig, &fast("attitude_rad_s")),
            fast_says,
        ),
        (refusal::<Indi>(&rig, &fast("attitude_1_s")), fast_says),
        (refusal::<Pid>(&rig, &fast("attitude_1_s")), fast_says),
        (refusal::<Indi>(&rig, &filter), filter_says),
        (refusal::<Pid>(&rig, &filter), filter_says),
        (refusal::<Estimating>(&rig, &crossed), crossed_says),
        (refusal::<Geometric>(&rig, &crossed), crossed_says),
        (
            refusal::<Indi>(&slow, &[]),
            "rate_1_s = 40 1/s (roll) cannot fly at a period_s of 0.02",
        ),
        (
            refusal::<Estimating>(&draggy, &[]),
            "translational_drag_kg_s / mass_kg = 10.192 1/s",
        ),
    ] {
        assert!(
            refusal.contains(expected),
            "`{expected}` is not in: {refusal}"
        );
    }
}
