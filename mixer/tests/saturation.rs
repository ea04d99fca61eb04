//! Saturation by priority: a table of expected motors, and properties of any mix.
//!
//! One of the properties is monotonicity.

use messages::allocation::Allocation;
use messages::parameters::{Airframe, Parameter};
use mixer::mix::{Mix, YAW_RESERVE, roll_pitch_first, thrust_first};
use nalgebra::{Vector3, Vector4};
use proptest::prelude::*;

type Law = fn(&Allocation, f64, &Vector3<f64>, f64, f64) -> Mix;

const BOTH: [Law; 2] = [roll_pitch_first, thrust_first];

/// An allocation with round numbers: a thrust of 1 N per rotor and torque of 1 N m on each axis.
fn unit_allocation() -> Allocation {
    let mut airframe = Airframe::nominal();
    for (parameter, value) in [
        (Parameter::ArmLength, std::f64::consts::SQRT_2 / 4.0),
        (Parameter::ThrustCoefficient, 4e-5),
        (Parameter::DragFactor, 1e-5),
    ] {
        airframe.set(parameter, value).unwrap();
    }
    Allocation::new(&airframe)
}

#[test]
fn expected_motors() {
    // With both lever arms at 1/4 m, a torque of 1 N m is +-1 N on every rotor; the limits are 0 N and 10 N.
    #[rustfmt::skip]
    let both: [(f64, [f64; 3], [f64; 4], bool); 13] = [
        (20.0,  [0.0, 0.0, 0.0],   [5.0, 5.0, 5.0, 5.0],     false),
        (20.0,  [1.0, 0.0, 0.0],   [6.0, 4.0, 4.0, 6.0],     false),
        (20.0,  [0.0, 1.0, 0.0],   [6.0, 6.0, 4.0, 4.0],     false),
        (20.0,  [0.0, 0.0, 1.0],   [6.0, 4.0, 6.0, 4.0],     false),
        (20.0,  [1.0, 1.0, 1.0],   [8.0, 4.0, 4.0, 4.0],     false),
        (20.0,  [5.0, 0.0, 0.0],   [10.0, 0.0, 0.0, 10.0],   false),
        // Thrust alone.
        (48.0,  [0.0, 0.0, 0.0],   [10.0, 10.0, 10.0, 10.0], true),
        (-4.0,  [0.0, 0.0, 0.0],   [0.0, 0.0, 0.0, 0.0],     true),
        // Roll and pitch shrink together.
        (20.0,  [10.0, 0.0, 0.0],  [10.0, 0.0, 0.0, 10.0],   true),
        (20.0,  [6.0, 4.0, 0.0],   [10.0, 4.0, 0.0, 6.0],    true),
        // Beyond its reserve, yaw takes what roll and pitch left.
        (20.0,  [0.0, 0.0, 8.0],   [10.0, 0.0, 10.0, 0.0],   true),
        (20.0,  [3.0, 0.0, 8.0],   [10.0, 0.0, 4.0, 6.0],    true),
        (20.0,  [5.0, 0.0, 1.0],   [10.0, 0.0, 0.0, 10.0],   true),
    ];
    // Roll and pitch first: they move the thrust; yaw moves it by up to 0.75 N per rotor.
    #[rustfmt::skip]
    let roll_pitch: [(f64, [f64; 3], [f64; 4], bool); 5] = [
        (40.0,  [1.0, 1.0, 1.0],   [10.0, 6.5, 6.0, 6.5], true),
        (0.0,   [1.0, -1.0, 1.0],  [3.5, 0.0, 3.5, 4.0],    true),
        (36.0,  [3.0, 1.0, 0.0],   [10.0, 4.0, 2.0, 8.0],    true),
        (36.0,  [-1.0, 0.0, -2.0], [6.5, 10.0, 8.5, 8.0],    true),
        (40.0,  [0.0, 0.0, 4.0],   [10.0, 8.5, 10.0, 8.5],   true),
    ];
    // Thrust first: at either end no torque is left.
    #[rustfmt::skip]
    let thrust: [(f64, [f64; 3], [f64; 4], bool); 5] = [
        (40.0,  [1.0, 1.0, 1.0],   [10.0, 10.0, 10.0, 10.0], true),
        (0.0,   [1.0, -1.0, 1.0],  [0.0, 0.0, 0.0, 0.0],     true),
        (36.0,  [3.0, 1.0, 0.0],   [10.0, 8.5, 8.0, 9.5],    true),
        (36.0,  [-1.0, 0.0, -2.0], [8.0, 10.0, 10.0, 8.0],   true),
        (40.0,  [0.0, 0.0, 4.0],   [10.0, 10.0, 10.0, 10.0], true),
    ];
    for (law, own) in BOTH.iter().zip([roll_pitch, thrust]) {
        for (u, tau, expected, saturated) in both.into_iter().chain(own) {
            let mix = law(&unit_allocation(), u, &Vector3::from(tau), 0.0, 10.0);
            assert!(
                (mix.f - Vector4::from(expected)).amax() < 1e-12,
                "{u} {tau:?}: {} is not {expected:?}",
                mix.f
            );
            assert_eq!(mix.saturated, saturated, "{u} {tau:?}");
        }
    }
}

