//! Turbulence of the air: the gusts of the Dryden model for low altitudes, as in MIL-F-8785C.
//!
//! This goes beyond the paper, whose air stands still. The gusts do not depend on the flight: their height is 10 ft, the
//! lowest of the model, and the wind W20 carries them past the airframe. So with W20 in m/s and heights in feet
//!
//! ```text
//!     sigma_w = 0.1 W20,   sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4
//!     L_w = h,             L_u = L_v = h / (0.177 + 0.000823 h)^1.2
//!     H_u = sigma_u sqrt(2 L_u / V) / (1 + s L_u / V)
//!     H_v = sigma_v sqrt(L_v / V) (1 + sqrt(3) s L_v / V) / (1 + s L_v / V)^2,   H_w likewise,   V = W20
//! ```
//!
//! u, v, w lie along world x, y, z. Per axis two states hold what the filters keep of unit white noise, in the time unit
//! L/V: x1' = -x1 + noise, x2' = x1 - x2. Their step over a tick is exact: it has the covariance of the continuous
//! filter at any sample time, and the gusts have it from their first tick on.

use messages::math::{exp, exp_m1};
use messages::parameters::{Airframe, Parameter};
use nalgebra::Vector3;

use crate::noise::Stream;

const METRES_PER_FOOT: f64 = 0.3048;
const HEIGHT_FT: f64 = 10.0;
/// (0.177 + 0.000823 h)^0.4 at that height, and the cube of it.
const ROOT: f64 = 0.509_430_016_412_212_5;
const CUBED: f64 = ROOT * ROOT * ROOT;

/// Standard deviation of u, v, w over W20.
pub const INTENSITY: [f64; 3] = [0.1 / ROOT, 0.1 / ROOT, 0.1];
/// L of u, v, w [m].
pub const LENGTH_M: [f64; 3] = [
    HEIGHT_FT / CUBED * METRES_PER_FOOT,
    HEIGHT_FT / CUBED * METRES_PER_FOOT,
    HEIGHT_FT * METRES_PER_FOOT,
];

/// Time in units of L/V after which the start has no effect on the filter.
const LONG: f64 = 1e3;

#[derive(Clone, Copy, Debug)]
pub struct Turbulence {
    period_s: f64,
    seed: u64,
    /// The states of u, v, w; none until the turbulence is switched on.
    states: Option<[[f64; 2]; 3]>,
}

impl Turbulence {
    /// `period_s` is T [s].
    pub const fn new(period_s: f64, seed: u64) -> Self {
        Self {
            period_s,
            seed,
            states: None,
        }
    }

    /// Goes on to a tick. Returns its gust [m/s, world], if the parameters have turbulence.
    #[inline]
    pub fn gust(&mut self, airframe: &Airframe, tick: u64) -> Option<Vector3<f64>> {
        let w20 = airframe.get(Parameter::Turbulence);
        if w20 <= 0.0 {
            self.states = None;
            return None;
        }
        Some(self.next(w20, tick))
    }

    fn next(&mut self, w20: f64, tick: u64) -> Vector3<f64> {
        let noise = [Stream::Gust, Stream::FilteredGust].map(|it| it.normal(self.seed, tick));
        let before = self.states;
        let states = std::array::from_fn(|axis| {
            let noise = noise.map(|noise| noise[axis]);
            before.map_or_else(
                || step([0.0; 2], LONG, noise),
                |states| step(states[axis], w20 * self.period_s / LENGTH_M[axis], noise),
            )
        });
        self.states = Some(states);
        let root_3 = 3.0_f64.sqrt();
        Vector3::from_fn(|axis, _| {
            let [x1, x2] = states[axis];
            let shaped = match axis {
                0 => 2.0_f64.sqrt() * x1,
                _ => root_3 * x1 + (1.0 - root_3) * x2,
            };
            shaped * INTENSITY[axis] * w20
        })
    }
}

/// The states `duration` time units later. The stationary covariance is [1/2, 1/4; 1/4, 1/4]; what the decay takes from
/// it, the noise restores.
fn step([x1, x2]: [f64; 2], duration: f64, noise: [f64; 2]) -> [f64; 2] {
    let (decay, lost) = (exp(-duration), -exp_m1(-2.0 * duration) / 2.0);
    let squared = decay * decay;
    let own = lost.sqrt();
    let shared = (0.25 - squared * (0.25 + duration / 2.0)) / own;
    let second = 0.25 - squared * (0.25 + duration / 2.0 + duration * duration / 2.0);
    // Of a very short step, rounding leaves less than the square.
    let rest = (second - shared * shared).max(0.0).sqrt();
    [
        decay * x1 + own * noise[0],
        decay * (x2 + duration * x1) + shared * noise[0] + rest * noise[1],
    ]
}
