//! Arc tangent without a branch, for flights side by side.
//!
//! The polynomial and its four ranges are those of FreeBSD's msun (s_atan.c, e_atan2.c), which the `libm` crate carries
//! as well: bit for bit [`super::atan2`], which a test holds it to. Their notice:
//!
//! > Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved. Developed at SunSoft, a Sun Microsystems, Inc.
//! > business. Permission to use, copy, modify, and distribute this software is freely granted, provided that this
//! > notice is preserved.

use std::f64::consts::PI;

/// Quotient up to which it is known [1]: 2^60.
const LARGEST: f64 = 1_152_921_504_606_846_976.0;
/// What pi has beyond its 53 bits.
const PI_LO: f64 = f64::from_bits(0x3ca1_a626_3314_5c07);
/// Arc tangents of 0.5, 1, 1.5 and of infinity, and what they have beyond their 53 bits.
const HIGH: [f64; 4] = [
    f64::from_bits(0x3fdd_ac67_0561_bb4f),
    f64::from_bits(0x3fe9_21fb_5444_2d18),
    f64::from_bits(0x3fef_730b_d281_f69b),
    f64::from_bits(0x3ff9_21fb_5444_2d18),
];
const LOW: [f64; 4] = [
    f64::from_bits(0x3c7a_2b7f_222f_65e2),
    f64::from_bits(0x3c81_a626_3314_5c07),
    f64::from_bits(0x3c70_0788_7af0_cbbd),
    f64::from_bits(0x3c91_a626_3314_5c07),
];

/// Angle of the point (x, y) from the axis of x [rad]; false, and no angle, where x is 0 or not finite, or far smaller
/// than y.
#[inline(always)]
pub fn atan2_of_most(y: f64, x: f64) -> (f64, bool) {
    let quotient = (y / x).abs();
    // False of what is no number, too.
    let is_known = quotient <= LARGEST && x.abs() <= f64::MAX;
    // Nearest of five angles, and the tangent of what is left.
    let (over, under, high, low) = if quotient < 0.4375 {
        (quotient, 1.0, 0.0, 0.0)
    } else if quotient < 0.6875 {
        (2.0 * quotient - 1.0, 2.0 + quotient, HIGH[0], LOW[0])
    } else if quotient < 1.1875 {
        (quotient - 1.0, quotient + 1.0, HIGH[1], LOW[1])
    } else if quotient < 2.4375 {
        (quotient - 1.5, 1.0 + 1.5 * quotient, HIGH[2], LOW[2])
    } else {
        (-1.0, quotient, HIGH[3], LOW[3])
    };
    let rest = over / under;
    let angle = high - ((rest * powers(rest * rest) - low) - rest);
    let turned = if x < 0.0 { PI - (angle - PI_LO) } else { angle };
    (turned.copysign(y), is_known)
}

/// The powers of the arc tangent after x, over x; `z` is x^2.
#[inline(always)]
fn powers(z: f64) -> f64 {
    const A: [f64; 11] = [
        f64::from_bits(0x3fd5_5555_5555_550d),
        f64::from_bits(0xbfc9_9999_9998_ebc4),
        f64::from_bits(0x3fc2_4924_9200_83ff),
        f64::from_bits(0xbfbc_71c6_fe23_1671),
        f64::from_bits(0x3fb7_45cd_c54c_206e),
        f64::from_bits(0xbfb3_b0f2_af74_9a6d),
        f64::from_bits(0x3fb1_0d66_a0d0_3d51),
        f64::from_bits(0xbfad_de2d_52de_fd9a),
        f64::from_bits(0x3fa9_7b4b_2476_0deb),
        f64::from_bits(0xbfa2_b444_2c6a_6c2f),
        f64::from_bits(0x3f90_ad3a_e322_da11),
    ];
    let w = z * z;
    let even = z * (A[0] + w * (A[2] + w * (A[4] + w * (A[6] + w * (A[8] + w * A[10])))));
    let odd = w * (A[1] + w * (A[3] + w * (A[5] + w * (A[7] + w * A[9]))));
    even + odd
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::atan2;
    use crate::noise::uniform;

    fn check(y: f64, x: f64) -> bool {
        let (angle, is_known) = atan2_of_most(y, x);
        let exact = atan2(y, x).to_bits();
        if is_known {
            assert_eq!(angle.to_bits(), exact, "y = {y:e}, x = {x:e}");
        }
        is_known
    }

    #[test]
    fn it_is_the_arc_tangent_bit_for_bit() {
        let mut known = 0;
        for i in 0..400_000 {
            let number = |stream| 2.0 * uniform(7, i, stream) - 1.0;
            known += u64::from(check(number(0), number(1)));
            known +=
                u64::from(check(number(2) * 1e-9, number(3)) & check(number(3), number(2) * 1e-9));
        }
        assert_eq!(known, 800_000);
        // Beside the ends of the ranges.
        for end in [
            0.4375_f64,
            0.6875,
            1.1875,
            2.4375,
            1.0,
            0.5,
            1.5,
            f64::powi(2.0, -27),
            f64::powi(2.0, 58),
        ] {
            for y in [end, end.next_up(), end.next_down(), -end] {
                for x in [1.0, -1.0, 0.3, -7.0] {
                    assert!(check(y * x, x) && check(y, x));
                }
            }
        }
    }

    #[test]
    fn what_is_rare_is_right_or_said_to_be_unknown() {
        let rare = [
            0.0,
            f64::MIN_POSITIVE,
            5e-324,
            1.0,
            1e300,
            f64::MAX,
            f64::INFINITY,
            f64::NAN,
        ];
        let signed = || rare.iter().flat_map(|number| [*number, -number]);
        for y in signed() {
            for x in signed() {
                let is_known = check(y, x);
                let is_rare = x == 0.0 || !x.is_finite() || y.is_nan() || (y / x).abs() > 1e18;
                assert!(is_known || is_rare, "{y:e}, {x:e}");
            }
        }
    }
}
