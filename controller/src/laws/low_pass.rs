//! Second-order low-pass over three axes, sampled by the bilinear transform.
//!
//! ```text
//!     H(s) = w_n^2 / (s^2 + 2 zeta w_n s + w_n^2)
//! ```
//!
//! The transform is prewarped: gain and phase at w_n are those of H.

use std::f64::consts::FRAC_PI_2;

use control_api::description::{Refused, Setting};
use control_api::saved_state::saved_fields;
use messages::math::tan;
use nalgebra::Vector3;

/// The filter and its memory, at rest at first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    b0: f64,
    a1: f64,
    a2: f64,
    s1: Vector3<f64>,
    s2: Vector3<f64>,
    output: Vector3<f64>,
}

saved_fields!(LowPass: s1, s2, output);

impl LowPass {
    /// H with w_n = `w_n` [rad/s] and zeta = `zeta`, sampled every `period_s` [s].
    ///
    /// # Errors
    /// [`Refused`] where w_n is above a quarter of the sampling frequency; `setting` is the one that gave it.
    pub fn new(setting: &Setting, w_n: f64, zeta: f64, period_s: f64) -> Result<Self, Refused> {
        let allowed = FRAC_PI_2 / period_s;
        if w_n > allowed {
            let name = setting.name;
            return Err(Refused(format!(
                "{name} = {w_n} rad/s is too fast for a period_s of {period_s}: allowed is up to a quarter of the \
                 sampling frequency, {allowed:.1} rad/s; lower {name}, or fly with a shorter period_s"
            )));
        }
        let c = tan(w_n * period_s / 2.0);
        let scale = 1.0 / (1.0 + 2.0 * zeta * c + c * c);
        let zero = Vector3::zeros();
        Ok(Self {
            b0: c * c * scale,
            a1: 2.0 * (c * c - 1.0) * scale,
            a2: (1.0 - 2.0 * zeta * c + c * c) * scale,
            s1: zero,
            s2: zero,
            output: zero,
        })
    }

    /// Takes the sample of a tick; gives what comes out.
    pub fn take(&mut self, x: &Vector3<f64>) -> Vector3<f64> {
        let y = self.b0 * x + self.s1;
        self.s1 = 2.0 * self.b0 * x - self.a1 * y + self.s2;
        self.s2 = self.b0 * x - self.a2 * y;
        self.output = y;
        y
    }

    pub const fn output(&self) -> &Vector3<f64> {
        &self.output
    }

    pub fn forget(&mut self) {
        (self.s1, self.s2, self.output) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
    }
}

#[cfg(test)]
mod tests {
    use control_api::description::{number, settings};

    use super::*;

    settings! {
        FILTER = "filter_rad_s", "rad/s", number(50.0, 1.0, 1e4), "";
    }

    #[test]
    fn gain_and_phase_at_its_frequency_are_those_of_h() {
        let (w_n, zeta, period_s) = (200.0, 0.55, 1e-3);
        let mut filter = LowPass::new(&FILTER, w_n, zeta, period_s).unwrap();
        // H(j w_n) = -j / 2 zeta: a sine comes out as minus a cosine.
        for tick in 0..2000 {
            let (sin, cos) = (w_n * period_s * f64::from(tick)).sin_cos();
            let y = filter.take(&Vector3::new(sin, 1.0, 0.0));
            if tick > 1900 {
                let expected = Vector3::new(-cos / (2.0 * zeta), 1.0, 0.0);
                assert!((y - expected).amax() < 1e-9, "{y}");
            }
        }
        filter.forget();
        assert_eq!(filter, LowPass::new(&FILTER, w_n, zeta, period_s).unwrap());
    }

    #[test]
    fn a_bandwidth_above_a_quarter_of_the_sampling_frequency_is_refused() {
        let error = LowPass::new(&FILTER, 200.0, 0.7, 0.01).unwrap_err();
        let expected = "filter_rad_s = 200 rad/s is too fast for a period_s of 0.01: allowed is up to a quarter of \
                        the sampling frequency, 157.1 rad/s; lower filter_rad_s";
        assert!(error.to_string().starts_with(expected), "{error}");
        assert!(LowPass::new(&FILTER, 157.0, 0.7, 0.01).is_ok());
    }
}
