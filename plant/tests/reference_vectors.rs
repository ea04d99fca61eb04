//! The accelerations against the reference vectors.

use messages::attitude::Attitude;
use messages::parameters::Airframe;
use messages::rate_dynamics::disturbance;
use plant::rigid_body::{Dynamics, Effort};

use crate::reference::{assert_close, each_case, number, vector};

#[test]
fn accelerations_by_equations_1_and_8() {
    let dynamics = Dynamics::new(&Airframe::nominal());
    each_case("acc_lin", |case| {
        let forcing = dynamics.forcing(&Effort {
            u: number(&case["u"]),
            ..Effort::default()
        });
        let attitude = Attitude::of_euler(&vector(&case["eul"]));
        let a = dynamics.linear_acceleration(&attitude, &vector(&case["vel"]), &forcing);
        assert_close(a.as_slice(), &case["out"]);
    });
    each_case("acc_rot", |case| {
        let forcing = dynamics.forcing(&Effort {
            tau: vector(&case["tau"]),
            om: number(&case["Om"]),
            ..Effort::default()
        });
        let forcing = dynamics.disturbed(&forcing, &disturbance(number(&case["t"])));
        let a = dynamics.angular_acceleration(&vector(&case["nu"]), &forcing);
        assert_close(a.as_slice(), &case["out"]);
    });
}
