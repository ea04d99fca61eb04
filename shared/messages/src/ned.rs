//! Frames, in one place: the rig's are z up, x forward, y left; those of MAVLink and of firmwares are NED and FRD, half a turn
//! about x away.
//!
//! Each conversion is its own inverse. At take-off x points north, y west.

use crate::frames::wrap;
use crate::math::cos;

/// A vector of either world frame in the other, or of either body frame.
pub fn turned([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}

/// An attitude, body to world, as w, x, y, z.
pub fn turned_quaternion([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w, x, -y, -z]
}

/// An attitude as roll, pitch and yaw (ZYX) [rad], roll and yaw within a half turn.
pub fn turned_angles([roll, pitch, yaw]: [f64; 3]) -> [f64; 3] {
    [wrap(roll), -pitch, wrap(-yaw)]
}

/// Where the start of every flight is on the map, because a map needs a place: latitude, longitude [deg], height [m].
pub const ORIGIN: [f64; 3] = [47.397742, 8.545594, 488.0];

/// Semi-major axis of WGS 84 [m].
const EARTH_RADIUS_M: f64 = 6_378_137.0;

/// Latitude and longitude [1e-7 deg] and height [mm] of a NED position, on the plane that touches the earth at [`ORIGIN`].
pub fn geographic([north_m, east_m, down_m]: [f64; 3]) -> [i32; 3] {
    let [latitude, longitude, height_m] = ORIGIN;
    let parallel_m = EARTH_RADIUS_M * cos(latitude.to_radians());
    let latitude = latitude + (north_m / EARTH_RADIUS_M).to_degrees();
    let longitude = longitude + (east_m / parallel_m).to_degrees();
    [
        (latitude * 1e7).round() as i32,
        (longitude * 1e7).round() as i32,
        ((height_m - down_m) * 1e3).round() as i32,
    ]
}

/// The inverse of [`geographic`]: the NED position at the height of [`ORIGIN`] of a latitude and a longitude [deg].
pub fn local([latitude_deg, longitude_deg]: [f64; 2]) -> [f64; 3] {
    let [latitude, longitude, _] = ORIGIN;
    let parallel_m = EARTH_RADIUS_M * cos(latitude.to_radians());
    let north_m = EARTH_RADIUS_M * (latitude_deg - latitude).to_radians();
    [
        north_m,
        parallel_m * (longitude_deg - longitude).to_radians(),
        0.0,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    use crate::attitude::Attitude;
    use proptest::prelude::*;

    /// R v of a unit quaternion.
    fn rotated([w, x, y, z]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [
                a[1] * b[2] - a[2] * b[1],
                a[2] * b[0] - a[0] * b[2],
                a[0] * b[1] - a[1] * b[0],
            ]
        };
        let t = cross([x, y, z], v).map(|it| 2.0 * it);
        let second = cross([x, y, z], t);
        std::array::from_fn(|i| v[i] + w * t[i] + second[i])
    }

    /// Roll, pitch and yaw of a quaternion by the usual formulas, which hold in every right-handed frame.
    fn angles_of([w, x, y, z]: [f64; 4]) -> [f64; 3] {
        [
            (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)),
            (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin(),
            (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)),
        ]
    }

    fn unit(q: [f64; 4]) -> [f64; 4] {
        let norm = q.iter().map(|it| it * it).sum::<f64>().sqrt();
        q.map(|it| it / norm)
    }

    #[test]
    fn known_attitudes_and_places() {
        // 1 m left of and 2 m above the start is 1 m west and 2 m up.
        assert_eq!(turned([3.0, 1.0, 2.0]), [3.0, -1.0, -2.0]);
        // Nose to the left is a turn to the west: 270 degrees on a compass.
        assert_eq!(turned_angles([0.0, 0.0, FRAC_PI_2])[2], -FRAC_PI_2);
        // Nose down is a negative pitch in FRD, left side up a positive roll in both.
        assert_eq!(turned_angles([0.2, 0.3, 0.0]), [0.2, -0.3, 0.0]);
        let tilted = Attitude::of_euler(&[0.2, 0.3, 1.0].into()).wxyz();
        let angles = angles_of(turned_quaternion(tilted));
        for (angle, known) in angles.into_iter().zip([0.2, -0.3, -1.0]) {
            assert!((angle - known).abs() < 1e-12, "{angles:?}");
        }
        // A hundred metres north and east, and 12 m up.
        let [latitude, longitude, height_mm] = geographic([100.0, 100.0, -12.0]);
        assert_eq!(
            [latitude, longitude, height_mm],
            [473_986_403, 85_469_211, 500_000]
        );
    }

    proptest! {
        #[test]
        fn a_place_on_the_map_is_found_again(north_m in -1e3..1e3, east_m in -1e3..1e3) {
            let [latitude, longitude, _] = geographic([north_m, east_m, 0.0]);
            let again = local([latitude, longitude].map(|it| f64::from(it) * 1e-7));
            prop_assert!((again[0] - north_m).hypot(again[1] - east_m) < 0.02, "{again:?}");
        }

        #[test]
        fn each_conversion_is_its_own_inverse(v in prop::array::uniform3(-1e3..1e3), q in prop::array::uniform4(-1.0..1.0)) {
            prop_assert_eq!(turned(turned(v)), v);
            prop_assert_eq!(turned_quaternion(turned_quaternion(q)), q);
            let angles = v.map(|it| it / 1e3 * 3.0);
            let again = turned_angles(turned_angles(angles));
            for (one, other) in again.into_iter().zip(angles) {
                prop_assert!((one - other).abs() < 1e-12);
            }
        }

        /// Turning a vector of the body into the world gives the same in both conventions, by quaternion and by angles.
        #[test]
        fn vectors_and_attitudes_turn_alike(v in prop::array::uniform3(-1e3..1e3), q in prop::array::uniform4(0.1..1.0)) {
            let q = unit(q);
            let (here, there) = (turned(rotated(q, v)), rotated(turned_quaternion(q), turned(v)));
            for (one, other) in here.into_iter().zip(there) {
                prop_assert!((one - other).abs() < 1e-9);
            }
            let (here, there) = (turned_angles(angles_of(q)), angles_of(turned_quaternion(q)));
            for (one, other) in here.into_iter().zip(there) {
                prop_assert!((one - other).rem_euclid(2.0 * PI).min((other - one).rem_euclid(2.0 * PI)) < 1e-9);
            }
        }
    }
}
