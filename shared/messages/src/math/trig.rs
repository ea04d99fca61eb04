//! Sine and cosine of one angle, together, in few operations.
//!
//! Kernels and reduction are those of FreeBSD's msun (k_sin.c, k_cos.c, e_rem_pio2.c), which the `libm` crate carries
//! as well. Here they are inlined, and the reduction has no branch. Their notice:
//!
//! > Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved. Developed at SunSoft, a Sun Microsystems, Inc.
//! > business. Permission to use, copy, modify, and distribute this software is freely granted, provided that this
//! > notice is preserved.

use std::f64::consts::FRAC_PI_4;

use crate::vectors::vectorised_by_four;

/// Largest angle that three parts of pi/2 reduce [rad]; beyond it, `libm` takes as many as it needs.
const REDUCED_RAD: f64 = 1e6;

/// Sine and cosine of an angle [rad], each within an ulp; the sine of -0 is 0.
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    if angle_rad.abs() <= FRAC_PI_4 {
        return (sin_kernel(angle_rad), cos_kernel(angle_rad));
    }
    sin_cos_beyond(angle_rad)
}

/// The same of an angle that is not between -pi/4 and pi/4 [rad].
fn sin_cos_beyond(angle_rad: f64) -> (f64, f64) {
    // False of what is no number, too.
    let is_reduced = angle_rad.abs() <= REDUCED_RAD;
    if !is_reduced {
        return libm::sincos(angle_rad);
    }
    let (quadrant, x, tail) = reduced(angle_rad);
    let (sin, cos) = (sin_kernel_of_two(x, tail), cos_kernel_of_two(x, tail));
    match quadrant & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Sine and cosine of up to four angles [rad]: [`sin_cos`] of all at once.
pub fn sin_cos_of_each<const N: usize>(angles_rad: [f64; N]) -> [(f64, f64); N] {
    let mut sin = [0.0; 4];
    sin[..N].copy_from_slice(&angles_rad);
    let mut cos = [0.0; 4];
    if into_sines(&mut sin, &mut cos) {
        std::array::from_fn(|i| (sin[i], cos[i]))
    } else {
        angles_rad.map(sin_cos)
    }
}

vectorised_by_four! {
    /// Makes sines of angles [rad], and their cosines; false where one of them is unknown. Of slices, as a loop of known
    /// length would be unrolled.
    #[inline(never)]
    pub fn into_sines(sin: &mut [f64], cos: &mut [f64]) -> bool {
        let mut all_known = true;
        for (sin, cos) in sin.iter_mut().zip(cos) {
            let is_known;
            (*sin, *cos, is_known) = sin_cos_of_most(*sin);
            all_known &= is_known;
        }
        all_known
    }
}

/// [`sin_cos`] without a branch; false, and no sine or cosine, of an angle that only `libm` reduces.
#[inline(always)]
fn sin_cos_of_most(angle_rad: f64) -> (f64, f64, bool) {
    let is_small = angle_rad.abs() <= FRAC_PI_4;
    let (bits, x, tail) = reduced(angle_rad);
    let quadrant = if is_small { 0 } else { bits };
    let x = if is_small { angle_rad } else { x };
    let of_one = (sin_kernel(x), cos_kernel(x));
    let of_two = (sin_kernel_of_two(x, tail), cos_kernel_of_two(x, tail));
    let (sin, cos) = if is_small { of_one } else { of_two };
    let (sin, cos) = if quadrant & 1 == 0 {
        (sin, cos)
    } else {
        (cos, sin)
    };
    let signed = |value: f64, half: u64| f64::from_bits(value.to_bits() ^ ((half & 2) << 62));
    let (sin, cos) = (signed(sin, quadrant), signed(cos, quadrant.wrapping_add(1)));
    (sin, cos, angle_rad.abs() <= REDUCED_RAD)
}

/// The quadrant, and what is left of an angle within it: a number in -pi/4..pi/4 [rad] and the tail of its digits.
#[inline]
fn reduced(angle_rad: f64) -> (u64, f64, f64) {
    const TWO_OVER_PI: f64 = f64::from_bits(0x3fe4_5f30_6dc9_c883);
    // Added and taken away again, it rounds to a whole number, which its last bits then hold.
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    // pi/2 in three parts, the first two of 33 bits: their products with the quadrant are exact.
    const FIRST: f64 = f64::from_bits(0x3ff9_21fb_5440_0000);
    const SECOND: f64 = f64::from_bits(0x3dd0_b461_1a60_0000);
    const THIRD: f64 = f64::from_bits(0x3ba3_198a_2e03_7073);
    let shifted = angle_rad * TWO_OVER_PI + WHOLE;
    let n = shifted - WHOLE;
    let first = angle_rad - n * FIRST;
    let w = n * SECOND;
    let second = first - w;
    let w = n * THIRD - ((first - second) - w);
    let x = second - w;
    (shifted.to_bits(), x, (second - x) - w)
}

/// Sine of an angle in -pi/4..pi/4 [rad].
#[inline]
fn sin_kernel(x: f64) -> f64 {
    let z = x * x;
    x + z * x * (S1 + z * sin_rest(z))
}

/// Sine of x + tail, x in -pi/4..pi/4 [rad].
#[inline]
fn sin_kernel_of_two(x: f64, tail: f64) -> f64 {
    let z = x * x;
    let v = z * x;
    x - ((z * (0.5 * tail - v * sin_rest(z)) - tail) - v * S1)
}

const S1: f64 = f64::from_bits(0xbfc5_5555_5555_5549);

/// The powers of the sine after x and x^3, over x^5; `z` is x^2.
#[inline]
fn sin_rest(z: f64) -> f64 {
    const S2: f64 = f64::from_bits(0x3f81_1111_1110_f8a6);
    const S3: f64 = f64::from_bits(0xbf2a_01a0_19c1_61d5);
    const S4: f64 = f64::from_bits(0x3ec7_1de3_57b1_fe7d);
    const S5: f64 = f64::from_bits(0xbe5a_e5e6_8a2b_9ceb);
    const S6: f64 = f64::from_bits(0x3de5_d93a_5acf_d57c);
    S2 + z * (S3 + z * S4) + z * (z * z) * (S5 + z * S6)
}

/// Cosine of an angle in -pi/4..pi/4 [rad].
#[inline]
fn cos_kernel(x: f64) -> f64 {
    let z = x * x;
    let half = 0.5 * z;
    let most = 1.0 - half;
    most + (((1.0 - most) - half) + z * cos_rest(z))
}

/// Cosine of x + tail, x in -pi/4..pi/4 [rad].
#[inline]
fn cos_kernel_of_two(x: f64, tail: f64) -> f64 {
    let z = x * x;
    let half = 0.5 * z;
    let most = 1.0 - half;
    most + (((1.0 - most) - half) + (z * cos_rest(z) - x * tail))
}

/// The powers of the cosine after 1 and x^2, over x^2; `z` is x^2.
#[inline]
fn cos_rest(z: f64) -> f64 {
    const C1: f64 = f64::from_bits(0x3fa5_5555_5555_554c);
    const C2: f64 = f64::from_bits(0xbf56_c16c_16c1_5177);
    const C3: f64 = f64::from_bits(0x3efa_01a0_19cb_1590);
    const C4: f64 = f64::from_bits(0xbe92_7e4f_809c_52ad);
    const C5: f64 = f64::from_bits(0x3e21_ee9e_bdb4_b1c4);
    const C6: f64 = f64::from_bits(0xbda8_fae9_be88_38d4);
    let w = z * z;
    z * (C1 + z * (C2 + z * C3)) + w * w * (C4 + z * (C5 + z * C6))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn check(angle_rad: f64) {
        let ((sin, cos), (sin_there, cos_there)) = (sin_cos(angle_rad), libm::sincos(angle_rad));
        for (each_sin, each_cos) in sin_cos_of_each([angle_rad; 3]) {
            let bits = [each_sin, each_cos].map(f64::to_bits);
            assert_eq!(bits, [sin, cos].map(f64::to_bits), "{angle_rad:e}");
        }
        for (here, there) in [(sin, sin_there), (cos, cos_there)] {
            // Two neighbours of a number are this far apart at the most.
            let ulp = there.abs() * f64::EPSILON;
            assert!(
                (here - there).abs() <= ulp,
                "{angle_rad:e}: {here:e}, by libm {there:e}"
            );
        }
    }

    #[test]
    fn angles_of_every_size_are_within_an_ulp() {
        for i in -400_000..400_000 {
            check(f64::from(i) * 1e-5);
            check(f64::from(i) * 3.7);
        }
        (0..300)
            .map(|power| 1e-290 * 10_f64.powi(power))
            .for_each(check);
    }

    #[test]
    fn no_digit_is_lost_beside_a_multiple_of_a_right_angle() {
        for quadrant in -600_000..600_000 {
            let right = f64::from(quadrant) * FRAC_PI_2;
            [right, right.next_up(), right.next_down()]
                .into_iter()
                .for_each(check);
        }
    }

    #[test]
    fn what_is_no_number_stays_none() {
        for angle_rad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (sin, cos) = sin_cos(angle_rad);
            assert!(sin.is_nan() && cos.is_nan(), "{angle_rad}");
        }
    }
}
