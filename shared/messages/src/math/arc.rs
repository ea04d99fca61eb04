//! Arc tangents of several points at once.
//!
//! The kernel is that of FreeBSD's msun (s_atan.c, e_atan2.c), as the `libm` crate carries it, without its branches: the
//! bits are those of [`atan2`]. Its notice:
//!
//! > Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved. Developed at SunSoft, a Sun Microsystems, Inc.
//! > business. Permission to use, copy, modify, and distribute this software is freely granted, provided that this
//! > notice is preserved.

use std::f64::consts::PI;

use super::atan2;
use crate::vectors::vectorised_by_four;

/// Largest |y/x| of the kernel; beyond it, and where a number is none, `libm` knows the angle.
const STEEPEST: f64 = 1e18;

/// Angles of up to four points from the axis of x [rad], each point as y and x: [`atan2`] of all at once.
pub fn atan2_of_each<const N: usize>(points: [(f64, f64); N]) -> [f64; N] {
    let (mut y, mut x) = ([0.0; 4], [1.0; 4]);
    for (i, point) in points.into_iter().enumerate() {
        (y[i], x[i]) = point;
    }
    if into_angles(&mut y, &x) {
        std::array::from_fn(|i| y[i])
    } else {
        points.map(|(y, x)| atan2(y, x))
    }
}

vectorised_by_four! {
    /// Makes angles [rad] of y; false where one of them is unknown. Of slices, as a loop of known length would be unrolled.
    #[inline(never)]
    pub fn into_angles(y: &mut [f64], x: &[f64]) -> bool {
        let mut all_known = true;
        for (y, x) in y.iter_mut().zip(x) {
            let is_known;
            (*y, is_known) = angle_of_most(*y, *x);
            all_known &= is_known;
        }
        all_known
    }
}

/// [`atan2`] without a branch; false, and no angle, of a point that only `libm` knows.
#[inline(always)]
fn angle_of_most(y: f64, x: f64) -> (f64, bool) {
    const PI_TAIL: f64 = f64::from_bits(0x3ca1_a626_3314_5c07);
    let steepness = (y / x).abs();
    let acute = arc_tangent(steepness);
    let obtuse = PI - (acute - PI_TAIL);
    let angle = if x < 0.0 { obtuse } else { acute };
    let signed = f64::from_bits(angle.to_bits() ^ (y.to_bits() & (1 << 63)));
    (signed, steepness <= STEEPEST)
}

/// Arc tangent of a number that is not negative [rad]: an angle nearby, in two parts, and the arc tangent of what is left.
#[inline(always)]
fn arc_tangent(x: f64) -> f64 {
    /// From a bound on: the angle and its tail, and what is left as a fraction.
    type Near = (f64, [u64; 2], f64, f64);
    let nearby: [Near; 4] = [
        (
            0.4375,
            [0x3fdd_ac67_0561_bb4f, 0x3c7a_2b7f_222f_65e2],
            2.0 * x - 1.0,
            2.0 + x,
        ),
        (
            0.6875,
            [0x3fe9_21fb_5444_2d18, 0x3c81_a626_3314_5c07],
            x - 1.0,
            x + 1.0,
        ),
        (
            1.1875,
            [0x3fef_730b_d281_f69b, 0x3c70_0788_7af0_cbbd],
            x - 1.5,
            1.0 + 1.5 * x,
        ),
        (
            2.4375,
            [0x3ff9_21fb_5444_2d18, 0x3c91_a626_3314_5c07],
            -1.0,
            x,
        ),
    ];
    let (mut near, mut tail, mut above, mut below) = (0.0, 0.0, x, 1.0);
    for (from, bits, a, b) in nearby {
        let is_near = x >= from;
        let [angle, rest] = bits.map(f64::from_bits);
        near = if is_near { angle } else { near };
        tail = if is_near { rest } else { tail };
        above = if is_near { a } else { above };
        below = if is_near { b } else { below };
    }
    let left = above / below;
    near - (left * series(left * left) - tail - left)
}

/// Share of x that its arc tangent lacks; `z` is x^2.
#[inline(always)]
fn series(z: f64) -> f64 {
    const A1: f64 = f64::from_bits(0x3fd5_5555_5555_550d);
    const A2: f64 = f64::from_bits(0xbfc9_9999_9998_ebc4);
    const A3: f64 = f64::from_bits(0x3fc2_4924_9200_83ff);
    const A4: f64 = f64::from_bits(0xbfbc_71c6_fe23_1671);
    const A5: f64 = f64::from_bits(0x3fb7_45cd_c54c_206e);
    const A6: f64 = f64::from_bits(0xbfb3_b0f2_af74_9a6d);
    const A7: f64 = f64::from_bits(0x3fb1_0d66_a0d0_3d51);
    const A8: f64 = f64::from_bits(0xbfad_de2d_52de_fd9a);
    const A9: f64 = f64::from_bits(0x3fa9_7b4b_2476_0deb);
    const A10: f64 = f64::from_bits(0xbfa2_b444_2c6a_6c2f);
    const A11: f64 = f64::from_bits(0x3f90_ad3a_e322_da11);
    let w = z * z;
    z * (A1 + w * (A3 + w * (A5 + w * (A7 + w * (A9 + w * A11)))))
        + w * (A2 + w * (A4 + w * (A6 + w * (A8 + w * A10))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(y: f64, x: f64) {
        let each = atan2_of_each([(y, x), (1.0, 2.0), (-y, -x)]);
        let bits = |angles: [f64; 3]| angles.map(f64::to_bits);
        let expected = [atan2(y, x), atan2(1.0, 2.0), atan2(-y, -x)];
        assert_eq!(bits(each), bits(expected), "{y:e} {x:e}");
    }

    #[test]
    fn angles_of_every_size_have_the_bits_of_one_at_a_time() {
        for i in -100_000..100_000 {
            let angle_rad = f64::from(i) * 3.2e-5;
            let (sin, cos) = super::super::sin_cos(angle_rad);
            check(sin, cos);
            check(f64::from(i) * 1e-3, 1.0);
        }
        for power in -320..309 {
            for size in [1.0, -4.3] {
                let y = size * 10_f64.powi(power);
                [-5.0, 1e-200, 3e200].into_iter().for_each(|x| check(y, x));
            }
        }
        for bound in [0.4375_f64, 0.6875, 1.1875, 2.4375] {
            let beside = [bound, bound.next_up(), bound.next_down()];
            beside.into_iter().for_each(|y| check(y, 1.0));
        }
    }

    #[test]
    fn special_numbers_have_the_bits_of_one_at_a_time() {
        let special = [
            0.0,
            -0.0,
            1.0,
            f64::INFINITY,
            f64::MIN_POSITIVE,
            5e-324,
            f64::MAX,
        ];
        for y in special {
            special.into_iter().for_each(|x| check(y, x));
        }
        let [angle, _] = atan2_of_each([(f64::NAN, 1.0), (0.0, 1.0)]);
        assert!(angle.is_nan());
    }
}
