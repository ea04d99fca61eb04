//! Elementary functions whose bits are the same on every machine.
//!
//! Those of the standard library come from the system's mathematics library, which chooses its code by processor and
//! version: a flight that was recorded here might end elsewhere a bit beside its record. These are compiled with the
//! laws, from one implementation that uses nothing but what IEEE 754 rounds exactly, in an order that no compiler may
//! change. Square roots are exact everywhere, and stay the standard library's.

mod trig;

pub use trig::{sin_cos, sin_cos_of_each};

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
    use super::*;

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
