//! Times both flights in turn: laws, hand, laws, hand.
//!
//! Interleaving them makes a disturbance of the machine hit both.

use std::hint::black_box;
use std::time::Instant;

use control_api::description::Refused;

use controller::Trajectory;

use crate::ScalarFlight;
use crate::laws::Laws;

/// One pair: the same ticks by the rig's laws and by hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPair {
    pub laws_s: f64,
    pub scalar_s: f64,
}

impl TimedPair {
    /// How many times longer the laws take.
    pub fn ratio(&self) -> f64 {
        self.laws_s / self.scalar_s
    }
}

/// Flies the first `ticks` ticks by the laws and by hand, in turn, `pairs` times.
///
/// One pair before them is flown and not counted: it finds caches and processor cold.
pub fn pairs(pairs: usize, ticks: u64) -> Result<Vec<TimedPair>, Refused> {
    let pair = || {
        Ok(TimedPair {
            laws_s: time(ticks, Laws::new(Trajectory::Lissajous, 0)?, Laws::tick),
            scalar_s: time(ticks, ScalarFlight::default(), ScalarFlight::tick),
        })
    };
    black_box(pair()?);
    (0..pairs).map(|_| pair()).collect()
}

/// Seconds per tick of a flight from its beginning.
fn time<F, S>(ticks: u64, flight: F, tick: impl Fn(&mut F) -> S) -> f64 {
    let mut flight = black_box(flight);
    let start = Instant::now();
    for _ in 0..ticks {
        black_box(tick(black_box(&mut flight)));
    }
    start.elapsed().as_secs_f64() / ticks as f64
}

#[cfg(test)]
mod tests {
    use controller::laws::adaptive;

    use super::*;

    /// Ticks of a flight of 10 s.
    const TICKS: u64 = 10_000;

    #[test]
    fn the_flight_by_hand_is_the_flight_of_the_laws() {
        let (mut laws, mut hand) = (
            Laws::new(Trajectory::Lissajous, 0).unwrap(),
            ScalarFlight::default(),
        );
        for tick in 0..=TICKS {
            laws.tick();
            let (sample, wrench) = (hand.tick(), &laws.wrench.content);
            let measured = &laws.state.content.measured;
            let body = [
                measured.position_w_m,
                measured.velocity_w_m_s,
                measured.attitude_rad,
                measured.rate_b_rad_s,
            ]
            .concat();
            let demand = [[wrench.thrust_n].as_slice(), &wrench.torque_b_nm].concat();
            let estimate = adaptive::estimate(&wrench.telemetry);
            for (name, ours, by_hand) in [
                ("body", body.as_slice(), sample.body.as_flattened()),
                ("thrust and torque", &demand, &sample.wrench),
                ("estimates", &estimate, &sample.estimate),
                (
                    "rotor speeds",
                    &laws.speeds.content.speed_rad_s,
                    &sample.speed,
                ),
            ] {
                for (ours, by_hand) in ours.iter().zip(by_hand) {
                    let off = (ours - by_hand).abs();
                    assert!(
                        off < 1e-9,
                        "{name} at tick {tick}: {by_hand} by hand, not {ours}"
                    );
                }
            }
        }
        let height_m = laws.state.content.measured.position_w_m[2];
        assert!(height_m > 1.0, "it flew: {height_m}");
    }
}
