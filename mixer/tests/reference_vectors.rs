//! Mixing against the reference vectors.

use messages::allocation::Allocation;
use messages::limits::RotorLimits;
use messages::parameters::Airframe;
use mixer::mix::{roll_pitch_first, speeds, thrust_first};

use crate::reference::{assert_close, cases, each_case, number, vector};

#[test]
fn rotor_thrusts_and_speeds_of_a_demand() {
    let model = Airframe::nominal();
    let allocation = Allocation::new(&model);
    each_case("mixer", |case| {
        let rotor = RotorLimits {
            min_rad_s: number(&case["omega_min"]),
            max_rad_s: number(&case["omega_max"]),
        };
        let (f_min, f_max) = (rotor.f_min(model.k()), rotor.f_max(model.k()));
        let (u, tau) = (number(&case["u"]), vector(&case["tau"]));
        let mix = thrust_first(&allocation, u, &tau, f_min, f_max);
        assert_close(mix.f.as_slice(), &case["f"]);
        assert_eq!(Some(u64::from(mix.saturated)), case["saturated"].as_u64());
    });
    each_case("alloc_inv", |case| {
        // The reference marks the speed of a negative thrust, which does not exist, by -1.
        let w = speeds(&vector(&case["f"]), model.k());
        let w = w.map(|w| if w.is_nan() { -1.0 } else { w });
        assert_close(w.as_slice(), &case["Omega"]);
    });
}

#[test]
fn rotor_thrusts_of_roll_and_pitch_first() {
    let allocation = Allocation::new(&Airframe::nominal());
    let vectors = include_str!("../../shared/reference/mixer.json");
    for case in cases(vectors, "cases", 120) {
        let [u, f_min, f_max] = ["u", "f_min", "f_max"].map(|name| number(&case[name]));
        let mix = roll_pitch_first(&allocation, u, &vector(&case["tau"]), f_min, f_max);
        assert_close(mix.f.as_slice(), &case["f"]);
        assert_eq!(Some(u64::from(mix.saturated)), case["saturated"].as_u64());
    }
}
