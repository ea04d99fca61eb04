//! Motor lag that the loops of the laws are unstable with, as far as their settings have the names of gains.

use control_api::description::{Description, Settings, Value};

use crate::gains::ALPHA_1_S;

/// A law that is flown, and its settings.
type Chosen<'a> = (&'a Description, &'a Settings);

/// Warn below this damping of the rate loop.
const DAMPING_MIN: f64 = 0.5;
/// Warn above this share of the motor lag that makes the attitude or the position loop unstable.
const LAG_SHARE_MAX: f64 = 0.5;
/// Longest lag that is tried [s].
const LAG_MAX_S: f64 = 4.0;
/// k_Omega of a law whose settings do not name it [1/s].
const UNKNOWN_RATE_1_S: f64 = 1e4;

/// Warnings for motors that the laws expect to lag by `built_s` [s], and that lag by `lag_s` [s] at tick 0.
pub fn warnings(inner: Chosen<'_>, outer: Chosen<'_>, built_s: f64, lag_s: f64) -> Vec<String> {
    let rate_loop = rate_loop(inner, built_s);
    let outer_loops = outer_loops(inner, outer, lag_s);
    rate_loop.into_iter().chain(outer_loops).collect()
}

fn rate_loop((law, settings): Chosen<'_>, built_s: f64) -> Option<String> {
    if !law.settings.contains(&ALPHA_1_S) {
        return None;
    }
    let alpha_1_s = settings.number(&ALPHA_1_S);
    // tau s^2 + s + alpha.
    let damping = 0.5 / (alpha_1_s * built_s).sqrt();
    (damping < DAMPING_MIN).then(|| {
        format!(
            "inner.alpha_1_s = {alpha_1_s} with motors that lag by {built_s} s leaves the rate loop a damping of \
             {damping:.2}; {DAMPING_MIN} needs {:.1} or less",
            1.0 / (4.0 * DAMPING_MIN * DAMPING_MIN * built_s)
        )
    })
}

/// The attitude loop, and the position loop around it.
fn outer_loops(inner: Chosen<'_>, outer: Chosen<'_>, lag_s: f64) -> Option<String> {
    let (law, _) = inner;
    let rate_1_s = gain(inner, ALPHA_1_S.name).or_else(|| gain(inner, "rate_1_s"));
    let (attitude, k_1_s) = match gain(inner, "attitude_1_s") {
        Some(k_1_s) => ("attitude_1_s", k_1_s),
        None => {
            let w = gain(inner, "attitude_rad_s")?;
            ("attitude_rad_s", w * w / rate_1_s?)
        }
    };
    let k_omega = rate_1_s.unwrap_or(UNKNOWN_RATE_1_S);
    let k_r = k_1_s * k_omega;
    // An inner law with a position loop replaces that of the outer law.
    let of_position = |(law, settings): Chosen<'_>| {
        let gain = |name| gain((law, settings), name);
        Some((law.name, [gain("velocity_1_s")?, gain("position_1_s2")?]))
    };
    let position = of_position(inner).or_else(|| of_position(outer));
    // tau s^5 + s^4 + k_Omega s^3 + k_R (s^2 + K_D s + K_P); without a known position loop the same over s^2.
    let is_stable = |lag_s: f64| {
        let around = position.iter().flat_map(|(_, gains)| gains);
        let around = around.map(|gain| k_r * gain);
        is_stable(
            [lag_s, 1.0, k_omega, k_r]
                .into_iter()
                .chain(around)
                .collect(),
        )
    };
    if let Some((of, [k_d, k_p])) = position
        && lag_s > 0.0
        && !is_stable(0.0)
    {
        let stage = if of == law.name { "inner" } else { "outer" };
        return Some(format!(
            "the attitude loop of {} ({k_1_s:.2} 1/s) is too slow for the position loop of {of} (K_P = {k_p} 1/s^2, \
             K_D = {k_d} 1/s), and motors that lag by {lag_s} s allow no faster one: lower {stage}.position_1_s2, or take \
             other laws",
            law.name
        ));
    }
    let [mut stable_s, mut unstable_s] = [0.0, LAG_MAX_S];
    for _ in 0..40 {
        let middle_s = (stable_s + unstable_s) / 2.0;
        match is_stable(middle_s) {
            true => stable_s = middle_s,
            false => unstable_s = middle_s,
        }
    }
    let loops = match position {
        Some(_) => "attitude and position loops are",
        None => "attitude loop is",
    };
    (lag_s > LAG_SHARE_MAX * unstable_s).then(|| {
        format!(
            "under {} the {loops} unstable with motors that lag by {unstable_s:.3} s or more; these lag by {lag_s} s: lower \
             inner.{attitude}, or take another law",
            law.name
        )
    })
}

