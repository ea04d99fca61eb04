//! Mixing against the reference vectors.

use messages::allocation::Allocation;
use messages::limits::RotorLimits;
use messages::parameters::Airframe;
use mixer::mix::{mix, speeds};

use crate::reference::{assert_close, each_case, number, vector};

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
        let mix = mix(&allocation, u, &tau, f_min, f_max);
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
