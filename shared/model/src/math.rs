//! Elementary functions whose bits are the same on every machine.
//!
//! Those of the standard library come from the system's mathematics library, which chooses its code by processor and
//! version: a flight that was recorded here might end elsewhere a bit beside its record. These are compiled with the
//! laws, from one implementation that uses nothing but what IEEE 754 rounds exactly, in an order that no compiler may
//! change. Square roots are exact everywhere, and stay the standard library's.

/// Sine and cosine of an angle [rad].
#[must_use]
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    libm::sincos(angle_rad)
}

/// Sine of an angle [rad].
#[must_use]
#[inline]
pub fn sin(angle_rad: f64) -> f64 {
    libm::sin(angle_rad)
}

/// Cosine of an angle [rad].
#[must_use]
#[inline]
pub fn cos(angle_rad: f64) -> f64 {
    libm::cos(angle_rad)
}

/// Tangent of an angle [rad].
#[must_use]
#[inline]
pub fn tan(angle_rad: f64) -> f64 {
    libm::tan(angle_rad)
}

/// Angle of the point (x, y) from the axis of x [rad].
#[must_use]
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// e to the power of x.
#[must_use]
#[inline]
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// e to the power of x, less 1: exact where x is small.
#[must_use]
#[inline]
pub fn exp_m1(x: f64) -> f64 {
    libm::expm1(x)
}

/// Natural logarithm of 1 + x: exact where x is small.
#[must_use]
#[inline]
pub fn ln_1p(x: f64) -> f64 {
    libm::log1p(x)
}

/// Natural logarithm.
#[must_use]
#[inline]
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

/// Length of the vector (x, y).
#[must_use]
#[inline]
pub fn hypot(x: f64, y: f64) -> f64 {
    libm::hypot(x, y)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;

    /// What the standard library takes from the system, or leaves to the compiler's choice.
    const OF_THE_SYSTEM: [&str; 18] = [
        ".sin(",
        ".cos(",
        ".tan(",
        ".sin_cos(",
        ".asin(",
        ".acos(",
        ".atan(",
        ".atan2(",
        ".exp(",
        ".ln(",
        ".log10(",
        ".powf(",
        ".powi(",
        ".exp_m1(",
        ".ln_1p(",
        ".hypot(",
        ".mul_add(",
        "from_euler_angles(",
    ];
    /// What the laws are compiled from.
    const LAWS: [&str; 5] = ["shared/model/src", "shared/law/src", "plant/src", "controller/src", "mixer/src"];

    fn sources(directory: &Path) -> Vec<PathBuf> {
        let paths = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
        paths.flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] }).collect()
    }

    #[test]
    fn no_law_takes_a_function_from_the_system() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let all: Vec<PathBuf> = LAWS.iter().flat_map(|laws| sources(&root.join(laws))).collect();
        assert!(all.len() > 30, "{all:?}");
        for path in all.iter().filter(|path| !path.ends_with("math.rs")) {
            let text = fs::read_to_string(path).unwrap();
            let law = text.split("#[cfg(test)]").next().unwrap_or_default();
            for (number, line) in law.lines().enumerate() {
                let found = OF_THE_SYSTEM.iter().find(|name| line.contains(**name));
                assert_eq!(found, None, "{}:{}: {line}", path.display(), number + 1);
            }
        }
    }

    #[test]
    fn they_are_those_functions() {
        for i in -2_000..2_000 {
            let x = f64::from(i) * 0.013;
            let near = |ours: f64, theirs: f64| assert!((ours - theirs).abs() <= 1e-15 * theirs.abs().max(1.0), "{x}");
            near(sin(x), x.sin());
            near(cos(x), x.cos());
            assert_eq!(sin_cos(x), (sin(x), cos(x)));
            near(tan(x / 30.0), (x / 30.0).tan());
            near(exp(x / 10.0), (x / 10.0).exp());
            near(atan2(x, 0.7), x.atan2(0.7));
            near(hypot(x, 1.3), x.hypot(1.3));
            near(exp_m1(x / 10.0), (x / 10.0).exp_m1());
            near(ln_1p(x.abs()), x.abs().ln_1p());
            near(ln(x.abs() + 0.1), (x.abs() + 0.1).ln());
        }
    }
}
