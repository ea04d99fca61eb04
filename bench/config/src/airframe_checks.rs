//! Airframes that cannot exist, and those whose numbers look like a wrong unit.

use messages::limits::RotorLimits;
use messages::parameters::Airframe;

/// Share by which rounded moments of inertia may miss their rule.
const ROUNDING: f64 = 1e-6;

/// A figure of an airframe, its plausible range, and the unit that a value outside of it suggests.
struct Check {
    figure: &'static str,
    unit: &'static str,
    range: [f64; 2],
    likely: &'static str,
    /// The figure; 0 where the airframe has none.
    of: fn(&Airframe, &RotorLimits) -> f64,
}

const CHECKS: [Check; 5] = [
    Check {
        figure: "rotor speed in hover",
        unit: " rad/s",
        range: [50.0, 5000.0],
        likely: "thrust_coefficient_n_s2 is in N/(rad/s)^2: multiply one in N/rpm^2 by 91.19",
        of: |it, _| it.hover_speed_rad_s(),
    },
    Check {
        figure: "arm over the cubic root of the mass",
        unit: " m/kg^(1/3)",
        range: [0.03, 3.0],
        likely: "arm_length_m is in m and mass_kg in kg: not in mm or g",
        of: |it, _| it.l() / it.m().cbrt(),
    },
    Check {
        figure: "thrust to weight of all rotors at rotor.max_rad_s",
        unit: "",
        range: [1.1, 20.0],
        likely: "rotor.max_rad_s is in rad/s, not in rpm, and mass_kg in kg, not in g",
        of: |it, rotor| match it.m() * it.g() {
            0.0 => 0.0,
            weight_n => 4.0 * rotor.f_max(it.k()) / weight_n,
        },
    },
    Check {
        figure: "yaw torque over thrust of a rotor",
        unit: " m",
        range: [0.001, 0.3],
        likely: "drag_factor_nm_s2 is in N m/(rad/s)^2: multiply a torque per thrust by thrust_coefficient_n_s2",
        of: |it, _| it.d() / it.k(),
    },
    Check {
        figure: "radius of gyration about x over the cubic root of the mass",
        unit: " m/kg^(1/3)",
        range: [0.01, 1.0],
        likely: "moments of inertia are in kg m^2: not in g cm^2 or kg mm^2",
        of: |it, _| (it.i_m()[0] / it.m()).sqrt() / it.m().cbrt(),
    },
];

/// Warnings of implausible figures of an airframe, each with the likely unit.
pub(super) fn implausible(airframe: &Airframe, rotor: &RotorLimits) -> Vec<String> {
    let warning = |check: &Check| {
        let &Check {
            figure,
            unit,
            range: [min, max],
            likely,
            of,
        } = check;
        let value = of(airframe, rotor);
        let is_plausible = value == 0.0 || (min..=max).contains(&value);
        (!is_plausible).then(|| {
            format!("the airframe's {figure} is {value:.2e}{unit}, plausible are {min} to {max}{unit}: {likely}")
        })
    };
    CHECKS.iter().filter_map(warning).collect()
}

/// Why no body has these moments of inertia, if so: each is at most the sum of the other two.
pub(super) fn impossible_body(airframe: &Airframe) -> Option<String> {
    let [x, y, z] = airframe.i_m();
    let sum = x + y + z;
    let is_impossible = [x, y, z]
        .iter()
        .any(|it| *it > (sum - it) * (1.0 + ROUNDING));
    is_impossible.then(|| {
        format!(
            "inertia_x_kg_m2 = {x}, inertia_y_kg_m2 = {y}, inertia_z_kg_m2 = {z}: no body has these moments of inertia; \
             each is at most the sum of the other two"
        )
    })
}
