//! Whether the estimates explain a flight, without ground truth: the innovation Y - X th_hat, and the bounds.
//!
//! What the model explains leaves no innovation. What it does not is noise, or a cause that the model lacks: noise has no
//! memory once the low-pass over X and Y is undone, and a missing cause has.

use nalgebra::Vector3;

use crate::adaptation::{Adaptation, Regression};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Innovation {
    /// Steps in which a bound held back the estimate of I_R, k_r, delta.
    pub steps_at_bound: [u64; 3],
    /// Means over the last second or so: |Y - X th_hat|^2, |Y|^2, |w|^2, that of the step before, and the product of both,
    /// where w is the innovation without the low-pass [rad^2/s^4].
    means: [f64; 5],
    before: Option<[Vector3<f64>; 2]>,
}

impl Innovation {
    /// Takes a step from `estimate`, which leaves `zb` of the innovation; `kept` is the share that the means keep.
    pub fn take(
        &mut self,
        adaptation: &Adaptation,
        regression: &Regression,
        estimate: &Vector3<f64>,
        zb: &Vector3<f64>,
        kept: f64,
    ) {
        let (p, Regression { x, y, .. }) = (adaptation.p, regression);
        let wanted = adaptation.wanted(estimate, x, zb);
        let bounded = adaptation.clip(&wanted);
        for (i, steps) in self.steps_at_bound.iter_mut().enumerate() {
            *steps += u64::from(wanted[i] != bounded[i]);
        }
        let r = y - x * estimate;
        let [r_before, w_before] = self.before.unwrap_or([r, Vector3::zeros()]);
        let w = (r - p * r_before) / (1.0 - p);
        let now = [
            r.norm_squared(),
            y.norm_squared(),
            w.norm_squared(),
            w_before.norm_squared(),
            w.dot(&w_before),
        ];
        if now.iter().all(|now| now.is_finite()) {
            self.before = Some([r, w]);
            let means = self.means.iter_mut().zip(now);
            means.for_each(|(mean, now)| *mean = now + kept * (*mean - now));
        }
    }

    /// |Y - X th_hat|, root mean square over the last second or so [rad/s^2].
    pub fn rms_rad_s2(&self) -> f64 {
        self.means[0].sqrt()
    }

    /// |Y|, what there was to explain [rad/s^2].
    pub fn sample_rms_rad_s2(&self) -> f64 {
        self.means[1].sqrt()
    }

    /// Correlation of the innovation with that of the step before: about 0 or less for noise, 1 for a cause that lasts;
    /// none before there are two steps with one.
    pub fn correlation(&self) -> Option<f64> {
        let [_, _, size, before, product] = self.means;
        let correlation = || (product / (size * before).sqrt()).clamp(-1.0, 1.0);
        (size * before > 0.0).then(correlation)
    }
}

#[cfg(test)]
mod tests {
    use control_api::law::Rig;
    use nalgebra::Matrix3;

    use super::*;
    use crate::gains::Gains;

    /// The correlation after 500 steps in which Y is what `sample` gives, and the estimates explain nothing.
    fn correlation(sample: impl Fn(i32) -> f64) -> f64 {
        let rig = Rig::default();
        let adaptation = Adaptation::new(&rig, &Gains::default());
        let mut innovation = Innovation::default();
        for step in 0..500 {
            let regression = Regression {
                x: Matrix3::zeros(),
                y: Vector3::repeat(sample(step)),
                ..Regression::default()
            };
            let zero = Vector3::zeros();
            innovation.take(&adaptation, &regression, &zero, &zero, 0.9);
        }
        innovation.correlation().unwrap()
    }

    #[test]
    fn a_cause_that_lasts_has_a_correlation_of_1_also_while_it_fades() {
        for share in [1.0, 0.999, 0.99] {
            let correlation = correlation(|step| f64::powi(share, step));
            assert!(
                (0.999..=1.0).contains(&correlation),
                "{share}: {correlation}"
            );
        }
        let alternating = correlation(|step| f64::from(1 - 2 * (step % 2)));
        assert!((-1.0..-0.9).contains(&alternating), "{alternating}");
    }
}
