//! Elementary functions whose bits are the same on every machine.
//!
//! Those of the standard library come from the system's mathematics library, which chooses its code by processor and
//! version: a flight that was recorded here might end elsewhere a bit beside its record. These are compiled with the
//! laws, from one implementation that uses nothing but what IEEE 754 rounds exactly, in an order that no compiler may
//! change. Square roots are exact everywhere, and stay the standard library's.

mod arc;
mod trig;

pub use arc::atan2_of_most;
pub use trig::sin_cos;

/// Sine of an angle [rad].
#[inline]
pub fn sin(angle_rad: f64) -> f64 {
    sin_cos(angle_rad).0
}

/// Cosine of an angle [rad].
#[inline]
pub fn cos(angle_rad: f64) -> f64 {
    sin_cos(angle_rad).1
}

/// Tangent of an angle [rad].
#[inline]
pub fn tan(angle_rad: f64) -> f64 {
    libm::tan(angle_rad)
}

/// Angle of the point (x, y) from the axis of x [rad].
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

#[inline]
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// e to the power of x, less 1: exact where x is small.
#[inline]
pub fn exp_m1(x: f64) -> f64 {
    libm::expm1(x)
}

/// Natural logarithm of 1 + x: exact where x is small.
#[inline]
pub fn ln_1p(x: f64) -> f64 {
    libm::log1p(x)
}

#[inline]
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;

    /// What the standard library takes from the system, or leaves to the compiler's choice: as methods and as paths.
    const OF_THE_SYSTEM: [&str; 31] = [
        "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
        "asinh", "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10",
        "powf", "powi", "cbrt", "hypot", "mul_add", "gamma", "ln_gamma", "sinc", "lp_norm",
    ];
    const ROTATIONS: [&str; 6] = [
        "Rotation2",
        "Rotation3",
        "Quaternion",
        "UnitComplex",
        "Isometry",
        "Similarity",
    ];
    const LAWS: [&str; 6] = [
        "shared/messages/src",
        "shared/control_api/src",
        "shared/faults/src",
        "plant/src",
        "controller/src",
        "mixer/src",
    ];

    fn sources(directory: &Path) -> Vec<PathBuf> {
        let paths = fs::read_dir(directory)
            .unwrap()
            .map(|entry| entry.unwrap().path());
        paths
            .flat_map(|path| {
                if path.is_dir() {
                    sources(&path)
                } else {
                    vec![path]
                }
            })
            .collect()
    }

    /// A function of the system that a line calls, or a type that does.
    fn found(line: &str) -> Option<&'static str> {
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        let calls = |name: &&&str| {
            line.match_indices(**name).any(|(at, name)| {
                let (before, after) = (&line[..at], &line[at + name.len()..]);
                let is_called = before.ends_with('.') && after.trim_start().starts_with(['(', ':']);
                let is_named = before.ends_with("::")
                    && !before.ends_with("math::")
                    && !before.ends_with("libm::");
                (is_called || is_named) && !after.starts_with(is_word)
            })
        };
        OF_THE_SYSTEM
            .iter()
            .find(calls)
            .or_else(|| ROTATIONS.iter().find(|name| line.contains(**name)))
            .copied()
    }

    #[test]
    fn no_law_takes_a_function_from_the_system() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let all: Vec<PathBuf> = LAWS
            .iter()
            .flat_map(|laws| sources(&root.join(laws)))
            .collect();
        assert!(all.len() > 30, "{all:?}");
        let ours = |path: &PathBuf| !path.ends_with("math.rs") && !path.ends_with("math/trig.rs");
        for path in all.iter().filter(|path| ours(path)) {
            let text = fs::read_to_string(path).unwrap();
            let law = text
                .split("#[cfg(test)]\nmod tests")
                .next()
                .unwrap_or_default();
            for (number, line) in law
                .lines()
                .enumerate()
                .filter(|(_, line)| !line.trim_start().starts_with("//"))
            {
                assert_eq!(
                    found(line),
                    None,
                    "{}:{}: {line}",
                    path.display(),
                    number + 1
                );
            }
        }
    }

    #[test]
    fn a_function_of_the_system_is_found_however_it_is_called() {
        for line in [
            "let s = t_s.sin();",
            "let s = f64::sin(t_s);",
            "w.map(f64::exp)",
            "x.powi (2)",
            "a.iter().map(<f64 as ComplexField>::sin_cos)",
            "let r = Rotation3::from_euler_angles(a, b, c);",
            "UnitQuaternion::identity()",
            "self.gain.exp_m1()",
        ] {
            assert!(found(line).is_some(), "{line}");
        }
        for line in [
            "use messages::math::sin_cos;",
            "let x = sin_cos(eta2.x);",
            "a.norm()",
            "libm::exp(x)",
            "self.sin * a",
        ] {
            assert_eq!(found(line), None, "{line}");
        }
    }

    #[test]
    fn they_are_those_functions() {
        for i in -2_000..2_000 {
            let x = f64::from(i) * 0.013;
            let near = |ours: f64, theirs: f64| {
                assert!(
                    (ours - theirs).abs() <= 1e-15 * theirs.abs().max(1.0),
                    "{x}"
                )
            };
            near(sin(x), x.sin());
            near(cos(x), x.cos());
            assert_eq!(sin_cos(x), (sin(x), cos(x)));
            near(tan(x / 30.0), (x / 30.0).tan());
            near(exp(x / 10.0), (x / 10.0).exp());
            near(atan2(x, 0.7), x.atan2(0.7));
            near(exp_m1(x / 10.0), (x / 10.0).exp_m1());
            near(ln_1p(x.abs()), x.abs().ln_1p());
            near(ln(x.abs() + 0.1), (x.abs() + 0.1).ln());
        }
    }
}
