//! Frames, allocation and rate dynamics against the reference vectors.

use messages::allocation::{Allocation, net_speed};
use messages::frames::RollPitch;
use messages::parameters::Airframe;
use messages::rate_dynamics::{Inertia, disturbance};
use nalgebra::{Matrix3, Vector3};

use crate::frames::{j2, rot_wb, w};
use crate::reference::{assert_close, each_case, number, vector};

#[test]
fn frames() {
    type Frame = fn(&Vector3<f64>) -> Matrix3<f64>;
    let frames: [(&str, Frame); 3] = [("J1", rot_wb), ("J2", j2), ("W", w)];
    for (group, frame) in frames {
        each_case(group, |case| {
            let actual = frame(&vector(&case["eul"]));
            assert_close(actual.transpose().as_slice(), &case["out"]);
        });
    }
    assert_eq!(
        RollPitch::of(&Vector3::zeros()).rot_wb(0.0),
        Matrix3::identity()
    );
}

#[test]
fn regressors() {
    each_case("regressors", |case| {
        let inertia = Inertia::new(Airframe::nominal().i_m().into());
        let (nu2, om, t_s) = (vector(&case["nu"]), number(&case["Om"]), number(&case["t"]));
        let phi = inertia.regressor(&nu2, om, &disturbance(t_s));
        assert_close(inertia.coupling(&nu2).as_slice(), &case["f"]);
        assert_close(disturbance(t_s).as_slice(), &case["h"]);
        for (column, name) in ["g1", "g2", "h"].into_iter().enumerate() {
            assert_close(phi.column(column).as_slice(), &case[name]);
        }
    });
}

#[test]
fn allocation() {
    let airframe = Airframe::nominal();
    let allocation = Allocation::new(&airframe);
    each_case("alloc", |case| {
        let (u, tau) = allocation.wrench(&vector(&case["f"]));
        assert_close(&[u, tau.x, tau.y, tau.z], &case["out_u_tp_tq_tr"]);
    });
    each_case("alloc_inv", |case| {
        let demand = vector::<4>(&case["u_tp_tq_tr"]);
        let f = allocation.thrusts(demand.x, &demand.fixed_rows::<3>(1).into());
        assert_close(f.as_slice(), &case["f"]);
        // The reference marks the speed of a negative thrust, which does not exist, by -1.
        let speed = |f: f64| {
            if f < 0.0 {
                -1.0
            } else {
                (f / airframe.k()).sqrt()
            }
        };
        assert_close(f.map(speed).as_slice(), &case["Omega"]);
    });
    each_case("omega_net", |case| {
        assert_close(&[net_speed(&vector(&case["Omega"]))], &case["out"]);
    });
}