/// A gain by its name: of three, the larger one of roll and pitch.
fn gain((law, settings): Chosen<'_>, name: &str) -> Option<f64> {
    let known = law.settings.iter().find(|setting| setting.name == name)?;
    match settings.value(known) {
        Value::Number(gain) => Some(gain),
        Value::Three([roll, pitch, _]) => Some(roll.max(pitch)),
        Value::Word(_) => None,
    }
}

/// Whether all roots of a polynomial lie in the left half plane (Routh), by its coefficients from the highest power on.
fn is_stable(polynomial: Vec<f64>) -> bool {
    let leading = polynomial.iter().position(|it| *it != 0.0);
    let mut rest = polynomial[leading.unwrap_or(0)..].to_vec();
    while let [first, second, ..] = rest[..] {
        if first <= 0.0 || second <= 0.0 {
            return false;
        }
        for i in (2..rest.len() - 1).step_by(2) {
            rest[i] -= first / second * rest[i + 1];
        }
        rest.remove(0);
    }
    rest[0] > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::{Adaptive, Estimating, Geometric, Indi, L1, Pd};
    use control_api::law::{Law, Rig};
    use messages::parameters::{Airframe, Parameter};

    #[test]
    fn a_polynomial_is_stable_if_its_roots_are() {
        for (roots, expected) in [
            (&[-1.0, -2.0, -3.0, -4.0, -0.01][..], true),
            (&[-1.0, -2.0, 0.01], false),
            (&[-1.0, 2.0, 3.0, -5.0, -6.0], false),
            (&[-1.0], true),
        ] {
            let times = |polynomial: Vec<f64>, root: &f64| {
                let shifted = polynomial.iter().chain([&0.0]);
                let scaled = [0.0]
                    .into_iter()
                    .chain(polynomial.iter().map(|it| -root * it));
                shifted.zip(scaled).map(|(a, b)| a + b).collect()
            };
            let polynomial = roots.iter().fold(vec![1.0], times);
            assert_eq!(is_stable(polynomial), expected, "{roots:?}");
        }
        // A pair of complex roots on either side: s^3 + s^2 + k s + k b is stable if b is below 1.
        assert!(is_stable(vec![0.0, 1.0, 1.0, 9.0, 9.0 * 0.99]));
        assert!(!is_stable(vec![1.0, 1.0, 9.0, 9.0 * 1.01]));
    }

    /// The warnings of default laws for an airframe that is built with a motor lag.
    fn of<Inner: Law, Outer: Law>(lag_s: f64) -> Vec<String> {
        let mut values = *Airframe::nominal().values();
        values[Parameter::MotorTimeConstant as usize] = lag_s;
        let rig = Rig {
            airframe: Airframe::built_with(values).unwrap(),
            ..Rig::default()
        };
        let suited = |law: &Description| match law.suited {
            Some(suited) => suited(&Settings::default(), &rig),
            None => Settings::default(),
        };
        let (inner, outer) = (Inner::DESCRIPTION, Outer::DESCRIPTION);
        let (of_inner, of_outer) = (suited(&inner), suited(&outer));
        warnings((&inner, &of_inner), (&outer, &of_outer), lag_s, lag_s)
    }

    #[test]
    fn slow_motors_are_warned_of_by_one_check_of_the_attitude_and_the_position_loop() {
        for lag_s in [0.0, 0.025, 0.05, 0.076] {
            assert_eq!(of::<Adaptive, Estimating>(lag_s), Vec::<String>::new());
            assert_eq!(of::<L1, Pd>(lag_s), Vec::<String>::new());
        }
        // alpha is lowered, and with it K_eta to less than the position loop needs.
        for lag_s in [0.12, 0.15, 0.2, 0.3] {
            for warned in [
                of::<Adaptive, Estimating>(lag_s),
                of::<L1, Estimating>(lag_s),
            ] {
                assert_eq!(warned.len(), 1, "{lag_s}");
                assert!(warned[0].contains("too slow for the position loop of estimating"));
                assert!(
                    warned[0].contains("lower outer.position_1_s2"),
                    "{warned:?}"
                );
            }
        }
        assert_eq!(of::<Adaptive, Pd>(0.15).len(), 1);
        // Laws that keep their gains.
        for (lag_s, count) in [(0.04, 0), (0.076, 1), (0.3, 1)] {
            for warned in [of::<Indi, Estimating>(lag_s), of::<Geometric, Pd>(lag_s)] {
                assert_eq!(warned.len(), count, "{lag_s}: {warned:?}");
            }
        }
    }
}
