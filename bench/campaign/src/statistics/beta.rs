//! The incomplete beta function for campaigns of any size.
//!
//! statrs has it too, with 140 terms at the most, which are too few where both parameters are large.

use statrs::function::gamma::ln_gamma;

/// I_x(a, b), the share of a beta distribution below x; a and b above 0, x from 0 to 1.
///
/// By the continued fraction of DLMF 8.17.22 (Lentz' method), of which some sqrt(a + b) terms count.
#[must_use]
pub fn beta_share(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    // Where the fraction converges slowly, the other end's does not.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_share(b, a, 1.0 - x);
    }
    let front = (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (-x).ln_1p()).exp() / a;
    front * fraction(a, b, x)
}

fn fraction(a: f64, b: f64, x: f64) -> f64 {
    const TERMS_MAX: u32 = 1_000_000;
    const TINY: f64 = 1e-300;
    let kept = |value: f64| if value.abs() < TINY { TINY } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / kept(1.0 - (a + b) * x / (a + 1.0));
    let mut product = d;
    for m in (1..TERMS_MAX).map(f64::from) {
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for term in [even, odd] {
            d = 1.0 / kept(1.0 + term * d);
            c = kept(1.0 + term / c);
            change = c * d;
            product *= change;
        }
        if (change - 1.0_f64).abs() < 1e-15 {
            break;
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_that_are_known_in_closed_form() {
        for (b, x) in [(3.0_f64, 0.2_f64), (1e4, 1e-4), (1e8, 3e-9)] {
            let known = -f64::exp_m1(b * (-x).ln_1p());
            assert!((beta_share(1.0, b, x) / known - 1.0).abs() < 1e-6, "{b} {x}");
        }
        // At most 2 of 5 throws, with a coin of 0.3.
        let known = 0.7_f64.powi(5) + 5.0 * 0.3 * 0.7_f64.powi(4) + 10.0 * 0.09 * 0.7_f64.powi(3);
        assert!((beta_share(3.0, 3.0, 0.7) - known).abs() < 1e-14);
        for a in [0.5, 20.0, 1e4, 5e7] {
            assert!((beta_share(a, a, 0.5) - 0.5).abs() < 1e-6, "{a}");
            assert_eq!((beta_share(a, 2.0, 0.0), beta_share(a, 2.0, 1.0)), (0.0, 1.0));
        }
        // One standard deviation above the middle of a distribution that is all but normal.
        let above = 0.5 + 0.5 / (4.0 * 1e6_f64).sqrt() * std::f64::consts::SQRT_2;
        assert!((beta_share(1e6, 1e6, above) - 0.841_344_7).abs() < 1e-4);
    }
}