#[test]
fn without_drag_torque_yaw_is_given_up_and_nothing_else() {
    let mut airframe = Airframe::nominal();
    airframe.set(Parameter::DragFactor, 0.0).unwrap();
    let allocation = Allocation::new(&airframe);
    for yaw in [-1.0, 1e-9, 1.0] {
        for law in BOTH {
            let with = law(&allocation, 5.0, &Vector3::new(0.1, -0.1, yaw), 0.03, 3.8);
            let without = law(&allocation, 5.0, &Vector3::new(0.1, -0.1, 0.0), 0.03, 3.8);
            assert_eq!(
                (with.f, with.saturated, without.saturated),
                (without.f, true, false)
            );
            assert_eq!((with.yaw_share, with.roll_pitch_share), (0.0, 1.0));
        }
    }
}

#[test]
fn of_a_demand_that_is_not_a_number_nothing_is_met() {
    let allocation = Allocation::new(&Airframe::nominal());
    let nan = f64::NAN;
    for (u, tau, share) in [
        (nan, [0.0; 3], F_MIN),
        (5.0, [nan, 0.1, 0.0], 1.25),
        (5.0, [0.0, 0.0, nan], 1.25),
    ] {
        for law in BOTH {
            let mix = law(&allocation, u, &Vector3::from(tau), F_MIN, F_MAX);
            assert_eq!(
                (mix.f, mix.saturated),
                (Vector4::repeat(share), true),
                "{u} {tau:?}"
            );
        }
    }
}

const F_MIN: f64 = 0.02817;
const F_MAX: f64 = 3.83425;

fn nominal(law: Law, u: f64, tau: &Vector3<f64>) -> (Mix, f64, Vector3<f64>) {
    let allocation = Allocation::new(&Airframe::nominal());
    let mix = law(&allocation, u, tau, F_MIN, F_MAX);
    let (thrust, torque) = allocation.wrench(&mix.f);
    (mix, thrust, torque)
}

prop_compose! {
    /// Demands from far inside to far outside of what the rotors can do.
    fn demand()(
        u in -2.0..20.0_f64,
        roll in -1.0..1.0_f64,
        pitch in -1.0..1.0_f64,
        yaw in -0.1..0.1_f64,
        scale in prop_oneof![Just(0.0), Just(1.0), -4.0..2.0_f64],
    ) -> (f64, Vector3<f64>) {
        (u, Vector3::new(roll, pitch, yaw) * 10.0_f64.powf(scale))
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn roll_and_pitch_are_kept_where_the_rotors_can_give_them((u, tau) in demand()) {
        let (mix, thrust, torque) = nominal(roll_pitch_first, u, &tau);
        let allocation = Allocation::new(&Airframe::nominal());
        let alone = allocation.thrusts(0.0, &Vector3::new(tau.x, tau.y, 0.0));
        let room = F_MAX - F_MIN;
        let share = (room / (alone.max() - alone.min())).min(1.0);
        prop_assert!((torque.xy() - tau.xy() * share).amax() < 1e-12, "{torque} of {tau}");
        // Yaw has its reserve, as far as roll and pitch leave room on the rotors.
        let yaw = allocation.thrusts(0.0, &Vector3::new(0.0, 0.0, tau.z));
        let reserved = (YAW_RESERVE * room / 2.0 / yaw.amax()).min(1.0);
        let span = alone * share + yaw * reserved;
        prop_assert!(span.max() - span.min() > room || torque.z.abs() >= reserved * tau.z.abs() - 1e-12);
        // Thrust moves no further than these need.
        let [least, most] = [F_MIN - span.min(), F_MAX - span.max()].map(|f| 4.0 * f);
        prop_assert!(least > most || (thrust - u.max(least).min(most)).abs() < 1e-12, "{thrust} of {u}");
        if u > 0.0 {
            prop_assert!((thrust - u - mix.thrust_excess_share * u).abs() < 1e-12);
        }
    }

    #[test]
    fn a_demand_that_can_be_met_gets_the_same_bits_from_both_laws((u, tau) in demand()) {
        let [attitude, thrust] = BOTH.map(|law| nominal(law, u, &tau).0);
        // At a limit, they may round it to either side.
        let f = thrust.f;
        let is_inside = f.iter().all(|f| (F_MIN + 1e-12..=F_MAX - 1e-12).contains(f));
        prop_assert!(thrust.saturated || !is_inside || attitude == thrust, "{attitude:?} {thrust:?}");
    }

    #[test]
    fn a_mix_stays_within_the_limits_and_gives_what_it_says((u, tau) in demand(), law in prop::sample::select(&BOTH)) {
        let (mix, thrust, torque) = nominal(law, u, &tau);
        prop_assert!(mix.f.iter().all(|f| (F_MIN..=F_MAX).contains(f)), "{}", mix.f);
        // Roll and pitch shrink together, yaw on its own.
        let Mix { roll_pitch_share, yaw_share, .. } = mix;
        let met = Vector3::new(roll_pitch_share, roll_pitch_share, yaw_share).component_mul(&tau);
        prop_assert!((torque - met).amax() < 1e-12, "{torque} is not {met}");
        prop_assert!((0.0..=1.0).contains(&roll_pitch_share) && (0.0..=1.0).contains(&yaw_share));
        // Yaw takes nothing from roll and pitch.
        let (alone, _, without) = nominal(law, u, &Vector3::new(tau.x, tau.y, 0.0));
        prop_assert!((torque.xy() - without.xy()).amax() < 1e-12);
        // The shares are the largest that fit.
        let at_limit = |f: &Vector4<f64>| f.iter().any(|f| (f - F_MIN).abs() < 1e-12 || (f - F_MAX).abs() < 1e-12);
        prop_assert!(roll_pitch_share == 1.0 || at_limit(&alone.f));
        prop_assert!(yaw_share == 1.0 || at_limit(&mix.f));
        let gap = (thrust - u).abs().max((torque - tau).amax());
        if mix.saturated {
            // By how much is bounded below only by rounding; a demand inside all limits must not be flagged.
            let allocation = Allocation::new(&Airframe::nominal());
            let [whole, alone] = [tau.z, 0.0].map(|yaw| allocation.thrusts(u, &Vector3::new(tau.x, tau.y, yaw)));
            let inside = |f: &Vector4<f64>| f.iter().all(|f| (F_MIN + 1e-12..=F_MAX - 1e-12).contains(f));
            prop_assert!(!(inside(&whole) && inside(&alone)), "{whole}");
        } else {
            prop_assert!(gap < 1e-12, "{gap}");
        }
    }

    #[test]
    fn more_demand_never_gives_less(
        (u, tau) in demand(),
        axis in 0..3_usize,
        more in 1.0..3.0_f64,
        law in prop::sample::select(&BOTH),
    ) {
        let (_, thrust, torque) = nominal(law, u, &tau);
        let (_, more_thrust, _) = nominal(law, u + more, &tau);
        prop_assert!(more_thrust >= thrust - 1e-12);
        // A larger demand on the axes alone never gives less of it.
        let mut single = Vector3::zeros();
        single[axis] = tau[axis];
        let (_, _, little) = nominal(law, u, &single);
        let (_, _, much) = nominal(law, u, &(single * more));
        prop_assert!(much[axis].abs() >= little[axis].abs() - 1e-12);
        prop_assert!(torque[axis] * tau[axis] >= -1e-12, "the sign of a torque is never turned");
    }

    #[test]
    fn a_motor_follows_the_demand_by_the_sign_of_its_column(
        u in 1.0..14.0_f64,
        axis in 0..3_usize,
        low in -1.0..1.0_f64,
        step in 0.0..1.0_f64,
        law in prop::sample::select(&BOTH),
    ) {
        let motors = |torque: f64| {
            let mut tau = Vector3::zeros();
            tau[axis] = torque;
            nominal(law, u, &tau).0.f
        };
        let allocation = Allocation::new(&Airframe::nominal());
        let change = motors(low + step) - motors(low);
        for rotor in 0..4 {
            let alone = Vector4::from_fn(|other, _| f64::from(u8::from(other == rotor)));
            let (_, torque) = allocation.wrench(&alone);
            prop_assert!(change[rotor] * torque[axis] >= -1e-12, "rotor {}", rotor + 1);
        }
    }
}
